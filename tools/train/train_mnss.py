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
import json
import math
import sys
import time
from pathlib import Path

import numpy as np
import torch

import mnss
import mnss_passes as passes
import nss_data
from srpo import ssim_loss
from train_nss import learning_rate
from train_srpo import Interruption, load_checkpoint, save_atomically

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
    optimizer = torch.optim.Adam(model.parameters(), lr=options.lr, eps=1e-4)
    record = {key: getattr(options, key) for key in ("scale", "steps", "batch", "crop", "frames", "chunk", "seed", "lr",
                                                     "qat")}
    record.update(clips=[clip.name for clip in clips], earlier=[], seconds=0.0, done=0)
    options.out.mkdir(parents=True, exist_ok=True)
    path, start = options.out / "last.pt", 0
    if options.resume:
        state = load_checkpoint(path)
        for key, value in record.items():
            if key not in ("seconds", "done", "earlier") and state["record"].get(key) != value:
                raise ValueError(f"{path}: checkpoint has {key} {state['record'].get(key)}, the run asks {value}")
        model.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        model.ranges, record, start = state["ranges"], state["record"], state["step"]
    else:
        if options.init:
            first, earlier = mnss.load_model(options.init)
            model.load_state_dict(first.state_dict())
            record["earlier"] = earlier.get("earlier", []) + [{k: v for k, v in earlier.items() if k != "earlier"}]
        if options.qat:
            calibrate(model, clips, options)
    report(f"seed {options.seed}, step {start} of {options.steps}")

    spent, began, mean = record["seconds"], time.monotonic(), None

    def state_at(step: int) -> dict:
        record["seconds"], record["done"] = round(spent + time.monotonic() - began, 1), step
        return {"model": model.state_dict(), "optimizer": optimizer.state_dict(), "step": step, "record": record,
                "ranges": model.ranges}

    step, end = start, options.steps if stop_after is None else min(stop_after, options.steps)
    with Interruption() as interruption:
        while step < end and not interruption.asked:
            rng = np.random.default_rng([options.seed, step])
            rollout = Rollout(model, nss_data.draw(clips, rng, options.batch, options.crop, options.frames))
            for first in range(0, options.frames, options.chunk):
                for group in optimizer.param_groups:
                    group["lr"] = learning_rate(options.lr, step + first / options.frames, options.steps)
                last = min(first + options.chunk, options.frames)
                loss = sum(rollout.step(t) for t in range(first, last)) / (last - first)
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
                optimizer.step()
                rollout.state = rollout.state.detached()
            step += 1
            late = rollout.squares[len(rollout.squares) // 2 :]
            now = (float(loss.detach()), sum(late) / len(late))
            mean = now if mean is None else tuple(0.97 * a + 0.03 * b for a, b in zip(mean, now))
            if step % options.every == 0:
                save_atomically(state_at(step), path)
                report(f"step {step}/{options.steps} loss {mean[0]:.5f} display {-10 * math.log10(mean[1]):.2f} dB "
                       f"{record['seconds']:.0f} s")
    state = state_at(step)
    save_atomically(state, path)
    if interruption.asked:
        report(f"stopped at step {step}; continue with --resume")
        raise KeyboardInterrupt
    return state


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Reads and checks the command line."""
    parser = argparse.ArgumentParser(
        description="Trains MNSS and keeps one checkpoint, OUT/last.pt, with its record OUT/record.json.",
        epilog="example: python3 tools/train/train_mnss.py --scale 2 --data build/train/mnss_data --out build/train/mnss",
    )
    parser.add_argument("--scale", type=int, choices=mnss.SCALES, default=2)
    parser.add_argument("--data", type=Path, required=True, help="data set folder; its cache is DATA/clips.pt")
    parser.add_argument("--steps", type=int, default=400, help="sequences (default: 400)")
    parser.add_argument("--batch", type=int, default=2, help="crops per sequence (default: 2)")
    parser.add_argument("--crop", type=int, default=48, help="crop side in render pixels (default: 48)")
    parser.add_argument("--frames", type=int, default=8, help="frames per sequence (default: 8)")
    parser.add_argument("--chunk", type=int, default=2, help="frames per update of the weights (default: 2)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lr", type=float, default=1e-3, help="highest learning rate (default: 0.001)")
    parser.add_argument("--qat", action="store_true", help="fake the INT8 arithmetic; needs --init")
    parser.add_argument("--init", type=Path, help="checkpoint or weights to start from")
    parser.add_argument("--out", type=Path, required=True, help="folder for the checkpoint")
    parser.add_argument("--resume", action="store_true", help="continue OUT/last.pt")
    parser.add_argument("--every", type=int, default=10, help="steps between checkpoints (default: 10)")
    parser.add_argument("--threads", type=int, default=1, help="torch threads (default: 1)")
    options = parser.parse_args(arguments)
    limits = {"steps": (1, 10**7), "batch": (1, 256), "crop": (16, 1024), "frames": (2, 256), "chunk": (1, 256),
              "seed": (0, 999), "every": (1, 10**7), "threads": (1, 256)}
    for name, (low, high) in limits.items():
        if not low <= getattr(options, name) <= high:
            raise ValueError(f"--{name} must lie in {low} to {high}, found {getattr(options, name)}")
    if not 0 < options.lr <= 1:
        raise ValueError(f"--lr must lie in 0 to 1, found {options.lr}")
    if options.qat and not (options.init or options.resume):
        raise ValueError("--qat needs --init")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input, 130 after Ctrl-C."""

    def report(line: str) -> None:
        if sys.stdout.isatty():
            print(f"\r\033[K{line}", end="", flush=True)
        else:
            print(line, flush=True)

    try:
        options = parse(arguments)
        clips = nss_data.load_clips(options.data, options.data / "clips.pt", report)
        state = train(options, clips, report)
        record = options.out / "record.json"
        record.write_text(json.dumps(state["record"], indent=1, sort_keys=True) + "\n")
    except KeyboardInterrupt:
        if sys.stdout.isatty():
            print()
        return 130
    except (ValueError, OSError) as error:
        print(f"train_mnss: error: {error}", file=sys.stderr)
        return 1
    if sys.stdout.isatty():
        print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
