#!/usr/bin/python3
"""Measures SRPO against nearest and Lanczos enlargement, in float and in INT8.

Pictures: the composed test picture (models/pictures) and a held-out set of random scenes; neither was seen in
training or calibration. PSNR and SSIM are those of the project: 8-bit RGB, all channels pooled; SSIM with an
11x11 Gaussian window, zero padding, full-size map. edge_psnr looks at the surroundings of edges only;
strong_steps is the number of neighbours that differ by more than 96 codes, over that of the reference.

Examples:
  python3 tools/train/evaluate_srpo.py --weights models/srpo_x2/weights.npz --out models/srpo_x2/quality.json
  python3 tools/train/evaluate_srpo.py --weights models/srpo_x3/weights.npz --pictures out --count 0
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import quantize
import shapes
import srpo
import training
from png import write_png

METHODS = ("nearest", "lanczos", "srpo_float", "srpo_int8")
HELD_OUT_SIZE = (192, 128)


def enlarge(model: srpo.Srpo, network: quantize.Int8Srpo, lr: np.ndarray) -> tuple[dict, dict]:
    """Pictures by method, uint8, and how the INT8 offsets differ from the float ones."""
    s, x = model.scale, lr / 255.0
    real, integer = srpo.float_offsets(model, lr), network.offsets(lr)
    pictures = {
        "nearest": srpo.nearest(lr, s),
        "lanczos": srpo.to_codes(srpo.lanczos(x, s)),
        "srpo_float": srpo.to_codes(srpo.fuse(x, real, s)),
        "srpo_int8": srpo.to_codes(srpo.fuse(x, integer, s)),
    }
    rounded = [srpo.round_half_away(offsets) for offsets in (real, integer)]
    facts = {
        "moved_share": float(np.mean(np.any(rounded[1] != 0, axis=2))),
        "largest_offset": float(np.abs(integer).max()),
        "same_rounded_share": float(np.mean(np.all(rounded[0] == rounded[1], axis=2))),
        "mean_offset_error": float(np.abs(real - integer).mean()),
    }
    return pictures, facts


def steps(picture: np.ndarray) -> np.ndarray:
    """Largest change of a channel to the right and lower neighbours, in codes: `[h - 1, w - 1]`."""
    p = picture.astype(np.int64)
    right, down = np.abs(np.diff(p, axis=1)).max(axis=2), np.abs(np.diff(p, axis=0)).max(axis=2)
    return np.maximum(right[:-1], down[:, :-1])


def edge_figures(picture: np.ndarray, reference: np.ndarray) -> tuple[float, float]:
    """PSNR in the 5x5 surroundings of reference steps above 32 codes; share of steps above 96 kept."""
    wanted = steps(reference)
    padded = np.pad(wanted > 32, 2)
    h, w = wanted.shape
    band = np.any([padded[j : j + h, i : i + w] for j in range(5) for i in range(5)], axis=0)
    error = ((picture.astype(float) - reference) ** 2).mean(axis=2)[:-1, :-1][band].mean() / 255.0**2
    return float(-10.0 * np.log10(max(error, 1e-10))), float((steps(picture) > 96).sum() / max((wanted > 96).sum(), 1))


def measure(model: srpo.Srpo, network: quantize.Int8Srpo, scenes: list[shapes.Scene]) -> dict:
    """Mean PSNR, SSIM and edge figures by method over the scenes."""
    rows = {method: {"psnr": [], "ssim": [], "edge_psnr": [], "strong_steps": []} for method in METHODS}
    facts: dict[str, list[float]] = {}
    for scene in scenes:
        reference = shapes.render(scene, model.scale)
        pictures, about = enlarge(model, network, shapes.render(scene))
        for method in METHODS:
            rows[method]["psnr"].append(min(srpo.psnr(pictures[method], reference), 100.0))
            rows[method]["ssim"].append(srpo.ssim(pictures[method], reference))
            near, kept = edge_figures(pictures[method], reference)
            rows[method]["edge_psnr"].append(near)
            rows[method]["strong_steps"].append(kept)
        for key, value in about.items():
            facts.setdefault(key, []).append(value)
    out = {m: {k: round(float(np.mean(v)), 4) for k, v in row.items()} for m, row in rows.items()}
    out["int8"] = {k: round(float(max(v) if k == "largest_offset" else np.mean(v)), 5) for k, v in facts.items()}
    return out


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 for refused input."""
    parser = argparse.ArgumentParser(
        description="Writes PSNR and SSIM of nearest, Lanczos, SRPO float and SRPO INT8 as JSON.",
        epilog="example: python3 tools/train/evaluate_srpo.py --weights models/srpo_x2/weights.npz",
    )
    parser.add_argument("--weights", type=Path, required=True, help="weights (.npz) or checkpoint (.pt)")
    parser.add_argument("--count", type=int, default=20, help="held-out scenes, 0 to 1000 (default: 20)")
    parser.add_argument("--out", type=Path, help="JSON file (default: standard output)")
    parser.add_argument("--pictures", type=Path, help="folder for the test picture by every method")
    options = parser.parse_args(arguments)
    def make() -> dict:
        if not 0 <= options.count <= 1000:
            raise ValueError(f"--count must lie in 0 to 1000, found {options.count}")
        model, _ = srpo.load_model(options.weights)
        network = quantize.quantize(model)
        test = shapes.test_scene()
        report = {"scale": model.scale, "test_picture": measure(model, network, [test])}
        if options.count:
            held_out = [shapes.random_scene(shapes.HELD_OUT_SEED + i, *HELD_OUT_SIZE) for i in range(options.count)]
            report["held_out"] = {"pictures": options.count, "size": list(HELD_OUT_SIZE),
                                  **measure(model, network, held_out)}
        if options.pictures:
            options.pictures.mkdir(parents=True, exist_ok=True)
            for method, picture in enlarge(model, network, shapes.render(test))[0].items():
                write_png(options.pictures / f"{method}_x{model.scale}.png", picture)
        return report

    return training.write_report("evaluate_srpo", options.out, make)


if __name__ == "__main__":
    sys.exit(main())
