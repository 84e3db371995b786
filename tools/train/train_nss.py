#!/usr/bin/python3
"""Trains an NSS network on rendered clips, recurrently, through the differentiable passes.

One step is one sequence: crops through FRAMES consecutive frames, started with a reset, with an update of the weights
every CHUNK frames (the state goes on, its gradient does not). With --qat the activation ranges are measured first and
then held while the INT8 arithmetic is faked. Sequences are a function of (seed, step), so a resumed run continues with
the same bits, given the same machine, thread count and clips, and no --minutes, which ends the run and its rate by the clock. AdamW, cosine rate, 5 % warm-up.

Loss per frame, on display pictures d(x) = sqrt(x / (1 + x)) of exposed colour, E = d(prediction) - d(truth), ' of the
frame before, moved to where it is now: w L_S + (1 - w) stability L_T + 0.1 mean|E of the filtered colour| (0.5 on a
reset) + 0.7 flicker + change C + 0.002 mean q (theta - 1)^2 + 0.0001 mean alpha^2, the last two where nothing is
disoccluded.
- L_S = mean|E| + 4 mean E^2 + 0.25 (mean|dE/dx| + mean|dE/dy|) + low mean|E over 8x8| + grid G, G the mean absolute
  Haar components of E over 2x2 where the truth has none: what jitter leaves behind has this period at ratio 2
- L_T = mean(exp(4 |E - E'|) - 1) / 4; w from .6 to .9 over the frames
- flicker = mean of the smaller square of two differences of theta in a row that have opposite signs, both above .02
- C = mean sqrt((q (p - p'))^2 + 1e-6) of predictions p; q = exp(-|truth - truth'| / .06): lag is no stability
Source: NSS notes 5. Ours: L_S's terms in place of LPIPS (no weights of it are at hand), the display curve, the weights,
q of the theta term, one past frame in C, the chunks.

Examples:
  python3 tools/train/train_nss.py --mode v1_high --data build/train/nss_data --steps 1000 --out build/train/nss_high
  python3 tools/train/train_nss.py --mode v1_low --data build/train/nss_data --steps 500 \\
      --init build/train/nss_high/last.pt --out build/train/nss_low
  python3 tools/train/train_nss.py --mode v1_high --data build/train/nss_data --steps 100 --qat --lr 0.0001 \\
      --init build/train/nss_high/last.pt --out build/train/nss_high_qat
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

import fused
import nss
import nss_data
import nss_passes as passes
import training

CALIBRATION_SEQUENCES = 12
#: Weights of loss terms, options of the command line: default and what they weigh.
WEIGHTS = {"stability": (1.0, "the temporal loss"), "low": (1.0, "errors of 8x8 means"),
           "grid": (1.0, "2x2 patterns in smooth places"), "change": (0.1, "change where the truth has none")}
#: Render size of the pictures that the crops are cut from, at ratio 2; it decides the tolerance of the depth test.
FULL = (960, 540)


class _Display(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        scale = 1.0 / (1.0 + x)
        y = torch.sqrt(x * scale + 1e-4)
        ctx.save_for_backward(scale, y)
        return y

    @staticmethod
    def backward(ctx, gradient):
        scale, y = ctx.saved_tensors
        return gradient * (scale * scale).div_(y).mul_(0.5)


def display(x: torch.Tensor) -> torch.Tensor:
    """Exposed linear colour to about what a display shows; smooth at 0, cheaper than the sRGB curve."""
    return _Display.apply(x)


def frame_weight(t: int, frames: int, low: float = 0.6, high: float = 0.9) -> float:
    """w of the recipe: low at the first frame, high at the last."""
    return high + (low - high) * (1 + math.cos(math.pi * t / max(frames - 1, 1))) / 2


#: Haar patterns of a 2x2 block: differences along x, along y, and both.
HAAR = (((1.0, -1.0), (1.0, -1.0)), ((1.0, 1.0), (-1.0, -1.0)), ((1.0, -1.0), (-1.0, 1.0)))


def haar(x: torch.Tensor) -> torch.Tensor:
    """`[n, c, h, w]` to its three differences of 2x2 blocks `[n, 3 c, h / 2, w / 2]`."""
    c = x.shape[1]
    filters = x.new_tensor(HAAR).div(4.0).repeat(c, 1, 1)[:, None]
    return F.conv2d(x, filters, stride=2, groups=c)


class _SpatialLoss(torch.autograd.Function):
    """Value and gradient in one go; autograd's slices cost more than the loss."""

    @staticmethod
    def forward(ctx, error, low, grid, smooth):
        dx = error[:, :, :, 1:] - error[:, :, :, :-1]
        dy = error[:, :, 1:] - error[:, :, :-1]
        value = error.abs().mean() + 4.0 * (error * error).mean() + 0.25 * (dx.abs().mean() + dy.abs().mean())
        slope = (torch.sign(error) + 8.0 * error) / error.numel()
        sx, sy = torch.sign(dx).mul_(0.25 / dx.numel()), torch.sign(dy).mul_(0.25 / dy.numel())
        slope[:, :, :, 1:] += sx
        slope[:, :, :, :-1] -= sx
        slope[:, :, 1:] += sy
        slope[:, :, :-1] -= sy
        pooled, block = F.avg_pool2d(error, 8), slope[:, :, : error.shape[2] // 8 * 8, : error.shape[3] // 8 * 8]
        value += low * pooled.abs().mean()
        block += F.interpolate(torch.sign(pooled).mul_(low / (64 * pooled.numel())), scale_factor=8)
        parts = haar(error)
        value += grid * (smooth * parts.abs()).mean()
        c = error.shape[1]
        filters = error.new_tensor(HAAR).div(4.0).repeat(c, 1, 1)[:, None]
        part_slope = torch.sign(parts).mul_(smooth * (grid / parts.numel()))
        slope += F.conv_transpose2d(part_slope, filters, stride=2, groups=c)
        ctx.save_for_backward(slope)
        return value

    @staticmethod
    def backward(ctx, gradient):
        return ctx.saved_tensors[0] * gradient, None, None, None


def spatial_loss(error: torch.Tensor, wanted: torch.Tensor, low: float = 1.0, grid: float = 1.0) -> torch.Tensor:
    """L_S of a display-domain error; its picture has an even number of pixels per axis."""
    return _SpatialLoss.apply(error, low, grid, (haar(wanted).abs() < 0.01).float())


def losses(output: torch.Tensor, filtered: torch.Tensor, truth: torch.Tensor, exposure: torch.Tensor, low: float,
           grid: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """L_S, mean|E of the filtered colour|, E, and the display picture of the truth.

    output, truth: linear `[n, 3, h, w]`; filtered: exposed; exposure `[n, 1, 1, 1]`.
    """
    if output.device.type == "cpu" and fused.available():
        return fused.losses(output, filtered, truth, exposure, low, grid)
    wanted = display(truth * exposure)
    error = display(output * exposure) - wanted
    return spatial_loss(error, wanted, low, grid), (display(filtered) - wanted).abs().mean(), error, wanted


def warp(image: torch.Tensor, motion: torch.Tensor) -> torch.Tensor:
    """image at uv - motion, 0 outside."""
    r = passes.uv_grid(image.shape[3], image.shape[2], image) - motion
    return F.grid_sample(image, r.permute(0, 2, 3, 1) * 2 - 1, padding_mode="zeros", align_corners=False)


class Rollout:
    """The network through the frames of a sequence. options: the weights of the loss."""

    def __init__(self, model: nss.Nss, sequence: nss_data.Sequence, options: argparse.Namespace):
        self.model, self.sequence, self.options = model, sequence, options
        self.state: passes.State | None = None
        # Of the frame before, held, in one tensor that is warped at once: error, truth, theta and its difference.
        self.past: torch.Tensor | None = None
        self.squares: list[float] = []
        if sequence.known:
            self._start_from_truth()

    def _start_from_truth(self) -> None:
        """The frame before the first is known: its truth is the history, the network's memory is empty."""
        with torch.no_grad():
            frame, truth = self.sequence.frame(-1), self.sequence.truth(-1)
            before = fused.pre(self.model.mode, frame, None)
            feedback = before.input.new_zeros(len(truth), 4, *before.input.shape[2:])
            self.state = passes.State(truth, feedback, before.memory, before.depth, frame.jitter)
            wanted = display(truth * frame.exposure)
            empty = torch.zeros_like(wanted[:, :1])
            self.past = torch.cat([torch.zeros_like(wanted), wanted, empty + 1.0, empty], 1)

    def step(self, t: int) -> torch.Tensor:
        """Runs frame t and returns its loss."""
        mode, frame, options = self.model.mode, self.sequence.frame(t), self.options
        truth = self.sequence.truth(t)
        output = (truth.shape[3], truth.shape[2])
        before = fused.pre(mode, frame, self.state)
        outputs = self.model(before.input)
        after = fused.post(mode, frame, before, outputs, self.state, output)
        loss, filtered, error, wanted = losses(after.output, after.filtered, truth, frame.exposure, options.low,
                                               options.grid)
        theta = after.theta
        slope = torch.zeros_like(theta)
        if self.state is None:
            loss = loss + 0.5 * filtered
        else:
            w = frame_weight(t, options.frames)
            warped = warp(self.past, self.sequence.truth_motion(t))
            old_error, old_wanted, old_theta, old_slope = warped.split((3, 3, 1, 1), 1)
            change = error - old_error
            temporal = torch.expm1(4.0 * change.abs().clamp(max=1.0)).mean() / 4.0
            loss = w * loss + options.stability * (1.0 - w) * temporal + 0.1 * filtered
            with torch.no_grad():
                turned = wanted - old_wanted
                same = torch.exp(turned.abs().amax(1, keepdim=True) / -0.06)
            steady = torch.sqrt((same * (change + turned)) ** 2 + 1e-6).mean() - 1e-3
            slope = theta - old_theta
            both = torch.minimum(slope.abs(), old_slope.abs())
            flips = ((slope * old_slope < 0) & (both > 0.02)).float()
            loss = loss + options.change * steady + 0.7 * (flips * both * both).mean()
            if mode.generation:
                known = same * passes.bilinear((before.disocclusion < 0.01).float(),
                                               passes.uv_grid(*output, error).expand(len(error), -1, -1, -1))
                loss = loss + (known * (0.002 * (theta - 1.0) ** 2 + 0.0001 * after.alpha**2)).mean()
        self.state = passes.next_state(frame, before, outputs, after)
        self.past = torch.cat([error.detach(), wanted, theta.detach(), slope.detach()], 1)
        self.squares.append(float((error.detach() ** 2).mean()))
        return loss

    def detach(self) -> None:
        """Cuts the gradient between chunks."""
        self.state = self.state.detached()


def learning_rate(base: float, step: float, steps: int) -> float:
    """5 % linear warm-up, then a cosine down to a thousandth."""
    return training.warm_cosine(base, step, steps, 0.05, 0.001)


def rollout_of(model: nss.Nss, clips: list[nss_data.Clip], options: argparse.Namespace, *seed: int) -> Rollout:
    """The crops of a step."""
    rng = np.random.default_rng([options.seed, *seed])
    return Rollout(model, nss_data.draw(clips, rng, options.batch, options.crop, options.frames, device=options.device,
                                        full=FULL, known=options.known, flashes=options.flashes), options)


def calibrate(model: nss.Nss, clips: list[nss_data.Clip], options: argparse.Namespace) -> None:
    """Measures the activation ranges on sequences of their own."""
    model.observed = {}
    with torch.no_grad():
        for index in range(CALIBRATION_SEQUENCES):
            rollout = rollout_of(model, clips, options, 10**9, index)
            for t in range(options.frames):
                rollout.step(t)
    model.calibrated()


def start_weights(model: nss.Nss, paths: list[Path]) -> dict:
    """Takes over the weights of another run, of this or another mode, or the mean of several; returns its record."""
    first, record = nss.load_average(paths)
    weights = first.state_dict()
    if first.mode.name == "v1_high" and model.mode.name == "v1_low":
        weights = nss.central_kernel(weights)
    model.load_state_dict(nss.shared_layers(model, weights))
    return record


def train(options: argparse.Namespace, clips: list[nss_data.Clip], report=print, stop_after: int | None = None) -> dict:
    """Runs until options.steps (or stop_after) and returns the final checkpoint.

    Errors: ValueError, OSError; KeyboardInterrupt after Ctrl-C, with the checkpoint written.
    """
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    model = nss.Nss(passes.MODES[options.mode]).to(options.device)
    model = model.to(memory_format=torch.channels_last)
    optimizer = torch.optim.AdamW(model.parameters(), lr=options.lr)
    record = {key: getattr(options, key) for key in ("mode", "steps", "batch", "crop", "frames", "chunk", "seed", "lr",
                                                     "qat", "minutes", "known", "flashes", *WEIGHTS)}
    record.update(clips=[clip.name for clip in clips], starts_from="random", earlier=[], seconds=0.0, done=0)
    options.out.mkdir(parents=True, exist_ok=True)
    start = 0
    if options.resume:
        state = training.load_checkpoint(options.out / "last.pt")
        for key, value in record.items():
            if key not in ("seconds", "done", "starts_from", "earlier", "clips") and state["record"].get(key) != value:
                raise ValueError(f"{options.out}: checkpoint has {key} {state['record'].get(key)}, the run asks {value}")
        model.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        model.ranges, start = state["ranges"], state["step"]
        record = state["record"] | {"clips": record["clips"]}  # a data set may grow
    else:
        if options.init:
            earlier = start_weights(model, options.init)
            record["starts_from"] = earlier.get("mode", "weights without a record")
            record["earlier"] = training.earlier_records(earlier)
        if options.qat:
            calibrate(model, clips, options)

    def rollout_at(step: int) -> Rollout:
        return rollout_of(model, clips, options, step)

    return training.run_sequences(model, optimizer, record, options, start, rollout_at, learning_rate, report, stop_after)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Reads and checks the command line."""
    parser = argparse.ArgumentParser(
        description="Trains NSS and keeps one checkpoint, OUT/last.pt, with its record OUT/record.json.",
        epilog="example: python3 tools/train/train_nss.py --mode v1_high --data build/train/nss --out build/train/high",
    )
    parser.add_argument("--mode", choices=sorted(passes.MODES), required=True)
    for name, (default, what) in WEIGHTS.items():
        parser.add_argument(f"--{name}", type=float, default=default, help=f"weight of {what} (default: {default:g})")
    parser.add_argument("--known", type=float, default=nss_data.KNOWN, metavar="SHARE",
                        help=f"of the sequences that start with the truth as history (default: {nss_data.KNOWN:g})")
    parser.add_argument("--flashes", type=float, default=0, metavar="SHARE",
                        help="of the sequences in which all light flashes or goes out for some frames (default: 0)")
    parser.add_argument("--init", type=Path, nargs="+", metavar="FILE",
                        help="checkpoint or weights to start from, of any mode; the mean of several")
    parser.add_argument("--device", default="cpu", help="torch device (default: cpu)")
    training.add_recurrent_options(parser, steps=1000, batch=4, crop=96, frames=16, chunk=8,
                                   crop_help="crop side in render pixels at ratio 2")
    options = parser.parse_args(arguments)
    training.check_recurrent(options)
    for name in WEIGHTS:
        if not 0 <= getattr(options, name) <= 100:
            raise ValueError(f"--{name} must lie in 0 to 100, found {getattr(options, name)}")
    training.check_limits(options, {"known": (0, 1), "flashes": (0, 1)})
    if options.crop % 16:
        raise ValueError(f"--crop must be a multiple of 16, found {options.crop}")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input, 130 after Ctrl-C."""

    def run(options: argparse.Namespace, report) -> dict:
        return train(options, nss_data.load_clips(options.data, options.data / "clips.pt", report), report)

    return training.command("train_nss", arguments, parse, run)


if __name__ == "__main__":
    sys.exit(main())
