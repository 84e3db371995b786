#!/usr/bin/python3
"""Writes the model folder of a trained QRISP network: its weight sets in four precisions, weights.npz, golden vectors.

Written into OUT: model.tosa (the first set, INT8, the input size of a 1920x1080 output), sets/NN.tosa (the others), both
also as .int16.tosa, .fp32.tosa and .fp16.tosa; quantization.json (what the codes of their tensors mean); weights.npz
(float weights, activation ranges and the training record, from which everything here can be made again); and
golden/<tensor>.npy: an input of 16x24 texels and the outputs of the exact integer network for it, set by set.
The offsets of the sets are the first ones of the jitter sequence; frame.json has to name the same.

Example:
  python3 tools/train/export_qrisp.py --weights build/train/s2_qat/last.pt --out models/qrisp_s_x2
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import torch

import precisions
import qrisp
from tosa_writer import write_atomically

GOLDEN_SIZE = (16, 24)


def golden_input(scale: int) -> torch.Tensor:
    """int8 `[1, rows, columns, c]`: waves and a step per channel, the jitter planes constant."""
    y, x = np.mgrid[0 : GOLDEN_SIZE[0], 0 : GOLDEN_SIZE[1]].astype(float)
    planes = [0.5 + 0.3 * np.sin(x * (0.3 + 0.02 * c) + c) * np.cos(y * (0.5 - 0.01 * c)) +
              0.2 * ((x + 2 * y) // (5 + c) % 2) for c in range(qrisp.input_channels(scale))]
    planes[4:6] = [np.full_like(x, 0.5625), np.full_like(x, 0.3125)]
    codes = np.floor(np.clip(np.stack(planes, 2), 0, 1) * 255 + 0.5) - 128
    return torch.from_numpy(codes.astype(np.int8))[None]


def set_file(precision: str, index: int) -> str:
    """Path of a set's network in the model folder."""
    name = precisions.FILES[precision]
    return name if index == 0 else "sets/" + name.replace("model", f"{index:02}")


def export(weights: Path, out: Path, count: int) -> qrisp.Int8Qrisp:
    """Writes the model folder. Errors: ValueError, OSError."""
    model, record = qrisp.load_model(weights)
    offsets = qrisp.jitter_sequence(count if model.conditioned else 1)
    network = qrisp.to_int8(model, offsets)
    for folder in ("golden", "sets") if len(offsets) > 1 else ("golden",):
        (out / folder).mkdir(parents=True, exist_ok=True)
    qrisp.save_weights(out / "weights.npz", model, record)
    size = tuple(side // model.scale for side in qrisp.OUTPUT)
    codes = golden_input(model.scale)
    results: dict[str, list[np.ndarray]] = {name: [] for name in qrisp.HEADS}
    for index, offset in enumerate(offsets):
        graphs = {"int8": qrisp.build_graph(network, index, *size),
                  "int16": qrisp.build_short_graph(model, offset, *size)}
        graphs |= {precision: qrisp.build_real_graph(model, offset, *size, dtype)
                   for precision, dtype in precisions.FLOATS.items()}
        for precision, graph in graphs.items():
            write_atomically(out / set_file(precision, index), graph.pack())
        for name, value in network.run(codes, index).items():
            results[name].append(value.numpy())
    write_atomically(out / "quantization.json", precisions.quantization_json(qrisp.tensor_scales(model)))
    np.save(out / "golden" / "input.npy", codes.numpy())
    for name, values in results.items():
        np.save(out / "golden" / f"{name}.npy", np.concatenate(values))
    return network


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes the weight sets, weights.npz and golden vectors of a trained QRISP network.",
        epilog="example: python3 tools/train/export_qrisp.py --weights build/train/s2/last.pt --out models/qrisp_s_x2",
    )
    parser.add_argument("--weights", type=Path, required=True, help="checkpoint (.pt) or weights (.npz), with ranges")
    parser.add_argument("--out", type=Path, required=True, help="model folder")
    parser.add_argument("--sets", type=int, default=16, help="weight sets, 1 to 64 (default: 16)")
    options = parser.parse_args(arguments)
    try:
        if not 1 <= options.sets <= 64:
            raise ValueError(f"--sets must lie in 1 to 64, found {options.sets}")
        network = export(options.weights, options.out, options.sets)
    except (ValueError, OSError) as error:
        print(f"export_qrisp: error: {error}", file=sys.stderr)
        return 1
    print(f"QRISP {network.size} x{network.scale}, {len(network.sets)} sets -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
