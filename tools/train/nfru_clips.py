#!/usr/bin/python3
"""Renders the clips that NFRU is trained on: scenes at twice their rate, every other picture as the truth of what is between.

A clip is a crop of a picture of 960x540 or 480x270 pixels through FRAMES frames of a scene that is changed before it is rendered:
cameras as those of `nss_clips.py`, things that fly through, and what has no motion vectors: particles, discs, overlays that scroll. Its
data set OUT (of `shale scene --ratio 1`) holds the true pictures as colours; OUT/between/NNNN/FFFF.exr is the truth between
frames FFFF - 1 and FFFF. What a clip was drawn from is a function of its number; its scene lies beside it as
OUT/scenes/NNNN.json. Clips that exist are kept. Needs the program `shale`.

Example:
  python3 tools/train/nfru_clips.py --shale build/tools/shale --out build/train/nfru_data --clips 0 120
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
from pathlib import Path

import nss_clips
from files import write_atomically
from nss_clips import FOCAL, VARIED_FRAMES, View

SIZE = 256
FRAMES = 6
#: Sizes of whole pictures.
PICTURES = ((960, 540), (480, 270))


def _discs(rng: random.Random, scene: dict, view: View) -> None:
    """Discs with hard edges, each in a colour of its own, that cover what is behind them and move by up to 20 pixels."""
    for _ in range(rng.randint(3, 8)):
        place = [e + view.reach * rng.uniform(0.3, 0.7) * a for e, a in zip(view.eye, view.ahead)]
        unit = view.reach / FOCAL
        speed = unit * nss_clips._log(rng, 2, 40)
        scene.setdefault("particles", []).append({
            "at": place, "count": rng.randint(3, 12), "area": [view.reach * 0.3] * 3,
            "velocity": [speed * rng.uniform(-1, 1) for _ in range(3)], "spread": [speed * rng.uniform(0, 0.5)] * 3,
            "life": rng.randint(20, 80), "size": [unit * nss_clips._log(rng, 4, 40)] * 2,
            "color": [rng.uniform(0, 1) for _ in range(3)], "emission": nss_clips._log(rng, 0.3, 4),
            "opacity": rng.choice((1, 1, 0.6)), "blend": "over", "edge": "hard"})


def _overlay(rng: random.Random, scene: dict) -> None:
    """Text on the screen, at rest or scrolling."""
    wide, high = rng.uniform(0.3, 0.8), rng.uniform(0.2, 0.6)
    rect = [rng.uniform(0, 1 - wide), rng.uniform(0, 1 - high), wide, high]
    scene["overlays"] = scene.get("overlays", [])[:3] + [{
        "rect": rect, "rows": rng.randint(6, 20), "color": [rng.uniform(0.3, 2) for _ in range(3)],
        "background": [rng.uniform(0, 0.1) for _ in range(3)], "opacity": rng.uniform(0, 0.7),
        "scroll": rng.choice((0, 0, rng.uniform(-0.5, 0.5)))}]


def draw(number: int, scenes: Path) -> tuple[dict, int, tuple[int, int], tuple[int, int]]:
    """Scene, first frame, whole picture (w, h) and corner of a clip. Errors: OSError, ValueError."""
    rng = random.Random(number)
    known = {path: json.loads(path.read_text()) for path in sorted(scenes.glob("*.json"))}
    # Those with models need packages, and five times as long.
    scene = rng.choice([scene for scene in known.values() if "models" not in scene])
    cuts = {key["frame"] for key in scene["camera"]["path"] if key.get("cut")}
    start = rng.choice([f for f in range(scene["frames"] - VARIED_FRAMES)
                        if not cuts & set(range(f, f + VARIED_FRAMES + 1))])
    view = View.of(scene["camera"], start + VARIED_FRAMES // 2)
    nss_clips._camera(rng, scene, start, view)
    if rng.random() < 0.3:
        nss_clips._light(rng, scene, start, view)
    for share, change in ((0.45, lambda: nss_clips._flyers(rng, scene, start, view)),
                          (0.35, lambda: nss_clips._particles(rng, scene, view)),
                          (0.45, lambda: _discs(rng, scene, view)), (0.25, lambda: _overlay(rng, scene))):
        if rng.random() < share:
            change()
    whole = rng.choice(PICTURES)
    x, y = (int(min(max(rng.gauss(0.5, 0.25), 0), 1) * (size - SIZE)) // 4 * 4 for size in whole)
    # Their middle is where cameras and things that fly meet.
    return scene, start + (VARIED_FRAMES - FRAMES) // 2, whole, (x, y)


def render(options: argparse.Namespace, number: int) -> None:
    """One clip. Errors: OSError, ValueError, CalledProcessError."""
    scene, first, whole, corner = draw(number, options.scenes)
    name, twice = f"{number:04d}", options.out / "twice"
    (options.out / "scenes").mkdir(parents=True, exist_ok=True)
    path = options.out / "scenes" / f"{name}.json"
    write_atomically(path, (json.dumps(scene) + "\n").encode())
    rate = scene.get("frame_rate", 30)
    common = [options.shale, "scene", path, "--number", number, "--render", "{}x{}".format(*whole), "--ratio", 1, "--pattern",
              "0,0", "--crop", "{},{},{},{}".format(*corner, SIZE, SIZE)]

    def run(*more) -> None:
        subprocess.run([str(part) for part in (*common, *more)], check=True, stdout=subprocess.DEVNULL)

    run("-o", twice, "--first", 2 * first, "--frames", 2 * FRAMES - 1, "--frame-rate", 2 * rate)
    # The description comes last: a clip that has one is whole.
    between = options.out / "between" / name
    between.mkdir(parents=True, exist_ok=True)
    run("-o", options.out, "--first", first, "--frames", FRAMES, "--no-truth")
    for t in range(2 * FRAMES - 1):
        to = between if t % 2 else options.out / "x1" / "color" / name
        (twice / "ground_truth" / name / f"{t:04d}.exr").replace(to / f"{(t + 1) // 2:04d}.exr")
    shutil.rmtree(twice)


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when the program fails, 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(
        description="Renders the training clips of NFRU; clips that exist are kept.",
        epilog="example: python3 tools/train/nfru_clips.py --shale build/tools/shale --out build/train/nfru_data --clips 0 120",
    )
    parser.add_argument("--shale", type=Path, required=True, help="the program")
    parser.add_argument("--scenes", type=Path, default=Path(__file__).resolve().parents[2] / "models" / "scenes" / "train", help="folder of the scenes")
    parser.add_argument("--out", type=Path, required=True, help="data set folder")
    parser.add_argument("--clips", type=int, nargs=2, required=True, metavar=("FIRST", "COUNT"), help="numbers of the clips")
    options = parser.parse_args(arguments)
    first, count = options.clips
    try:
        for number in range(first, first + count):
            if not (options.out / "between" / f"{number:04d}" / f"{FRAMES - 1:04d}.exr").exists():
                render(options, number)
                print(f"clip {number} of {first} to {first + count - 1}", flush=True)
    except (OSError, ValueError, subprocess.CalledProcessError) as error:
        print(f"nfru_clips: error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
