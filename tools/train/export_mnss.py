#!/usr/bin/python3
"""Writes the model folder of a trained MNSS: the network in four precisions, frame.json, weights.npz, golden vectors.

Written into OUT: model.tosa (INT8), model.int16.tosa, model.fp32.tosa and model.fp16.tosa, quantization.json (what the
codes of their tensors mean), frame.json with the numbers of the two small networks, frame_sharp.json, which sharpens
what is shown, weights.npz (float weights, activation ranges and the training record, from which everything here can be
made again), weights_float.npz if the float graphs have others, and golden/<tensor>.npy: a picture of 64x64 and the result of the exact integer network for it.

Examples:
  python3 tools/train/export_mnss.py --weights build/train/mnss_qat/last.pt --out models/mnss_x2
  python3 tools/train/export_mnss.py --weights models/mnss_x2/weights.npz --out models/mnss_x2
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np

import mnss
import precisions
from files import save_array, write_atomically

SHADERS = "../../shaders/frame/mnss"
BETA = 0.15


def golden_input(rows: int = mnss.STORED[0], columns: int = mnss.STORED[1]) -> np.ndarray:
    """int8 `[1, rows, columns, 3]`: waves and steps, so that shifts and borders show."""
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    planes = [0.5 + 0.3 * np.sin(x * (0.2 + 0.1 * c)) * np.cos(y * (0.35 - 0.05 * c))
              + 0.2 * ((x.astype(int) // (5 + c) + y.astype(int) // (7 - c)) % 2) for c in range(3)]
    codes = np.floor(np.clip(np.stack(planes, 2), 0, 1) * 255 + 0.5) - 128
    return codes.astype(np.int8)[None]


def definitions(model: mnss.Mnss) -> dict[str, dict[str, float]]:
    """Definitions of the passes "weight" and "insert": the small networks."""
    inpaint, aa = (model.convs[c.name] for c in (mnss.INPAINT, mnss.AA))
    by_channel = inpaint.weight.detach()[0].permute(1, 2, 0).flatten().tolist()
    by_output = aa.weight.detach().flatten().tolist()
    return {"weight": {**{f"W{i}": w for i, w in enumerate(by_channel)}, "BIAS": float(inpaint.bias)},
            "insert": {**{f"W{i}": w for i, w in enumerate(by_output)},
                       **{f"B{i}": b for i, b in enumerate(aa.bias.tolist())}}}


def frame_description(model: mnss.Mnss, sharpen: bool = False, shaders: str = SHADERS) -> dict:
    """frame.json; with `sharpen` the output is not the history but the sharpened one."""
    scale, numbers = model.scale, definitions(model)

    def image(name: str, role: str, form: str, size: str, **more) -> dict:
        return {"name": name, "role": role, "format": form, "size": size, **more}

    def shader(name: str, over: str, reads: list, writes: list, **more) -> dict:
        return {"name": name, "shader": f"{shaders}/{name}.comp", "over": over, "workgroup": [32, 4], **more,
                "reads": reads, "writes": writes}

    history = {"of": "history", "frames_back": 1}
    nearness = {"of": "nearness", "frames_back": 1, "as": "past_nearness"}
    passes = [
        shader("difference", "color", ["color", "depth", "motion", history, nearness], ["difference", "nearness"]),
        shader("weight", "color", ["difference"], ["weight"], defines=numbers["weight"]),
        shader("insert", "color", ["color", "motion", "weight", history], ["input"], defines=numbers["insert"]),
        {"graph": "model.tosa"},
        shader("show", "output", ["input", mnss.OUTPUT], ["history"]),
    ]
    shows = {"shows": "history"}
    if sharpen:
        passes.append(shader("sharpen", "output", ["history"], ["output"], defines={"BETA": BETA}))
        shows = {}

    def codes(scale: precisions.Scale) -> dict:
        return {"scale": scale[0], "zero_point": scale[1]}

    return {
        "schema": "shale-frame/2",
        "render": [1920 // (2 * scale), 1080 // (2 * scale)],
        "output": [960, 540],
        "ratio": [scale, scale],
        "pattern": "mnss",
        "params": [
            {"name": "jitter", "type": "vec2"},
            {"name": "previous_jitter", "type": "vec2"},
            {"name": "exposure", "type": "float", "default": [1]},
            {"name": "reset", "type": "int", "reset": True},
            {"name": "motion_scale", "type": "vec2", "default": [1, 1]},
            {"name": "reverse_depth", "type": "int"},
            {"name": "depth_to_view", "type": "vec4", "default": [1.002004, -0.1002004, 1.0264, 0.57735]},
        ],
        "images": [
            image("color", "input", "rgba8_unorm", "render"),
            image("depth", "input", "r32_float", "render"),
            image("motion", "input", "rg16_float", "render"),
            image("output", "output", "rgba8_unorm", "output", **shows),
            image("history", "history", "rgba8_unorm", "output", depth=2),
            image("nearness", "history", "r32_float", "render", depth=2),
            image("difference", "internal", "r32_uint", "render"),
            image("weight", "internal", "r32_float", "render"),
        ],
        "tensors": [{"name": "input", **codes(mnss.CODES), "size": "output"},
                    {"name": mnss.OUTPUT, **codes(mnss.CORRECTION)}],
        "passes": passes,
        "views": [
            {"title": "history with samples", "of": "input", "first": 0, "channels": 3},
            {"title": "correction", "of": mnss.OUTPUT, "first": 0, "channels": 3, "low": -0.1, "high": 0.1},
            {"title": "share of the frame", "of": "weight"},
            {"title": "motion", "of": "motion", "channels": 2, "low": -0.02, "high": 0.02},
            {"title": "depth", "of": "depth", "low": 1, "high": 0.9},
        ],
    }


def export(weights: Path, out: Path, shaders: str = SHADERS, real: Path | None = None) -> mnss.Mnss:
    """Writes the model folder; `shaders` is the path from it to the passes, `real` the weights of the float graphs, where they
    are others; the small networks are those of `weights`. Errors: ValueError, OSError."""
    model, record = mnss.load_model(weights)
    real_model, real_record = mnss.load_model(real or weights)
    if real_model.scale != model.scale:
        raise ValueError(f"{real}: has scale {real_model.scale}, {weights} has {model.scale}")
    network = mnss.to_int8(model)
    (out / "golden").mkdir(parents=True, exist_ok=True)
    mnss.save_weights(out / "weights.npz", model, record)
    if real:
        mnss.save_weights(out / "weights_float.npz", real_model, real_record)
    write_atomically(precisions.file_in(out, "int8"), mnss.build_graph(network, *mnss.STORED).pack())
    write_atomically(precisions.file_in(out, "int16"), mnss.build_short_graph(model, *mnss.STORED).pack())
    for precision, dtype in precisions.FLOATS.items():
        write_atomically(precisions.file_in(out, precision), mnss.build_real_graph(real_model, *mnss.STORED, dtype).pack())
    write_atomically(out / "quantization.json", precisions.quantization_json(mnss.tensor_scales(model)))
    for name, sharpen in (("frame.json", False), ("frame_sharp.json", True)):
        text = json.dumps(frame_description(model, sharpen, shaders), indent=1)
        write_atomically(out / name, (text + "\n").encode())
    codes = golden_input()
    save_array(out / "golden" / "input.npy", codes)
    save_array(out / "golden" / f"{mnss.OUTPUT}.npy", network.run(codes))
    return model


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes model.tosa, frame.json, weights.npz and golden vectors of a trained MNSS.",
        epilog="example: python3 tools/train/export_mnss.py --weights build/train/mnss_qat/last.pt --out models/mnss_x2",
    )
    parser.add_argument("--weights", type=Path, required=True, help="checkpoint (.pt) or weights (.npz), with ranges")
    parser.add_argument("--float-weights", type=Path, help="the same for the float graphs (default: those of --weights)")
    parser.add_argument("--out", type=Path, required=True, help="model folder")
    parser.add_argument("--shaders", default=SHADERS, help=f"path from OUT to the passes (default: {SHADERS})")
    options = parser.parse_args(arguments)
    try:
        model = export(options.weights, options.out, options.shaders, options.float_weights)
    except (ValueError, OSError) as error:
        print(f"export_mnss: error: {error}", file=sys.stderr)
        return 1
    print(f"x{model.scale} -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
