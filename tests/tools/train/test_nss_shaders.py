"""From a scene to pictures: trains each NSS network for a few steps on clips that `shale scene` renders, exports it,
plays it with `shale play`, and compares the shaders with the PyTorch passes on the same frames.

Needs the program: its path is in SHALE_PROGRAM (CTest sets it); without it the tests are skipped.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools" / "train"))

import export_nss
import nss_data
import nss_passes as passes
import train_nss

PROGRAM = os.environ.get("SHALE_PROGRAM", "")
SCENE = ROOT / "models" / "scenes" / "train" / "courtyard.json"
MODELS = {"v1_high": "nss_v1_high", "v1_low": "nss_v1_low", "v0_1": "nss_v0_1"}
FRAMES = 4

#: Float rounding differs between the two by a few units in the last place, which moves a value across the border
#: of two codes at most: one code. A value at a threshold (disocclusion, a motion of 0.1 px, a depth tie) may fall on
#: either side; so few texels may differ by more.
CODE_BOUND = 1
SHARE_AT_THRESHOLDS = 1e-3
#: Half floats are rounded once here and once in the shader, to nearest or towards zero: two steps of 2^-11 each, and
#: float rounding on top. Below the normal half floats the step is 2^-24.
HALF_STEP = 2.0**-10 * 1.01
HALF_SMALLEST = 2.0**-23


def shale(*arguments) -> None:
    """Runs the program. Errors: AssertionError with what it said."""
    done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode != 0:
        raise AssertionError(f"shale {arguments[0]} exits with {done.returncode}: {done.stdout}{done.stderr}")


@unittest.skipUnless(PROGRAM, "SHALE_PROGRAM is not set")
class FromSceneToPictures(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.keep = tempfile.TemporaryDirectory()
        cls.folder = Path(cls.keep.name)
        # A height that needs padding, and a crop that holds objects.
        shale("scene", SCENE, "-o", cls.folder / "x2", "--render", "136x76", "--ratio", "2", "--frames", FRAMES)
        shale("scene", SCENE, "-o", cls.folder / "x1.5", "--render", "64x36", "--ratio", "1.5", "--frames", FRAMES,
              "--reverse-depth")
        cls.models = {mode: cls.train(mode) for mode in MODELS}

    @classmethod
    def tearDownClass(cls):
        cls.keep.cleanup()

    @classmethod
    def train(cls, mode: str) -> Path:
        """A few steps in float, one with fake quantization, export; the model folder."""
        common = ["--mode", mode, "--data", str(cls.folder / "x2"), "--batch", "1", "--crop", "32", "--frames", "3",
                  "--every", "1"]
        calibration, train_nss.CALIBRATION_SEQUENCES = train_nss.CALIBRATION_SEQUENCES, 1
        output, sys.stdout = sys.stdout, open(os.devnull, "w")
        try:
            code = train_nss.main([*common, "--steps", "3", "--out", str(cls.folder / f"{mode}_float")])
            code += train_nss.main([*common, "--steps", "1", "--qat", "--lr", "0.0001", "--init",
                                    str(cls.folder / f"{mode}_float" / "last.pt"), "--out",
                                    str(cls.folder / f"{mode}_qat")])
            code += export_nss.main(["--weights", str(cls.folder / f"{mode}_qat" / "last.pt"), "--out",
                                     str(cls.folder / mode)])
        finally:
            sys.stdout.close()
            sys.stdout, train_nss.CALIBRATION_SEQUENCES = output, calibration
        if code:
            raise AssertionError(f"training of {mode} failed")
        frame = (ROOT / "models" / MODELS[mode] / "frame.json").read_text()
        (cls.folder / mode / "frame.json").write_text(frame.replace("../../shaders", str(ROOT / "shaders")))
        return cls.folder / mode

    def compare(self, mode_name: str, ratio: str) -> None:
        mode, out = passes.MODES[mode_name], self.folder / f"{mode_name}_{ratio}"
        shale("play", self.models[mode_name], "-i", self.folder / ratio, "-o", out, "--dump", out, "--kernels",
              "generic", "--check", "--validation")
        clip = nss_data.load_clip(self.folder / ratio, "0000", ratio=ratio)
        state = None
        for t in range(FRAMES):
            found = {name: np.load(out / f"{t:04}.{name}.npy") for name in ("input", "output")}
            frame = clip.frame(t)
            before = passes.pre(mode, frame, state)
            difference = np.abs(passes.input_codes(before.input).numpy().astype(int) - found["input"].astype(int))
            wrong = (difference > CODE_BOUND).any(axis=3).mean()
            self.assertLessEqual(wrong, SHARE_AT_THRESHOLDS, f"{mode_name} {ratio} frame {t}: input")

            codes = {name: passes.from_codes(torch.from_numpy(np.load(out / f"{t:04}.{name}.npy")))
                     for name in (("temporal", "kernel") if mode.generation else
                                  ("k0", "k1", "k2", "k3", "temporal", "feedback"))}
            if not mode.generation:
                codes["kernel"] = torch.cat([codes[f"k{i}"] for i in range(4)], 1)
            after = passes.post(mode, frame, before, codes, state, clip.output)
            wanted = after.output[0].permute(1, 2, 0).numpy()
            shown = found["output"][..., :3]
            error = np.abs(wanted - shown) - HALF_STEP * np.abs(wanted) - HALF_SMALLEST
            self.assertLessEqual((error > 0).any(axis=2).mean(), SHARE_AT_THRESHOLDS,
                                 f"{mode_name} {ratio} frame {t}: output, by up to {error.max()}")
            state = passes.next_state(frame, before, codes, after, half=True)
            # Go on from what the shaders left, so that each frame is compared for itself.
            state.history = torch.from_numpy(shown.copy()).permute(2, 0, 1)[None]

    def test_v1_high_agrees(self):
        self.compare("v1_high", "x2")

    def test_v1_low_agrees(self):
        self.compare("v1_low", "x2")

    def test_v0_1_agrees(self):
        self.compare("v0_1", "x2")

    def test_other_ratios_agree_with_reverse_depth(self):
        for mode in MODELS:
            self.compare(mode, "x1.5")


if __name__ == "__main__":
    unittest.main()
