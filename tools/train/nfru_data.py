"""What NFRU is trained on: of each pair of frames the network's input, the four samples and the truth between.

Nothing of it depends on the weights, so it is made once, of the clips of `nfru_clips.py`: `shale play` runs splat and optical flow,
`nfru_passes` the rest. DATA/pairs/NNNN.pt keeps it (pickles of our own making).
"""

from __future__ import annotations

import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import nfru_passes as passes
import nss_data
import training
from exr import read_exr

#: Any sandwich of the passes will do: what is read does not depend on how samples are weighed.
MODEL = Path(__file__).resolve().parents[2] / "models/baselines/generation/nfru_by_hand"


@dataclass
class Pairs:
    """Pairs of one clip, in bytes of 0..1: inputs `[n, 16, rows, columns]`, samples `[n, 4, 3, H, W]`, which of them count
    `[n, 4, H, W]` as 0 or 1, truth `[n, 3, H, W]`; H = 4 rows."""

    name: str
    inputs: torch.Tensor
    samples: torch.Tensor
    counted: torch.Tensor
    truth: torch.Tensor


def _bytes(x: torch.Tensor) -> torch.Tensor:
    return torch.floor(x.clamp(0.0, 1.0) * 255.0 + 0.5).to(torch.uint8)


def make_pairs(root: Path, name: str, program: Path) -> Pairs:
    """Runs the program on a clip. Errors: OSError, ValueError, CalledProcessError."""
    cameras, exposures, reverse, _ = nss_data.load_cameras(root / f"{name}.json")
    parts = [[], [], [], []]
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([str(program), "play", str(MODEL), "-i", str(root / f"{name}.json"), "-o", folder, "--dump", folder,
                        "--generate", "1"], check=True, stdout=subprocess.DEVNULL)
        for i in range(1, len(cameras)):
            pair = passes.read_pair(Path(folder), 2 * i - 1, 2 * i - 2, i + 1, torch.tensor([cameras[i]]), reverse)
            truth = read_exr(root / "between" / name / f"{i:04d}.exr")
            colour = torch.from_numpy(np.stack([truth[c] for c in "RGB"]).astype(np.float32))[None]
            taken, counted = passes.samples(pair)
            for part, value in zip(parts, (passes.pre(pair), taken, (counted > 0).float(),
                                           passes.displayed(colour * exposures[i]))):
                part.append(_bytes(value))
    return Pairs(name, *(torch.cat(part) for part in parts))


def _is_whole(root: Path, description: Path) -> bool:
    frames = len(nss_data.load_cameras(description)[0])
    return frames > 1 and len(list((root / "between" / description.stem).glob("*.exr"))) == frames - 1


def load_pairs(root: Path, program: Path | None, report=lambda line: None) -> list[Pairs]:
    """Those of all whole clips; what is not kept yet is made if there is a program. Errors: OSError, ValueError."""
    names = [path.stem for path in sorted(root.glob("*.json")) if _is_whole(root, path)]
    out = []
    for name in names:
        kept = root / "pairs" / f"{name}.pt"
        if not kept.exists() and program is not None:
            report(f"preparing clip {name}")
            try:
                pairs = make_pairs(root, name, program)
            except subprocess.CalledProcessError as error:
                raise ValueError(f"{root}: clip {name}: {program} exits with {error.returncode}") from None
            kept.parent.mkdir(exist_ok=True)
            training.save_atomically(pairs, kept)
        if kept.exists():
            out.append(torch.load(kept, weights_only=False))
    if not out:
        raise ValueError(f"{root}: no clips with pictures between (between/NNNN, NNNN.json)")
    return out


@dataclass
class Batch:
    """In 0..1, as Pairs."""

    inputs: torch.Tensor
    samples: torch.Tensor
    counted: torch.Tensor
    truth: torch.Tensor


#: Channels of the input when the two frames change places, and its colours.
SWAPPED = [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8, 13, 12, 15, 14]
COLOURS = 12


def _augmented(rng: np.random.Generator, parts: list[torch.Tensor]) -> list[torch.Tensor]:
    """One crop: frames in either order, mirrored, turned, colours permuted, brightness and contrast changed; a mean by weights
    goes along with all of it."""
    inputs, taken, counted, truth = parts
    if rng.random() < 0.5:
        inputs, taken, counted = inputs[SWAPPED], taken[[1, 0, 3, 2]], counted[[1, 0, 3, 2]]
    axes = [axis for axis in (-1, -2) if rng.random() < 0.5]
    parts = [torch.flip(x, axes) for x in (inputs, taken, counted, truth)]
    if rng.random() < 0.5:
        parts = [x.transpose(-1, -2) for x in parts]
    inputs, taken, counted, truth = parts
    order = torch.from_numpy(rng.permutation(3))
    gain, low = rng.uniform(0.6, 1.2), rng.uniform(0.0, 0.1)
    colours = inputs[:COLOURS].unflatten(0, (4, 3))[:, order].flatten(0, 1)
    inputs = torch.cat([(colours * gain + low).clamp(0.0, 1.0), inputs[COLOURS:]])
    return [inputs, taken[:, order] * gain + low, counted, truth[order] * gain + low]


#: Of so many crops the one is taken whose samples differ most: where they are the same, weights do not matter.
TRIES = 3


def _crop(clips: list[Pairs], rng: np.random.Generator, crop: int) -> tuple[float, list[torch.Tensor]]:
    """How much the samples of a random crop differ, and its parts in bytes."""
    clip = clips[rng.integers(len(clips))]
    i, (rows, columns) = int(rng.integers(len(clip.inputs))), clip.inputs.shape[2:]
    if crop > min(rows, columns):
        raise ValueError(f"clip {clip.name}: {columns}x{rows} pixels of the lane do not hold crops of {crop}")
    y, x = (int(rng.integers(size - crop + 1)) for size in (rows, columns))
    small, large = (..., slice(y, y + crop), slice(x, x + crop)), (..., slice(4 * y, 4 * (y + crop)), slice(4 * x, 4 * (x + crop)))
    parts = [clip.inputs[i][small], clip.samples[i][large], clip.counted[i][large], clip.truth[i][large]]
    some = parts[1][:, :, ::4, ::4].float()
    return float((some.amax(0) - some.amin(0)).mean()), parts


def draw(clips: list[Pairs], rng: np.random.Generator, batch: int, crop: int) -> Batch:
    """Random crops of `crop` pixels of the lane, even. Errors: ValueError when a clip is smaller."""
    drawn = []
    for _ in range(batch):
        _, parts = max((_crop(clips, rng, crop) for _ in range(TRIES)), key=lambda each: each[0])
        drawn.append(_augmented(rng, [part.float() / 255 for part in parts]))
    return Batch(*(torch.stack(part) for part in zip(*drawn)))
