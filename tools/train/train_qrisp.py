#!/usr/bin/python3
"""Trains a QRISP network on rendered clips, recurrently, through the differentiable passes.

One step is one sequence: crops through FRAMES consecutive frames, started with a reset, with an update of the weights
every CHUNK frames (the state goes on, its gradient does not). Loss: mean absolute difference of what is shown and
the truth, both as displayed (qrisp_passes.displayed). Adam, linear warm-up over 2 %, cosine rate. With --qat the
activation ranges are measured first, unless the weights have theirs, and then held while the INT8 arithmetic is
faked. --sets N takes the weights of the nearest of N offsets, as frames do that hold N sets; else those of the exact
jitter. Sequences are a function of (seed, step), so a resumed run continues with the same bits, given the same machine
and thread count. --no-dilation, --no-blending and --no-jitter leave a part out, for ablations; of them --no-jitter alone
changes what is exported, as --cubic and --corrects do. Weights that do not correct can begin a run that does: its
candidate begins at no correction.
Source: network notes 2.5. Ours: fewer, smaller crops, the rate, the display curve.

Examples:
  python3 tools/train/train_qrisp.py --size s --scale 2 --data build/train/nss_data --steps 1000 --out build/train/s2
  python3 tools/train/train_qrisp.py --size s --scale 2 --data build/train/nss_data --steps 200 --qat --lr 0.0003 \\
      --init build/train/s2/last.pt --out build/train/s2_qat
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

import nss_data
import qrisp
import qrisp_passes as passes
import training

CALIBRATION_SEQUENCES = 8
#: What a resumed run has to be asked for again.
RECIPE = ("size", "scale", "steps", "batch", "crop", "frames", "chunk", "seed", "lr", "qat", "dilation", "blending",
          "jitter", "sets", "half", "minutes", "hold", "cubic", "corrects")


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

    def detach(self) -> None:
        """The gradient does not go on; the history does."""
        self.state = self.state.detached()


def learning_rate(base: float, step: float, steps: int) -> float:
    """2 % linear warm-up, then a cosine down to a hundredth."""
    return training.warm_cosine(base, step, steps, 0.02, 0.01)


def rollout_of(model: qrisp.Qrisp, clips: list[nss_data.Clip], options: argparse.Namespace, *seed: int) -> Rollout:
    """The crops of a step."""
    rng = np.random.default_rng([options.seed, *seed])
    sequence = nss_data.draw(clips, rng, options.batch, options.crop, options.frames)
    return Rollout(model, sequence, passes.Options.of(vars(options)), options.sets)


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
    model = qrisp.Qrisp(options.size, options.scale, options.jitter, options.corrects)
    model.half = options.half
    optimizer = torch.optim.Adam(model.parameters(), lr=options.lr)
    record = {key: getattr(options, key) for key in RECIPE}
    record.update(qrisp.describe(model), clips=[clip.name for clip in clips], earlier=[], seconds=0.0, done=0)
    options.out.mkdir(parents=True, exist_ok=True)
    start = 0
    if options.resume:
        state = training.load_checkpoint(options.out / "last.pt")
        for key in (*RECIPE, "clips"):
            if state["record"].get(key) != record[key]:
                raise ValueError(f"{options.out}: checkpoint has {key} {state['record'].get(key)}, the run asks {record[key]}")
        model.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        model.ranges, record, start = state["ranges"], state["record"], state["step"]
    elif options.init:
        first, earlier = qrisp.load_model(options.init)
        begins = options.corrects and not first.corrects
        if qrisp.describe(first) | ({"corrects": True} if begins else {}) != qrisp.describe(model):
            raise ValueError(f"{options.init}: is {qrisp.describe(first)}, the run asks {qrisp.describe(model)}")
        model.load_state_dict(first.state_dict())
        if begins:
            model.correct_nothing()
        with torch.no_grad():
            model.convs["alpha"].bias -= options.hold
        if options.qat and not begins:  # as in train_mnss.py
            model.ranges = first.ranges
        record["earlier"] = training.earlier_records(earlier)
    if options.qat and not model.ranges:
        calibrate(model, clips, options)

    def rollout_at(step: int) -> Rollout:
        return rollout_of(model, clips, options, step)

    return training.run_sequences(model, optimizer, record, options, start, rollout_at, learning_rate, report, stop_after)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Reads and checks the command line."""
    parser = argparse.ArgumentParser(
        description="Trains QRISP and keeps one checkpoint, OUT/last.pt, with its record OUT/record.json.",
        epilog="example: python3 tools/train/train_qrisp.py --data build/train/nss_data --out build/train/qrisp_s_x2",
    )
    parser.add_argument("--size", choices=sorted(qrisp.SIZES), default="s", help="network (default: s)")
    parser.add_argument("--scale", type=int, choices=qrisp.SCALES, default=2, help="ratio (default: 2)")
    parser.add_argument("--sets", type=int, default=0, help="weight sets to choose from (default: exact jitter)")
    parser.add_argument("--no-dilation", dest="dilation", action="store_false", help="each pixel moves by itself")
    parser.add_argument("--no-blending", dest="blending", action="store_false", help="the candidate is shown")
    parser.add_argument("--no-jitter", dest="jitter", action="store_false", help="one weight set for all offsets")
    parser.add_argument("--init", type=Path, help="checkpoint or weights of the same network to start from")
    parser.add_argument("--cubic", action="store_true", help="the history is read by Catmull-Rom, not bilinear")
    parser.add_argument("--corrects", action="store_true", help="the candidate is what is added to the enlarged frame")
    parser.add_argument("--hold", type=float, default=0.0,
                        help="begin with alpha lower by this much before its sigmoid, so that the history counts for more; "
                        "needs --init (default: 0)")
    training.add_recurrent_options(parser, steps=1000, batch=4, crop=48, frames=12, chunk=4)
    training.add_half(parser)
    options = parser.parse_args(arguments)
    training.check_recurrent(options)
    training.check_limits(options, {"sets": (0, 64), "hold": (-8, 8)})
    if options.hold and not (options.init or options.resume):
        raise ValueError("--hold needs --init")
    if options.crop % 8:
        raise ValueError(f"--crop must be a multiple of 8, found {options.crop}")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input, 130 after Ctrl-C."""

    def run(options: argparse.Namespace, report) -> dict:
        return train(options, nss_data.load_clips(options.data, options.data / "clips.pt", report), report)

    return training.command("train_qrisp", arguments, parse, run)


if __name__ == "__main__":
    sys.exit(main())
