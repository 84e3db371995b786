#!/usr/bin/python3
"""A training job for another machine, one with a GPU: at most 60 MiB to carry there, at most 9 minutes to run.

`pack` writes JOB/clips.bin, as many clips of a data set as fit, and JOB/start.npz, the weights to start from. `run`, on
the other machine, in a copy of the repository, trains on them by the clock, measures the PSNR of the clips that were
held out before and after, and leaves OUT/weights.npz, OUT/last.pt and OUT/record.json (with what it measured) to bring
back; with --qat the weights can be exported. Needs PyTorch 1.13 or later and NumPy there.

clips.bin: a line of JSON, then for each clip a compressed block: its pictures one after the other, each as the low bytes
and then the high bytes of its halves. Depth is stored as k / z, whose halves keep z to 2^-11 of itself at any distance.

Examples:
  python3 tools/train/nss_job.py pack --data build/train/nss_data --init models/nss_v1_high/weights.npz --out build/job
  python3 tools/train/nss_job.py run --job build/job --mode v1_high --device cuda --batch 32 --minutes 8 --out OUT
"""

from __future__ import annotations

import argparse
import json
import lzma
import shutil
import sys
from pathlib import Path

import numpy as np
import torch

import evaluate_nss
import nss
import nss_data
import train_nss
from files import write_atomically

LIMIT = 60 << 20
PICTURES = ("colour", "depth", "motion", "truth", "truth_motion")
HELD_OUT = 2


def _halves(clip: nss_data.Clip, name: str) -> torch.Tensor:
    picture = getattr(clip, name)
    if name == "depth":
        picture = picture - torch.tensor([c[0] for c in clip.camera]).view(-1, 1, 1, 1)
    return picture.half()


def pack_clip(clip: nss_data.Clip) -> tuple[dict, bytes]:
    """What describes a clip, and its pictures, compressed."""
    parts, about = [], {key: getattr(clip, key) for key in ("name", "jitter", "exposure", "cut", "camera", "reverse")}
    about["shapes"] = {}
    for name in PICTURES:
        halves = _halves(clip, name).contiguous()
        about["shapes"][name] = list(halves.shape)
        raw = halves.numpy().view(np.uint8)
        parts += [raw.reshape(-1)[0::2].tobytes(), raw.reshape(-1)[1::2].tobytes()]
    block = lzma.compress(b"".join(parts), preset=1)
    about["bytes"] = len(block)
    return about, block


def unpack_clip(about: dict, block: bytes) -> nss_data.Clip:
    """The clip of `pack_clip`. Errors: ValueError, KeyError, lzma.LZMAError for what is none."""
    data, at, pictures = np.frombuffer(lzma.decompress(block), np.uint8), 0, {}
    for name in PICTURES:
        shape = about["shapes"][name]
        count = int(np.prod(shape))
        halves = np.stack([data[at : at + count], data[at + count : at + 2 * count]], 1).reshape(-1).view(np.float16)
        pictures[name], at = torch.from_numpy(halves.reshape(shape).copy()), at + 2 * count
    constants = torch.tensor([c[0] for c in about["camera"]]).view(-1, 1, 1, 1)
    pictures["depth"] = pictures["depth"].float() + constants
    jitter = [tuple(j) for j in about["jitter"]]
    return nss_data.Clip(about["name"], **pictures, jitter=jitter,
                         **{key: about[key] for key in ("exposure", "cut", "camera", "reverse")})


def pack(options: argparse.Namespace, report=print) -> None:
    """Writes the job. Errors: ValueError, OSError."""
    names = nss_data.clip_names(options.data)
    names = [names[i] for i in np.random.default_rng(options.seed).permutation(len(names))]
    clips, room = [], LIMIT - options.init.stat().st_size - (1 << 16)
    for name in names:
        about, block = pack_clip(nss_data.load_clip(options.data, name))
        room -= len(block) + len(json.dumps(about))
        if room < 0:
            break
        clips.append((about, block))
        report(f"clip {name}: {len(block) / 1e6:.2f} MB, {room / 1e6:.1f} MB left")
    if len(clips) <= HELD_OUT:
        raise ValueError(f"{options.data}: {len(clips)} clips fit, a job needs {HELD_OUT + 1}")
    options.out.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(options.init, options.out / "start.npz")
    head = json.dumps([about for about, _ in clips]).encode() + b"\n"
    write_atomically(options.out / "clips.bin", head + b"".join(block for _, block in clips))
    report(f"{len(clips)} clips -> {options.out}")


def load(path: Path) -> list[nss_data.Clip]:
    """The clips of a job. Errors: OSError, ValueError."""
    head, newline, blocks = path.read_bytes().partition(b"\n")
    try:
        clips, at = [], 0
        for about in json.loads(head) if newline else []:
            clips.append(unpack_clip(about, blocks[at : at + about["bytes"]]))
            at += about["bytes"]
    except (ValueError, KeyError, TypeError, lzma.LZMAError) as error:
        raise ValueError(f"{path}: not the clips of a job ({type(error).__name__}: {error})") from None
    if len(clips) <= HELD_OUT:
        raise ValueError(f"{path}: {len(clips)} clips, expected more than {HELD_OUT}")
    return clips


def validate(weights: Path, clips: list[nss_data.Clip]) -> dict[str, float]:
    """PSNR in float by clip, dB, without the first frame."""
    model, _ = nss.load_model(weights)
    return {clip.name: round(float(np.mean(evaluate_nss.measure(model, clip, ["float"])["float"]["psnr"][1:])), 3)
            for clip in clips}


def run(options: argparse.Namespace, more: list[str], report=print) -> dict:
    """Trains; returns the record. Errors: ValueError, OSError."""
    clips = load(options.job / "clips.bin")
    start = options.job / "start.npz"
    training = train_nss.parse(["--data", str(options.job), "--out", str(options.out), "--init", str(start),
                                "--minutes", str(options.minutes), *more])
    before = validate(start, clips[:HELD_OUT])
    report(f"before: {before}")
    record = train_nss.train(training, clips[HELD_OUT:], report)["record"]
    record["validation"] = {"before": before, "after": validate(options.out / "last.pt", clips[:HELD_OUT])}
    report(f"after: {record['validation']['after']}")
    nss.save_weights(options.out / "weights.npz", nss.load_model(options.out / "last.pt")[0], record)
    write_atomically(options.out / "record.json", (json.dumps(record, indent=1, sort_keys=True) + "\n").encode())
    return record


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input, 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(
        description="Packs a training job for a machine with a GPU, and runs it there.",
        epilog="example: python3 tools/train/nss_job.py run --job build/job --mode v1_high --device cuda --out OUT")
    commands = parser.add_subparsers(dest="command", required=True)
    packing = commands.add_parser("pack", help="write the job")
    packing.add_argument("--data", type=Path, required=True, help="data set folder")
    packing.add_argument("--init", type=Path, required=True, help="weights to start from (.npz)")
    packing.add_argument("--seed", type=int, default=1, help="for the choice of clips (default: 1)")
    packing.add_argument("--out", type=Path, required=True, help="folder of the job")
    running = commands.add_parser("run", help="train; other options are those of train_nss.py, --mode is needed")
    running.add_argument("--job", type=Path, required=True, help="folder of the job")
    running.add_argument("--minutes", type=float, default=8.0, help="of training, at most 9 (default: 8)")
    running.add_argument("--out", type=Path, required=True, help="folder for the results")
    options, more = parser.parse_known_args(arguments)
    try:
        if options.command == "pack":
            if more:
                raise ValueError(f"pack takes no {more[0]}")
            pack(options)
        else:
            if not 0 < options.minutes <= 9:
                raise ValueError(f"--minutes must lie in 0 to 9, found {options.minutes}")
            run(options, more)
    except KeyboardInterrupt:
        return 130
    except (ValueError, OSError) as error:
        print(f"nss_job: error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
