#!/usr/bin/python3
"""Quantizes trained SRPO weights and writes a model folder: graph, frame description, golden vectors.

Written into OUT: model.tosa (INT8, shapes for 64x64), model.int16.tosa, model.fp32.tosa and model.fp16.tosa,
quantization.json (what the codes of their tensors mean), frame.json, weights.npz (the float weights and the
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

import precisions
import quantize
import shapes
import srpo
from files import save_array, write_atomically
from tosa_writer import GraphWriter

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


PAD = (2, 2, 2, 2)


def build_real_graph(model: srpo.Srpo, network: quantize.Int8Srpo, dtype: str, size: int = GRAPH_SIZE) -> GraphWriter:
    """The graph in FP32 or FP16, with the weights as they were trained."""
    graph = GraphWriter()
    codes = graph.input("input", (1, size, size, 3))
    x = precisions.real_input(graph, codes, _input_scale(), dtype)
    for index, conv in enumerate((model.conv1, model.conv2), start=1):
        x = precisions.relu(graph, f"relu{index}", precisions.real_conv(graph, f"conv{index}", x, conv, PAD))
    x = graph.resize_nearest("upsample", x, model.scale)
    x = precisions.real_conv(graph, "conv3", x, model.conv3, PAD)
    graph.output(precisions.real_output(graph, "offsets", x, _offset_scale(network)))
    return graph


def build_short_graph(model: srpo.Srpo, network: quantize.Int8Srpo, size: int = GRAPH_SIZE) -> GraphWriter:
    """The graph with int16 activations, in the ranges of the INT8 ones."""
    graph, scales = GraphWriter(), short_scales(network)
    x, scale = precisions.short_input(graph, graph.input("input", (1, size, size, 3)), _input_scale())
    for index, conv in enumerate((model.conv1, model.conv2), start=1):
        result = f"relu{index}"
        x = precisions.short_conv(graph, f"conv{index}", f"conv{index}/rescale", x, scale, conv, scales[result],
                                  "INT16", PAD)
        x, scale = precisions.relu(graph, result, x), scales[result][0]
    x = graph.resize_nearest("upsample", x, model.scale)
    graph.output(precisions.short_conv(graph, "conv3", "offsets", x, scale, model.conv3, scales["offsets"], "INT8",
                                       PAD))
    return graph


def _input_scale() -> precisions.Scale:
    return (quantize.INPUT_SCALE, quantize.INPUT_ZERO_POINT)


def _offset_scale(network: quantize.Int8Srpo) -> precisions.Scale:
    return (network.offset_scale, network.layers[2].output_zp)


def short_scales(network: quantize.Int8Srpo) -> dict[str, precisions.Scale]:
    """Scale and zero point of the tensors of the INT16 form."""
    relus = [(layer.output_scale * 255.0 / precisions.INT16_MAX, 0) for layer in network.layers[:2]]
    return {"input": _input_scale(), "relu1": relus[0], "relu2": relus[1], "upsample": relus[1],
            "offsets": _offset_scale(network)}


def tensor_scales(network: quantize.Int8Srpo) -> dict[str, dict[str, precisions.Scale]]:
    """For quantization.json."""
    ends = {"input": _input_scale(), "offsets": _offset_scale(network)}
    codes = [(layer.output_scale, layer.output_zp) for layer in network.layers[:2]]
    return {"int8": {**ends, "conv1/rescale": codes[0], "relu1": codes[0], "conv2/rescale": codes[1],
                     "relu2": codes[1], "upsample": codes[1]},
            "int16": short_scales(network), "fp32": ends, "fp16": ends}


def frame_description(network: quantize.Int8Srpo) -> dict:
    """frame.json: quantize the frame, run the network, then project, interpolate and fuse."""
    shader = "../../shaders/frame/srpo"
    return {
        "schema": "shale-frame/2",
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
            {"name": "pre", "shader": f"{shader}/pre.comp", "over": "color", "reads": ["color"], "writes": ["input"]},
            {"graph": "model.tosa"},
            {"name": "post", "shader": f"{shader}/post.comp", "over": "output", "reads": ["color", "offsets"],
             "writes": ["output"]},
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
    write_atomically(precisions.file_in(out, "int8"), build_graph(network).pack())
    write_atomically(precisions.file_in(out, "int16"), build_short_graph(model, network).pack())
    for precision, dtype in precisions.FLOATS.items():
        write_atomically(precisions.file_in(out, precision), build_real_graph(model, network, dtype).pack())
    write_atomically(out / "quantization.json", precisions.quantization_json(tensor_scales(network)))
    text = json.dumps(frame_description(network), indent=1)
    write_atomically(out / "frame.json", (text + "\n").encode())
    save_array(out / "golden" / "input.npy", golden)
    save_array(out / "golden" / "offsets.npy", network.run(golden))
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
