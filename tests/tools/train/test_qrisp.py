"""QRISP: graph description, weight sets, exact INT8, passes, training; with SHALE_PROGRAM also the cost rows and exact
runs of all nine networks with random weights."""

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
sys.path.insert(0, str(Path(__file__).resolve().parent))

import nss_passes  # noqa: E402
import qrisp  # noqa: E402
import qrisp_passes as passes  # noqa: E402
import quantize  # noqa: E402
import train_qrisp  # noqa: E402
from test_nss import frame_of, make_clip  # noqa: E402

torch.set_num_threads(1)
PROGRAM = os.environ.get("SHALE_PROGRAM", "")
ROWS = json.loads((Path(__file__).resolve().parents[2] / "golden" / "cost_tables.json").read_text())["rows"]
#: By size and scale: parameters, MAC per render pixel, GMAC of a 1920x1080 output as the table prints it.
TABLE = {(row["id"].split("_")[2], row["scale"]): (row["params"], row["computed"]["macs_per_lr_px"],
                                                   row["computed"]["gmac_at_1080p_out"])
         for row in ROWS if row["id"].startswith("qrisp_ours_")}


def network(size: str, scale: int, conditioned: bool = True, corrects: bool = False) -> qrisp.Qrisp:
    """Random weights, every kernel of the sets included, with ranges."""
    torch.manual_seed(5)
    model = qrisp.Qrisp(size, scale, conditioned, corrects).eval()
    with torch.no_grad():
        for name in qrisp.HEADS:
            model.convs[name].weight.mul_(8.0)
        for kernel in model.basis.values():
            kernel.add_(0.02 * torch.randn(kernel.shape))
        model.observed = {}
        model((picture_codes(scale, 16, 24).permute(0, 3, 1, 2).float() + 128) / 255, (0.1875, -0.3125))
    model.calibrated()
    return model


def picture_codes(scale: int, rows: int, columns: int) -> torch.Tensor:
    """Random int8 `[1, rows, columns, c]`."""
    generator = torch.Generator().manual_seed(7)
    return torch.randint(-128, 128, (1, rows, columns, qrisp.input_channels(scale)), generator=generator,
                         dtype=torch.int8)


class Description(unittest.TestCase):
    def test_work_and_parameters_are_those_of_the_notes(self):
        for (size, scale), (parameters, macs, gmac) in TABLE.items():
            self.assertEqual(qrisp.parameters(size, scale), parameters)
            self.assertEqual(qrisp.macs_per_pixel(size, scale), macs)
            pixels = qrisp.OUTPUT[0] // scale * (qrisp.OUTPUT[1] // scale)
            self.assertEqual(round(macs * pixels / 1e9, 4), gmac)
            plain = qrisp.Qrisp(size, scale, conditioned=False)
            self.assertEqual(sum(p.numel() for p in plain.convs.parameters()), parameters)

    def test_sixteen_sets_take_the_bytes_of_the_notes(self):
        for (size, scale), kib in {("s", 2): 94.5, ("m", 3): 391.5, ("l", 4): 1350.0}.items():
            weights = sum(9 * c.inputs * c.outputs for c in qrisp.convs(size, scale) if c.conditioned)
            self.assertEqual(16 * weights / 1024, kib)


class Sets(unittest.TestCase):
    def test_the_start_is_bilinear_where_the_samples_lie(self):
        for scale in qrisp.SCALES:
            for jitter in ((0.4375, -0.4375), (-0.1875, 0.0625), (0.0, 0.0)):
                model = qrisp.Qrisp("s", scale)
                with torch.no_grad():
                    for name in qrisp.HEADS:
                        model.convs[name].weight.zero_()
                    for kernel in model.basis.values():
                        kernel.zero_()
                    colour = torch.rand(1, 3, 9, 11)
                    x = torch.cat([colour, torch.rand(1, qrisp.input_channels(scale) - 3, 9, 11)], 1)
                    found = torch.pixel_shuffle(model(x, jitter)["candidate"], scale)
                frame = frame_of(colour, jitter)
                uv = nss_passes.uv_grid(11 * scale, 9 * scale, colour) - nss_passes._jitter_uv(frame, jitter)
                wanted = nss_passes.bilinear(colour, uv)
                inner = (slice(None), slice(None), slice(scale, -scale), slice(scale, -scale))
                self.assertLess((found[inner] - wanted[inner]).abs().max(), 1e-5)

    def test_sets_differ_in_the_first_convolution_and_the_heads_alone(self):
        offsets = qrisp.jitter_sequence(3)
        self.assertEqual(offsets[0], (0.0625, -0.1875))
        found = qrisp.to_int8(network("m", 2), offsets)
        self.assertEqual(len(found.sets), 3)
        for node in qrisp.convs("m", 2):
            same = np.array_equal(found.sets[0][node.name].weight, found.sets[2][node.name].weight)
            self.assertEqual(same, not node.conditioned, node.name)
            self.assertEqual(found.sets[0][node.name].output_scale, found.sets[2][node.name].output_scale)

    def test_without_conditioning_there_is_one_set(self):
        model = network("s", 2, conditioned=False)
        self.assertEqual(len(qrisp.to_int8(model, qrisp.jitter_sequence(16)).sets), 1)
        x = torch.rand(1, 22, 8, 8)
        one, other = model(x, (0.25, 0.0)), model(x, (-0.25, 0.4))
        self.assertTrue(all(torch.equal(one[name], other[name]) for name in qrisp.HEADS))


class Integer(unittest.TestCase):
    def test_integer_network_equals_the_definition_and_the_faked_one(self):
        offsets = qrisp.jitter_sequence(2)
        for size, scale, corrects in (("s", 2, False), ("m", 3, True), ("s", 4, False)):
            model, codes = network(size, scale, corrects=corrects), picture_codes(scale, 10, 13)
            exact = qrisp.to_int8(model, offsets)
            for which, offset in enumerate(offsets):
                values = {"input": codes[0].numpy().astype(np.int64)}
                for node in qrisp.convs(size, scale):
                    y = quantize.run_layer(exact.sets[which][node.name], values[node.source])
                    values[node.name] = exact.table[y + 128] if node.act == "sigmoid" else y
                found = exact.run(codes, which)
                with torch.no_grad():
                    faked = model((codes.permute(0, 3, 1, 2).float() + 128) / 255, offset)
                for name, (step, zero) in model.outputs.items():
                    np.testing.assert_array_equal(found[name][0].numpy(), values[name])
                    self.assertGreater(len(found[name].unique()), 20)
                    error = (found[name].float() - zero) * step - faked[name].permute(0, 2, 3, 1)
                    # Biases are rounded to steps of the accumulators, about 1/80 of a code: in each layer some codes
                    # at a border fall on the other side.
                    self.assertLess(error.abs().mean(), 0.25 * step, name)

    def test_graphs_of_all_precisions(self):
        model = network("s", 2)
        for graph, operators in (
                (qrisp.build_graph(qrisp.to_int8(model, [(0.1, 0.2)]), 0, 8, 8), {"CONV2D", "RESCALE", "TABLE"}),
                (qrisp.build_short_graph(model, (0.1, 0.2), 8, 8), {"CONV2D", "RESCALE", "TABLE", "CLAMP"}),
                (qrisp.build_real_graph(model, (0.1, 0.2), 8, 8, "FP16"),
                 {"CONV2D", "CLAMP", "SIGMOID", "CAST", "ADD", "SUB", "MUL"})):
            self.assertEqual(graph.pack()[4:8], b"TOSA")
            self.assertEqual(set(graph.operators()), operators)
        self.assertEqual(set(qrisp.tensor_scales(model)), {"int8", "int16", "fp32", "fp16"})

    def test_weights_come_back(self):
        model = network("s", 3)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "weights.npz"
            qrisp.save_weights(path, model, {"seed": 5})
            again, record = qrisp.load_model(path)
            self.assertEqual((record["seed"], again.scale, again.ranges), (5, 3, model.ranges))
            self.assertTrue(all(torch.equal(a, b) for a, b in zip(model.state_dict().values(),
                                                                  again.state_dict().values())))
            for damage, name in ((lambda: model.convs["first"].bias.fill_(torch.nan), "convs.first.bias"),
                                 (lambda: model.ranges.update(first=(0.0, float("inf"))), "range of first")):
                model = network("s", 3)
                with torch.no_grad():
                    damage()
                qrisp.save_weights(path, model, {})
                with self.assertRaisesRegex(ValueError, f"{name} holds a value that is not finite"):
                    qrisp.load_model(path)
            path.write_bytes(b"none")
            with self.assertRaisesRegex(ValueError, "not weights of a QRISP network"):
                qrisp.load_model(path)


class Passes(unittest.TestCase):
    def test_blocks_take_the_motion_of_their_nearest_depth(self):
        frame = frame_of(torch.rand(1, 3, 6, 9))
        frame.motion = torch.arange(2 * 54).float().view(1, 2, 6, 9)
        frame.depth[0, 0, 3, 2] = 0.5
        frame.depth[0, 0, 2, 8] = frame.depth[0, 0, 3, 8] = 0.4  # equal ones: the first in rows
        for scale in (2, 4):
            moved = passes.block_motion(frame, scale)
            self.assertEqual(moved.shape[2:], (-(-6 * scale // 8), -(-9 * scale // 8)))
            size = 8 // scale
            self.assertEqual(moved[0, 0, 3 // size, 2 // size], frame.motion[0, 0, 3, 2])
            self.assertEqual(moved[0, 0, 2 // size, 8 // size], frame.motion[0, 0, 2, 8])
        # At ratio 3 the block of output rows 8 to 15 begins inside render row 2.
        moved = passes.block_motion(frame, 3)
        self.assertEqual(moved[0, 0, 1, 0], frame.motion[0, 0, 3, 2])
        self.assertEqual(moved[0, 0, 0, 3], frame.motion[0, 0, 2, 8])
        frame.reverse = True
        self.assertNotEqual(passes.block_motion(frame, 2)[0, 0, 0, 0], frame.motion[0, 0, 3, 2])

    def test_compensation_takes_the_jitter_out_of_motion(self):
        """What stands still moves by the change of the jitter between rasters: the sum is 0."""
        jitter, before = (0.3, -0.2), (-0.1, 0.4)
        between = torch.tensor([(before[0] - jitter[0]) / 9, (before[1] - jitter[1]) / 6]).view(1, 2, 1, 1)
        found = passes.compensate(between.expand(1, 2, 6, 9), jitter, before)
        self.assertLess(found.abs().max(), 1e-7)

    def test_warp_follows_motion_and_space_to_depth_has_the_phases_in_rows(self):
        frame = frame_of(torch.rand(1, 3, 8, 8), motion=(1 / 16, 0.0))  # one output pixel to the right
        state = passes.State(torch.rand(1, 3, 16, 16), torch.rand(1, 1, 16, 16))
        before = passes.pre(frame, state, 2)
        self.assertLess((before.warped[..., 1:] - state.colour[..., :-1]).abs().max(), 1e-5)
        self.assertTrue(torch.equal(before.input[:, 6:18], torch.pixel_unshuffle(before.warped, 2)))
        self.assertLess((before.input[:, 18 + 1, :, 0] - state.feature[:, 0, ::2, 0]).abs().max(), 1e-5)
        self.assertTrue(torch.equal(before.input[:, 4, 0, 0], torch.tensor([frame.jitter[0] + 0.5])))

    def test_odd_sizes_show_the_last_column_and_row_again(self):
        before = passes.pre(frame_of(torch.rand(1, 3, 5, 7)), None, 2)
        self.assertEqual(before.input.shape[2:], (6, 8))
        self.assertTrue(torch.equal(before.input[..., 7], before.input[..., 6]))
        self.assertFalse(before.warped.any())

    def test_blend_and_reset(self):
        frame = frame_of(torch.rand(1, 3, 4, 4))
        state = passes.State(torch.rand(1, 3, 8, 8), torch.rand(1, 1, 8, 8))
        before = passes.pre(frame, state, 2)
        heads = {name: 0.9 * torch.rand(1, count, 4, 4) for name, count in (("alpha", 4), ("candidate", 12), ("feature", 4))}
        after = passes.post(frame, before, heads, state, 2)
        share, candidate = (torch.pixel_shuffle(heads[name], 2) for name in ("alpha", "candidate"))
        wanted = share * candidate + (1 - share) * before.warped
        self.assertLess((after.colour - wanted).abs().max(), 1e-6)
        for past, options in ((None, passes.Options()), (state, passes.Options(blending=False))):
            shown = passes.post(frame, before, heads, past, 2, options)
            self.assertTrue(torch.equal(shown.colour, candidate))
        shown = passes.output(frame, after) * frame.exposure
        self.assertLess((passes.displayed(shown) - after.colour).abs().max(), 1e-5)

    def test_almost_white_nothing_is_brighter_than_around_it(self):
        colour = torch.full((1, 3, 4, 4), 0.5)
        colour[..., 0, 0] = 20.0
        frame = frame_of(colour)
        heads = {name: torch.ones(1, count, 4, 4) for name, count in (("alpha", 4), ("candidate", 12), ("feature", 4))}
        shown = passes.output(frame, passes.post(frame, passes.pre(frame, None, 2), heads, None, 2)) * frame.exposure
        light = 20.0 * frame.exposure
        self.assertLess((shown[..., :4, :4] / light - 1).abs().max(), 1e-3)  # beside the light
        self.assertLess((shown[..., 4:, 4:] / 7 - 1).abs().max(), 1e-3)


class Training(unittest.TestCase):
    def options(self, folder, *more):
        return train_qrisp.parse(["--data", folder, "--out", str(Path(folder) / "run"), "--steps", "6", "--batch", "2",
                                  "--crop", "16", "--frames", "3", "--chunk", "2", "--every", "2", *more])

    def test_resuming_is_exact_in_float_half_and_with_fake_quantization(self):
        clips = [make_clip(k) for k in range(2)]
        kept, train_qrisp.CALIBRATION_SEQUENCES = train_qrisp.CALIBRATION_SEQUENCES, 1
        try:
            for more in ([], ["--no-jitter", "--no-blending", "--no-dilation"], ["--half"], ["--qat"], ["--qat", "--corrects"]):
                with tempfile.TemporaryDirectory() as folder:
                    if "--qat" in more:
                        qrisp.save_weights(Path(folder) / "first.npz", qrisp.Qrisp("s", 2), {})
                        more = [*more, "--init", str(Path(folder) / "first.npz")]
                    options, lines = self.options(folder, *more), []
                    whole = train_qrisp.train(options, clips, lines.append)
                    train_qrisp.train(options, clips, lines.append, stop_after=3)
                    options.resume = True
                    again = train_qrisp.train(options, clips, lines.append)
                    for key, value in whole["model"].items():
                        self.assertTrue(torch.isfinite(value).all())
                        self.assertTrue(torch.equal(value, again["model"][key]), key)
                    options.lr = 0.1
                    with self.assertRaisesRegex(ValueError, "lr"):
                        train_qrisp.train(options, clips, lines.append)
        finally:
            train_qrisp.CALIBRATION_SEQUENCES = kept

    def test_a_few_steps_help(self):
        losses = []
        with tempfile.TemporaryDirectory() as folder:
            options = self.options(folder)
            options.steps, options.every, options.crop = 40, 1, 24
            train_qrisp.train(options, [make_clip(k) for k in range(2)],
                              lambda line: losses.append(float(line.split("loss ")[1].split()[0]))
                              if "loss" in line else None)
        self.assertLess(losses[-1], 0.95 * losses[0])

    def test_refusals(self):
        with tempfile.TemporaryDirectory() as folder:
            with self.assertRaisesRegex(ValueError, "no clip has the ratio 3"):
                train_qrisp.train(self.options(folder, "--scale", "3"), [make_clip()], lambda line: None)
            for more, message in ((["--crop", "20"], "multiple of 8"), (["--lr", "2"], "--lr"), (["--qat"], "--init")):
                with self.assertRaisesRegex(ValueError, message):
                    self.options(folder, *more)


@unittest.skipUnless(PROGRAM, "SHALE_PROGRAM is not set")
class Program(unittest.TestCase):
    """Every network of the paper in the program: its cost row, and a run of random weights bit for bit."""

    def shale(self, *arguments) -> str:
        done = subprocess.run([PROGRAM, *map(str, arguments)], capture_output=True, text=True)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        return done.stdout

    def test_report_and_exact_run(self):
        with tempfile.TemporaryDirectory() as folder:
            for (size, scale), (parameters, macs, gmac) in TABLE.items():
                exact = qrisp.to_int8(network(size, scale), qrisp.jitter_sequence(1))
                path = Path(folder) / f"{size}{scale}.tosa"
                path.write_bytes(qrisp.build_graph(exact, 0, *(side // scale for side in qrisp.OUTPUT)).pack())
                row = json.loads(self.shale("report", path, "--json"))["files"][0]
                self.assertEqual((row["parameters"], row["macs_per_pixel"]), (parameters, macs))
                self.assertEqual(round(row["macs"] / 1e9, 4), gmac)
                codes = picture_codes(scale, 6, 10)
                np.save(Path(folder) / "input.npy", codes.numpy())
                out = Path(folder) / f"{size}{scale}"
                self.shale("run", path, "--input", f"input={folder}/input.npy", "--input-shape",
                           f"input=1,6,10,{codes.shape[3]}", "--kernels", "generic", "--check", "-o", out)
                for name, wanted in exact.run(codes, 0).items():
                    np.testing.assert_array_equal(np.load(out / f"{name}.npy"), wanted.numpy(), f"{size} {scale}")


if __name__ == "__main__":
    unittest.main()
