#!/usr/bin/python3
"""Trains SRPO on procedural pictures; no ground-truth offsets, only the high-resolution pictures.

Loss: 1 - SSIM between the bilinearly projected and the high-resolution picture; with --fused, a second stage,
between the displayed picture (rounded, masked, mixed with Lanczos) and the high-resolution one. Adam (0.9, 0.99),
the rate halved every 7/40 of the run. Batches are a function of (seed, step), so a resumed run continues with the
same bits as one that was never stopped, given the same machine and thread count.
Source: SRPO (ECCV 2022), training; the reduced step count, crops, augmentation and second stage are ours.

Examples:
  python3 tools/train/train_srpo.py --scale 2 --steps 20000 --out build/train/srpo_x2
  python3 tools/train/train_srpo.py --scale 3 --steps 8000 --init build/train/srpo_x2/last.pt \\
      --out build/train/srpo_x3
  python3 tools/train/train_srpo.py --scale 2 --steps 20000 --out build/train/srpo_x2 --resume
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
import torch

import shapes
import srpo
import training

PICTURE_SIZE = 128


class Pictures:
    """`count` scenes from consecutive seeds as uint8, low resolution and `scale` times that."""

    def __init__(self, count: int, first_seed: int, scale: int):
        scenes = [shapes.random_scene(first_seed + i, PICTURE_SIZE, PICTURE_SIZE) for i in range(count)]
        self.scale = scale
        self.lr = np.stack([shapes.render(scene) for scene in scenes])
        self.hr = np.stack([shapes.render(scene, scale) for scene in scenes])

    def batch(self, seed: int, step: int, size: int, crop: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Random crops, mirrored, transposed and with permuted colours: `[n, 3, h, w]` in [0, 1]."""
        rng = np.random.default_rng([seed, step])
        s, lr, hr = self.scale, [], []
        for _ in range(size):
            index = rng.integers(len(self.lr))
            y, x = rng.integers(0, PICTURE_SIZE - crop + 1, 2)
            small = self.lr[index, y : y + crop, x : x + crop]
            large = self.hr[index, s * y : s * (y + crop), s * x : s * (x + crop)]
            if rng.random() < 0.5:
                small, large = small[::-1], large[::-1]
            if rng.random() < 0.5:
                small, large = small[:, ::-1], large[:, ::-1]
            if rng.random() < 0.5:
                small, large = small.transpose(1, 0, 2), large.transpose(1, 0, 2)
            order = rng.permutation(3)
            lr.append(small[:, :, order])
            hr.append(large[:, :, order])

        def tensor(crops):
            return torch.from_numpy(np.stack(crops).astype(np.float32) / 255.0).permute(0, 3, 1, 2).contiguous()

        return tensor(lr), tensor(hr)


def learning_rate(base: float, step: int, steps: int) -> float:
    """Halved every 7/40 of the run, as in 40,000 steps with a halving every 7,000."""
    return base * 0.5 ** int(step * 40 / (7 * steps))


def train(options: argparse.Namespace, report=print, stop_after: int | None = None) -> dict:
    """Runs until options.steps (or stop_after) and returns the final checkpoint.

    Errors: ValueError, OSError; KeyboardInterrupt after Ctrl-C, with the checkpoint written.
    """
    torch.manual_seed(options.seed)
    torch.set_num_threads(1)
    model = srpo.Srpo(options.scale)
    if srpo.parameter_count(model) != srpo.PARAMETERS:
        raise ValueError(f"expected {srpo.PARAMETERS} parameters, found {srpo.parameter_count(model)}")
    optimizer = torch.optim.Adam(model.parameters(), lr=options.lr, betas=(0.9, 0.99))
    record = {
        "scale": options.scale, "steps": options.steps, "batch": options.batch, "crop": options.crop,
        "pictures": options.pictures, "picture_size": PICTURE_SIZE, "seed": options.seed, "lr": options.lr,
        "noise": options.noise, "rest": options.rest,
        "loss": "1 - SSIM of the displayed picture" if options.fused else "1 - SSIM of the projection",
        "starts_from": "random", "seconds": 0.0,
    }
    options.out.mkdir(parents=True, exist_ok=True)
    path, start = options.out / "last.pt", 0
    if options.resume:
        state = training.load_checkpoint(path)
        for key, value in record.items():
            found = state["record"].get(key)
            if key not in ("seconds", "starts_from") and found != value:
                raise ValueError(f"{path}: checkpoint has {key} {found}, the run asks {value}")
        model.load_state_dict(state["model"])
        optimizer.load_state_dict(state["optimizer"])
        record, start = state["record"], state["step"]
    elif options.init:
        first, earlier = srpo.load_model(options.init)
        model.load_state_dict(first.state_dict())
        record["starts_from"] = earlier
    show = srpo.fuse_straight_through if options.fused else srpo.project_bilinear
    pictures = Pictures(options.pictures, options.seed * 1000, options.scale)
    report(f"seed {options.seed}, step {start} of {options.steps}")

    spent, began, mean_loss = record["seconds"], time.monotonic(), None

    def state_at(step: int) -> dict:
        record["seconds"] = round(spent + time.monotonic() - began, 1)
        return {"scale": options.scale, "model": model.state_dict(), "optimizer": optimizer.state_dict(),
                "step": step, "record": record}

    step = start
    end = options.steps if stop_after is None else min(stop_after, options.steps)
    with training.Interruption() as interruption:
        while step < end and not interruption.asked:
            for group in optimizer.param_groups:
                group["lr"] = learning_rate(options.lr, step, options.steps)
            lr, hr = pictures.batch(options.seed, step, options.batch, options.crop)
            offsets = model(lr)
            if options.noise:
                generator = torch.Generator().manual_seed(options.seed * 1_000_003 + step)
                offsets = offsets + (torch.rand(offsets.shape, generator=generator) - 0.5) * options.noise
            loss = srpo.ssim_loss(show(lr, offsets, options.scale), hr)
            if options.rest:
                loss = loss + options.rest * srpo.moved_softly(offsets).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            step += 1
            value = float(loss.detach())
            mean_loss = value if mean_loss is None else 0.99 * mean_loss + 0.01 * value
            if step % options.every == 0:
                training.save_atomically(state_at(step), path)
                report(f"step {step}/{options.steps} loss {mean_loss:.5f} {record['seconds']:.0f} s")
    state = state_at(step)
    training.save_atomically(state, path)
    if interruption.asked:
        report(f"stopped at step {step}; continue with --resume")
        raise KeyboardInterrupt
    return state


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Reads and checks the command line."""
    parser = argparse.ArgumentParser(
        description="Trains SRPO and keeps one checkpoint, OUT/last.pt, with its record OUT/record.json.",
        epilog="example: python3 tools/train/train_srpo.py --scale 2 --steps 20000 --out build/train/srpo_x2",
    )
    parser.add_argument("--scale", type=int, choices=[2, 3], required=True)
    parser.add_argument("--steps", type=int, default=20000)
    parser.add_argument("--batch", type=int, default=8, help="crops per step (default: 8)")
    parser.add_argument("--crop", type=int, default=48, help="crop side in low-resolution pixels (default: 48)")
    parser.add_argument("--pictures", type=int, default=300, help="training scenes (default: 300)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lr", type=float, default=1e-3, help="first learning rate (default: 0.001)")
    parser.add_argument("--noise", type=float, default=0.0,
                        help="width of uniform noise on the offsets, in pixels, against values near a rounding "
                             "boundary (default: 0)")
    parser.add_argument("--fused", action="store_true",
                        help="loss on the displayed picture instead of the projection alone (second stage)")
    parser.add_argument("--rest", type=float, default=0.0,
                        help="weight of the share of moved pixels in the loss, so that flat areas stay Lanczos "
                             "(default: 0)")
    parser.add_argument("--init", type=Path, help="checkpoint to start the weights from")
    parser.add_argument("--out", type=Path, required=True, help="folder for the checkpoint")
    parser.add_argument("--resume", action="store_true", help="continue OUT/last.pt")
    parser.add_argument("--every", type=int, default=250, help="steps between checkpoints (default: 250)")
    options = parser.parse_args(arguments)
    limits = {"steps": (1, 10**7), "batch": (1, 256), "crop": (16, PICTURE_SIZE), "pictures": (1, 10**4),
              "seed": (0, 999), "every": (1, 10**7)}
    training.check_limits(options, limits)
    for name, high in {"lr": 1, "noise": 2, "rest": 1}.items():
        if not 0 <= getattr(options, name) <= high:
            raise ValueError(f"--{name} must lie in 0 to {high}, found {getattr(options, name)}")
    return options


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input, 130 after Ctrl-C."""
    return training.command("train_srpo", arguments, parse, train)


if __name__ == "__main__":
    sys.exit(main())
