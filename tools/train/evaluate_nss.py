#!/usr/bin/python3
"""Measures an NSS network, in float and in exact INT8, on whole frames of a data set; any ratio.

Everything runs through the PyTorch passes (nss_passes.py) with a half-float history, the INT8 network bit for bit. For
comparison: bilinear enlargement of the frame alone, and the temporal upscaler of Mob-FGSR (section 4.4 of the
network notes: bilinear colour, YCoCg-clamped Catmull-Rom history, weight 0.25 - 0.4 |q|^2, depth test 0.01) on T-mapped
colours. PSNR is that of display pictures: exposed colour, x / (1 + x) per channel, sRGB curve, 8 bit, all channels.
A clip's value is the mean over its frames' dB, without frame 0; the result is the mean of the clips.

Examples:
  python3 tools/train/evaluate_nss.py --weights models/nss_v1_high/weights.npz --data build/train/nss_test \\
      --out build/train/nss_v1_high.json
  python3 tools/train/evaluate_nss.py --weights build/train/nss_high/last.pt --data build/train/nss_test --frames 16 \\
      --methods float
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Callable

import numpy as np
import torch
import torch.nn.functional as F

import fused
import nss
import nss_data
import nss_passes as passes
import srpo
import training
from png import write_png

METHODS = ("float", "int8", "bilinear", "mobfgsr")


def display_codes(colour: torch.Tensor, exposure: float) -> np.ndarray:
    """Linear `[1, 3, h, w]` to uint8 `[h, w, 3]` as a display shows it."""
    x = (passes.sanitise(colour) * exposure)[0].permute(1, 2, 0).double()
    x = x / (1.0 + x)
    x = torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return srpo.to_codes(x.numpy())


# ---- the compared methods: frame in, linear output picture out --------------------------------------------


class Bilinear:
    """The frame alone, at the un-jittered position."""

    def __call__(self, frame: passes.Frame, cut: bool, output: tuple[int, int]) -> torch.Tensor:
        uv = passes.uv_grid(*output, frame.colour) - passes._jitter_uv(frame, frame.jitter)
        return passes.karis_inverse(passes.bilinear(passes.karis(frame.colour * frame.exposure), uv)) / frame.exposure


class MobFgsr:
    """Temporal accumulation without a network."""

    def __init__(self):
        self.state: tuple[torch.Tensor, torch.Tensor] | None = None

    def __call__(self, frame: passes.Frame, cut: bool, output: tuple[int, int]) -> torch.Tensor:
        w, h = frame.size
        colour = passes.karis(frame.colour * frame.exposure)
        depth, y, x = passes.nearest_depth(frame.depth, range(-1, 2), frame.reverse)
        motion = passes.fetch(frame.motion, y, x)
        uv = passes.uv_grid(*output, colour)
        nearest = torch.div((2 * torch.arange(output[1])[:, None] + 1) * h, 2 * output[1], rounding_mode="floor"), \
            torch.div((2 * torch.arange(output[0])[None, :] + 1) * w, 2 * output[0], rounding_mode="floor")
        rows, columns = (t.expand(output[1], output[0])[None] for t in nearest)
        current = passes.bilinear(colour, uv - passes._jitter_uv(frame, frame.jitter))
        out = current
        if self.state is not None and not cut:
            history, old_depth = self.state
            r = uv - passes.fetch(motion, rows, columns)
            past = _to_ycocg(_cubic(history, r))
            low, high = _bounds(_to_ycocg(colour))
            low, high = (passes.fetch(bound, rows, columns) for bound in (low, high))
            past = torch.minimum(torch.maximum(past, low), high)
            past = _from_ycocg(past).clamp(0.0, 1.0)
            py = torch.floor(r[:, 1] * h).long()
            px = torch.floor(r[:, 0] * w).long()
            near = (passes.fetch(depth, rows, columns) - passes.fetch(old_depth, py, px)).abs() < 0.01
            inside = ((r >= 0) & (r < 1)).all(1, keepdim=True)
            position = uv * uv.new_tensor([w, h]).view(1, 2, 1, 1) - uv.new_tensor(frame.jitter).view(1, 2, 1, 1)
            q = position - torch.floor(position) - 0.5
            weight = (0.25 - 0.4 * (q * q).sum(1, keepdim=True)).clamp(min=0.0)
            out = torch.where(near & inside, past + weight * (current - past), current)
        self.state = (out, depth)
        return passes.karis_inverse(out) / frame.exposure


def _to_ycocg(x: torch.Tensor) -> torch.Tensor:
    r, g, b = x.unbind(1)
    return torch.stack([r / 4 + g / 2 + b / 4, (r - b) / 2, g / 2 - (r + b) / 4], 1)


def _from_ycocg(x: torch.Tensor) -> torch.Tensor:
    y, co, cg = x.unbind(1)
    return torch.stack([y - cg + co, y + cg, y - cg - co], 1)


def _bounds(x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Minimum and maximum of the 3x3 neighbourhood."""
    padded = F.pad(x, (1, 1, 1, 1), mode="replicate")
    return -F.max_pool2d(-padded, 3, 1), F.max_pool2d(padded, 3, 1)


def _cubic(image: torch.Tensor, r: torch.Tensor) -> torch.Tensor:
    """Catmull-Rom over all 16 taps."""
    h, w = image.shape[2:]
    px, py = r[:, 0] * w - 0.5, r[:, 1] * h - 0.5
    x0, y0 = torch.floor(px), torch.floor(py)

    def weights(f: torch.Tensor) -> list[torch.Tensor]:
        return [-0.5 * f**3 + f**2 - 0.5 * f, 1.5 * f**3 - 2.5 * f**2 + 1, -1.5 * f**3 + 2 * f**2 + 0.5 * f,
                0.5 * (f**3 - f**2)]

    wx, wy, out = weights(px - x0), weights(py - y0), 0.0
    for dy in range(4):
        for dx in range(4):
            out = out + (wy[dy] * wx[dx])[:, None] * passes.fetch(image, y0.long() + dy - 1, x0.long() + dx - 1)
    return out


class Network:
    """The network between its passes. `last` keeps the passes' results of the latest frame, for comparisons."""

    def __init__(self, mode: passes.Mode, run: Callable[[torch.Tensor], dict[str, torch.Tensor]]):
        self.mode, self.run = mode, run
        self.state: passes.State | None = None
        self.last: dict = {}

    def __call__(self, frame: passes.Frame, cut: bool, output: tuple[int, int]) -> torch.Tensor:
        state = None if cut else self.state
        before = fused.pre(self.mode, frame, state)
        outputs = self.run(before.input)
        after = fused.post(self.mode, frame, before, outputs, state, output)
        self.state = passes.next_state(frame, before, outputs, after, half=True)
        self.last = {"pre": before, "outputs": outputs, "post": after}
        return self.state.history


def int8_runner(network: nss.Int8Nss) -> Callable[[torch.Tensor], dict[str, torch.Tensor]]:
    """Float input 0..1 through the integer network to outputs 0..1 as the passes want them."""

    def run(x: torch.Tensor) -> dict[str, torch.Tensor]:
        values = {name: passes.from_codes(codes) for name, codes in network.run(passes.input_codes(x)).items()}
        if network.mode.generation == 0:
            values["kernel"] = torch.cat([values[f"k{i}"] for i in range(4)], 1)
        return values

    return run


def method(name: str, model: nss.Nss | None):
    """A fresh instance of one of METHODS."""
    if name == "bilinear":
        return Bilinear()
    if name == "mobfgsr":
        return MobFgsr()
    if name == "int8":
        return Network(model.mode, int8_runner(nss.to_int8(model)))
    plain = nss.Nss(model.mode)
    plain.load_state_dict(model.state_dict())
    return Network(model.mode, plain.eval())


def measure(model: nss.Nss | None, clip: nss_data.Clip, names: list[str], ssim: bool = False,
            keep: Path | None = None) -> dict[str, dict[str, list[float]]]:
    """Per method the PSNR (and SSIM) of every frame of a clip; keep: folder for the last frame's pictures."""
    out: dict[str, dict[str, list[float]]] = {}
    with torch.no_grad():
        for name in names:
            run, rows = method(name, model), {"psnr": []}
            for t in range(len(clip.jitter)):
                picture = run(clip.frame(t), t == 0 or clip.cut[t], clip.output)
                shown = display_codes(picture, clip.exposure[t])
                wanted = display_codes(clip.truth[t : t + 1].float(), clip.exposure[t])
                rows["psnr"].append(min(srpo.psnr(shown, wanted), 100.0))
                if ssim:
                    rows.setdefault("ssim", []).append(srpo.ssim(shown, wanted))
            out[name] = rows
            if keep is not None:
                write_png(keep / f"{clip.name}_{name}.png", shown)
                write_png(keep / f"{clip.name}_truth.png", wanted)
    return out


def summary(clips: dict[str, dict]) -> dict[str, dict[str, float]]:
    """Means over clips of the means over frames, without frame 0."""
    first = next(iter(clips.values()))
    return {name: {key: round(float(np.mean([np.mean(rows[name][key][1:]) for rows in clips.values()])), 4)
                   for key in first[name]} for name in first}


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes PSNR per frame of NSS float, NSS INT8, bilinear and Mob-FGSR as JSON.",
        epilog="example: python3 tools/train/evaluate_nss.py --weights models/nss_v1_high/weights.npz --data DIR",
    )
    parser.add_argument("--weights", type=Path, help="weights (.npz) or checkpoint (.pt); not for bilinear, mobfgsr")
    parser.add_argument("--data", type=Path, required=True, help="data set folder")
    parser.add_argument("--clips", nargs="+", help="clip names (default: all)")
    parser.add_argument("--first", type=int, default=0, help="first frame (default: 0)")
    parser.add_argument("--frames", type=int, help="frames per clip (default: all)")
    parser.add_argument("--ratio", help="folder of the rendered pictures (default: x2, else the first)")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--ssim", action="store_true", help="SSIM, too (slow)")
    parser.add_argument("--out", type=Path, help="JSON file (default: standard output)")
    parser.add_argument("--pictures", type=Path, help="folder for the last frame of each clip by every method")
    parser.add_argument("--threads", type=int, default=1, help="torch threads (default: 1)")
    options = parser.parse_args(arguments)
    def make() -> dict:
        torch.set_num_threads(max(1, options.threads))
        model, report = None, {}
        if {"float", "int8"} & set(options.methods):
            if options.weights is None:
                raise ValueError("--weights is needed for float and int8")
            model, _ = nss.load_model(options.weights)
            report["mode"] = model.mode.name
        if options.pictures:
            options.pictures.mkdir(parents=True, exist_ok=True)
        clips = {}
        for name in options.clips or nss_data.clip_names(options.data):
            clip = nss_data.load_clip(options.data, name, options.frames, options.ratio, options.first)
            clips[name] = measure(model, clip, options.methods, options.ssim, options.pictures)
        report.update(mean=summary(clips), clips=clips)
        return report

    return training.write_report("evaluate_nss", options.out, make)


if __name__ == "__main__":
    sys.exit(main())
