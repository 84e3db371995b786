#!/usr/bin/python3
"""Writes the model folder of a trained NFRU: the network in four precisions, frame.json, weights.npz, golden vectors.

Written into OUT: model.tosa (INT8), model.int16.tosa, model.fp32.tosa and model.fp16.tosa, quantization.json (what the
codes of their tensors mean), frame.json, weights.npz (float weights, activation ranges and the training record, from which
everything here can be made again) and golden/<tensor>.npy: an input of 64x64 and the result of the exact integer network for
it. With --by-hand instead: frame.json alone, of the same passes with weights by a formula.

Examples:
  python3 tools/train/export_nfru.py --weights build/train/nfru_qat/last.pt --out models/nfru
  python3 tools/train/export_nfru.py --by-hand --out models/baselines/generation/nfru_by_hand --shaders ../../../../shaders/frame
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import torch

import nfru
import precisions
from files import save_array, write_atomically

SHADERS = "../../shaders/frame"
#: Levels of the flow's pyramid: 0 has the output's size, each next one half of it.
LEVELS = 6
#: The flow is that of this level.
FINEST = 2


def golden_input(rows: int = nfru.STORED[0], columns: int = nfru.STORED[1]) -> torch.Tensor:
    """int8 `[1, rows, columns, 16]`: waves and steps of each channel, so that shifts, pads and borders show."""
    y, x = np.mgrid[0:rows, 0:columns].astype(float)
    planes = [0.5 + 0.3 * np.sin(x * (0.13 + 0.05 * c) + 0.9 * c) * np.cos(y * (0.33 - 0.015 * c))
              + 0.2 * ((x.astype(int) // (3 + c) + y.astype(int) // (5 + c)) % 2) for c in range(nfru.CHANNELS)]
    codes = np.floor(np.clip(np.stack(planes, 2), 0, 1) * 255 + 0.5) - 128
    return torch.from_numpy(codes.astype(np.int8))[None]


def frame_description(weights_scale: float | None, shaders: str = SHADERS) -> dict:
    """frame.json; a scale of the logits, or None for weights by hand."""
    by_hand = weights_scale is None

    def level(divide: int) -> dict | str:
        return "output" if divide == 1 else {"of": "output", "divide": divide}

    def image(name: str, role: str, form: str, size, **more) -> dict:
        return {"name": name, "role": role, "format": form, "size": size, **more}

    def shader(name: str, file: str, over: str, reads: list, writes: list, **more) -> dict:
        return {"name": name, "shader": f"{shaders}/{file}.comp", "over": over, **more, "reads": reads, "writes": writes}

    def called(of: str, name: str) -> dict:
        return {"of": of, "as": name}

    def before(of: str, name: str) -> dict:
        return {"of": of, "frames_back": 1, "as": name}

    history = {"role": "history", "depth": 2}
    images = [
        image("color", "input", "rgba16_float", "render"), image("depth", "input", "r32_float", "render"),
        image("motion", "input", "rg16_float", "render"),
        image("output", "output", "rgba16_float", "output", shows="shown"),
        image("shown", form="rgba16_float", size="output", **history),
        image("displayed", form="rgba16_float", size="output", **history),
        image("dilated_depth", form="r32_float", size="render", **history),
        image("dilated_motion", form="rg16_float", size="render", **history),
        *(image(name, "internal", "r32_uint", "render") for name in ("splat", "splat_previous", "filled")),
        *(image(f"luma_{i}", form="r32_float", size=level(2**i), **history) for i in range(LEVELS)),
        *(image(f"{name}_{i}", "internal", "rg16_float", level(2**i))
          for i in range(LEVELS - 1, FINEST - 1, -1) for name in ("found", "cleaned", "flow")),
        image("flow", form="rg16_float", size=level(2**FINEST), **history),
        image("flow_splat", "internal", "r32_uint", level(2**FINEST)),
    ]
    upscale = [
        shader("dilate", "baseline/mob_fgsr_dilate", "dilated_depth", ["depth", "motion"], ["dilated_depth", "dilated_motion"]),
        shader("keep", "framegen/keep", "output", ["color"], ["shown"]),
        shader("display", "nfru/display", "output", ["shown"], ["displayed", "luma_0"]),
        *(shader(f"halve_{i}", "flow/halve", f"luma_{i}", [called(f"luma_{i - 1}", "fine")], [called(f"luma_{i}", "coarse")],
                 defines={"BLUR": int(i > 1)}) for i in range(1, LEVELS)),
    ]
    for i in range(LEVELS - 1, FINEST - 1, -1):
        coarsest, past = i == LEVELS - 1, before(f"luma_{i}", "before")
        above = [] if coarsest else [called(f"flow_{i + 1}", "above")]
        upscale += [
            shader(f"match_{i}", "flow/match", f"found_{i}", [past, called(f"luma_{i}", "after"), *above],
                   [called(f"found_{i}", "found")], defines={"COARSEST": int(coarsest)}),
            shader(f"median_{i}", "flow/median", f"cleaned_{i}", [called(f"found_{i}", "found")],
                   [called(f"cleaned_{i}", "cleaned")]),
            shader(f"bilateral_{i}", "flow/bilateral", f"flow_{i}", [past, called(f"cleaned_{i}", "cleaned")],
                   [called(f"flow_{i}", "flow")]),
        ]
    upscale.append(shader("hint", "flow/hint", "flow", [
        before(f"luma_{FINEST}", "before"), called(f"luma_{FINEST}", "after"), called(f"flow_{FINEST}", "smooth"),
        called("dilated_motion", "hint")], ["flow"], defines={"RAW": 0}))
    past = [before(name, f"previous_{name.removeprefix('dilated_')}") for name in ("dilated_depth", "dilated_motion")]
    warped = ["filled", "displayed", "dilated_depth", "dilated_motion", "flow", "flow_splat",
              before("displayed", "previous_displayed"), *past]
    hand = {"BY_HAND": int(by_hand)}
    splats = ["splat", "splat_previous"]
    generate = [
        {"name": "splat", "shader": f"{shaders}/framegen/splat.comp", "over": "splat", "defines": {"QUADRATIC": 1, "AHEAD": 0},
         "clears": splats, "reads": ["dilated_depth", "dilated_motion", *past], "updates": splats},
        shader("refine", "framegen/refine", "filled", splats, ["filled"], defines={"REFINES": 1, "FILLS": 1}),
        {"name": "flow_splat", "shader": f"{shaders}/framegen/flow_splat.comp", "over": "flow_splat", "clears": ["flow_splat"],
         "reads": ["flow", past[0]], "updates": ["flow_splat"]},
        shader("pre", "nfru/pre", nfru.OUTPUT if by_hand else "input", warped, [nfru.OUTPUT if by_hand else "input"],
               defines=hand),
        *([] if by_hand else [{"graph": "model.tosa"}]),
        shader("post", "nfru/post", "output", [nfru.OUTPUT, "shown", before("shown", "previous_shown"), *warped],
               ["output"], defines=hand),
    ]
    description = {
        "schema": "shale-frame/2",
        "render": [1920, 1080],
        "output": [1920, 1080],
        "pattern": [[0, 0]],
        "params": [
            {"name": "exposure", "type": "float", "default": [7.389056]},
            {"name": "reset", "type": "int", "reset": True},
            {"name": "time", "type": "float", "time": True},
            {"name": "motion_scale", "type": "vec2", "default": [1, 1]},
            {"name": "frames", "type": "int", "frames": True},
            {"name": "reverse_depth", "type": "int"},
            {"name": "depth_to_view", "type": "vec4", "default": [1.002004, -0.1002004, 1.0264, 0.57735]},
        ],
        "images": images,
        "programs": [{"name": "upscale", "passes": upscale},
                     {"name": "generate", "generates": [0, 1], "passes": generate}],
    }
    if by_hand:
        images.append(image(nfru.OUTPUT, "internal", "rgba8_unorm", level(2**FINEST)))
        return description
    description["tensors"] = [
        {"name": "input", "scale": nfru.INPUT[0], "zero_point": nfru.INPUT[1],
         "size": {"of": "output", "divide": 2**FINEST, "multiple": 8}},
        {"name": nfru.OUTPUT, "scale": weights_scale, "zero_point": 0}]
    description["views"] = [
        *({"title": title, "of": "input", "first": first, "channels": count} for title, first, count in (
            ("previous by motion", 0, 3), ("newest by motion", 3, 3), ("previous by flow", 6, 3), ("newest by flow", 9, 3),
            ("depth, previous", 12, 1), ("depth, newest", 13, 1), ("hidden, previous", 14, 1), ("hidden, newest", 15, 1))),
        {"title": "weights of the first three", "of": nfru.OUTPUT, "first": 0, "channels": 3,
         "low": -64 * weights_scale, "high": 64 * weights_scale},
        {"title": "motion", "of": "motion", "channels": 2, "low": -0.02, "high": 0.02}]
    return description


def as_bytes(description: dict) -> bytes:
    """frame.json: a line for each entry of a list."""
    lines = []
    for key, value in description.items():
        if key == "programs":
            programs = []
            for program in value:
                head = json.dumps({k: v for k, v in program.items() if k != "passes"})[:-1]
                passes = ",\n".join(f"      {json.dumps(entry)}" for entry in program["passes"])
                programs.append(f'    {head}, "passes": [\n{passes}]}}')
            lines.append('  "programs": [\n' + ",\n".join(programs) + "\n  ]")
        elif isinstance(value, list) and isinstance(value[0], dict):
            lines.append(f'  "{key}": [\n' + ",\n".join(f"    {json.dumps(entry)}" for entry in value) + "\n  ]")
        else:
            lines.append(f'  "{key}": {json.dumps(value)}')
    return ("{\n" + ",\n".join(lines) + "\n}\n").encode()


def export(weights: Path, out: Path, shaders: str = SHADERS) -> nfru.Nfru:
    """Writes the model folder; `shaders` is the path from it to the passes. Errors: ValueError, OSError."""
    model, record = nfru.load_model(weights)
    network = nfru.to_int8(model)
    (out / "golden").mkdir(parents=True, exist_ok=True)
    nfru.save_weights(out / "weights.npz", model, record)
    write_atomically(precisions.file_in(out, "int8"), nfru.build_graph(network, *nfru.STORED).pack())
    write_atomically(precisions.file_in(out, "int16"), nfru.build_short_graph(model, *nfru.STORED).pack())
    for precision, dtype in precisions.FLOATS.items():
        write_atomically(precisions.file_in(out, precision), nfru.build_real_graph(model, *nfru.STORED, dtype).pack())
    write_atomically(out / "quantization.json", precisions.quantization_json(nfru.tensor_scales(model)))
    write_atomically(out / "frame.json", as_bytes(frame_description(nfru.scales(model)[nfru.OUTPUT][0], shaders)))
    codes = golden_input()
    save_array(out / "golden" / "input.npy", codes.numpy())
    save_array(out / "golden" / f"{nfru.OUTPUT}.npy", network.run(codes).numpy())
    return model


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes model.tosa, frame.json, weights.npz and golden vectors of a trained NFRU.",
        epilog="example: python3 tools/train/export_nfru.py --weights build/train/nfru_qat/last.pt --out models/nfru",
    )
    kind = parser.add_mutually_exclusive_group(required=True)
    kind.add_argument("--weights", type=Path, help="checkpoint (.pt) or weights (.npz), with ranges")
    kind.add_argument("--by-hand", action="store_true", help="frame.json alone, of the passes with weights by a formula")
    parser.add_argument("--out", type=Path, required=True, help="model folder")
    parser.add_argument("--shaders", default=SHADERS, help=f"path from OUT to shaders/frame (default: {SHADERS})")
    options = parser.parse_args(arguments)
    try:
        if options.by_hand:
            options.out.mkdir(parents=True, exist_ok=True)
            write_atomically(options.out / "frame.json", as_bytes(frame_description(None, options.shaders)))
        else:
            export(options.weights, options.out, options.shaders)
    except (ValueError, OSError) as error:
        print(f"export_nfru: error: {error}", file=sys.stderr)
        return 1
    print(f"NFRU -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
