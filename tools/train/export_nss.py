#!/usr/bin/python3
"""Writes the model folder of a trained NSS network: the network in four precisions, weights.npz, golden vectors.

Written into OUT: model.tosa (INT8, the input size of a 960x540 picture), model.int16.tosa, model.fp32.tosa and
model.fp16.tosa, quantization.json (what the codes of their tensors mean), weights.npz (float weights, activation ranges
and the training record, from which everything here can be made again) and golden/<tensor>.npy: a structured input
of 64x64 texels and the outputs of the exact integer network for it.

Examples:
  python3 tools/train/export_nss.py --weights build/train/nss_high_qat/last.pt --out models/nss_v1_high
  python3 tools/train/export_nss.py --weights models/nss_v1_high/weights.npz --out models/nss_v1_high
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

import nss
import precisions
from files import save_array, write_atomically

GOLDEN_SIZE = 64


def golden_input(rows: int = GOLDEN_SIZE, columns: int = GOLDEN_SIZE) -> torch.Tensor:
    """int8 `[1, rows, columns, 12]`: ramps, waves and a step per channel, so that a shifted resize shows."""
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    planes = []
    for c in range(nss.INPUT_CHANNELS):
        wave = np.sin(x * (0.11 + 0.05 * c) + 0.7 * c) * np.cos(y * (0.31 - 0.02 * c))
        ramp = (x * (c % 3) + y * (c % 4 + 1)) / (3 * columns + 4 * rows)
        step = ((x.astype(int) // (3 + c) + y.astype(int) // (5 + c)) % 2) * 0.25
        planes.append(0.25 + 0.25 * wave + 0.5 * ramp + step)
    codes = np.floor(np.clip(np.stack(planes, 2), 0, 1) * 255 + 0.5) - 128
    return torch.from_numpy(codes.astype(np.int8))[None]


def export(weights: list[Path], out: Path) -> nss.Int8Nss:
    """Writes the model folder. Errors: ValueError, OSError."""
    model, record = nss.load_average(weights)
    network = nss.to_int8(model)
    (out / "golden").mkdir(parents=True, exist_ok=True)
    nss.save_weights(out / "weights.npz", model, record)
    size = nss.STORED[model.mode.name]
    write_atomically(precisions.file_in(out, "int8"), nss.build_graph(network, *size).pack())
    write_atomically(precisions.file_in(out, "int16"), nss.build_short_graph(model, *size).pack())
    for precision, dtype in precisions.FLOATS.items():
        write_atomically(precisions.file_in(out, precision), nss.build_real_graph(model, *size, dtype).pack())
    scales = nss.tensor_scales(model, network)
    write_atomically(out / "quantization.json", precisions.quantization_json(scales))
    codes = golden_input()
    save_array(out / "golden" / "input.npy", codes.numpy())
    for name, value in network.run(codes).items():
        save_array(out / "golden" / f"{name}.npy", value.numpy())
    return network


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes model.tosa, weights.npz and golden vectors of a trained NSS network.",
        epilog="example: python3 tools/train/export_nss.py --weights build/train/high/last.pt --out models/nss_v1_high",
    )
    parser.add_argument("--weights", type=Path, required=True, nargs="+", metavar="FILE",
                        help="checkpoint (.pt) or weights (.npz), with ranges; the mean of several")
    parser.add_argument("--out", type=Path, required=True, help="model folder")
    options = parser.parse_args(arguments)
    try:
        network = export(options.weights, options.out)
    except (ValueError, OSError) as error:
        print(f"export_nss: error: {error}", file=sys.stderr)
        return 1
    print(f"{network.mode.name} -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
