#!/usr/bin/python3
"""Quantizes trained SRPO weights and writes a model folder: graph, frame description, golden vectors.

Written into OUT: model.tosa (INT8, shapes for 64x64), frame.json, weights.npz (the float weights and the
training record, from which everything here can be made again) and golden/input.npy, golden/offsets.npy.

Examples:
  python3 tools/train/export_srpo.py --weights build/train/srpo_x2/last.pt --out models/srpo_x2
  python3 tools/train/export_srpo.py --weights models/srpo_x2/weights.npz --out models/srpo_x2
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

import quantize
import shapes
import srpo
from tosa_writer import GraphWriter, write_atomically

GRAPH_SIZE = 64


def build_graph(network: quantize.Int8Srpo, size: int = GRAPH_SIZE) -> GraphWriter:
    """conv1, relu1, conv2, relu2, upsample, conv3 with a RESCALE behind each convolution."""
    graph = GraphWriter()
    x = graph.input("input", (1, size, size, 3))
    for index, layer in enumerate(network.layers, start=1):
        if index == 3:
            x = graph.resize_nearest("upsample", x, network.scale)
        x = graph.conv2d(layer.name, x, layer.weight, layer.bias, input_zp=layer.input_zp, pad=(2, 2, 2, 2))
        result = "offsets" if index == 3 else f"{layer.name}/rescale"
        x = graph.rescale(result, x, layer.multiplier, layer.shift, output_zp=layer.output_zp)
        if layer.relu:
            x = graph.clamp(f"relu{index}", x, -128, 127)
    graph.output(x)
    return graph


def frame_description(network: quantize.Int8Srpo) -> dict:
    """frame.json: quantize the frame, run the network, then project, interpolate and fuse."""
    shader = "../../shaders/frame/srpo"
    return {
        "schema": "shale-frame/1",
        "render": [480, 270],
        "output": [480 * network.scale, 270 * network.scale],
        "ratio": [network.scale, network.scale],
        "images": [
            {"name": "color", "role": "input", "format": "rgba8_unorm", "size": "render"},
            {"name": "output", "role": "output", "format": "rgba8_unorm", "size": "output"},
        ],
        "tensors": [
            {"name": "input", "scale": quantize.INPUT_SCALE, "zero_point": quantize.INPUT_ZERO_POINT,
             "size": "render"},
            {"name": "offsets", "scale": network.offset_scale, "zero_point": network.layers[2].output_zp},
        ],
        "passes": [
            {"name": "pre", "shader": f"{shader}/pre.comp", "over": "color", "workgroup": [8, 8],
             "bindings": [{"binding": 0, "image": "color", "access": "read"},
                          {"binding": 1, "tensor": "input", "access": "write"}]},
            {"graph": "model.tosa"},
            {"name": "post", "shader": f"{shader}/post.comp", "over": "output", "workgroup": [8, 8],
             "bindings": [{"binding": 0, "image": "color", "access": "read"},
                          {"binding": 1, "tensor": "offsets", "access": "read"},
                          {"binding": 2, "image": "output", "access": "write"}]},
        ],
    }


def golden_input() -> np.ndarray:
    """int8 `[1, 64, 64, 3]`: the text and the rim of the fan in the test picture."""
    picture = shapes.render(shapes.test_scene())
    return quantize.input_codes(picture[14 : 14 + GRAPH_SIZE, 270 : 270 + GRAPH_SIZE])


def export(weights: Path, out: Path) -> quantize.Int8Srpo:
    """Writes the model folder. Errors: ValueError, OSError."""
    model, record = srpo.load_model(weights)
    network = quantize.quantize(model)
    golden = golden_input()
    (out / "golden").mkdir(parents=True, exist_ok=True)
    srpo.save_weights(out / "weights.npz", model, record)
    write_atomically(out / "model.tosa", build_graph(network).pack())
    text = json.dumps(frame_description(network), indent=1)
    write_atomically(out / "frame.json", (text + "\n").encode())
    np.save(out / "golden" / "input.npy", golden)
    np.save(out / "golden" / "offsets.npy", network.run(golden))
    return network


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes model.tosa, frame.json, weights.npz and golden vectors of a trained SRPO.",
        epilog="example: python3 tools/train/export_srpo.py --weights build/train/srpo_x2/last.pt --out models/srpo_x2",
    )
    parser.add_argument("--weights", type=Path, required=True, help="checkpoint (.pt) or weights (.npz)")
    parser.add_argument("--out", type=Path, required=True, help="model folder")
    options = parser.parse_args(arguments)
    try:
        network = export(options.weights, options.out)
    except (ValueError, OSError) as error:
        print(f"export_srpo: error: {error}", file=sys.stderr)
        return 1
    print(f"x{network.scale}: one offset code is {network.offset_scale} pixels -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
