#!/usr/bin/python3
"""Trains a QRISP network on rendered clips, recurrently, through the differentiable passes.

One step is one sequence: crops through FRAMES consecutive frames, started with a reset, with an update of the weights
every CHUNK frames (the state goes on, its gradient does not). Loss: mean absolute difference of what is shown and
the truth, both as displayed (qrisp_passes.displayed). Adam, linear warm-up over 2 %, cosine rate. With --qat the
activation ranges are measured first and then held while the INT8 arithmetic is faked. --sets N takes the weights of the
nearest of N offsets, as frames do that hold N sets; else those of the exact jitter. Sequences are a function of
(seed, step), so a resumed run continues with the same bits, given the same machine and thread count.
--no-dilation, --no-blending and --no-jitter leave a part out, for ablations; only --no-jitter changes what is exported.
Source: network notes 2.5. Ours: fewer, smaller crops, the rate, the display curve.

Examples:
  python3 tools/train/train_qrisp.py --size s --scale 2 --data build/train/nss_data --steps 1000 --out build/train/s2
  python3 tools/train/train_qrisp.py --size s --scale 2 --data build/train/nss_data --steps 200 --qat --lr 0.0003 \\
      --init build/train/s2/last.pt --out build/train/s2_qat
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

import nss_data
import qrisp
import qrisp_passes as passes
from train_srpo import Interruption, load_checkpoint, save_atomically

CALIBRATION_SEQUENCES = 8
#: What a resumed run has to be asked for again.
RECIPE = ("size", "scale", "steps", "batch", "crop", "frames", "chunk", "seed", "lr", "qat", "dilation", "blending",
          "jitter", "sets")


class Rollout:
    """The network through the frames of a sequence."""

    def __init__(self, model: qrisp.Qrisp, sequence: nss_data.Sequence, options: passes.Options, sets: int = 0):
        self.model, self.sequence, self.options = model, sequence, options
        self.offsets = qrisp.jitter_sequence(sets)
        self.state: passes.State | None = None
        self.squares: list[float] = []

    def step(self, t: int) -> torch.Tensor:
        """Runs frame t and returns its loss."""
        frame, scale = self.sequence.frame(t), self.model.scale
        wanted = passes.displayed(self.sequence.truth(t) * frame.exposure)
        before = passes.pre(frame, self.state, scale, self.options)
        jitter = self.offsets[qrisp.nearest(self.offsets, frame.jitter)] if self.offsets else frame.jitter
        outputs = self.model(before.input, jitter)
        self.state = passes.post(frame, before, outputs, self.state, scale, self.options)
        error = self.state.colour - wanted
        self.squares.append(float((error.detach() ** 2).mean()))
        return error.abs().mean()


def learning_rate(base: float, step: float, steps: int) -> float:
    """2 % linear warm-up, then a cosine down to a hundredth."""
    warm = 0.02 * steps
    if step < warm:
        return base * (step + 1) / (warm + 1)
    return base * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * (step - warm) / max(steps - warm, 1))))


def rollout_of(model: qrisp.Qrisp, clips: list[nss_data.Clip], options: argparse.Namespace, *seed: int) -> Rollout:
    """The crops of a step."""
    rng = np.random.default_rng([options.seed, *seed])
    sequence = nss_data.draw(clips, rng, options.batch, options.crop, options.frames)
    return Rollout(model, sequence, passes.Options(options.dilation, options.blending), options.sets)


def calibrate(model: qrisp.Qrisp, clips: list[nss_data.Clip], options: argparse.Namespace) -> None:
    """Measures the activation ranges on sequences of their own."""
    model.observed = {}
    with torch.no_grad():
        for index in range(CALIBRATION_SEQUENCES):
            rollout = rollout_of(model, clips, options, 10**9, index)
            for t in range(options.frames):
                rollout.step(t)
    model.calibrated()


def train(options: argparse.Namespace, clips: list[nss_data.Clip], report=print, stop_after: int | None = None) -> dict:
    """Runs until options.steps (or stop_after) and returns the final checkpoint.

    Errors: ValueError, OSError; KeyboardInterrupt after Ctrl-C, with the checkpoint written.
    """
    clips = [clip for clip in clips if clip.output == tuple(options.scale * side for side in clip.render)]
    if not clips:
        raise ValueError(f"{options.data}: no clip has the ratio {options.scale}")
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    model = qrisp.Qrisp(options.size, options.scale, options.jitter)
    optimizer = torch.optim.Adam(model.parameters(), lr=options.lr)
    record = {key: getattr(options, key) for key in RECIPE}
    record.update(qrisp.describe(model), clips=[clip.name for clip in clips], earlier=[], seconds=0.0, done=0)
    options.out.mkdir(parents=True, exist_ok=True)
    path, start = options.out / "last.pt", 0
    if options.resume:
        state = load_checkpoint(path)
        for key in (*RECIPE, "clips"):
            if state["record"].get(key) != record[key]:
                raise ValueError(f"{path}: checkpoint has {key} {state['record'].get(key)}, the run asks {record[key]}")
        model.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        model.ranges, record, start = state["ranges"], state["record"], state["step"]
    elif options.init:
        first, earlier = qrisp.load_model(options.init)
        if qrisp.describe(first) != qrisp.describe(model):
            raise ValueError(f"{options.init}: is {qrisp.describe(first)}, the run asks {qrisp.describe(model)}")
        model.load_state_dict(first.state_dict())
        record["earlier"] = earlier.get("earlier", []) + [{k: v for k, v in earlier.items() if k != "earlier"}]
    if options.qat and not options.resume:
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
            rollout = rollout_of(model, clips, options, step)
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
        description="Trains QRISP and keeps one checkpoint, OUT/last.pt, with its record OUT/record.json.",
        epilog="example: python3 tools/train/train_qrisp.py --data build/train/nss_data --out build/train/qrisp_s_x2",
    )
    parser.add_argument("--size", choices=sorted(qrisp.SIZES), default="s", help="network (default: s)")
    parser.add_argument("--scale", type=int, choices=qrisp.SCALES, default=2, help="ratio (default: 2)")
    parser.add_argument("--data", type=Path, required=True, help="data set folder; its cache is DATA/clips.pt")
    parser.add_argument("--steps", type=int, default=1000, help="sequences (default: 1000)")
    parser.add_argument("--batch", type=int, default=4, help="crops per sequence (default: 4)")
    parser.add_argument("--crop", type=int, default=48, help="crop side in render pixels (default: 48)")
    parser.add_argument("--frames", type=int, default=12, help="frames per sequence (default: 12)")
    parser.add_argument("--chunk", type=int, default=4, help="frames per update of the weights (default: 4)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lr", type=float, default=1e-3, help="highest learning rate (default: 0.001)")
    parser.add_argument("--qat", action="store_true", help="fake the INT8 arithmetic; needs --init")
    parser.add_argument("--sets", type=int, default=0, help="weight sets to choose from (default: exact jitter)")
    parser.add_argument("--no-dilation", dest="dilation", action="store_false", help="each pixel moves by itself")
    parser.add_argument("--no-blending", dest="blending", action="store_false", help="the candidate is shown")
    parser.add_argument("--no-jitter", dest="jitter", action="store_false", help="one weight set for all offsets")
    parser.add_argument("--init", type=Path, help="checkpoint or weights of the same network to start from")
    parser.add_argument("--out", type=Path, required=True, help="folder for the checkpoint")
    parser.add_argument("--resume", action="store_true", help="continue OUT/last.pt")
    parser.add_argument("--every", type=int, default=10, help="steps between checkpoints (default: 10)")
    parser.add_argument("--threads", type=int, default=1, help="torch threads (default: 1)")
    options = parser.parse_args(arguments)
    limits = {"steps": (1, 10**7), "batch": (1, 256), "crop": (16, 1024), "frames": (2, 256), "chunk": (1, 256),
              "seed": (0, 999), "every": (1, 10**7), "threads": (1, 256), "sets": (0, 64)}
    for name, (low, high) in limits.items():
        if not low <= getattr(options, name) <= high:
            raise ValueError(f"--{name} must lie in {low} to {high}, found {getattr(options, name)}")
    if not 0 < options.lr <= 1:
        raise ValueError(f"--lr must lie in 0 to 1, found {options.lr}")
    if options.crop % 8:
        raise ValueError(f"--crop must be a multiple of 8, found {options.crop}")
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
        print(f"\n{options.out / 'last.pt'}: {state['step']} steps, {state['record']['seconds']:.0f} s")
    except (ValueError, OSError) as error:
        print(f"train_qrisp: error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
