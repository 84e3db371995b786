"""QRISP from a scene to pictures: exports random weights, plays them with `shale play`, which compares each set's
network with the interpreter, and compares the shaders with the PyTorch passes on the same frames.

Needs the program: its path is in SHALE_PROGRAM (CTest sets it); without it the tests are skipped.
"""

from __future__ import annotations

import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools" / "train"))
sys.path.insert(0, str(Path(__file__).resolve().parent))

import export_qrisp  # noqa: E402
import nss_data  # noqa: E402
import qrisp  # noqa: E402
import qrisp_passes as passes  # noqa: E402
from test_nss_shaders import (CODE_BOUND, HALF_SMALLEST, HALF_STEP, PROGRAM, SCENE, SHARE_AT_THRESHOLDS,  # noqa: E402
                              shale)
from test_qrisp import network  # noqa: E402

FRAMES = 4


def _picture(texels: np.ndarray) -> torch.Tensor:
    """`[h, w, 3 or more]` to `[1, 3, h, w]`."""
    return torch.from_numpy(texels[..., :3].copy()).permute(2, 0, 1)[None]


class Folder(unittest.TestCase):
    def test_shipped_folders_are_what_their_weights_export(self):
        for shipped in sorted((ROOT / "models").glob("qrisp_*")):
            with self.subTest(shipped.name), tempfile.TemporaryDirectory() as out:
                export_qrisp.export(shipped / "weights.npz", Path(out), 16, real=shipped / "weights_float.npz")
                for path in (p for p in Path(out).rglob("*") if p.is_file()):
                    name = path.relative_to(out)
                    self.assertEqual(path.read_bytes(), (shipped / name).read_bytes(), name)


@unittest.skipUnless(PROGRAM, "SHALE_PROGRAM is not set")
class FromSceneToPictures(unittest.TestCase):
    def compare(self, scale: int, render: str, *more: str, **trained: bool) -> None:
        options = passes.Options(**trained)
        with tempfile.TemporaryDirectory() as keep:
            folder = Path(keep)
            shale("scene", SCENE, "-o", folder / "data", "--render", render, "--ratio", scale, "--frames", FRAMES,
                  *more)
            qrisp.save_weights(folder / "weights.npz", network("s", scale, corrects=options.corrects), trained)
            export_qrisp.export(folder / "weights.npz", folder / "model", 16, str(ROOT / "shaders/frame/qrisp"))
            out = folder / "out"
            shale("play", folder / "model", "-i", folder / "data", "-o", out, "--dump", out, "--kernels", "generic",
                  "--check", "--validation")
            self.compare_frames(scale, nss_data.load_clip(folder / "data", "0000", ratio=f"x{scale}"), out, options)

    def compare_frames(self, scale: int, clip: nss_data.Clip, out: Path, options: passes.Options) -> None:
        state = None
        for t in range(FRAMES):
            found = {name: np.load(out / f"{t:04}.{name}.npy") for name in (
                "input", "moved", "warped", "output", "history", "features", *qrisp.HEADS)}
            frame = clip.frame(t)
            before = passes.pre(frame, state, scale, options)
            np.testing.assert_array_equal(found["moved"][..., :2], before.motion[0].permute(1, 2, 0).numpy())
            codes = torch.floor(before.input * 255.0 + 0.5).clamp(0, 255) - 128
            difference = np.abs(codes.permute(0, 2, 3, 1).numpy() - found["input"].astype(float))
            self.assertLessEqual((difference > CODE_BOUND).any(axis=3).mean(), SHARE_AT_THRESHOLDS, f"frame {t}: input")
            heads = {name: torch.from_numpy((np.load(out / f"{t:04}.{name}.npy").astype(np.float32) - zero) * step)
                     .permute(0, 3, 1, 2) for name, (step, zero) in qrisp.output_scales(options.corrects).items()}
            warped, before.warped = before.warped, _picture(found["warped"])  # as the post pass reads it
            state = passes.post(frame, before, heads, state, scale, options)
            for name, wanted in (("warped", warped), ("history", state.colour),
                                 ("output", passes.output(frame, state))):
                shown, wanted, least = found[name][..., :3], wanted[0].permute(1, 2, 0).numpy(), HALF_SMALLEST
                if name == "output":  # y^2 / (1 - y^2): near white a step of y is many of the colour, so y is compared;
                    shown, wanted = (np.sqrt(c / (1 + c)) for c in (shown.astype(np.float64), wanted))
                    least = np.sqrt(wanted**2 + least) - wanted  # in the dark a step of the colour is many of y
                error = np.abs(wanted - shown) - HALF_STEP * np.abs(wanted) - least - 1e-6
                self.assertLessEqual((error > 0).any(axis=2).mean(), SHARE_AT_THRESHOLDS,
                                     f"frame {t}: {name}, by up to {error.max()}")
            self.assertLess(np.abs(found["features"].squeeze() - state.feature[0, 0].numpy()).max(), 1e-3)
            # Go on from what the shaders left, so that each frame is compared for itself.
            features = torch.from_numpy(found["features"].reshape(state.feature.shape))
            state = passes.State(_picture(found["history"]), features)

    def test_ratio_2_at_odd_sizes(self):
        self.compare(2, "137x77")

    def test_ratio_3_whose_blocks_cross_texels_with_reverse_depth(self):
        self.compare(3, "50x35", "--reverse-depth")

    def test_history_by_catmull_rom(self):
        self.compare(2, "75x44", cubic=True)

    def test_a_candidate_that_corrects(self):
        self.compare(2, "75x43", corrects=True)
        self.compare(3, "50x35", corrects=True, cubic=True)

    def test_ratio_4(self):
        self.compare(4, "34x21")


if __name__ == "__main__":
    unittest.main()
