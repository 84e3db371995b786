#!/usr/bin/python3
"""Measures QRISP or MNSS networks in float on whole clips, through their PyTorch passes: what ablations cost.

A network runs as it was trained: with its options (--no-dilation, --no-blending, --no-jitter, --sets), which only training
knows of. PSNR is that of display pictures, as in evaluate_nss.py; beside it how much a pixel swings over the later half of
a clip where its truth does not change at all, in codes (the mean of standard deviations over time). Bilinear enlarges the
frame alone.

Example:
  python3 tools/train/evaluate_recurrent.py --data build/train/test --weights build/train/q1/last.pt build/train/q2/last.pt
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

import evaluate_nss
import mnss
import mnss_passes
import nss_data
import qrisp
import qrisp_passes
import srpo
import training


class Qrisp:
    """A QRISP network between its passes: a frame in, what is shown out, `[1, 3, H, W]` in 0..1."""

    def __init__(self, model: qrisp.Qrisp, record: dict):
        self.model, self.offsets = model, qrisp.jitter_sequence(record.get("sets", 0))
        self.options = qrisp_passes.Options.of(record)
        self.state: qrisp_passes.State | None = None

    def __call__(self, frame, cut: bool) -> torch.Tensor:
        state = None if cut else self.state
        before = qrisp_passes.pre(frame, state, self.model.scale, self.options)
        jitter = self.offsets[qrisp.nearest(self.offsets, frame.jitter)] if self.offsets else frame.jitter
        after = qrisp_passes.post(frame, before, self.model(before.input, jitter), state, self.model.scale, self.options)
        self.state = qrisp_passes.stored(after)
        return qrisp_passes.output(frame, after)


class Mnss:
    """An MNSS network between its passes; what is shown goes back to linear colour."""

    def __init__(self, model: mnss.Mnss, record: dict):
        self.model = model
        self.state: mnss_passes.State | None = None

    def __call__(self, frame, cut: bool) -> torch.Tensor:
        colour = mnss_passes.display(frame.colour * frame.exposure)
        before = mnss_passes.pre(self.model, frame, colour, None if cut else self.state)
        shown = mnss_passes._Rounded.apply(self.model(before.inserted))
        self.state = mnss_passes.next_state(frame, before, shown)
        return shown


def measure(run, clip: nss_data.Clip, shown_as_codes: bool) -> dict[str, float]:
    """`psnr_db` without frame 0 and `rest`, None where nothing rests. shown_as_codes: `run` gives display values."""
    pictures, truths = [], []
    with torch.no_grad():
        for t in range(len(clip.jitter)):
            picture = run(clip.frame(t), t == 0 or clip.cut[t])
            pictures.append(srpo.to_codes(picture[0].permute(1, 2, 0).double().numpy()) if shown_as_codes
                            else evaluate_nss.display_codes(picture, clip.exposure[t]))
            truths.append(evaluate_nss.display_codes(clip.truth[t : t + 1].float(), clip.exposure[t]))
    psnr = np.mean([min(srpo.psnr(a, b), 100.0) for a, b in zip(pictures[1:], truths[1:])])
    late = len(pictures) // 2
    rests = np.ptp(np.stack(truths[late:]), axis=0).max(axis=2) == 0
    swing = np.std(np.stack(pictures[late:]).astype(float), axis=0)[rests]
    return {"psnr_db": round(float(psnr), 3), "rest": round(float(swing.mean()), 3) if swing.size else None}


def load(path: Path):
    """A run from a file of either kind, made anew for each clip. Errors: ValueError, OSError."""
    try:
        model, record = qrisp.load_model(path)
        kind = Qrisp
    except ValueError:
        try:
            model, record = mnss.load_model(path)
            kind = Mnss
        except ValueError:
            raise ValueError(f"{path}: not weights of a QRISP or an MNSS network") from None
    model.ranges = {}
    return lambda: kind(model, record)


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes PSNR and swing at rest of QRISP or MNSS networks in float as JSON.",
        epilog="example: python3 tools/train/evaluate_recurrent.py --data DIR --weights build/train/q1/last.pt")
    parser.add_argument("--weights", type=Path, nargs="+", required=True, help="weights (.npz) or checkpoints (.pt)")
    parser.add_argument("--data", type=Path, required=True, help="data set folder")
    parser.add_argument("--clips", nargs="+", help="clip names (default: all)")
    parser.add_argument("--frames", type=int, help="frames per clip (default: all)")
    parser.add_argument("--out", type=Path, help="JSON file (default: standard output)")
    options = parser.parse_args(arguments)
    def report() -> dict:
        torch.set_num_threads(1)
        methods = {str(path): load(path) for path in options.weights}
        rows = {name: {} for name in (*methods, "bilinear")}
        for name in options.clips or nss_data.clip_names(options.data):
            clip = nss_data.load_clip(options.data, name, options.frames)
            bilinear = evaluate_nss.Bilinear()
            rows["bilinear"][name] = measure(lambda frame, cut: bilinear(frame, cut, clip.output), clip, False)
            for path, make in methods.items():
                run = make()
                rows[path][name] = measure(run, clip, isinstance(run, Mnss))
        for clips in rows.values():
            means = {}
            for key in ("psnr_db", "rest"):
                values = [clip[key] for clip in clips.values() if clip[key] is not None]
                means[key] = round(float(np.mean(values)), 3) if values else None
            clips["mean"] = means
        return rows

    return training.write_report("evaluate_recurrent", options.out, report)


if __name__ == "__main__":
    sys.exit(main())
