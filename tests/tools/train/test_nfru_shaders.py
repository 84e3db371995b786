"""NFRU from a scene to pictures: random weights, exported, played; the graph must equal the interpreter bit for bit, the
shaders the PyTorch passes on the same frames.

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

import export_nfru
import nfru
import nfru_clips
import nfru_data
import nfru_passes as passes
import nss_data
import train_nfru
from test_nfru import MACS, network
from test_nss_shaders import shale

PROGRAM = os.environ.get("SHALE_PROGRAM", "")
SCENE = ROOT / "models" / "scenes" / "train" / "flyers.json"
FRAMES = 4
#: Lanes of 19x11 and 32x8 pixels: padded in both directions, and not at all.
SIZES = {"odd": "75x43", "even": "128x32"}
#: Float rounding moves a value across the border of two codes at most. A position at the border of the screen or of a texel,
#: or a depth at a threshold, may fall on either side.
CODE_BOUND = 1
SHARE_AT_THRESHOLDS = 2e-3
#: As displayed: the output is a half, up to 2^-11 of a linear colour.
DISPLAYED_BOUND = 1e-3

STILL = {"schema": "shale-scene/1", "frames": 8, "seed": 1,
         "camera": {"path": [{"frame": 0, "eye": [0, 1, 4], "target": [0, 0.8, 0]}]},
         "sun": {"direction": [1, 2, 1]}, "sky": {"clouds": 0.6},
         "materials": {"wall": {"pattern": "checker", "color": [0.8, 0.2, 0.1], "color_b": [0.1, 0.3, 0.9], "cell": [0.2, 0.2]}},
         "objects": [{"shape": "box", "size": [2, 1, 1], "material": "wall"}]}


@unittest.skipUnless(PROGRAM, "SHALE_PROGRAM is not set")
class FromSceneToPictures(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        cls.keep = tempfile.TemporaryDirectory()
        cls.folder = Path(cls.keep.name)
        nfru.save_weights(cls.folder / "weights.npz", network(), {"seed": 3})
        export_nfru.export(cls.folder / "weights.npz", cls.folder / "nfru", str(ROOT / "shaders/frame"))

    @classmethod
    def tearDownClass(cls):
        cls.keep.cleanup()

    def compare(self, size: str, count: int, *more: str) -> None:
        data, out = self.folder / size, self.folder / f"played_{size}"
        shale("scene", SCENE, "-o", data, "--render", SIZES[size], "--ratio", 1, "--pattern", "0,0", "--first", 8, "--frames",
              FRAMES, "--no-truth", *more)
        shale("play", self.folder / "nfru", "-i", data, "-o", out, "--dump", out, "--generate", count, "--kernels", "generic",
              "--check", "--validation")
        cameras, exposures, reverse, _ = nss_data.load_cameras(data / "0000.json")
        self.assertEqual(reverse, bool(more))
        scale = nfru.scales(network())[nfru.OUTPUT][0]
        differing = 0.0
        for i in range(1, FRAMES):
            for k in range(1, count + 1):
                shown = (i - 1) * (count + 1) + k
                pair = passes.read_pair(out, shown, (i - 1) * (count + 1), i + 1, torch.tensor([cameras[i]]), reverse,
                                        float(np.float32(k / (count + 1))))
                found = {name: np.load(out / f"{shown:04d}.{name}.npy") for name in ("input", nfru.OUTPUT, "output")}
                codes = passes.input_codes(passes.pre(pair)).numpy()
                difference = np.abs(codes.astype(int) - found["input"].astype(int))
                wrong = (difference > CODE_BOUND).any(axis=3).mean()
                self.assertLessEqual(wrong, SHARE_AT_THRESHOLDS, f"{size} {shown}: input, by up to {difference.max()}")
                logits = torch.from_numpy(found[nfru.OUTPUT].astype(np.float32)).permute(0, 3, 1, 2) * scale
                taken, counted = passes.samples(pair)
                wanted = passes.post(passes.enlarged(logits, pair.lane, pair.output), taken, counted)
                made = passes.displayed(torch.from_numpy(found["output"][..., :3]).permute(2, 0, 1)[None] * exposures[i])
                error = (wanted - made).abs().amax(1)
                self.assertLessEqual(float((error > DISPLAYED_BOUND).float().mean()), SHARE_AT_THRESHOLDS,
                                     f"{size} {shown}: output, by up to {float(error.max())}")
                # The four samples are not all the same, so the weights matter.
                differing = max(differing, float((taken - taken[:, :1]).abs().max()))
        self.assertGreater(differing, 0.2)

    def test_halfway_agrees(self):
        self.compare("odd", 1)

    def test_other_times_and_reversed_depth_agree(self):
        self.compare("even", 2, "--reverse-depth")

    def test_frames_alike_give_the_frame_whatever_the_weights(self):
        (self.folder / "still.json").write_text(json.dumps(STILL))
        out = self.folder / "still"
        shale("play", self.folder / "nfru", "-i", self.folder / "still.json", "-o", out, "--dump", out, "--generate", 1,
              "--render", "45x27", "--frames", 3, "--kernels", "generic")
        frame = np.load(out / "0000.output.npy")
        self.assertGreater(frame[..., :3].std(), 0.01)
        for shown in range(1, 5):
            np.testing.assert_array_equal(np.load(out / f"{shown:04d}.output.npy"), frame)
        # The network did have an opinion.
        self.assertGreater(np.load(out / f"0001.{nfru.OUTPUT}.npy").astype(float).std(), 5)

    def test_all_precisions_are_the_same_network(self):
        given = export_nfru.golden_input(16, 24)
        np.save(self.folder / "golden.npy", given.numpy())
        wanted = nfru.to_int8(network()).run(given).numpy().astype(int)
        for name in ("model.int16.tosa", "model.fp32.tosa", "model.fp16.tosa"):
            shale("run", self.folder / "nfru" / name, "--input", f"input={self.folder}/golden.npy", "--input-shape",
                  "input=1,16,24,16", "--kernels", "generic", "-o", self.folder / name.replace(".", "_"))
            found = np.load(self.folder / name.replace(".", "_") / f"{nfru.OUTPUT}.npy").astype(int)
            self.assertLess(np.abs(found - wanted).mean(), 2.0, name)

    def test_costs_of_the_folder_are_those_of_the_notes(self):
        done = subprocess.run([PROGRAM, "report", str(self.folder / "nfru"), "--json"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        row = json.loads(done.stdout)["files"][0]
        self.assertEqual((row["parameters"], row["macs"]), (103_492, MACS))

    def test_a_check_without_a_picture_is_refused(self):
        done = subprocess.run([PROGRAM, "play", str(self.folder / "nfru"), "-i", str(SCENE), "-o", str(self.folder / "none"),
                               "--check", "--render", "32x16", "--frames", "2"], capture_output=True, text=True)
        self.assertEqual(done.returncode, 1)
        self.assertIn("it needs --generate", done.stderr)

    def test_clips_are_rendered_prepared_and_trained_on(self):
        data, out = self.folder / "clips", self.folder / "trained"
        small = nfru_clips.FRAMES, nfru_clips.SIZE
        try:
            nfru_clips.FRAMES, nfru_clips.SIZE = 3, 64
            self.assertEqual(nfru_clips.main(["--shale", PROGRAM, "--out", str(data), "--clips", "0", "1"]), 0)
        finally:
            nfru_clips.FRAMES, nfru_clips.SIZE = small
        pairs = nfru_data.load_pairs(data, Path(PROGRAM))
        self.assertEqual([len(each.inputs) for each in pairs], [2])
        self.assertEqual(tuple(pairs[0].samples.shape), (2, 4, 3, 64, 64))
        # What is between lies nearer to the means of the samples than to black.
        mean = pairs[0].samples.float().mean(1)
        self.assertLess(float((mean - pairs[0].truth.float()).abs().mean()), 0.5 * float(pairs[0].truth.float().mean()))
        common = ["--data", str(data), "--steps", "2", "--batch", "2", "--crop", "16", "--out"]
        self.assertEqual(train_nfru.main([*common, str(out)]), 0)
        self.assertEqual(train_nfru.main([*common, str(self.folder / "q"), "--qat", "--init", str(out / "last.pt")]), 0)
        export_nfru.export(self.folder / "q" / "last.pt", self.folder / "exported", str(ROOT / "shaders/frame"))


if __name__ == "__main__":
    unittest.main()
