#!/usr/bin/python3
"""Trains NFRU on pairs of frames whose samples were made once: a step is the network and the mean by its weights.

A step is a batch of crops, a function of (seed, step), so a resumed run continues with the same bits, given the same machine
and thread count, and no --minutes, which ends the run and its rate by the clock. The network starts as one that weighs by the
formula of the weights by hand; --normalize has random weights and batch normalization in its place. --qat folds that into the
weights, measures the activation ranges, holds them, and fakes the INT8 arithmetic. Adam, eps 1e-7, a cosine rate behind a warm-up.

Loss, on pictures as displayed: mean|error| + 5 mean error^2 + 0.1 (1 - SSIM, 11x11 window).
Source: Arm's NFRU v1 (nfru.md section 5). Ours: the start; SSIM in place of LPIPS, for which no weights are at hand; the square, without which the choice between samples
becomes harder than PSNR bears; Adam in place of LARS-Adam.

Examples:
  python3 tools/train/train_nfru.py --data build/train/nfru_data --shale build/tools/shale --steps 2000 --out build/train/nfru
  python3 tools/train/train_nfru.py --data build/train/nfru_data --steps 200 --qat --lr 0.0001 \\
      --init build/train/nfru/last.pt --out build/train/nfru_qat
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

import nfru
import nfru_data
import nfru_passes as passes
import training
from srpo import ssim_loss

CALIBRATION_BATCHES = 16


class Rollout:
    """One batch: `training.run_sequences` sees it as a sequence of one frame."""

    def __init__(self, model: nfru.Nfru, batch: nfru_data.Batch):
        self.model, self.batch = model, batch
        self.squares: list[float] = []

    def step(self, t: int) -> torch.Tensor:
        """Runs the network and returns the loss."""
        lane, output = self.batch.inputs.shape[:1:-1], self.batch.truth.shape[:1:-1]
        logits = passes.enlarged(self.model(self.batch.inputs), tuple(lane), tuple(output))
        shown = passes.post(logits, self.batch.samples, self.batch.counted)
        error = shown - self.batch.truth
        square = (error**2).mean()
        self.squares.append(float(square.detach()))
        return error.abs().mean() + 5.0 * square + 0.1 * ssim_loss(shown, self.batch.truth)

    def detach(self) -> None:
        """There is no history."""


def calibrate(model: nfru.Nfru, clips: list[nfru_data.Pairs], options: argparse.Namespace) -> None:
    """Measures the activation ranges on batches of their own."""
    model.observed = {}
    with torch.no_grad():
        for index in range(CALIBRATION_BATCHES):
            rng = np.random.default_rng([options.seed, 10**9, index])
            model(nfru_data.draw(clips, rng, options.batch, options.crop).inputs)
    model.calibrated()


def train(options: argparse.Namespace, clips: list[nfru_data.Pairs], report=print, stop_after: int | None = None) -> dict:
    """Runs until options.steps (or stop_after) and returns the final checkpoint.

    Errors: ValueError, OSError; KeyboardInterrupt after Ctrl-C, with the checkpoint written.
    """
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    model = nfru.Nfru(normalized=True) if options.normalize else nfru.by_formula(options.seed)
    record = {key: getattr(options, key) for key in ("steps", "batch", "crop", "seed", "lr", "qat", "minutes")}
    record.update(normalized=model.normalized, clips=[clip.name for clip in clips], earlier=[], seconds=0.0, done=0)
    state = training.load_checkpoint(options.out / "last.pt") if options.resume else None
    if state is None and options.init:
        first, earlier = nfru.load_model(options.init)
        if first.normalized and not options.normalize:
            first = first.folded()
        if first.normalized != model.normalized:
            raise ValueError(f"{options.init}: has no batch normalization, --normalize asks for it")
        model.load_state_dict(first.state_dict())
        record["earlier"] = training.earlier_records(earlier)
    optimizer = torch.optim.Adam(model.parameters(), lr=options.lr, eps=1e-7)
    options.out.mkdir(parents=True, exist_ok=True)
    start = 0
    if state is not None:
        for key, value in record.items():
            if key not in ("seconds", "done", "earlier") and state["record"].get(key) != value:
                raise ValueError(f"{options.out}: checkpoint has {key} {state['record'].get(key)}, the run asks {value}")
        model.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        model.ranges, record, start = state["ranges"], state["record"], state["step"]
    elif options.qat:
        calibrate(model, clips, options)
    model.train()

    def rollout_at(step: int) -> Rollout:
        rng = np.random.default_rng([options.seed, step])
        return Rollout(model, nfru_data.draw(clips, rng, options.batch, options.crop))

    def rate(base: float, step: float, steps: int) -> float:
        return training.warm_cosine(base, step, steps, 0.1 if options.qat else 0.05, 0.003 if not options.qat else 0.01)

    options.frames = options.chunk = 1
    return training.run_sequences(model, optimizer, record, options, start, rollout_at, rate, report, stop_after)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Reads and checks the command line."""
    parser = argparse.ArgumentParser(
        description="Trains NFRU and keeps one checkpoint, OUT/last.pt, with its record OUT/record.json.",
        epilog="example: python3 tools/train/train_nfru.py --data build/train/nfru_data --shale build/tools/shale --out build/train/nfru",
    )
    parser.add_argument("--shale", type=Path, help="the program, for clips whose samples are not kept yet in DATA/pairs")
    parser.add_argument("--init", type=Path, help="checkpoint or weights to start from")
    parser.add_argument("--normalize", action="store_true", help="random weights and batch normalization to start from")
    parser.add_argument("--minutes", type=float, default=0, help="stop earlier, after so long; the rate follows (default: never)")
    training.add_options(parser, steps=2000, batch=8, crop=48, what="batches", crop_help="crop side in pixels of the network")
    options = parser.parse_args(arguments)
    training.check_options(options)
    if options.qat and options.normalize:
        raise ValueError("--qat folds what --normalize asks for")
    training.check_limits(options, {"minutes": (0, 10**5)})
    if options.crop % 2:
        raise ValueError(f"--crop must be even, found {options.crop}")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input, 130 after Ctrl-C."""

    def run(options: argparse.Namespace, report) -> dict:
        return train(options, nfru_data.load_pairs(options.data, options.shale, report), report)

    return training.command("train_nfru", arguments, parse, run)


if __name__ == "__main__":
    sys.exit(main())
