"""MNSS from a scene to pictures: random weights, exported, played on frames with the paper's pattern; the graph must equal
the interpreter bit for bit, the shaders the PyTorch passes on the same frames.

Needs the program: its path is in SHALE_PROGRAM (CTest sets it); without it the tests are skipped.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tools" / "train"), str(Path(__file__).resolve().parent)]

import export_mnss
import mnss
import mnss_passes as passes
import nss_data
from test_mnss import PATTERN, offset, random_model
from test_nss_shaders import shale

PROGRAM = os.environ.get("SHALE_PROGRAM", "")
SCENE = ROOT / "models" / "scenes" / "train" / "courtyard.json"
FRAMES = 3
#: Sizes that no tile or workgroup divides.
RENDER = {2: "75x43", 3: "51x29"}
#: Float rounding moves a value across the border of two codes at most; one of the 8-bit difference then moves the weight by
#: less than a code, too. A position at the border of the screen, or a choice at a depth of NaN, may fall on either side.
CODE_BOUND = 1
SHARE_AT_THRESHOLDS = 2e-3


@unittest.skipUnless(PROGRAM, "SHALE_PROGRAM is not set")
class FromSceneToPictures(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.keep = tempfile.TemporaryDirectory()
        cls.folder = Path(cls.keep.name)
        for scale in mnss.SCALES:
            model = random_model(scale)
            mnss.save_weights(cls.folder / f"w{scale}.npz", model, {"seed": 3})
            export_mnss.export(cls.folder / f"w{scale}.npz", cls.folder / f"mnss_x{scale}", str(ROOT / "shaders/frame/mnss"))
            shale("scene", SCENE, "-o", cls.folder / f"x{scale}", "--render", RENDER[scale], "--ratio", scale, "--frames",
                  FRAMES, "--pattern", "mnss")

    @classmethod
    def tearDownClass(cls):
        cls.keep.cleanup()

    def compare(self, scale: int, *more: str) -> None:
        out = self.folder / f"played_{scale}{len(more)}"
        shale("play", self.folder / f"mnss_x{scale}", "-i", self.folder / f"x{scale}", "-o", out, "--dump", out, "--kernels",
              "generic", "--check", "--validation", *more)
        clip = nss_data.load_clip(self.folder / f"x{scale}", "0000", ratio=f"x{scale}")
        model, state = random_model(scale), None
        for t in range(FRAMES):
            found = {name: np.load(out / f"{t:04}.{name}.npy") for name in ("input", "correction", "output")}
            frame = clip.frame(t)
            with torch.no_grad():
                before = passes.pre(model, frame, passes.display(frame.colour * frame.exposure), state)
            difference = np.abs(passes.input_codes(before.inserted).numpy().astype(int) - found["input"].astype(int))
            wrong = (difference > CODE_BOUND).any(axis=3).mean()
            self.assertLessEqual(wrong, SHARE_AT_THRESHOLDS, f"x{scale} frame {t}: input, by up to {difference.max()}")
            shown = passes.from_codes(*(torch.from_numpy(found[name]) for name in ("input", "correction")))
            wanted = passes.sharpened(shown, export_mnss.BETA) if more else shown
            error = np.abs(found["output"][..., :3] * 255 - wanted[0].permute(1, 2, 0).numpy() * 255).max()
            self.assertLessEqual(error, 0.51 if more else 1e-3, f"x{scale} frame {t}: output")
            state = passes.next_state(frame, before, shown)

    def test_x2_agrees(self):
        self.compare(2)

    def test_x3_agrees(self):
        self.compare(3)

    def test_sharpening_agrees(self):
        self.compare(2, "--frame", str(self.folder / "mnss_x2" / "frame_sharp.json"))

    def test_scenes_are_rendered_with_the_pattern(self):
        description = json.loads((self.folder / "x2" / "0000.json").read_text())
        self.assertEqual(description["Samples"], {"Sequence": "mnss", "Count": 12, "Quantized": False})
        found = [(f["Jitter"]["X"], f["Jitter"]["Y"]) for f in description["Frames"]]
        self.assertEqual(found, [(offset(x, 2), offset(y, 2)) for x, y in PATTERN[:FRAMES]])
        # A scene that play renders itself is the same as the data set.
        played = self.folder / "played_scene"
        shale("play", self.folder / "mnss_x2", "-i", SCENE, "-o", played, "--dump", played, "--kernels", "generic",
              "--render", RENDER[2], "--frames", FRAMES)
        with_data = self.folder / "played_data"
        shale("play", self.folder / "mnss_x2", "-i", self.folder / "x2", "-o", with_data, "--dump", with_data, "--kernels",
              "generic")
        for t in range(FRAMES):
            a, b = (np.load(folder / f"{t:04}.input.npy").astype(int) for folder in (played, with_data))
            # The data set holds halves.
            self.assertLessEqual((np.abs(a - b) > 2).mean(), 0.01)

    def test_costs_of_the_file_are_those_of_the_reference(self):
        for scale in mnss.SCALES:
            for width, height in ((1920, 1080), (1280 if scale == 2 else 1281, 720)):
                done = subprocess.run([PROGRAM, "report", str(self.folder / f"mnss_x{scale}"), "--render",
                                       f"{width // scale}x{height // scale}", "--json"], capture_output=True, text=True)
                self.assertEqual(done.returncode, 0, done.stderr)
                row = json.loads(done.stdout)["files"][0]
                self.assertEqual((row["parameters"], row["macs"]), (15203, 15120 * width * height))


if __name__ == "__main__":
    unittest.main()
