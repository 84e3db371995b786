"""MNSS: costs, exact INT8, graphs, passes, training."""

import json
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools" / "train"))

import export_mnss  # noqa: E402
import mnss  # noqa: E402
import mnss_passes as passes  # noqa: E402
import nss_data  # noqa: E402
import nss_passes  # noqa: E402
import quantize  # noqa: E402
import train_mnss  # noqa: E402
import training  # noqa: E402

torch.set_num_threads(1)
CAMERA = nss_passes.camera_vector(1.2, 0.8, 0.1, -1.0, False)
#: Columns and rows of the pattern of scale 2, over twelve frames. Source: MNSS (TVCG 2023).
PATTERN = list(zip((0, 1, 1, 0, 0, 1, 1, 0, 0, 1, 1, 0), (0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0)))


def offset(cell: int, scale: int) -> float:
    return (cell + 0.5) / scale - 0.5


def make_clip(seed: int = 0, frames: int = 6, w: int = 32, h: int = 24, scale: int = 2,
              speed=(1.0, -0.5)) -> nss_data.Clip:
    """A moving pattern, sampled at the pattern's places, `speed` output pixels a frame; the truth is not filtered."""

    def picture(width, height, step, dx, dy, t):
        x = ((torch.arange(width) + 0.5 + dx) * step - speed[0] * t)[None, :].expand(height, width)
        y = ((torch.arange(height) + 0.5 + dy) * step - speed[1] * t)[:, None].expand(height, width)
        a = torch.sin(x * 0.35 + seed) * torch.sin(y * 0.3)
        return torch.stack([0.5 + 0.4 * a, 0.5 - 0.3 * a, 0.6 + 0.3 * torch.cos(x * 0.2)])

    jitter = [(offset(x % scale, scale), offset(y % scale, scale)) for x, y in (PATTERN * frames)[:frames]]
    motion = torch.tensor([speed[0] / (scale * w), speed[1] / (scale * h)]).view(1, 2, 1, 1)
    return nss_data.Clip(
        f"{seed:04d}", torch.stack([picture(w, h, scale, *jitter[t], t) for t in range(frames)]).half(),
        torch.full((frames, 1, h, w), 0.9), motion.expand(frames, 2, h, w).half(),
        torch.stack([picture(scale * w, scale * h, 1.0, 0, 0, t) for t in range(frames)]).half(),
        motion.expand(frames, 2, scale * h, scale * w).half(), jitter, [1.0] * frames, [False] * frames,
        [CAMERA] * frames, False)


def random_model(scale: int = 2, seed: int = 3) -> mnss.Mnss:
    """Random weights, and ranges that their values reach."""
    torch.manual_seed(seed)
    model = mnss.Mnss(scale)
    with torch.no_grad():
        for conv in mnss.RECONSTRUCTION:
            layer = model.convs[conv.name]
            layer.weight.normal_(0.0, (2.0 / (9 * conv.inputs)) ** 0.5)
            layer.bias.normal_(0.0, 0.05)
        model.convs["inpaint"].weight.normal_(0.0, 0.5)
        model.convs["aa"].weight.normal_(0.2, 0.1)
        model.observed = {}
        model(torch.rand(1, 3, 48, 48))
        model.calibrated()
    return model.eval()


class Costs(unittest.TestCase):
    def test_parameters_and_macs_are_those_of_the_reference(self):
        # seed_networks.md, 1.4: parameters and MAC per pixel of every layer of reading A, GMAC at 1080p, 720p, 900x900.
        self.assertEqual([mnss.parameters((c,)) for c in (mnss.INPAINT, mnss.AA, *mnss.RECONSTRUCTION)],
                         [37, 21, 448, 4640, 9248, 867])
        self.assertEqual([mnss.macs(1, 1, (c,)) for c in (mnss.INPAINT, mnss.AA, *mnss.RECONSTRUCTION)],
                         [36, 18, 432, 4608, 9216, 864])
        self.assertEqual(mnss.parameters(), 15203)
        self.assertEqual([f"{mnss.macs(*size) / 1e9:.3f}" for size in ((1080, 1920), (720, 1280), (900, 900))],
                         ["31.353", "13.935", "12.247"])
        model = mnss.Mnss(3)
        self.assertEqual(sum(p.numel() for p in model.parameters()), 15203 + 37 + 21)


class Network(unittest.TestCase):
    def test_starts_as_one_that_hands_the_picture_on(self):
        x = torch.rand(1, 3, 20, 24)
        with torch.no_grad():
            self.assertLess(float((mnss.Mnss(2)(x) - x).abs().max()), 1e-6)

    def test_integer_network_is_close_to_the_faked_one(self):
        model = random_model()
        codes = export_mnss.golden_input(32, 40)
        with torch.no_grad():
            wanted = model(passes.from_codes(torch.from_numpy(codes)))[0].permute(1, 2, 0).numpy()
        correction = mnss.to_int8(model).run(codes)
        found = passes.from_codes(*map(torch.from_numpy, (codes, correction)))[0].permute(1, 2, 0).numpy()
        # Roundings of bias and multipliers move a result to a neighbouring code here and there, at each of four layers.
        self.assertLess(np.abs(found - wanted).mean(), 1.0 / 255)
        self.assertLess(np.abs(found - wanted).max(), 8.0 / 255)
        self.assertGreater(found.std(), 0.02)

    def test_run_is_the_arithmetic_of_tosa(self):
        network = mnss.to_int8(random_model())
        codes = export_mnss.golden_input(6, 7)
        x = codes[0].astype(int)
        for layer in network.layers:
            padded = np.full((x.shape[0] + 2, x.shape[1] + 2, x.shape[2]), layer.input_zp)
            padded[1:-1, 1:-1] = x
            out = np.zeros((*x.shape[:2], len(layer.bias)), int)
            for y, column, oc in np.ndindex(*out.shape):
                total = int(((padded[y : y + 3, column : column + 3] - layer.input_zp) * layer.weight[oc]).sum())
                total = (total + int(layer.bias[oc])) * int(layer.multiplier[oc])
                total = (total + (1 << int(layer.shift[oc]) - 1)) >> int(layer.shift[oc])
                out[y, column, oc] = min(max(total + layer.output_zp, -128), 127)
            x = out
        np.testing.assert_array_equal(network.run(codes)[0], x)

    def test_refuses_scales_and_files(self):
        with self.assertRaisesRegex(ValueError, "scale must be 2 or 3, found 4"):
            mnss.Mnss(4)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "w.npz"
            path.write_bytes(b"nothing")
            with self.assertRaisesRegex(ValueError, "not weights of an MNSS network"):
                mnss.load_model(path)

    def test_weights_come_back(self):
        model = random_model(3)
        with tempfile.TemporaryDirectory() as folder:
            mnss.save_weights(Path(folder) / "w.npz", model, {"seed": 3})
            back, record = mnss.load_model(Path(folder) / "w.npz")
            mnss.save_weights(Path(folder) / "again.npz", back, record)
            self.assertEqual((Path(folder) / "w.npz").read_bytes(), (Path(folder) / "again.npz").read_bytes())
        self.assertEqual((back.scale, back.ranges, record["seed"]), (3, model.ranges, 3))


class Passes(unittest.TestCase):
    def test_samples_lie_in_their_cells(self):
        for scale in mnss.SCALES:
            for column in range(scale):
                self.assertEqual(passes.cell((offset(column, scale), 0.0), scale)[0], column)
        self.assertEqual(passes.cell((0.5, -0.5), 2), (1, 0))

    def test_upsampling_meets_the_samples(self):
        # At the sampled output pixels the texel itself comes out.
        image = torch.rand(1, 2, 5, 7)
        for scale in mnss.SCALES:
            for column in range(scale):
                for row in range(scale):
                    jitter = (offset(column, scale), offset(row, scale))
                    wide = passes.upsample(image, scale, jitter)
                    self.assertLess(float((wide[:, :, row::scale, column::scale] - image).abs().max()), 1e-5)

    def test_upsampling_of_a_slope_is_the_slope(self):
        x = torch.arange(12.0)
        for scale, jitter in ((2, (-0.25, 0.25)), (3, (1 / 3, 0.0)), (2, (0.1, -0.3))):
            at = x + 0.5 + jitter[0]
            wide = passes.upsample(at.view(1, 1, 1, -1).expand(1, 1, 4, -1), scale, jitter)[0, 0, 0]
            wanted = (torch.arange(12 * scale) + 0.5) / scale
            self.assertLess(float((wide - wanted)[scale:-scale].abs().max()), 1e-5)

    def test_history_follows_motion(self):
        # The difference of a moving picture to its own warped past is small where it was on the screen, 1 elsewhere.
        clip = make_clip(speed=(2.0, 0.0))
        model = mnss.Mnss(2)
        frame = clip.frame(0)
        truth = [passes.display(clip.truth[t : t + 1].float()) for t in range(2)]
        before = passes.pre(model, frame, passes.display(frame.colour), None)
        self.assertEqual(float(before.difference.max()), 0.0)
        self.assertEqual(float(before.weight.min()), 1.0)
        state = passes.State(truth[0], before.nearness, frame.jitter)
        frame = clip.frame(1)
        after = passes.pre(model, frame, passes.display(frame.colour), state)
        self.assertLess(float(after.difference[:, :, :, 2:].max()), 0.05)
        self.assertEqual(float(after.difference[:, :, :, :1].min()), 1.0)
        self.assertEqual(float(after.difference[:, 3, :, 2:].max()), 0.0)

    def test_insertion_puts_the_samples_back(self):
        clip = make_clip()
        for t in (0, 1):
            frame = clip.frame(t)
            colour = passes.display(frame.colour)
            before = passes.pre(mnss.Mnss(2), frame, colour, None)
            column, row = passes.cell(frame.jitter, 2)
            torch.testing.assert_close(before.inserted[:, :, row::2, column::2], colour)
            kept = before.inserted.clone()
            kept[:, :, row::2, column::2] = before.rectified[:, :, row::2, column::2]
            torch.testing.assert_close(kept, before.rectified)

    def test_sharpening_keeps_a_constant_and_steepens_a_step(self):
        flat = torch.full((1, 3, 6, 6), 0.4)
        torch.testing.assert_close(passes.sharpened(flat, 0.15), flat)
        step = torch.full((1, 1, 4, 8), 0.3)
        step[..., 4:] = 0.6
        found = passes.sharpened(step, 0.15)[0, 0, 1]
        torch.testing.assert_close(found[[2, 3, 4, 5]], torch.tensor([0.3, 0.3 - 0.09, 0.6 + 0.09, 0.6]))

    def test_codes_come_back(self):
        codes = torch.arange(-128, 128, dtype=torch.int32).to(torch.int8).view(1, 16, 16, 1).expand(-1, -1, -1, 3)
        np.testing.assert_array_equal(passes.input_codes(passes.from_codes(codes)).numpy(), codes.numpy())


class Training(unittest.TestCase):
    def options(self, out: Path, *more: str):
        return train_mnss.parse(["--data", "unused", "--steps", "4", "--batch", "2", "--crop", "16", "--frames", "4",
                                 "--every", "1", "--out", str(out), *more])

    def test_resumes_bit_for_bit_and_reaches_every_network(self):
        clips = [make_clip(0), make_clip(1)]
        quiet = lambda line: None  # noqa: E731
        with tempfile.TemporaryDirectory() as folder:
            whole = train_mnss.train(self.options(Path(folder) / "a"), clips, quiet)
            train_mnss.train(self.options(Path(folder) / "b"), clips, quiet, stop_after=2)
            parts = train_mnss.train(self.options(Path(folder) / "b", "--resume"), clips, quiet)
            for name, value in whole["model"].items():
                self.assertTrue(torch.equal(value, parts["model"][name]), name)
            fresh = mnss.Mnss(2).state_dict()
            for name in ("inpaint", "aa", "rec4"):
                self.assertFalse(torch.equal(whole["model"][f"convs.{name}.weight"], fresh[f"convs.{name}.weight"]), name)
            qat = train_mnss.train(self.options(Path(folder) / "c", "--qat", "--init", str(Path(folder) / "a" / "last.pt")),
                                   clips, quiet)
            self.assertEqual(sorted(qat["ranges"]), ["rec1", "rec2", "rec3"])
            # No steps: the weights as they are, with ranges.
            ranged = train_mnss.train(self.options(Path(folder) / "d", "--qat", "--steps", "0", "--init",
                                                   str(Path(folder) / "a" / "last.pt")), clips, quiet)
            self.assertEqual(sorted(ranged["ranges"]), ["rec1", "rec2", "rec3"])
            for name, value in whole["model"].items():
                self.assertTrue(torch.equal(value, ranged["model"][name]), name)
            again = train_mnss.train(self.options(Path(folder) / "f", "--qat", "--seed", "9", "--init",
                                                  str(Path(folder) / "c" / "last.pt")), clips, quiet)
            self.assertEqual(again["ranges"], qat["ranges"])
            with self.assertRaisesRegex(ValueError, "steps must lie in 1 to"):
                self.options(Path(folder) / "e", "--steps", "0")
            with self.assertRaisesRegex(ValueError, "checkpoint has qat False, the run asks True"):
                train_mnss.train(self.options(Path(folder) / "a", "--resume", "--qat"), clips, quiet)

    def test_half_rounds_operands_and_result_once(self):
        # bfloat16 has 8 bits: input, weights and result are off by 2^-9 each, sums are in float.
        torch.manual_seed(1)
        x, weight, bias = torch.randn(2, 16, 12, 12), torch.randn(8, 16, 3, 3), torch.randn(8)
        half, exact = (training.convolve(x, weight, bias, half) for half in (True, False))
        self.assertEqual((half.dtype, exact.dtype), (torch.bfloat16, torch.float32))
        self.assertTrue(((half - exact).abs() <= 2**-7 * training.convolve(x.abs(), weight.abs(), bias.abs(), False)).all())
        self.assertFalse(torch.equal(half.float(), exact))

    def test_half_trains_every_network_in_float(self):
        with tempfile.TemporaryDirectory() as folder:
            whole = train_mnss.train(self.options(Path(folder), "--half"), [make_clip(0)], lambda line: None)
            fresh = mnss.Mnss(2).state_dict()
            for name, value in whole["model"].items():
                self.assertEqual(value.dtype, torch.float32, name)
                self.assertTrue(torch.isfinite(value).all(), name)
            self.assertFalse(torch.equal(whole["model"]["convs.rec2.weight"], fresh["convs.rec2.weight"]))
            with self.assertRaisesRegex(ValueError, "--qat and --half exclude each other"):
                self.options(Path(folder), "--half", "--qat", "--init", "a.pt")

    def test_refuses_clips_of_another_scale(self):
        with tempfile.TemporaryDirectory() as folder:
            with self.assertRaisesRegex(ValueError, "is not of scale 3"):
                train_mnss.train(self.options(Path(folder), "--scale", "3"), [make_clip()], lambda line: None)


class Export(unittest.TestCase):
    def test_folder_is_complete_and_repeats(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            mnss.save_weights(folder / "w.npz", random_model(3), {"seed": 3})
            for out in ("a", "b"):
                export_mnss.export(folder / "w.npz", folder / out)
            names = sorted(p.relative_to(folder / "a") for p in (folder / "a").rglob("*") if p.is_file())
            self.assertEqual([str(n) for n in names],
                             ["frame.json", "frame_sharp.json", "golden/correction.npy", "golden/input.npy",
                              "model.fp16.tosa", "model.fp32.tosa", "model.int16.tosa", "model.tosa",
                              "quantization.json", "weights.npz"])
            for name in names:
                self.assertEqual((folder / "a" / name).read_bytes(), (folder / "b" / name).read_bytes(), name)
            frame = json.loads((folder / "a" / "frame.json").read_text())
            self.assertEqual((frame["ratio"], frame["pattern"]), ([3, 3], "mnss"))

    def test_shipped_folders_are_what_their_weights_export(self):
        for shipped in sorted((ROOT / "models").glob("mnss_*")):
            with self.subTest(shipped.name), tempfile.TemporaryDirectory() as out:
                real = shipped / "weights_float.npz"
                export_mnss.export(shipped / "weights.npz", Path(out), real=real if real.exists() else None)
                for path in (p for p in Path(out).rglob("*") if p.is_file()):
                    name = path.relative_to(out)
                    self.assertEqual(path.read_bytes(), (shipped / name).read_bytes(), name)


if __name__ == "__main__":
    unittest.main()
