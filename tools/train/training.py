"""What the training programs share: checkpoints, the loop over sequences, weights as files, the command line.

A rollout is the networks through the frames of one sequence: `step(t)` runs frame t and returns its loss, `detach()` cuts
the gradient at the history, `squares` has the mean squared error of each frame.
"""

from __future__ import annotations

import argparse
import json
import math
import signal
import sys
import time
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F

from files import atomic, write_atomically


def save_atomically(state, path: Path) -> None:
    """Writes a pickle, so that `path` is always a whole one."""
    with atomic(path) as file:
        torch.save(state, file)


def load_checkpoint(path: Path) -> dict:
    """A checkpoint of an own run (a pickle). Errors: ValueError, OSError."""
    try:
        state = torch.load(path, map_location="cpu", weights_only=False)
        if not {"model", "optimizer", "step", "record"} <= set(state):
            raise ValueError("fields are missing")
        return state
    except OSError:
        raise
    except Exception as error:  # torch raises many kinds for a file that is no checkpoint
        raise ValueError(f"{path}: not a checkpoint ({type(error).__name__})") from None


class Interruption:
    """Turns Ctrl-C into a flag, so that it takes effect between two steps."""

    def __init__(self):
        self.asked = False

    def __enter__(self) -> "Interruption":
        self._previous = signal.signal(signal.SIGINT, self._ask)
        return self

    def __exit__(self, *_) -> None:
        signal.signal(signal.SIGINT, self._previous)

    def _ask(self, *_) -> None:
        self.asked = True


def warm_cosine(base: float, step: float, steps: int, warm_share: float, least: float) -> float:
    """A linear warm-up over a share of the run, then a cosine down to `least` of `base`."""
    warm = warm_share * steps
    if step < warm:
        return base * (step + 1) / (warm + 1)
    return base * (least + (1 - least) * 0.5 * (1 + math.cos(math.pi * (step - warm) / max(steps - warm, 1))))


def earlier_records(record: dict) -> list[dict]:
    """The stages of a run that starts from weights with this record."""
    return record.get("earlier", []) + [{k: v for k, v in record.items() if k != "earlier"}]


def run_sequences(model: torch.nn.Module, optimizer: torch.optim.Optimizer, record: dict, options: argparse.Namespace,
                  start: int, rollout_at, rate, report, stop_after: int | None) -> dict:
    """Runs from step `start` to options.steps (or stop_after), or until options.minutes above 0 are over, and returns
    the final checkpoint, also OUT/last.pt. `rollout_at(step)` draws a sequence; `rate(base, step, steps)` is the rate.

    Errors: OSError; KeyboardInterrupt after Ctrl-C, with the checkpoint written.
    """
    report(f"seed {options.seed}, step {start} of {options.steps}")
    path, spent, began, mean = options.out / "last.pt", record["seconds"], time.monotonic(), None
    minutes = options.minutes

    def elapsed() -> float:
        return spent + time.monotonic() - began

    def state_at(step: int) -> dict:
        record["seconds"], record["done"] = round(elapsed(), 1), step
        return {"model": model.state_dict(), "optimizer": optimizer.state_dict(), "step": step, "record": record,
                "ranges": model.ranges}

    step, end = start, options.steps if stop_after is None else min(stop_after, options.steps)
    with Interruption() as interruption:
        while step < end and not interruption.asked and not (minutes and elapsed() > 60 * minutes):
            rollout = rollout_at(step)
            for first in range(0, options.frames, options.chunk):
                done = step + first / options.frames
                if minutes:
                    done = max(done, options.steps * elapsed() / (60 * minutes))
                for group in optimizer.param_groups:
                    group["lr"] = rate(options.lr, done, options.steps)
                last = min(first + options.chunk, options.frames)
                loss = sum(rollout.step(t) for t in range(first, last)) / (last - first)
                optimizer.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
                optimizer.step()
                rollout.detach()
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


def convolve(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, half: bool) -> torch.Tensor:
    """3x3, pad 1; with `half` in bfloat16, which is also what it returns, else in float."""
    if not half:
        return F.conv2d(x.float(), weight, bias, padding=1)
    return F.conv2d(x.bfloat16().contiguous(memory_format=torch.channels_last), weight.bfloat16(), bias.bfloat16(), padding=1)


def save_model(path, model: torch.nn.Module, record: dict) -> None:
    """Weights, ranges and record as .npz; the same model gives the same bytes."""
    arrays = {name: value.cpu().numpy() for name, value in model.state_dict().items()}
    ranges = {"ranges": model.ranges} if hasattr(model, "ranges") else {}
    text = json.dumps({**record, **ranges}, sort_keys=True)
    with atomic(Path(path)) as file:
        np.savez(file, record=np.frombuffer(text.encode(), np.uint8), **arrays)


def load_model(path, kind: str, make, as_range):
    """Model and record from a .npz or an own checkpoint (a pickle): `make(record)` is the model without weights,
    `as_range` makes a range of what a file holds, None for models without ranges, `kind` is for messages. Errors: ValueError, OSError."""
    try:
        if str(path).endswith(".npz"):
            with np.load(path, allow_pickle=False) as arrays:
                record = json.loads(arrays["record"].tobytes())
                weights = {name: torch.from_numpy(arrays[name]) for name in arrays.files if name != "record"}
            ranges = record.pop("ranges") if as_range else {}
        else:
            state = torch.load(path, map_location="cpu", weights_only=False)
            record, weights, ranges = state["record"], state["model"], state["ranges"] if as_range else {}
        model = make(record)
        model.load_state_dict(weights)
        if as_range:
            model.ranges = {name: as_range(value) for name, value in ranges.items()}
    except OSError:
        raise
    except Exception as error:  # numpy, json, zipfile and torch each raise their own kinds
        raise ValueError(f"{path}: not weights of {kind} network ({type(error).__name__})") from None
    numbers = weights | {f"range of {name}": torch.tensor(as_range(value)) for name, value in ranges.items()}
    for name, value in numbers.items():
        if not torch.isfinite(value).all():
            raise ValueError(f"{path}: {name} holds a value that is not finite")
    return model.eval(), record


def check_limits(options: argparse.Namespace, limits: dict[str, tuple[float, float]]) -> None:
    """Errors: ValueError naming the option."""
    for name, (low, high) in limits.items():
        if not low <= getattr(options, name) <= high:
            raise ValueError(f"--{name} must lie in {low} to {high}, found {getattr(options, name)}")


def check_options(options: argparse.Namespace) -> None:
    """What add_options adds. Errors: ValueError."""
    check_limits(options, {"steps": (0 if options.qat else 1, 10**7), "batch": (1, 256), "crop": (16, 1024),
                           "seed": (0, 999), "every": (1, 10**7), "threads": (1, 256)})
    if not 0 < options.lr <= 1:
        raise ValueError(f"--lr must lie in 0 to 1, found {options.lr}")
    if options.qat and not (options.init or options.resume):
        raise ValueError("--qat needs --init")
    if options.qat and getattr(options, "half", False):
        raise ValueError("--qat and --half exclude each other")


def check_recurrent(options: argparse.Namespace) -> None:
    """The options that all recurrent training has. Errors: ValueError."""
    check_options(options)
    check_limits(options, {"frames": (2, 256), "chunk": (1, 256), "minutes": (0, 10**5)})


def add_options(parser: argparse.ArgumentParser, *, steps: int, batch: int, crop: int, what: str = "sequences",
                crop_help: str = "crop side in render pixels") -> None:
    """With these defaults; check_options checks them. --init is the program's own."""
    parser.add_argument("--data", type=Path, required=True, help="data set folder, which holds a cache, too")
    parser.add_argument("--steps", type=int, default=steps,
                        help=f"{what}; 0 with --qat measures the ranges alone (default: {steps})")
    parser.add_argument("--batch", type=int, default=batch, help=f"crops of each (default: {batch})")
    parser.add_argument("--crop", type=int, default=crop, help=f"{crop_help} (default: {crop})")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lr", type=float, default=1e-3, help="highest learning rate (default: 0.001)")
    parser.add_argument("--qat", action="store_true", help="fake the INT8 arithmetic; needs --init")
    parser.add_argument("--out", type=Path, required=True, help="folder for the checkpoint")
    parser.add_argument("--resume", action="store_true", help="continue OUT/last.pt")
    parser.add_argument("--every", type=int, default=10, help="steps between checkpoints (default: 10)")
    parser.add_argument("--threads", type=int, default=1, help="torch threads (default: 1)")


def add_half(parser: argparse.ArgumentParser) -> None:
    """--half, of the programs whose steps are mostly convolutions."""
    parser.add_argument("--half", action="store_true",
                        help="inner convolutions in bfloat16, faster where the processor has matrix units; not with --qat")


def add_recurrent_options(parser: argparse.ArgumentParser, *, steps: int, batch: int, crop: int, frames: int,
                          chunk: int, crop_help: str = "crop side in render pixels") -> None:
    """With these defaults; check_recurrent checks them. --init is the program's own."""
    add_options(parser, steps=steps, batch=batch, crop=crop, crop_help=crop_help)
    parser.add_argument("--frames", type=int, default=frames, help=f"frames per sequence (default: {frames})")
    parser.add_argument("--chunk", type=int, default=chunk, help=f"frames per update of the weights (default: {chunk})")
    parser.add_argument("--minutes", type=float, default=0, help="end after this time, the rate with it (default: 0, no)")


def command(name: str, arguments: list[str] | None, parse, train) -> int:
    """Command line: `train(options, report)` returns the final checkpoint, whose record is written to OUT/record.json.
    Exit code 1 for refused input, 130 after Ctrl-C."""

    def report(line: str) -> None:
        if sys.stdout.isatty():
            print(f"\r\033[K{line}", end="", flush=True)
        else:
            print(line, flush=True)

    try:
        options = parse(arguments)
        state = train(options, report)
        record = options.out / "record.json"
        record.write_text(json.dumps(state["record"], indent=1, sort_keys=True) + "\n")
    except KeyboardInterrupt:
        if sys.stdout.isatty():
            print()
        return 130
    except (ValueError, OSError) as error:
        print(f"{name}: error: {error}", file=sys.stderr)
        return 1
    if sys.stdout.isatty():
        print()
    return 0


def write_report(name: str, out: Path | None, make) -> int:
    """Writes what `make()` returns as JSON to `out`, or prints it; the exit code, 1 for refused input."""
    try:
        text = json.dumps(make(), indent=1) + "\n"
        if out:
            write_atomically(out, text.encode())
        else:
            print(text, end="")
    except (ValueError, OSError) as error:
        print(f"{name}: error: {error}", file=sys.stderr)
        return 1
    return 0
