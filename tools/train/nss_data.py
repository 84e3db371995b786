"""Clips for NSS: the data set on disk, a cache of it, random crops, augmentation.

A data set is a folder with NNNN.json per clip and ground_truth/, motion_gt/, x2/color/, x2/depth/, x2/motion/ with
NNNN/FFFF.exr (section 5 of the NSS notes; names of our exporter). Motion is forward uv motion (prev = uv - m), clamped
to +-1; Jitter is in render pixels; Exposure is linear.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import nss_passes as passes
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


def load_clip(root: Path, name: str, count: int | None = None, ratio: str = "x2", first: int = 0) -> Clip:
    """Reads a clip. Errors: OSError, ValueError naming the file."""
    path = root / f"{name}.json"
    try:
        sequence = json.loads(path.read_text())
        frames = sequence["Frames"]
        frames = frames[first : None if count is None else first + count]
        jitter = [(float(f["Jitter"]["X"]), float(f["Jitter"]["Y"])) for f in frames]
        exposure = [float(f.get("Exposure", DEFAULT_EXPOSURE)) for f in frames]
        cut = [bool(f.get("CameraCut", False)) for f in frames]
        reverse = bool(sequence.get("ReverseZ", False))
        camera = [passes.camera_vector(f["FovX"], f["FovY"], f["CameraNearPlane"], f["CameraFarPlane"], reverse)
                  for f in frames]
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
    """All clips of a data set; `cache` keeps them in one file, which is used when it exists."""
    if cache is not None and cache.exists():
        return torch.load(cache)
    clips = []
    for name in clip_names(root):
        report(f"reading clip {name}")
        clips.append(load_clip(root, name))
    if cache is not None:
        cache.parent.mkdir(parents=True, exist_ok=True)
        temporary = cache.with_suffix(".tmp")
        torch.save(clips, temporary)
        temporary.replace(cache)
    return clips


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


class Sequence:
    """A batch of crops through the same frames of several clips. full: (w, h) of the whole picture behind them."""

    def __init__(self, clips: list[Clip], start: int, corners: list[tuple[int, int]], crop: int, ratio: int,
                 augmentation: Augmentation, gain: torch.Tensor, device: str = "cpu",
                 full: tuple[int, int] | None = None):
        self.full = full or clips[0].render
        self.clips, self.start, self.corners, self.crop, self.ratio = clips, start, corners, crop, ratio
        self.augmentation, self.gain, self.device = augmentation, gain, device

    def _crops(self, key: str, t: int, scale: int) -> torch.Tensor:
        size = self.crop * scale
        return torch.stack([
            getattr(clip, key)[self.start + t, :, y * scale : y * scale + size, x * scale : x * scale + size]
            for clip, (x, y) in zip(self.clips, self.corners)
        ]).float()

    def _vectors(self, key: str, t: int, scale: int) -> torch.Tensor:
        # uv of the clip to uv of the crop
        factor = torch.tensor([[clip.render[0] / self.crop, clip.render[1] / self.crop] for clip in self.clips])
        return self.augmentation.vector(self._crops(key, t, scale) * factor.view(-1, 2, 1, 1)).to(self.device)

    def frame(self, t: int) -> passes.Frame:
        """Frame t of the batch."""
        a, at = self.augmentation, self.start + t
        exposure = torch.tensor([clip.exposure[at] for clip in self.clips]).view(-1, 1, 1, 1) * self.gain
        full = self.full
        camera = torch.tensor([[*clip.camera[at][:2], clip.camera[at][2] * full[0] / clip.render[0],
                                clip.camera[at][3] * full[1] / clip.render[1]] for clip in self.clips])
        if a.swap:
            camera, full = camera[:, [0, 1, 3, 2]], (full[1], full[0])
        return passes.Frame(
            passes.sanitise(a.picture(self._crops("colour", t, 1))[:, list(a.channels)].contiguous()).to(self.device),
            a.picture(self._crops("depth", t, 1)).contiguous().to(self.device), self._vectors("motion", t, 1),
            a.jitter(self.clips[0].jitter[at]), exposure.to(self.device), camera.to(self.device),
            self.clips[0].reverse, full)

    def truth(self, t: int) -> torch.Tensor:
        """Ground truth, linear `[n, 3, H, W]`."""
        a = self.augmentation
        return passes.sanitise(a.picture(self._crops("truth", t, self.ratio))[:, list(a.channels)]).to(self.device)

    def truth_motion(self, t: int) -> torch.Tensor:
        """uv motion at output size."""
        return self._vectors("truth_motion", t, self.ratio)


def draw(clips: list[Clip], rng: np.random.Generator, batch: int, crop: int, frames: int, augment: bool = True,
         device: str = "cpu", full: tuple[int, int] | None = None) -> Sequence:
    """A random sequence. All crops share the jitter of their frames, because the kernel tables do.

    crop: side in render pixels. Errors: ValueError when no clip has `frames` frames without a cut.
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
    jitter = lead.jitter[start : start + frames]
    fitting = [c for c in clips if c.jitter[start : start + frames] == jitter and c.render == lead.render
               and c.output == lead.output and c.reverse == lead.reverse and not any(c.cut[start + 1 : start + frames])]
    order = rng.permutation(len(fitting))
    chosen = [fitting[order[i % len(fitting)]] for i in range(batch)]
    ratio, rest = divmod(lead.output[0], lead.render[0])
    if rest or lead.output[1] != ratio * lead.render[1] or crop > min(lead.render):
        raise ValueError(f"clip {lead.name}: {lead.render} to {lead.output} does not fit crops of {crop}")
    corners = [(int(rng.integers((lead.render[0] - crop) // 4 + 1)) * 4,
                int(rng.integers((lead.render[1] - crop) // 4 + 1)) * 4) for _ in chosen]
    if augment:
        flips = rng.random(3) < 0.5
        how = Augmentation(*(bool(f) for f in flips), tuple(int(i) for i in rng.permutation(3)))
        gain = torch.from_numpy(2.0 ** rng.uniform(-0.75, 0.75, batch)).float().view(-1, 1, 1, 1)
    else:
        how, gain = Augmentation(), torch.ones(batch, 1, 1, 1)
    return Sequence(chosen, start, corners, crop, ratio, how, gain, device, full)
