"""NFRU: graph description, batch normalization, exact INT8; with SHALE_PROGRAM also the cost rows and an exact run."""

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

import nfru  # noqa: E402
import quantize  # noqa: E402

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
            nfru.blended(model(torch.rand(1, 16, 16, 16)), samples).square().mean().backward()
            for name, value in model.named_parameters():
                self.assertGreater(float(value.grad.abs().max()), 0.0, name)

    def test_equal_samples_are_the_picture_whatever_the_weights(self):
        picture = torch.rand(1, 1, 3, 8, 8)
        found = nfru.blended(10 * torch.randn(1, 4, 8, 8), picture.expand(1, 4, 3, 8, 8))
        self.assertLess(float((found - picture[:, 0]).abs().max()), 1e-6)

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
