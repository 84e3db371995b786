#!/usr/bin/python3
"""Writes the model folder of a trained QRISP network: its weight sets in four precisions, weights.npz, golden vectors.

Written into OUT: model.tosa (the first set, INT8, the input size of a 1920x1080 output), sets/NN.tosa (the others), both
also as .int16.tosa, .fp32.tosa and .fp16.tosa; quantization.json (what the codes of their tensors mean); frame.json;
weights.npz (float weights, activation ranges and the training record, from which everything here can be made again), of the float
graphs weights_float.npz if they have others; and golden/<tensor>.npy: an input of 16x24 texels and the outputs of the exact integer network for it, set by set.
The offsets of the sets are the first ones of the jitter sequence.

Example:
  python3 tools/train/export_qrisp.py --weights build/train/s2_qat/last.pt --out models/qrisp_s_x2
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import torch

import precisions
import qrisp
import qrisp_passes
from files import save_array, write_atomically

SHADERS = "../../shaders/frame/qrisp"
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


def frame_description(scale: int, offsets: list[qrisp.Jitter], shaders: str, options: qrisp_passes.Options) -> dict:
    """frame.json of a network with a weight set for each offset."""

    def image(name: str, role: str, form: str, size, **more) -> dict:
        return {"name": name, "role": role, "format": form, "size": size, **more}

    def shader(name: str, over, reads: list, writes: list, bounds: dict | None = None, **more) -> dict:
        return {"name": name, "shader": f"{shaders}/{name}.comp", "over": over, **more, "reads": reads, "writes": writes,
                **({"bounds": bounds} if bounds else {})}

    past = [{"of": name, "frames_back": 1} for name in ("history", "features")]
    rows = {name: {"scale": step, "zero_point": zero} for name, (step, zero) in qrisp.output_scales(options.corrects).items()}

    def defined(name: str, wanted: bool) -> dict:
        return {"defines": {name: 1}} if wanted else {}

    step, zero = qrisp.INPUT_SCALE
    files = [set_file("int8", index) for index in range(len(offsets))]
    output = [qrisp.OUTPUT[1], qrisp.OUTPUT[0]]
    return {
        "schema": "shale-frame/2",
        "render": [side // scale for side in output],
        "output": output,
        "ratio": [scale, scale],
        "params": [
            {"name": "jitter", "type": "vec2"},
            {"name": "previous_jitter", "type": "vec2"},
            {"name": "exposure", "type": "float", "default": [7.389056]},
            {"name": "reset", "type": "int", "reset": True},
            {"name": "motion_scale", "type": "vec2", "default": [1, 1]},
            {"name": "reverse_depth", "type": "int"},
            {"name": "jittered_motion", "type": "int"},
        ],
        "images": [
            image("color", "input", "rgba16_float", "render"),
            image("depth", "input", "r32_float", "render"),
            image("motion", "input", "rg16_float", "render"),
            image("output", "output", "rgba16_float", "output"),
            image("history", "history", "rgba16_float", "output", depth=2),
            image("features", "history", "r8_unorm", "output", depth=2),
            image("moved", "internal", "rg16_float", {"of": "output", "divide": 8}),
            image("warped", "internal", "rgba16_float", "output"),
        ],
        "tensors": [
            {"name": "input", "scale": step, "zero_point": zero, "size": {"of": "render", "multiple": 2}},
            *({"name": name, **row} for name, row in rows.items()),
        ],
        **({"sets": {"chosen_by": "jitter", "at": [list(offset) for offset in offsets]}} if len(offsets) > 1 else {}),
        "passes": [
            shader("dilate", "moved", ["depth", "motion"], ["moved"]),
            shader("pre", {"of": "render", "divide": [2, 1], "multiple": 2}, ["color", "depth", "moved", *past],
                   ["input", "warped"], workgroup=[32, 4], **defined("CUBIC", options.cubic),
                   bounds={"input": [*[[0, 1]] * 6, *["history"] * 3 * scale**2, *["features"] * scale**2]}),
            {"graph": files if len(files) > 1 else files[0]},
            shader("post", "output", [*qrisp.HEADS, "warped", "color"], ["history", "features", "output"], workgroup=[32, 4],
                   **defined("CORRECTS", options.corrects), bounds={"history": [0, 1], "features": "feature"}),
        ],
        "views": [
            {"title": "current colour", "of": "input", "first": 0, "channels": 3},
            {"title": "nearness", "of": "input", "first": 3},
            {"title": "warped history", "of": "warped", "channels": 3},
            {"title": "block motion", "of": "moved", "channels": 2, "low": -0.02, "high": 0.02},
            {"title": "alpha, first phase", "of": "alpha", "first": 0},
            {"title": "feature", "of": "features"},
        ],
    }


def export(weights: Path, out: Path, count: int, shaders: str = SHADERS, real: Path | None = None) -> qrisp.Int8Qrisp:
    """Writes the model folder; `shaders` is the path from it to the passes, `real` the weights of the float graphs, where they
    are others. Errors: ValueError, OSError."""
    model, record = qrisp.load_model(weights)
    real_model, real_record = qrisp.load_model(real or weights)
    if qrisp.describe(real_model) != qrisp.describe(model):
        raise ValueError(f"{real}: is {qrisp.describe(real_model)}, {weights} is {qrisp.describe(model)}")
    offsets = qrisp.jitter_sequence(count if model.conditioned else 1)
    network = qrisp.to_int8(model, offsets)
    for folder in ("golden", "sets") if len(offsets) > 1 else ("golden",):
        (out / folder).mkdir(parents=True, exist_ok=True)
    qrisp.save_weights(out / "weights.npz", model, record)
    if real:
        qrisp.save_weights(out / "weights_float.npz", real_model, real_record)
    size = tuple(side // model.scale for side in qrisp.OUTPUT)
    codes = golden_input(model.scale)
    results: dict[str, list[np.ndarray]] = {name: [] for name in qrisp.HEADS}
    for index, offset in enumerate(offsets):
        graphs = {"int8": qrisp.build_graph(network, index, *size),
                  "int16": qrisp.build_short_graph(model, offset, *size)}
        graphs |= {precision: qrisp.build_real_graph(real_model, offset, *size, dtype)
                   for precision, dtype in precisions.FLOATS.items()}
        for precision, graph in graphs.items():
            write_atomically(out / set_file(precision, index), graph.pack())
        for name, value in network.run(codes, index).items():
            results[name].append(value.numpy())
    write_atomically(out / "quantization.json", precisions.quantization_json(qrisp.tensor_scales(model)))
    text = json.dumps(frame_description(model.scale, offsets, shaders, qrisp_passes.Options.of(record)), indent=1)
    write_atomically(out / "frame.json", (text + "\n").encode())
    save_array(out / "golden" / "input.npy", codes.numpy())
    for name, values in results.items():
        save_array(out / "golden" / f"{name}.npy", np.concatenate(values))
    return network


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes the weight sets, weights.npz and golden vectors of a trained QRISP network.",
        epilog="example: python3 tools/train/export_qrisp.py --weights build/train/s2/last.pt --out models/qrisp_s_x2",
    )
    parser.add_argument("--weights", type=Path, required=True, help="checkpoint (.pt) or weights (.npz), with ranges")
    parser.add_argument("--out", type=Path, required=True, help="model folder")
    parser.add_argument("--float-weights", type=Path, help="the same for the float graphs (default: those of --weights)")
    parser.add_argument("--sets", type=int, default=16, help="weight sets, 1 to 64 (default: 16)")
    options = parser.parse_args(arguments)
    try:
        if not 1 <= options.sets <= 64:
            raise ValueError(f"--sets must lie in 1 to 64, found {options.sets}")
        network = export(options.weights, options.out, options.sets, real=options.float_weights)
    except (ValueError, OSError) as error:
        print(f"export_qrisp: error: {error}", file=sys.stderr)
        return 1
    print(f"QRISP {network.size} x{network.scale}, {len(network.sets)} sets -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
