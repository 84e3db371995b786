#!/usr/bin/python3
"""Trains MNSS on rendered clips, recurrently, through the differentiable passes.

One step is one sequence: crops through FRAMES consecutive frames, started without a past, with an update of all three
networks every CHUNK frames (the history goes on, its gradient does not). With --qat the activation ranges are measured
first and then held while the INT8 arithmetic of the reconstruction is faked. Sequences are a function of (seed, step),
so a resumed run continues with the same bits, given the same machine and thread count. Adam, eps 1e-4.

Loss per frame, on display pictures: (1 - SSIM, 11x11 window) + 5 mean|I_AA - truth at the sampled pixels| + mean|error|.
Source: MNSS (TVCG 2023). Ours: the mean error in place of the perceptual term, for which no weights are at hand; a cosine
rate; no epochs with a true history, because the network starts as one that shows what is inserted.

Examples:
  python3 tools/train/train_mnss.py --scale 2 --data build/train/mnss_data --steps 400 --out build/train/mnss
  python3 tools/train/train_mnss.py --scale 2 --data build/train/mnss_data --steps 60 --qat --lr 0.0002 \\
      --init build/train/mnss/last.pt --out build/train/mnss_qat
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

import mnss
import mnss_passes as passes
import nss_data
import training
from srpo import ssim_loss
from train_nss import learning_rate

CALIBRATION_SEQUENCES = 6


class Rollout:
    """The networks through the frames of a sequence."""

    def __init__(self, model: mnss.Mnss, sequence: nss_data.Sequence):
        self.model, self.sequence = model, sequence
        self.state: passes.State | None = None
        self.squares: list[float] = []

    def step(self, t: int) -> torch.Tensor:
        """Runs frame t and returns its loss."""
        frame, scale = self.sequence.frame(t), self.model.scale
        colour = passes.display(frame.colour * frame.exposure)
        truth = passes.display(self.sequence.truth(t) * frame.exposure)
        before = passes.pre(self.model, frame, colour, self.state)
        shown = self.model(before.inserted)
        column, row = passes.cell(frame.jitter, scale)
        sampled = (before.antialiased - truth[:, :, row::scale, column::scale]).abs().mean()
        error = shown - truth
        self.state = passes.next_state(frame, before, shown)
        self.squares.append(float((error.detach() ** 2).mean()))
        return ssim_loss(shown, truth) + 5.0 * sampled + error.abs().mean()

    def detach(self) -> None:
        """The gradient does not go on; the history does."""
        self.state = self.state.detached()


def calibrate(model: mnss.Mnss, clips: list[nss_data.Clip], options: argparse.Namespace) -> None:
    """Measures the activation ranges on sequences of their own."""
    model.observed = {}
    with torch.no_grad():
        for index in range(CALIBRATION_SEQUENCES):
            rng = np.random.default_rng([options.seed, 10**9, index])
            rollout = Rollout(model, nss_data.draw(clips, rng, options.batch, options.crop, options.frames))
            for t in range(options.frames):
                rollout.step(t)
    model.calibrated()


def train(options: argparse.Namespace, clips: list[nss_data.Clip], report=print, stop_after: int | None = None) -> dict:
    """Runs until options.steps (or stop_after) and returns the final checkpoint.

    Errors: ValueError, OSError; KeyboardInterrupt after Ctrl-C, with the checkpoint written.
    """
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    for clip in clips:
        if clip.output != (clip.render[0] * options.scale, clip.render[1] * options.scale):
            raise ValueError(f"clip {clip.name}: {clip.render} to {clip.output} is not of scale {options.scale}")
    model = mnss.Mnss(options.scale)
    model.half = options.half
    optimizer = torch.optim.Adam(model.parameters(), lr=options.lr, eps=1e-4)
    record = {key: getattr(options, key) for key in ("scale", "steps", "batch", "crop", "frames", "chunk", "seed", "lr",
                                                     "qat", "half", "minutes")}
    record.update(clips=[clip.name for clip in clips], earlier=[], seconds=0.0, done=0)
    options.out.mkdir(parents=True, exist_ok=True)
    start = 0
    if options.resume:
        state = training.load_checkpoint(options.out / "last.pt")
        for key, value in record.items():
            if key not in ("seconds", "done", "earlier") and state["record"].get(key) != value:
                raise ValueError(f"{options.out}: checkpoint has {key} {state['record'].get(key)}, the run asks {value}")
        model.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        model.ranges, record, start = state["ranges"], state["record"], state["step"]
    else:
        if options.init:
            first, earlier = mnss.load_model(options.init)
            model.load_state_dict(first.state_dict())
            if options.qat:  # measured anew, in float on weights that are for INT8, they would be others
                model.ranges = first.ranges
            record["earlier"] = training.earlier_records(earlier)
        if options.qat and not model.ranges:
            calibrate(model, clips, options)

    def rollout_at(step: int) -> Rollout:
        rng = np.random.default_rng([options.seed, step])
        return Rollout(model, nss_data.draw(clips, rng, options.batch, options.crop, options.frames))

    return training.run_sequences(model, optimizer, record, options, start, rollout_at, learning_rate, report, stop_after)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Reads and checks the command line."""
    parser = argparse.ArgumentParser(
        description="Trains MNSS and keeps one checkpoint, OUT/last.pt, with its record OUT/record.json.",
        epilog="example: python3 tools/train/train_mnss.py --scale 2 --data build/train/mnss_data --out build/train/mnss",
    )
    parser.add_argument("--scale", type=int, choices=mnss.SCALES, default=2)
    parser.add_argument("--init", type=Path, help="checkpoint or weights to start from")
    training.add_recurrent_options(parser, steps=400, batch=2, crop=48, frames=8, chunk=2)
    training.add_half(parser)
    options = parser.parse_args(arguments)
    training.check_recurrent(options)
    return options


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input, 130 after Ctrl-C."""

    def run(options: argparse.Namespace, report) -> dict:
        return train(options, nss_data.load_clips(options.data, options.data / "clips.pt", report), report)

    return training.command("train_mnss", arguments, parse, run)


if __name__ == "__main__":
    sys.exit(main())
