#!/usr/bin/python3
"""Renders the clips that the NSS networks are trained on: 256x256 crops of 1920x1080 pictures at ratio 2.

Every clip begins at frame 0, 32 or 64 of its scene, so that all clips share the jitter of their frames, as batches
need. Crops are drawn from a seed. Needs the program `shale`.

Example:
  python3 tools/train/nss_clips.py --shale build/tools/shale --out build/train/nss_data
"""

from __future__ import annotations

import argparse
import random
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

SIZE = 256
FRAMES = 32


@dataclass(frozen=True)
class Group:
    """Clips `number` to `number + count - 1`: rounds over the first frames, then over the scenes."""

    number: int
    count: int
    scenes: tuple[str, ...]
    firsts: tuple[int, ...]
    top: int  # no crop starts above this row, which leaves out empty sky


GROUPS = (
    Group(0, 15, ("city", "courtyard", "forest"), (0, 32, 64), 120),
    Group(15, 40, ("city", "courtyard", "forest"), (0, 32, 64), 280),
    Group(100, 24, ("gears", "interior", "night", "wires"), (0, 32), 280),
    Group(200, 20, ("control_room", "fountain", "market", "meadow", "shadows"), (0, 32), 280),
    Group(300, 24, ("cellar", "night_office", "signs", "flyers"), (0, 32, 64), 100),
)


def clips(group: Group) -> list[tuple[int, str, int, int, int]]:
    """(number, scene, first frame, x, y) of each clip."""
    rng, out = random.Random(group.number + 1), []
    while len(out) < group.count:
        for first in group.firsts:
            for scene in group.scenes:
                x = rng.randrange(0, (1920 - SIZE) // 2) * 2
                y = rng.randrange(group.top // 2, (1080 - SIZE) // 2) * 2
                out.append((group.number + len(out), scene, first, x, y))
    return out[: group.count]


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 when the program fails."""
    parser = argparse.ArgumentParser(
        description="Renders the training clips of the NSS networks; clips that exist are kept.",
        epilog="example: python3 tools/train/nss_clips.py --shale build/tools/shale --out build/train/nss_data",
    )
    parser.add_argument("--shale", type=Path, required=True, help="the program")
    parser.add_argument("--scenes", type=Path, default=Path("models/scenes/train"), help="folder of the scenes")
    parser.add_argument("--out", type=Path, required=True, help="data set folder")
    options = parser.parse_args(arguments)
    for group in GROUPS:
        for number, scene, first, x, y in clips(group):
            if (options.out / f"{number:04d}.json").exists():
                continue
            command = [options.shale, "scene", options.scenes / f"{scene}.json", "-o", options.out, "--number", number,
                       "--first", first, "--frames", FRAMES, "--crop", f"{x},{y},{SIZE},{SIZE}"]
            try:
                subprocess.run([str(part) for part in command], check=True)
            except (OSError, subprocess.CalledProcessError) as error:
                print(f"nss_clips: error: {error}", file=sys.stderr)
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
