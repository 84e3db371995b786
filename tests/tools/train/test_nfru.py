"""NFRU: graph description, batch normalization, exact INT8, data and training; with SHALE_PROGRAM also the cost rows and an exact run."""

import json
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "tools" / "train"))

import export_nfru  # noqa: E402
import nfru  # noqa: E402
import nfru_clips  # noqa: E402
import nfru_data  # noqa: E402
import nfru_passes  # noqa: E402
import quantize  # noqa: E402
import train_nfru  # noqa: E402

torch.set_num_threads(1)
PROGRAM = os.environ.get("SHALE_PROGRAM", "")
#: The notes' table: parameters, MMAC of an input of 480x272 to the printed digit.
TABLE = {"conv1": (4640, 601.62), "conv2": (12816, 1671.17), "conv3": (2320, 300.81), "skip1": (2320, 300.81),
         "conv5": (6416, 208.90), "conv5a": (272, 8.36), "conv5b": (2320, 75.20), "conv5c": (12560, 409.44),
         "conv5c_1": (12560, 409.44), "conv5d": (12560, 409.44), "conv5d_1": (12560, 409.44),
         "conv5d_2": (12560, 409.44), "conv5e": (1040, 33.42), "conv6": (2320, 300.81), "conv7": (4624, 601.62),
         "weights": (1604, 208.90)}
MACS = 6_358_794_240


def network() -> nfru.Nfru:
    """Random weights with ranges; the logits reach some units."""
    torch.manual_seed(3)
    model = nfru.Nfru().eval()
    with torch.no_grad():
        model.convs[nfru.OUTPUT].weight.mul_(10.0)
        for conv in model.convs.values():
            conv.bias.normal_(0.0, 0.05)
        model.observed = {}
        model((codes(24, 32).permute(0, 3, 1, 2).float() + 128) / 255)
    model.calibrated()
    return model


def codes(rows: int, columns: int) -> torch.Tensor:
    """Random int8 `[1, rows, columns, 16]`."""
    generator = torch.Generator().manual_seed(11)
    return torch.randint(-128, 128, (1, rows, columns, nfru.CHANNELS), generator=generator, dtype=torch.int8)


class Description(unittest.TestCase):
    def test_work_and_parameters_are_those_of_the_notes(self):
        parameters, macs = nfru.parameters(), nfru.macs(272, 480)
        for name, (count, millions) in TABLE.items():
            self.assertEqual(parameters[name], count, name)
            self.assertEqual(f"{macs[name] / 1e6:.2f}", f"{millions:.2f}", name)
        self.assertEqual(sum(parameters.values()), 103_492)
        self.assertEqual(sum(macs.values()), MACS)
        self.assertEqual(f"{MACS / 1e6:.1f}", "6358.8")
        self.assertEqual(sum(p.numel() for p in nfru.Nfru().parameters()), 103_492)
        self.assertEqual(sum(p.numel() for p in nfru.Nfru(normalized=True).parameters()), 104_004)

    def test_sizes_are_kept(self):
        for rows, columns in ((16, 24), (2, 2), (34, 6)):
            self.assertEqual(tuple(nfru.Nfru().eval()(torch.zeros(1, 16, rows, columns)).shape), (1, 4, rows, columns))

    def test_joined_tensors_share_a_range(self):
        ranges = network().ranges
        self.assertEqual(len({ranges[name] for name in ("conv5a", "conv5b", "conv5c_1", "conv5d_2")}), 1)
        self.assertEqual(ranges["conv6"], ranges["skip1"])
        self.assertNotEqual(ranges["conv6"], ranges["conv5a"])


class Training(unittest.TestCase):
    def test_folding_keeps_the_function(self):
        torch.manual_seed(1)
        model = nfru.Nfru(normalized=True)
        for _ in range(4):
            model(torch.rand(2, 16, 16, 16))
        model.eval()
        x = torch.rand(1, 16, 20, 24)
        with torch.no_grad():
            wanted, found = model(x), model.folded()(x)
        self.assertLess(float((wanted - found).abs().max()), 1e-4 * float(wanted.abs().max()))
        with self.assertRaisesRegex(ValueError, "without batch normalization"):
            model.calibrated()

    def test_gradients_reach_every_weight_in_both_stages(self):
        for model in (nfru.Nfru(normalized=True), network().train()):
            samples = torch.rand(1, 4, 3, 16, 16)
            nfru_passes.post(model(torch.rand(1, 16, 16, 16)), samples, torch.ones(1, 4, 16, 16)).square().mean().backward()
            for name, value in model.named_parameters():
                self.assertGreater(float(value.grad.abs().max()), 0.0, name)

    def test_training_starts_near_the_weights_by_hand(self):
        x = torch.rand(1, 16, 24, 24, generator=torch.Generator().manual_seed(2))
        # The frames agree by either way in a half of the picture each.
        x[:, 3:6, :, :12], x[:, 9:12, :, 12:] = x[:, 0:3, :, :12], x[:, 6:9, :, 12:]
        with torch.no_grad():
            found = torch.softmax(nfru.by_formula()(x), 1)
        shares = torch.tensor([0.25, 0.5, 0.25]).view(1, 3, 1, 1)
        motion, flow = (0.01 + ((x[:, i : i + 3] - x[:, i + 3 : i + 6]).abs() * shares).sum(1) for i in (0, 6))
        wanted = torch.stack([(1.02 - x[:, 14]) / motion**2, (1.02 - x[:, 15]) / motion**2, 1 / flow**2, 1 / flow**2], 1)
        wanted = wanted / wanted.sum(1, keepdim=True)
        self.assertLess(float((found - wanted).abs().mean()), 0.06)
        self.assertGreater(float((wanted - 0.25).abs().mean()), 0.2)

    def test_weights_come_back(self):
        model = network()
        with tempfile.TemporaryDirectory() as folder:
            nfru.save_weights(Path(folder) / "w.npz", model, {"seed": 3})
            back, record = nfru.load_model(Path(folder) / "w.npz")
            (Path(folder) / "broken.npz").write_bytes(b"nothing")
            with self.assertRaisesRegex(ValueError, "not weights of an NFRU network"):
                nfru.load_model(Path(folder) / "broken.npz")
        self.assertEqual((back.ranges, record["seed"]), (model.ranges, 3))
        x = torch.rand(1, 16, 8, 8)
        with torch.no_grad():
            self.assertTrue(torch.equal(model(x), back(x)))


class Integers(unittest.TestCase):
    def test_integer_network_is_close_to_the_faked_one(self):
        model = network()
        given = codes(16, 24)
        with torch.no_grad():
            wanted = model((given.permute(0, 3, 1, 2).float() + 128) / 255)[0].permute(1, 2, 0).numpy()
        found = nfru.to_int8(model).run(given)[0].numpy() * nfru.scales(model)[nfru.OUTPUT][0]
        step = nfru.scales(model)[nfru.OUTPUT][0]
        # Roundings of biases and multipliers move codes to their neighbours here and there, at each of ten layers.
        self.assertLess(np.abs(found - wanted).mean(), 1.5 * step)
        self.assertGreater(found.std(), 5 * step)

    def test_run_is_the_arithmetic_of_tosa(self):
        # A layer of each form: 5x5 of stride 2, whose pad is 2 above and 1 below, and 7x7.
        integers = nfru.to_int8(network())
        generator = np.random.default_rng(5)
        for name in ("conv5", "conv5c"):
            node, layer = next(c for c in nfru.CONVS if c.name == name), integers.layers[name]
            x = generator.integers(-128, 128, (6, 8, node.inputs))
            found = nfru.convolve_exactly(layer, torch.from_numpy(x.transpose(2, 0, 1)[None].copy()).float(),
                                          node.stride, node.kernel // 2)[0].permute(1, 2, 0).numpy()
            top, bottom, left, right = node.pad
            padded = np.pad(x - layer.input_zp, ((top, bottom), (left, right), (0, 0)))
            for y, column, oc in np.ndindex(*found.shape):
                window = padded[y * node.stride :, column * node.stride :][: node.kernel, : node.kernel]
                total = np.array([int((window * layer.weight[oc]).sum()) + int(layer.bias[oc])])
                total = quantize.apply_scale_32(total, layer.multiplier[oc], layer.shift[oc])[0] + layer.output_zp
                self.assertEqual(found[y, column, oc], min(max(total, -128), 127))
            self.assertEqual(found.shape, (6 // node.stride, 8 // node.stride, 16))


class Mean(unittest.TestCase):
    def test_what_does_not_count_has_no_weight(self):
        taken, logits = torch.rand(1, 4, 3, 6, 6), 20 * torch.randn(1, 4, 6, 6)
        counted = torch.zeros(1, 4, 6, 6)
        counted[:, 2] = 0.5
        found = nfru_passes.post(logits, taken, counted)
        self.assertLess(float((found - taken[:, 2]).abs().max()), 1e-6)

    def test_of_equal_samples_it_is_the_picture(self):
        picture = torch.rand(1, 1, 3, 6, 6)
        found = nfru_passes.post(20 * torch.randn(1, 4, 6, 6), picture.expand(1, 4, 3, 6, 6), torch.full((1, 4, 6, 6), 0.5))
        self.assertLess(float((found - picture[:, 0]).abs().max()), 1e-6)

    def test_logits_are_enlarged_within_the_picture(self):
        # A lane of 6x4 in a tensor of 8x8: what lies in the padding is not reached but by half a pixel at the border.
        logits = torch.zeros(1, 4, 8, 8)
        logits[:, :, 5:], logits[:, :, :, 7:] = 9.0, 9.0
        self.assertEqual(float(nfru_passes.enlarged(logits, (6, 4), (24, 16)).max()), 0.0)


def pairs() -> nfru_data.Pairs:
    """Random; the truth is the third sample."""
    generator = torch.Generator().manual_seed(4)

    def numbers(*shape: int) -> torch.Tensor:
        return torch.randint(0, 200, shape, generator=generator, dtype=torch.uint8)

    taken = numbers(2, 4, 3, 96, 96)
    return nfru_data.Pairs("0000", numbers(2, 16, 24, 24), taken, torch.ones(2, 4, 96, 96, dtype=torch.uint8), taken[:, 2].clone())


class Data(unittest.TestCase):
    def test_samples_go_along_with_the_truth(self):
        for step in range(12):
            batch = nfru_data.draw([pairs()], np.random.default_rng(step), 2, 16)
            self.assertEqual(tuple(batch.inputs.shape), (2, 16, 16, 16))
            self.assertEqual(tuple(batch.truth.shape), (2, 3, 64, 64))
            for taken, truth in zip(batch.samples, batch.truth):  # the third, or, with the frames changed, the fourth
                self.assertLess(min(float((taken[i] - truth).abs().max()) for i in (2, 3)), 1e-6)

    def test_crops_that_do_not_fit_are_refused(self):
        with self.assertRaisesRegex(ValueError, "do not hold crops of 26"):
            nfru_data.draw([pairs()], np.random.default_rng(0), 1, 26)

    def test_a_clip_is_a_function_of_its_number(self):
        scenes = Path(__file__).resolve().parents[3] / "models/scenes/train"
        for number in range(6):
            scene, first, whole, (x, y) = nfru_clips.draw(number, scenes)
            self.assertEqual((scene, first, whole, (x, y)), nfru_clips.draw(number, scenes))
            self.assertLessEqual(first + nfru_clips.FRAMES, scene["frames"])
            self.assertLessEqual(x + nfru_clips.SIZE, whole[0])
            self.assertLessEqual(y + nfru_clips.SIZE, whole[1])


class Runs(unittest.TestCase):
    def options(self, folder: str, *more: str):
        return train_nfru.parse(["--data", folder, "--out", folder, "--steps", "4", "--batch", "2", "--crop", "16",
                                 "--every", "1", *more])

    def test_resumed_training_has_the_same_bits(self):
        with tempfile.TemporaryDirectory() as one, tempfile.TemporaryDirectory() as two:
            whole = train_nfru.train(self.options(one), [pairs()], report=lambda line: None)
            train_nfru.train(self.options(two), [pairs()], report=lambda line: None, stop_after=2)
            parts = train_nfru.train(self.options(two, "--resume"), [pairs()], report=lambda line: None)
            for name, value in whole["model"].items():
                self.assertTrue(torch.equal(value, parts["model"][name]), name)
            with self.assertRaisesRegex(ValueError, "checkpoint has batch 2, the run asks 1"):
                train_nfru.train(self.options(two, "--resume", "--batch", "1"), [pairs()], report=lambda line: None)

    def test_weights_without_ranges_are_refused(self):
        with tempfile.TemporaryDirectory() as folder:
            nfru.save_weights(Path(folder) / "w.npz", nfru.Nfru(), {})
            with self.assertRaisesRegex(ValueError, "no activation ranges yet"):
                export_nfru.export(Path(folder) / "w.npz", Path(folder) / "out")


class Shipped(unittest.TestCase):
    def test_the_folder_is_what_its_weights_export(self):
        shipped = Path(__file__).resolve().parents[3] / "models/nfru"
        with tempfile.TemporaryDirectory() as out:
            export_nfru.export(shipped / "weights.npz", Path(out))
            names = sorted(str(path.relative_to(out)) for path in Path(out).rglob("*") if path.is_file())
            self.assertEqual(names, ["frame.json", "golden/input.npy", f"golden/{nfru.OUTPUT}.npy", "model.fp16.tosa",
                                     "model.fp32.tosa", "model.int16.tosa", "model.tosa", "quantization.json", "weights.npz"])
            for name in names:
                self.assertEqual((Path(out) / name).read_bytes(), (shipped / name).read_bytes(), name)


class Baseline(unittest.TestCase):
    def test_the_weights_by_hand_have_the_passes_of_the_network(self):
        path = nfru_data.MODEL / "frame.json"
        wanted = export_nfru.as_bytes(export_nfru.frame_description(None, "../../../../shaders/frame"))
        self.assertEqual(path.read_bytes(), wanted)
        self.assertEqual(json.loads(wanted), export_nfru.frame_description(None, "../../../../shaders/frame"))


@unittest.skipUnless(PROGRAM, "SHALE_PROGRAM is not set")
class Program(unittest.TestCase):
    def shale(self, *arguments) -> str:
        done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stderr)
        return done.stdout

    def test_costs_are_those_of_the_notes_and_the_device_is_exact(self):
        integers, given = nfru.to_int8(network()), codes(16, 24)
        with tempfile.TemporaryDirectory() as folder:
            path, out = Path(folder) / "model.tosa", Path(folder) / "out"
            path.write_bytes(nfru.build_graph(integers, 272, 480).pack())
            row = json.loads(self.shale("report", path, "--json"))["files"][0]
            self.assertEqual((row["parameters"], row["macs"]), (103_492, MACS))
            np.save(Path(folder) / "input.npy", given.numpy())
            self.shale("run", path, "--input", f"input={folder}/input.npy", "--input-shape", "input=1,16,24,16",
                       "--kernels", "generic", "--check", "-o", out)
            np.testing.assert_array_equal(np.load(out / f"{nfru.OUTPUT}.npy"), integers.run(given).numpy())


if __name__ == "__main__":
    unittest.main()
