#!/usr/bin/python3
"""Renders the clips that the NSS networks are trained on: crops of 1920x1080 pictures, ratios 1.33 to 3.

`GROUPS` are crops of the scenes as they are, at ratio 2. `Varied` clips change a scene before it is rendered: cameras
that rest, pan or slide, lamps that swing and blink in the dark, a sun that races, flat skies, things that fly through, particles.
What a clip was drawn from is a function of its number; its scene lies beside it as OUT/scenes/NNNN.json. Clips start
where the jitter of their ratio does (or 32 frames on), so that batches find others with the same. Needs the program
`shale`.

Example:
  python3 tools/train/nss_clips.py --shale build/tools/shale --out build/train/nss_data --varied 200
"""

from __future__ import annotations

import argparse
import json
import math
import random
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from files import write_atomically


SIZE = 256
FRAMES = 32


@dataclass(frozen=True)
class Group:
    """Clips `number` to `number + count - 1`: rounds over the first frames, then over the scenes."""

    number: int
    count: int
    scenes: tuple[str, ...]
    firsts: tuple[int, ...]
    top: int  # no crop starts above this row, which leaves out empty sky


GROUPS = (
    Group(0, 15, ("city", "courtyard", "forest"), (0, 32, 64), 120),
    Group(15, 40, ("city", "courtyard", "forest"), (0, 32, 64), 280),
    Group(100, 24, ("gears", "interior", "night", "wires"), (0, 32), 280),
    Group(200, 20, ("control_room", "fountain", "market", "meadow", "shadows"), (0, 32), 280),
    Group(300, 24, ("cellar", "night_office", "signs", "flyers"), (0, 32, 64), 100),
)


def clips(group: Group) -> list[tuple[int, str, int, int, int]]:
    """(number, scene, first frame, x, y) of each clip."""
    rng, out = random.Random(group.number + 1), []
    while len(out) < group.count:
        for first in group.firsts:
            for scene in group.scenes:
                x = rng.randrange(0, (1920 - SIZE) // 2) * 2
                y = rng.randrange(group.top // 2, (1080 - SIZE) // 2) * 2
                out.append((group.number + len(out), scene, first, x, y))
    return out[: group.count]


# ---- varied scenes ----------------------------------------------------------------------------------------

VARIED_NUMBER = 1000
VARIED_FRAMES = 20
#: Output over render size as two integers, share of the clips, crop side in output pixels, first frames.
RATIOS = (
    ((2, 1), 0.58, 192, (0, 32, 64)),
    ((3, 2), 0.14, 192, (0, 36, 54)),
    ((3, 1), 0.12, 192, (0,)),
    ((4, 3), 0.08, 192, (0, 28, 56)),
    ((5, 2), 0.08, 200, (0, 50)),
)
#: Output pixels per radian near the middle of a picture 1080 pixels high with the fields of view in use.
FOCAL = 935.0


def _moved(at: list[float], *steps: tuple[float, list[float]]) -> list[float]:
    """at + sum of factor * vector."""
    return [round(a + sum(f * v[i] for f, v in steps), 5) for i, a in enumerate(at)]


def _unit(v: list[float]) -> list[float]:
    length = math.sqrt(sum(x * x for x in v)) or 1.0
    return [x / length for x in v]


def _log(rng: random.Random, low: float, high: float) -> float:
    return math.exp(rng.uniform(math.log(low), math.log(high)))


@dataclass(frozen=True)
class View:
    """Where a camera is, and its axes."""

    eye: list[float]
    ahead: list[float]
    right: list[float]
    reach: float  # distance of the target

    @staticmethod
    def of(camera: dict, frame: int) -> View:
        """Of a camera of the scene format, linear between its keys."""
        keys = camera["path"]
        after = next((i for i, key in enumerate(keys) if key["frame"] >= frame), len(keys) - 1)
        a, b = keys[max(after - 1, 0)], keys[after]
        t = min(max((frame - a["frame"]) / max(b["frame"] - a["frame"], 1), 0.0), 1.0)
        eye, target = ([p + (q - p) * t for p, q in zip(a[k], b[k])] for k in ("eye", "target"))
        ahead = [q - p for p, q in zip(eye, target)]
        reach = math.sqrt(sum(x * x for x in ahead))
        ahead = _unit(ahead)
        return View(eye, ahead, _unit([-ahead[2], 0.0, ahead[0]]), reach)


def _camera(rng: random.Random, scene: dict, first: int, view: View) -> None:
    """Half of the cameras stay; others rest, pan or slide."""
    kind, keys = rng.random(), []
    if kind < 0.45:
        return
    turn = _log(rng, 0.004, 0.07) * rng.choice((-1, 1)) if 0.65 <= kind < 0.85 else 0.0
    slide = _log(rng, 3, 40) / FOCAL * view.reach * rng.choice((-1, 1)) if kind >= 0.85 else 0.0
    for t in range(VARIED_FRAMES):
        angle = turn * (t - VARIED_FRAMES / 2)
        eye = _moved(view.eye, (slide * (t - VARIED_FRAMES / 2), view.right))
        target = _moved(eye, (view.reach * math.cos(angle), view.ahead), (view.reach * math.sin(angle), view.right))
        keys.append({"frame": first + t, "eye": eye, "target": target})
    scene["camera"] |= {"interpolation": "linear", "path": keys if kind >= 0.65 else keys[:1]}


def _rest(scene: dict, first: int) -> None:
    """The camera stays where the scene has it in the middle of the clip."""
    at = first + VARIED_FRAMES // 2
    key = min(scene["camera"]["path"], key=lambda key: abs(key["frame"] - at))
    scene["camera"] |= {"interpolation": "linear", "path": [key]}


def _light(rng: random.Random, scene: dict, first: int, view: View) -> None:
    """Night with lamps that swing fast, or a sun that races so that shadows sweep."""
    kind, sun, sky = rng.random(), scene["sun"], scene.setdefault("sky", {})
    if kind < 0.3:
        dim = _log(rng, 0.01, 0.2)
        sun["color"] = [c * dim for c in sun.get("color", [3, 3, 3])]
        sky.pop("harmonics", None)
        for name, default in (("zenith", 0.3), ("horizon", 0.6), ("ground", 0.2), ("ambient", 0.3)):
            sky[name] = [c * dim for c in sky.get(name, [default] * 3)]
        scene["exposure"] = scene.get("exposure", 1.0) * rng.uniform(1.0, 3.0)
        scene["lights"], signals = [], scene.setdefault("signals", {})
        for index in range(rng.randint(1, 4)):
            place = _moved(view.eye, (view.reach * rng.uniform(0.2, 1.1), view.ahead),
                           (view.reach * rng.uniform(-0.4, 0.4), view.right), (rng.uniform(0, 2.5), [0, 1, 0]))
            size = view.reach * _log(rng, 0.05, 0.4)
            swing = [size * rng.uniform(-1, 1), size * rng.uniform(-0.3, 0.3), size * rng.uniform(-1, 1)]
            scene["lights"].append({
                "at": place, "color": [rng.uniform(0.5, 1) ** 3 * 14 for _ in range(3)],
                "range": view.reach * rng.uniform(0.4, 1.2),
                "animate": {"bob": {"offset": swing, "period": round(_log(rng, 5, 60))}}})
            if rng.random() < 0.5:
                signals[f"lamp{index}"] = rng.choice((
                    {"blink": {"period": rng.randint(4, 30), "off": rng.choice((0, 0.1, 0.5)), "random": True}},
                    {"flicker": {"amount": rng.uniform(0.3, 1), "period": rng.randint(2, 8)}},
                    {"wave": {"amount": rng.uniform(0.3, 1), "period": rng.randint(6, 40)}}))
                scene["lights"][-1]["signal"] = f"lamp{index}"
    elif kind < 0.45:
        rate, start, height = _log(rng, 0.004, 0.12) * rng.choice((-1, 1)), rng.uniform(0, 6.3), rng.uniform(0.4, 1.2)
        sun.pop("direction", None)
        turns = [(first + t, start + rate * t) for t in range(VARIED_FRAMES)]
        sun["path"] = [{"frame": at, "direction": [math.cos(angle), height, math.sin(angle)]} for at, angle in turns]
    if rng.random() < 0.25:  # ghosts show most where nothing else is
        sky |= {"clouds": 0, "stars": 0, "horizon": sky.get("zenith", [0.3, 0.4, 0.8])}


def _material(rng: random.Random) -> dict:
    def colour() -> list[float]:
        return [rng.uniform(0, 1) ** 2 for _ in range(3)]

    kind = rng.random()
    if kind < 0.5:
        return {"color": [c * rng.choice((0.05, 0.3, 1.0)) for c in colour()]}
    if kind < 0.65:
        return {"color": colour(), "emission": _log(rng, 2, 60)}
    if kind < 0.8:
        return {"color": colour(), "cutout": rng.choice(("mesh", "leaves", "glyphs")),
                "cutout_cell": rng.uniform(0.05, 0.3), "cutout_amount": rng.uniform(0.2, 0.6)}
    return {"pattern": rng.choice(("stripes", "checker", "glyphs", "dots")), "color": colour(), "color_b": colour(),
            "cell": [rng.uniform(0.05, 0.4)] * 2, "width": 0.4}


def _flyers(rng: random.Random, scene: dict, first: int, view: View) -> None:
    """Things that cross the view: poles, wires, rotors, balls, nets."""
    materials = scene.setdefault("materials", {})
    for index in range(rng.randint(2, 7)):
        name = f"flyer{index}"
        materials[name] = _material(rng)
        away = view.reach * rng.uniform(0.25, 0.9)
        size = away * _log(rng, 0.02, 0.12)
        speed = _log(rng, 1, 30) / FOCAL * away * rng.choice((-1, 1))
        climb = speed * rng.uniform(-0.4, 0.4)
        middle = _moved(view.eye, (away, view.ahead), (away * rng.uniform(-0.3, 0.3), view.right),
                        (away * rng.uniform(-0.1, 0.3), [0, 1, 0]))
        half = VARIED_FRAMES / 2
        path = [{"frame": first + t, "at": _moved([0, 0, 0], (speed * (t - half), view.right),
                                                  (climb * (t - half), [0, 1, 0]))} for t in (0, VARIED_FRAMES)]
        kind = rng.randrange(5)
        parts = [{"shape": "sphere", "radius": size * 0.6}]
        if kind == 1:
            parts = [{"shape": "cylinder", "radius": size * 0.05, "height": size * 8}]
        elif kind == 2:
            ends = [[2 * size, 0, 0], [0, 0, 2 * size]]
            parts = [{"shape": "wire", "from": [-x for x in end], "to": end, "radius": size * 0.03} for end in ends]
            parts.append({"shape": "box", "size": [size * 0.4] * 3})
        elif kind == 3:
            parts = [{"shape": "quad", "size": [size * 3, size * 2]}]
        elif kind == 4:
            parts = [{"shape": "box", "size": [size, size * 0.2, size]}]
        for part in parts:
            part["material"] = name
        turning = {"spin": {"axis": [0, 1, 0], "degrees": rng.choice((0, 3, 11, 37))}}
        scene["objects"].append({"at": middle, "animate": {"path": path, "interpolation": "linear"},
                                 "objects": [{"objects": parts, "animate": turning}]})


def _particles(rng: random.Random, scene: dict, view: View) -> None:
    for _ in range(rng.randint(1, 2)):
        place = _moved(view.eye, (view.reach * rng.uniform(0.3, 0.9), view.ahead), (rng.uniform(-1, 1), [0, 1, 0]),
                       (view.reach * rng.uniform(-0.2, 0.2), view.right))
        unit = view.reach / FOCAL  # about a pixel
        over = rng.random() < 0.3
        scene.setdefault("particles", []).append({
            "at": place, "count": rng.randint(40, 250), "area": [view.reach * rng.uniform(0, 0.2)] * 3,
            "velocity": [unit * rng.uniform(-6, 6) for _ in range(3)], "spread": [unit * rng.uniform(0, 6)] * 3,
            "gravity": [0, -unit * rng.uniform(0, 0.4), 0], "life": rng.randint(6, 50),
            "size": [unit * _log(rng, 1, 9 if not over else 40) for _ in range(2)],
            "color": [rng.uniform(0.2, 1) for _ in range(3)], "emission": _log(rng, 0.5, 100) if not over else 0.3,
            "opacity": rng.uniform(0.2, 1), "blend": "over" if over else "add",
            "edge": rng.choice(("soft", "hard"))})


@dataclass(frozen=True)
class Varied:
    """A clip of a changed scene."""

    number: int
    scene: str
    first: int
    ratio: tuple[int, int]
    crop: tuple[int, int, int, int]
    json: dict

    @staticmethod
    def of(number: int, scenes: Path, steady: bool = False) -> Varied:
        """The clip with this number, `steady`: its light as the scene has it, the camera too or at rest. Errors: OSError,
        ValueError for scenes that cannot be read."""
        rng = random.Random(number)
        path = rng.choice(sorted(scenes.glob("*.json")))
        ratio, _, size, firsts = rng.choices(RATIOS, [r[1] for r in RATIOS])[0]
        scene = json.loads(path.read_text())
        first = rng.choice([f for f in firsts if f + VARIED_FRAMES <= scene["frames"]])
        view = View.of(scene["camera"], first + VARIED_FRAMES // 2)
        if steady:
            flown = False
            if rng.random() < 0.6:
                _rest(scene, first)
        else:
            _camera(rng, scene, first, view)
            _light(rng, scene, first, view)
            flown = rng.random() < 0.4
            if flown:
                _flyers(rng, scene, first, view)
            if rng.random() < 0.25:
                _particles(rng, scene, view)
        step = 4 * ratio[0]
        wide, high, spread = 1920 - size, 1080 - size, 0.15 if flown else 0.4
        x, y = (int(min(max(rng.gauss(0.5, spread), 0), 1) * room) // step * step for room in (wide, high))
        return Varied(number, path.stem, first, ratio, (x, y, size, size), scene)


def render(options: argparse.Namespace, number: int, scene: Path, first: int, frames: int, crop: tuple,
           more: list) -> None:
    """Runs the program. Errors: OSError, CalledProcessError."""
    command = [options.shale, "scene", scene, "-o", options.out, "--number", number, "--first", first, "--frames",
               frames, "--crop", ",".join(map(str, crop)), *more]
    subprocess.run([str(part) for part in command], check=True)


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when the program fails, 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(
        description="Renders the training clips of the NSS networks; clips that exist are kept.",
        epilog="example: python3 tools/train/nss_clips.py --shale build/tools/shale --out build/train/nss_data",
    )
    parser.add_argument("--shale", type=Path, required=True, help="the program")
    parser.add_argument("--scenes", type=Path, default=Path("models/scenes/train"), help="folder of the scenes")
    parser.add_argument("--out", type=Path, required=True, help="data set folder")
    parser.add_argument("--varied", type=int, nargs="+", default=[0], metavar="N",
                        help="varied clips: how many, or the first and how many (default: 0)")
    parser.add_argument("--steady", action="store_true", help="varied clips: without moving light and added things")
    parser.add_argument("--no-groups", action="store_true", help="varied clips alone")
    options = parser.parse_args(arguments)
    start, count = ([0] + options.varied)[-2:]
    try:
        for group in () if options.no_groups else GROUPS:
            for number, scene, first, x, y in clips(group):
                if not (options.out / f"{number:04d}.json").exists():
                    render(options, number, options.scenes / f"{scene}.json", first, FRAMES, (x, y, SIZE, SIZE), [])
        for number in range(VARIED_NUMBER + start, VARIED_NUMBER + start + count):
            if not (options.out / f"{number:04d}.json").exists():
                clip = Varied.of(number, options.scenes, options.steady)
                (options.out / "scenes").mkdir(parents=True, exist_ok=True)
                scene = options.out / "scenes" / f"{number:04d}.json"
                write_atomically(scene, (json.dumps(clip.json) + "\n").encode())
                w, h = (size * clip.ratio[1] // clip.ratio[0] for size in (1920, 1080))
                render(options, number, scene, clip.first, VARIED_FRAMES, clip.crop,
                       ["--render", f"{w}x{h}", "--output-size", "1920x1080"])
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        print(f"nss_clips: error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
