"""Clips for NSS: the data set on disk, a cache of it, random crops, augmentation.

A data set is a folder with NNNN.json per clip and ground_truth/, motion_gt/, x2/color/, x2/depth/, x2/motion/ with
NNNN/FFFF.exr (section 5 of the NSS notes; names of our exporter; other ratios in x1_5 and the like). Motion is forward
uv motion (prev = uv - m), clamped to +-1; Jitter is in render pixels; Exposure is linear.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
import torch

import nss_passes as passes
import training
from exr import read_exr


DEFAULT_EXPOSURE = 7.38905609893065


@dataclass
class Clip:
    """One clip. Pictures are CPU tensors, one entry per frame; colour and ground truth half floats."""

    name: str
    colour: torch.Tensor  # [t, 3, h, w]
    depth: torch.Tensor  # [t, 1, h, w] float32
    motion: torch.Tensor  # [t, 2, h, w]
    truth: torch.Tensor  # [t, 3, H, W]
    truth_motion: torch.Tensor  # [t, 2, H, W]
    jitter: list[tuple[float, float]]
    exposure: list[float]
    cut: list[bool]
    camera: list[list[float]]
    reverse: bool

    @property
    def render(self) -> tuple[int, int]:
        """(w, h)."""
        return self.colour.shape[3], self.colour.shape[2]

    @property
    def output(self) -> tuple[int, int]:
        """(W, H)."""
        return self.truth.shape[3], self.truth.shape[2]

    def frame(self, t: int) -> passes.Frame:
        """Frame t as a batch of one."""
        return passes.Frame(
            passes.sanitise(self.colour[t : t + 1].float()), self.depth[t : t + 1], self.motion[t : t + 1].float(),
            self.jitter[t], torch.tensor(self.exposure[t]).view(1, 1, 1, 1), torch.tensor([self.camera[t]]),
            self.reverse)


def _picture(path: Path, names: tuple[str, ...], kind) -> np.ndarray:
    """Channels by any of their names, e.g. "R|X"; a single channel of another name will do for one."""
    channels = read_exr(path)
    out = []
    for name in names:
        found = [channels[option] for option in name.split("|") if option in channels]
        if not found and len(names) == 1 and len(channels) == 1:
            found = list(channels.values())
        if not found:
            raise ValueError(f"{path}: channel {name} is missing, found {', '.join(sorted(channels))}")
        out.append(found[0].astype(kind))
    return np.stack(out)


def _sequence(path: Path) -> dict:
    """What a sequence's file holds. Errors: OSError, ValueError."""
    try:
        sequence = json.loads(path.read_text())
    except ValueError as error:
        raise ValueError(f"{path}: not a sequence description ({error})") from None
    if not isinstance(sequence, dict) or not isinstance(sequence.get("UpscalingRatiosIndices", {}), dict):
        raise ValueError(f"{path}: not a sequence description")
    return sequence


def ratio_folder(root: Path, name: str) -> str:
    """Folder of the rendered pictures of a clip. Errors: OSError, ValueError when there is none."""
    found = sorted(path.parent.parent.name for path in root.glob(f"x*/color/{name}"))
    own = {key.replace(".", "_") for key in _sequence(root / f"{name}.json").get("UpscalingRatiosIndices", {})}
    if own:  # pictures of other ratios were left by another clip of its name
        found = [folder for folder in found if folder.replace(".", "_") + "_index" in own]
    if not found:
        raise ValueError(f"{root}: no pictures of clip {name} in x*/color/{name}, of a ratio that its file names")
    return "x2" if "x2" in found else found[0]


def load_cameras(path: Path, first: int = 0, count: int | None = None) -> tuple[list[list[float]], list[float], bool, list[dict]]:
    """Of the frames of a sequence: `nss_passes.camera_vector` and exposure, whether depth is reversed, and what the file says of
    each frame. Errors: OSError, ValueError."""
    sequence = _sequence(path)
    try:
        frames = sequence["Frames"]
        frames = frames[first : None if count is None else first + count]
        exposure = [float(f.get("Exposure", DEFAULT_EXPOSURE)) for f in frames]
        reverse = bool(sequence.get("ReverseZ", False))
        camera = [passes.camera_vector(f["FovX"], f["FovY"], f["CameraNearPlane"], f["CameraFarPlane"], reverse)
                  for f in frames]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ValueError(f"{path}: not a sequence description ({error})") from None
    return camera, exposure, reverse, frames


def load_clip(root: Path, name: str, count: int | None = None, ratio: str | None = None, first: int = 0) -> Clip:
    """Reads a clip; ratio: folder of its pictures (default: x2, else the first). Errors: OSError, ValueError."""
    ratio = ratio or ratio_folder(root, name)
    path = root / f"{name}.json"
    camera, exposure, reverse, frames = load_cameras(path, first, count)
    try:
        jitter = [(float(f["Jitter"]["X"]), float(f["Jitter"]["Y"])) for f in frames]
        cut = [bool(f.get("CameraCut", False)) for f in frames]
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{path}: not a sequence description ({error})") from None
    if not (root / ratio).is_dir():
        ratio = ratio.replace(".", "_")  # tools write x1_5 or x1.5
    rgb, xy = ("R", "G", "B"), ("R|X|U", "G|Y|V")
    layout = {"colour": (f"{ratio}/color", rgb, np.float16), "depth": (f"{ratio}/depth", ("Z|R|Y|V",), np.float32),
              "motion": (f"{ratio}/motion", xy, np.float16), "truth": ("ground_truth", rgb, np.float16),
              "truth_motion": ("motion_gt", xy, np.float16)}
    pictures = {}
    for key, (folder, names, kind) in layout.items():
        files = sorted((root / folder / name).glob("*.exr"))[first : first + len(frames)]
        if len(files) != len(frames) or not files:
            raise ValueError(f"{root / folder / name}: {len(files)} pictures for {len(frames)} frames")
        pictures[key] = torch.from_numpy(np.stack([_picture(file, names, kind) for file in files]))
    for key in ("motion", "truth_motion"):
        pictures[key] = torch.nan_to_num(pictures[key].float()).clamp(-1.0, 1.0).half()
    return Clip(name, **pictures, jitter=jitter, exposure=exposure, cut=cut, camera=camera, reverse=reverse)


def clip_names(root: Path) -> list[str]:
    """Clips of a data set in order. Errors: ValueError when there are none."""
    names = sorted(path.stem for path in root.glob("*.json") if (root / "ground_truth" / path.stem).is_dir())
    if not names:
        raise ValueError(f"{root}: no clips (NNNN.json with ground_truth/NNNN)")
    return names


def load_clips(root: Path, cache: Path | None = None, report=lambda line: None) -> list[Clip]:
    """All clips of a data set; `cache` keeps them in one file, and only what it lacks is read."""
    names = clip_names(root)
    # A pickle of our own making: current PyTorch has to be told.
    kept = torch.load(cache, weights_only=False) if cache is not None and cache.exists() else []
    clips = {clip.name: clip for clip in kept}
    missing = [name for name in names if name not in clips]
    for name in missing:
        report(f"reading clip {name}")
        clips[name] = load_clip(root, name)
    out = [clips[name] for name in names]
    if cache is not None and missing:
        cache.parent.mkdir(parents=True, exist_ok=True)
        training.save_atomically(out, cache)
    return out


@dataclass(frozen=True)
class Augmentation:
    """Applied alike to all frames of a batch: mirror x, mirror y, swap axes, in this order; colour channel order."""

    mirror_x: bool = False
    mirror_y: bool = False
    swap: bool = False
    channels: tuple[int, int, int] = (0, 1, 2)

    def picture(self, x: torch.Tensor) -> torch.Tensor:
        """`[..., rows, columns]`."""
        axes = [axis for axis, on in ((-1, self.mirror_x), (-2, self.mirror_y)) if on]
        x = torch.flip(x, axes) if axes else x
        return x.transpose(-1, -2) if self.swap else x

    def vector(self, x: torch.Tensor) -> torch.Tensor:
        """`[n, 2, rows, columns]`, (x, y)."""
        signs = x.new_tensor([-1.0 if mirrored else 1.0 for mirrored in (self.mirror_x, self.mirror_y)])
        x = self.picture(x) * signs.view(2, 1, 1)
        return x.flip(1) if self.swap else x

    def jitter(self, j: tuple[float, float]) -> tuple[float, float]:
        """A mirrored sample position l + 0.5 + j is again one, with the other sign."""
        x, y = -j[0] if self.mirror_x else j[0], -j[1] if self.mirror_y else j[1]
        return (y, x) if self.swap else (x, y)


#: Lights that `Light` adds up.
LIGHTS = 2


@dataclass(frozen=True)
class Light:
    """Light that changes where nothing moves: factors on colour and truth alike, the sum of discs with soft rims.

    Arrays per batch entry and light: centre and velocity (uv, uv per frame) `[n, k, 2]`, radius and rim (uv)
    `[n, k]`, strength, the natural logarithm of the factor per colour and frame, `[n, k, 3, t]`. A disc far away is a
    straight edge, a huge one lights everything.
    """

    centre: torch.Tensor
    velocity: torch.Tensor
    radius: torch.Tensor
    rim: torch.Tensor
    strength: torch.Tensor

    @staticmethod
    def draw(rng: np.random.Generator, batch: int, frames: int, pixel: float) -> Light:
        """Lamps that switch, flicker, pulse and wander, each alone or over everything. pixel: of the truth, in uv."""
        shape = (batch, LIGHTS)
        radius, centre = rng.uniform(0.1, 0.6, shape), rng.uniform(0.0, 1.0, (*shape, 2))
        far = rng.random(shape) < 0.35
        angle = rng.uniform(0, 2 * math.pi, shape)
        away = np.stack([np.cos(angle), np.sin(angle)], 2) * 20.0
        centre = np.where(far[..., None], 0.5 + away, centre)
        radius = np.where(far, 20.0 + rng.uniform(-0.5, 0.5, shape), radius)
        radius = np.where(rng.random(shape) < 0.25, 100.0, radius)
        speed = np.exp(rng.uniform(math.log(0.002), math.log(0.15), shape)) * (rng.random(shape) < 0.6)
        turn = rng.uniform(0, 2 * math.pi, shape)
        rim = np.exp(rng.uniform(math.log(pixel), math.log(0.3), shape))
        t = np.arange(frames)
        waves = np.zeros((*shape, frames))
        for where in np.ndindex(*shape):
            kind, period, phase = rng.integers(5), rng.uniform(3, 40), rng.uniform(0, 1)
            if kind == 0:  # stays, so that only its place changes
                waves[where] = 1.0
            elif kind == 1:  # is switched once
                waves[where] = t >= rng.integers(1, frames)
            elif kind == 2:
                waves[where] = (t / period + phase) % 1.0 < 0.5
            elif kind == 3:
                waves[where] = 0.5 + 0.5 * np.sin(2 * math.pi * (t / period + phase))
            else:  # flickers
                waves[where] = rng.random(frames)
        colour = rng.uniform(-1.8, 1.8, (*shape, 1)) + rng.uniform(-0.5, 0.5, (*shape, 3))
        tensors = (centre, np.stack([np.cos(turn) * speed, np.sin(turn) * speed], 2), radius, rim,
                   colour[..., None] * waves[:, :, None])
        return Light(*(torch.from_numpy(np.asarray(part)).float() for part in tensors))

    def gain(self, t: int, w: int, h: int, shift: tuple[float, float] = (0.0, 0.0)) -> torch.Tensor:
        """`[n, 3, h, w]` at the texel centres plus `shift` texels."""
        x, y = (torch.arange(w) + 0.5 + shift[0]) / w, (torch.arange(h) + 0.5 + shift[1]) / h
        total = 0.0
        for k in range(LIGHTS):
            cx, cy = (self.centre[:, k] + t * self.velocity[:, k]).view(-1, 2, 1, 1).unbind(1)
            distance = torch.sqrt((x - cx) ** 2 + (y[:, None] - cy) ** 2)
            inside = torch.sigmoid((self.radius[:, k].view(-1, 1, 1) - distance) / self.rim[:, k].view(-1, 1, 1))
            total = total + self.strength[:, k, :, max(t, 0), None, None] * inside[:, None]
        return total.exp()


class Sequence:
    """A batch of crops through frames of several clips.

    starts: first frame of each clip; crop: side in render pixels; ratio: output over render size; gain: on the exposure
    `[n, 1, 1, t]`; full: (w, h) of the whole picture behind the crops; known: whether the frame before the first one
    exists and its truth is the history of the first; flash: factors on all light, colour and truth, `[n, 1, 1, t]`.
    """

    def __init__(self, clips: list[Clip], starts: list[int], corners: list[tuple[int, int]], crop: int,
                 ratio: Fraction, augmentation: Augmentation, gain: torch.Tensor, device: str = "cpu",
                 full: tuple[int, int] | None = None, light: Light | None = None, known: bool = False,
                 flash: torch.Tensor | None = None):
        self.full, self.flash = full or clips[0].render, flash
        self.clips, self.starts, self.corners, self.crop, self.ratio = clips, starts, corners, crop, ratio
        self.augmentation, self.gain, self.device, self.light, self.known = augmentation, gain, device, light, known

    def _crops(self, key: str, t: int, scale: Fraction) -> torch.Tensor:
        size = int(self.crop * scale)
        return torch.stack([
            getattr(clip, key)[start + t, :, int(y * scale) : int(y * scale) + size,
                               int(x * scale) : int(x * scale) + size]
            for clip, start, (x, y) in zip(self.clips, self.starts, self.corners)
        ]).float()

    def _colours(self, key: str, t: int, scale: Fraction, shift: tuple[float, float]) -> torch.Tensor:
        colours = self._crops(key, t, scale)
        if self.light is not None:
            colours *= self.light.gain(t, colours.shape[3], colours.shape[2], shift)
        if self.flash is not None and t >= 0:
            colours *= self.flash[..., t, None]
        colours = self.augmentation.picture(colours)[:, list(self.augmentation.channels)].contiguous()
        return passes.sanitise(colours.to(self.device))

    def _vectors(self, key: str, t: int, scale: Fraction) -> torch.Tensor:
        # uv of the clip to uv of the crop
        factor = torch.tensor([[clip.render[0] / self.crop, clip.render[1] / self.crop] for clip in self.clips])
        return self.augmentation.vector(self._crops(key, t, scale) * factor.view(-1, 2, 1, 1)).to(self.device)

    def frame(self, t: int) -> passes.Frame:
        """Frame t of the batch."""
        a, starts, full = self.augmentation, self.starts, self.full
        exposure = torch.tensor([clip.exposure[s + t] for clip, s in zip(self.clips, starts)]).view(-1, 1, 1, 1)
        exposure = exposure * self.gain[..., max(t, 0), None]
        camera = torch.tensor([[*clip.camera[s + t][:2], clip.camera[s + t][2] * full[0] / clip.render[0],
                                clip.camera[s + t][3] * full[1] / clip.render[1]]
                               for clip, s in zip(self.clips, starts)])
        if a.swap:
            camera, full = camera[:, [0, 1, 3, 2]], (full[1], full[0])
        jitter = self.clips[0].jitter[starts[0] + t]
        return passes.Frame(
            self._colours("colour", t, Fraction(1), jitter), a.picture(self._crops("depth", t, 1)).contiguous().to(
                self.device), self._vectors("motion", t, Fraction(1)), a.jitter(jitter), exposure.to(self.device),
            camera.to(self.device), self.clips[0].reverse, full)

    def truth(self, t: int) -> torch.Tensor:
        """Ground truth, linear `[n, 3, H, W]`."""
        return self._colours("truth", t, self.ratio, (0.0, 0.0))

    def truth_motion(self, t: int) -> torch.Tensor:
        """uv motion at output size."""
        return self._vectors("truth_motion", t, self.ratio)


def crop_size(clip: Clip, crop: int) -> tuple[int, Fraction]:
    """Side in render pixels of a crop that shows what `crop` pixels show at ratio 2, and the ratio.

    It is a multiple of 16 whose output has whole pixels. Errors: ValueError when the clip is too small or its ratio
    differs between the axes.
    """
    ratio = Fraction(clip.output[0], clip.render[0])
    step = math.lcm(16, ratio.denominator)
    side = max(round(2 * crop / ratio / step), 1) * step
    if ratio != Fraction(clip.output[1], clip.render[1]) or side > min(clip.render):
        raise ValueError(f"clip {clip.name}: {clip.render} to {clip.output} does not fit crops of {side}")
    return side, ratio


#: Shares of the sequences with light that changes, with exposure that changes, and with the truth as first history.
LIT, EXPOSED, KNOWN = 0.4, 0.2, 0.3


def _gains(rng: np.random.Generator, batch: int, frames: int) -> torch.Tensor:
    """Exposure factors `[n, 1, 1, t]`: +-0.75 stops, and for some a step or a drift of up to 2 stops."""
    stops = np.repeat(rng.uniform(-0.75, 0.75, (batch, 1)), frames, 1)
    for row in stops:
        if rng.random() < EXPOSED:
            at, lasts = rng.integers(1, frames), rng.choice((1, 4, 12))
            row += rng.uniform(-2, 2) * np.clip((np.arange(frames) - at + 1) / lasts, 0, 1)
    return torch.from_numpy(2.0**stops).float().view(batch, 1, 1, frames)


def _flash(rng: np.random.Generator, batch: int, frames: int) -> torch.Tensor:
    """Factors `[n, 1, 1, t]`: for one to three frames 2^3 to 2^14 times the light, or so much less, then as before."""
    stops = np.zeros((batch, frames))
    for row in stops:
        at = rng.integers(1, max(frames - 4, 2))
        row[at : at + rng.integers(1, 4)] = rng.uniform(3, 14) * rng.choice((-1, 1))
    return torch.from_numpy(2.0**stops).float().view(batch, 1, 1, frames)


def draw(clips: list[Clip], rng: np.random.Generator, batch: int, crop: int, frames: int, augment: bool = True,
         device: str = "cpu", full: tuple[int, int] | None = None, known: float = KNOWN,
         flashes: float = 0.0) -> Sequence:
    """A random sequence. All crops share the jitter of their frames, because the kernel tables do.

    crop: side in render pixels at ratio 2, see `crop_size`; full: (w, h) of the whole picture at ratio 2; known: share of
    the sequences that start with the truth as history; flashes: of those in which all light flashes. Errors:
    ValueError when no clip has `frames` frames without a cut.
    """
    for _ in range(1000):
        lead = clips[rng.integers(len(clips))]
        if len(lead.jitter) < frames:
            continue
        start = int(rng.integers(len(lead.jitter) - frames + 1))
        if not any(lead.cut[start + 1 : start + frames]):
            break
    else:
        raise ValueError(f"no clip has {frames} frames without a cut")
    side, ratio = crop_size(lead, crop)
    starts_known = augment and rng.random() < known
    jitter = lead.jitter[start : start + frames]
    fitting = [(c, s) for c in clips if c.render == lead.render and c.output == lead.output
               and c.reverse == lead.reverse for s in range(len(c.jitter) - frames + 1)
               if c.jitter[s] == jitter[0] and c.jitter[s : s + frames] == jitter
               and not any(c.cut[s + 1 : s + frames])]
    order = rng.permutation(len(fitting))
    chosen, starts = zip(*(fitting[order[i % len(fitting)]] for i in range(batch)))
    starts_known = starts_known and all(
        s > 0 and not c.cut[s] and c.jitter[s - 1] == lead.jitter[start - 1] and start > 0
        for c, s in zip(chosen, starts))
    # Corners are whole pixels of both pictures, and keep the phase of 4x4 blocks.
    step = math.lcm(4, ratio.denominator)
    corners = [tuple(int(rng.integers((size - side) // step + 1)) * step for size in lead.render) for _ in chosen]
    light = flash = None
    if augment:
        flips = rng.random(3) < 0.5
        how = Augmentation(*(bool(f) for f in flips), tuple(int(i) for i in rng.permutation(3)))
        gain = _gains(rng, batch, frames)
        if rng.random() < LIT:
            light = Light.draw(rng, batch, frames, 1.0 / float(side * ratio))
        if flashes and rng.random() < flashes:
            flash = _flash(rng, batch, frames)
    else:
        how, gain = Augmentation(), torch.ones(batch, 1, 1, frames)
    if full is not None:
        full = tuple(round(2 * size / ratio) for size in full)
    return Sequence(list(chosen), list(starts), corners, side, ratio, how, gain, device, full, light, starts_known,
                    flash)
