"""SRPO from pictures to the exported graph: python3 -m unittest discover tests/tools/train"""

import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import flatbuffers
import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tools" / "train"))

import evaluate_srpo  # noqa: E402
import export_srpo  # noqa: E402
import files  # noqa: E402
import png  # noqa: E402
import quantize  # noqa: E402
import shapes  # noqa: E402
import srpo  # noqa: E402
import tosa_writer  # noqa: E402
import train_srpo  # noqa: E402

SEED = 7


def quietly(run, arguments):
    """Exit code and standard error of a command line."""
    errors = io.StringIO()
    with contextlib.redirect_stderr(errors), contextlib.redirect_stdout(io.StringIO()):
        code = run([str(a) for a in arguments])
    return code, errors.getvalue()


class View:
    """A FlatBuffers table by field ids, read without the writer's code."""

    def __init__(self, data, at):
        self.table = flatbuffers.table.Table(data, at)

    @classmethod
    def root(cls, data):
        return cls(data, int.from_bytes(data[:4], "little"))

    def _at(self, field):
        return self.table.Offset(4 + 2 * field)

    def number(self, field, flags, default=0):
        at = self._at(field)
        return self.table.Get(flags, at + self.table.Pos) if at else default

    def text(self, field):
        return self.table.String(self._at(field) + self.table.Pos).decode()

    def child(self, field):
        return View(self.table.Bytes, self.table.Indirect(self._at(field) + self.table.Pos))

    def vector(self, field):
        """Start and length."""
        at = self._at(field)
        return (self.table.Vector(at), self.table.VectorLen(at)) if at else (0, 0)

    def children(self, field):
        start, count = self.vector(field)
        return [View(self.table.Bytes, self.table.Indirect(start + 4 * i)) for i in range(count)]

    def texts(self, field):
        start, count = self.vector(field)
        return [self.table.String(start + 4 * i).decode() for i in range(count)]

    def array(self, field, dtype):
        start, count = self.vector(field)
        size = np.dtype(dtype).itemsize if dtype == np.int32 else 1
        return np.frombuffer(bytes(self.table.Bytes[start : start + count * size]), dtype)


class Shapes(unittest.TestCase):
    def test_the_same_seed_draws_the_same_pictures(self):
        for make in (shapes.random_scene, shapes.test_scene):
            one, two = (shapes.render(make(SEED, 64, 48), 2) for _ in range(2))
            self.assertTrue(np.array_equal(one, two))
            self.assertFalse(np.array_equal(one, shapes.render(make(SEED + 1, 64, 48), 2)))

    def test_a_scale_3_pixel_in_the_middle_is_the_low_resolution_pixel(self):
        scene = shapes.random_scene(SEED, 64, 48)
        self.assertTrue(np.array_equal(shapes.render(scene, 3)[1::3, 1::3], shapes.render(scene)))

    def test_edges_are_not_smoothed(self):
        paint = shapes.Gradient(np.zeros(2), np.ones(2), np.full(3, 200.0), np.full(3, 200.0), False)
        back = shapes.Gradient(np.zeros(2), np.ones(2), np.zeros(3), np.zeros(3), False)
        disc = shapes.Ring(np.array([16.0, 16.0]), 0.0, 9.3, paint)
        picture = shapes.render(shapes.Scene(32, 32, back, [disc]))
        self.assertEqual(set(np.unique(picture)), {0, 200})

    def test_the_committed_pictures_are_those_of_the_generator(self):
        scene = shapes.test_scene()
        for name, scale in (("raster_lr", 1), ("raster_x2", 2), ("raster_x3", 3)):
            picture = png.read_png(ROOT / "models" / "pictures" / f"{name}.png")
            drawn = shapes.render(scene, scale)
            self.assertEqual(picture.shape, drawn.shape)
            # Sines and powers may differ in the last bit between C libraries.
            self.assertLess(np.mean(np.any(picture != drawn, axis=2)), 1e-3, name)

    def test_png_round_trips_and_refuses_damage(self):
        picture = shapes.render(shapes.random_scene(SEED, 33, 21))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "a.png"
            png.write_png(path, picture)
            self.assertTrue(np.array_equal(png.read_png(path), picture))
            data = path.read_bytes()
            for damaged in (b"", data[:40], data[: len(data) // 2], b"x" + data[1:]):
                path.write_bytes(damaged)
                with self.assertRaises(ValueError):
                    png.read_png(path)


class Files(unittest.TestCase):
    def test_they_are_written_whole_or_not_at_all_and_never_replace_a_device_or_a_link(self):
        with tempfile.TemporaryDirectory() as folder:
            path, link, pipe = (Path(folder) / name for name in ("file", "link", "pipe"))
            files.write_atomically(path, b"one")
            with self.assertRaises(KeyboardInterrupt), files.atomic(path) as file:
                file.write(b"two")
                raise KeyboardInterrupt
            self.assertEqual(path.read_bytes(), b"one")
            link.symlink_to(path)
            files.write_atomically(link, b"three")
            self.assertTrue(link.is_symlink())
            self.assertEqual(path.read_bytes(), b"three")
            os.mkfifo(pipe)
            reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
            files.write_atomically(pipe, b"four")
            self.assertEqual(os.read(reader, 9), b"four")
            os.close(reader)
            self.assertEqual(sorted(entry.name for entry in Path(folder).iterdir()), ["file", "link", "pipe"])


class Picture(unittest.TestCase):
    def test_round_half_away_from_zero(self):
        values = np.array([-1.5, -0.5, -0.49, 0.0, 0.49, 0.5, 1.5])
        self.assertEqual(srpo.round_half_away(values).tolist(), [-2, -1, 0, 0, 0, 1, 2])

    def test_mask_is_0_where_nothing_moves_and_1_inside_what_moves(self):
        rounded = np.zeros((12, 12, 2), int)
        rounded[2:8, 3:9, 0] = 1
        alpha = srpo.mask(rounded)
        self.assertEqual(alpha[10, 1], 0.0)
        self.assertAlmostEqual(alpha[5, 5], 1.0)
        self.assertAlmostEqual(alpha[1, 5], 2 * 0.094742 + 0.118318, places=5)
        self.assertLess(srpo.mask(np.ones((4, 4, 2), int))[0, 0], 0.6)  # outside counts as unmoved
        self.assertTrue(np.allclose(srpo.mask_kernel(), [[0.094742, 0.118318, 0.094742], [0.118318, 0.147761, 0.118318],
                                                         [0.094742, 0.118318, 0.094742]], atol=1e-6))

    def test_fusion_without_offsets_is_lanczos_and_positive_offsets_look_right_and_down(self):
        lr = shapes.render(shapes.random_scene(SEED, 24, 16)) / 255.0
        for s in (2, 3):
            still = np.zeros((16 * s, 24 * s, 2))
            self.assertTrue(np.allclose(srpo.fuse(lr, still, s), np.clip(srpo.lanczos(lr, s), 0, 1)))
            fused = srpo.fuse(lr, still + [1.0, 2.0], s)
            self.assertTrue(np.allclose(fused[5 * s, 7 * s], lr[7, 8]))

    def test_lanczos_keeps_constants_and_matches_the_weights_of_the_shader(self):
        self.assertTrue(np.allclose(srpo.lanczos(np.full((5, 7, 3), 0.3), 3), 0.3))
        shader = (ROOT / "shaders" / "frame" / "srpo" / "post.comp").read_text()
        for s in (2, 3):
            row = srpo.lanczos_matrix(16, s)[8 * s]
            found = re.search(rf"kLanczosBy{s}\[6\] = float\[6\]\((.*?)\)", shader).group(1)
            self.assertTrue(np.allclose([float(x) for x in found.split(",")], row[5:11], atol=1e-8))

    def test_training_projection_equals_the_rounded_one_at_whole_offsets(self):
        rng = np.random.default_rng(SEED)
        lr = rng.random((9, 11, 3))
        whole = rng.integers(-3, 4, (18, 22, 2))
        expected = srpo.project(lr, whole, 2)
        got = srpo.project_bilinear(torch.from_numpy(lr).permute(2, 0, 1)[None],
                                    torch.from_numpy(whole.astype(float)).permute(2, 0, 1)[None], 2)
        self.assertTrue(np.allclose(got[0].permute(1, 2, 0).numpy(), expected, atol=1e-6))

    def test_the_second_stage_trains_on_the_displayed_picture(self):
        rng = np.random.default_rng(SEED)
        lr, offsets = rng.random((9, 11, 3)), rng.normal(0, 1, (27, 33, 2))
        moved = torch.from_numpy(offsets).permute(2, 0, 1)[None].requires_grad_()
        got = srpo.fuse_straight_through(torch.from_numpy(lr).permute(2, 0, 1)[None], moved, 3)
        self.assertTrue(np.allclose(got[0].permute(1, 2, 0).detach().numpy().clip(0, 1), srpo.fuse(lr, offsets, 3)))
        got.sum().backward()
        self.assertGreater(float(moved.grad.abs().max()), 0)

    def test_metrics(self):
        a = shapes.render(shapes.random_scene(SEED, 40, 30))
        self.assertEqual(srpo.psnr(a, a), float("inf"))
        self.assertAlmostEqual(srpo.ssim(a, a), 1.0)
        loss = srpo.ssim_loss(*(torch.from_numpy(a / 255.0).permute(2, 0, 1)[None] for _ in range(2)))
        self.assertAlmostEqual(float(loss), 0.0)


class Network(unittest.TestCase):
    def test_it_has_8434_parameters_and_phase_filters_equal_the_literal_form(self):
        torch.manual_seed(SEED)
        for s in (2, 3):
            model = srpo.Srpo(s)
            self.assertEqual(srpo.parameter_count(model), srpo.PARAMETERS)
            x = torch.rand(1, 3, 13, 10)
            with torch.no_grad():
                self.assertLess(float((model(x) - model.forward_literal(x)).abs().max()), 1e-5)

    def test_ssim_gradient_agrees_with_differences(self):
        torch.manual_seed(SEED)
        a = torch.rand(1, 1, 13, 13, dtype=torch.float64, requires_grad=True)
        b = torch.rand(1, 1, 13, 13, dtype=torch.float64)
        self.assertTrue(torch.autograd.gradcheck(lambda x: srpo.ssim_loss(x, b), a))


class Writer(unittest.TestCase):
    def make(self):
        rng = np.random.default_rng(SEED)
        g = tosa_writer.GraphWriter()
        x = g.input("x", (1, 8, 6, 4))
        a = g.conv2d("a", x, rng.integers(-127, 128, (8, 3, 3, 4)), np.arange(8), input_zp=-128, pad=(1, 1, 1, 1))
        a = g.clamp("relu", g.rescale("a8", a, np.full(8, 1 << 30), np.full(8, 40), output_zp=-128), -128, 127)
        d = g.depthwise_conv2d("d", a, rng.integers(-9, 9, (3, 3, 8, 1)), np.zeros(8), input_zp=-128, pad=(1, 1, 1, 1))
        d = g.table("t", g.rescale("d8", d, 1 << 30, 38), np.arange(-128, 128))
        c = g.concat("c", [a, d], 3)
        p = g.avg_pool2d("p", c, (2, 2), (2, 2), input_zp=0, output_zp=0)
        m = g.max_pool2d("m", c, (2, 2), (2, 2))
        wide = [g.rescale(n, v, 1 << 30, 30, dtype="INT32") for n, v in (("p32", p), ("m32", m))]
        y = g.rescale("sum8", g.add("sum", *wide), 1 << 30, 31)
        g.output(g.resize_nearest("up", y, 2))
        g.output(g.rescale("prod8", g.mul("prod", p, m), 1 << 30, 36))
        return g

    def test_file_has_identifier_version_and_consistent_operators(self):
        data = self.make().pack()
        self.assertEqual(data, self.make().pack())
        self.assertEqual(data[4:8], b"TOSA")
        number = flatbuffers.number_types
        root = View.root(data)
        version = root.child(0)
        self.assertEqual([version.number(i, number.Int32Flags, -1) for i in range(3)], [1, 0, 0])
        self.assertFalse(version.number(3, number.BoolFlags, True))
        (region,) = root.children(1)
        (block,) = region.children(1)
        self.assertEqual((region.text(0), block.text(0)), ("main", "main"))
        self.assertEqual((block.texts(3), block.texts(4)), (["x"], ["up", "prod8"]))
        names, made = {t.text(0) for t in block.children(2)} | {s.text(0) for s in block.children(5)}, {"x"}
        for operator in block.children(1):
            self.assertEqual(operator.number(0, number.Uint32Flags), operator.number(1, number.Uint8Flags))
            operator.child(2)  # the attribute table is there
            self.assertLessEqual(set(operator.texts(3)), made)
            made |= set(operator.texts(4))
        self.assertEqual(names, made)
        tensors = {t.text(0): t for t in block.children(2)}
        self.assertEqual(tensors["up"].array(1, np.int32).tolist(), [1, 8, 6, 16])
        self.assertEqual(tensors["a/bias"].array(3, np.uint8).view(np.int32).tolist(), list(range(8)))
        self.assertEqual(tensors["a/bias"].vector(3)[0] % 8, 0)

    def test_flatc_decodes_the_file(self):
        schema = ROOT / "ir" / "schema" / "tosa.fbs"
        if not shutil.which("flatc") or not schema.exists():
            self.skipTest("flatc or the schema is not here")
        graph = self.make()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "graph.tosa"
            path.write_bytes(graph.pack())
            subprocess.run(["flatc", "--json", "--strict-json", "--raw-binary", "-o", folder, str(schema), "--",
                            str(path)], check=True, capture_output=True)
            block = json.loads((Path(folder) / "graph.json").read_text())["regions"][0]["blocks"][0]
        self.assertEqual([o["op"] for o in block["operators"]], graph.operators(constants=True))
        by_result = {o["outputs"][0]: o for o in block["operators"]}
        self.assertEqual(by_result["a"]["attribute"], {"pad": [1, 1, 1, 1], "stride": [1, 1], "dilation": [1, 1],
                                                       "acc_type": "INT32"})
        self.assertEqual(by_result["relu"]["attribute"], {"min_val": [128], "max_val": [127], "nan_mode": "PROPAGATE"})

    def test_resize_nearest_repeats_pixels_under_the_rule_of_tosa(self):
        for factor in (2, 3, 4):
            g = tosa_writer.GraphWriter()
            g.output(g.resize_nearest("up", g.input("x", (1, 5, 5, 1)), factor))
            (n, d, _, _), (offset, _), _ = (values for _, values in g._shapes)
            picked = []
            for o in range(5 * factor):
                i, rest = divmod(o * d + offset, n)
                picked.append(min(i + 1, 4) if 2 * rest >= n else max(i, 0))
            self.assertEqual(picked, [o // factor for o in range(5 * factor)])

    def test_faults_name_the_tensor(self):
        g = tosa_writer.GraphWriter()
        x = g.input("x", (1, 8, 8, 4))
        for fault in (lambda: g.input("x", (1, 1, 1, 1)), lambda: g.const("c", [128], "INT8"),
                      lambda: g.conv2d("k", x, np.zeros((1, 1, 1, 3), int), [0], input_zp=0),
                      lambda: g.rescale("r", x, [1, 2], [30, 30])):
            with self.assertRaises(ValueError):
                fault()


class Integers(unittest.TestCase):
    def test_multiplier_and_shift_give_the_factor(self):
        factors = np.array([1e-6, 0.00731, 0.25, 0.5, 0.999999999999, 1.0, 3.7])
        multiplier, shift = quantize.scale_to_multiplier(factors)
        self.assertTrue(np.all((multiplier >= 2**30) & (multiplier < 2**31)))
        self.assertTrue(np.allclose(multiplier / 2.0**shift, factors, rtol=1e-9))
        with self.assertRaises(ValueError):
            quantize.scale_to_multiplier(np.array([0.0]))

    def test_apply_scale_rounds_halves_up_and_checks_its_range(self):
        one = (np.int64(1 << 30), np.int64(31))
        self.assertEqual([int(quantize.apply_scale_32(np.int64(v), *one)) for v in (-3, -1, 1, 3)], [-1, 0, 1, 2])
        with self.assertRaises(ValueError):
            quantize.apply_scale_32(np.int64(2), np.int64(1 << 30), np.int64(2))

    def test_convolution_counts_every_tap_once(self):
        rng = np.random.default_rng(SEED)
        x, w = rng.integers(-255, 256, (6, 5, 3)), rng.integers(-127, 128, (2, 5, 5, 3))
        padded = np.pad(x, ((2, 2), (2, 2), (0, 0)))
        for y, column, channel in ((0, 0, 0), (3, 2, 1), (5, 4, 1)):
            expected = int((padded[y : y + 5, column : column + 5] * w[channel]).sum())
            self.assertEqual(int(quantize.convolve(x, w)[y, column, channel]), expected)

    def test_int8_offsets_stay_close_to_float_offsets(self):
        torch.manual_seed(SEED)
        model = srpo.Srpo(2).eval()
        with torch.no_grad():
            model.conv3.weight.mul_(4)
        pictures = [shapes.render(shapes.random_scene(SEED + i, 48, 48)) for i in range(3)]
        network = quantize.quantize(model, pictures)
        self.assertEqual(np.log2(network.offset_scale), np.round(np.log2(network.offset_scale)))
        real, integer = srpo.float_offsets(model, pictures[0]), network.offsets(pictures[0])
        self.assertLess(np.abs(real - integer).max(), 6 * network.offset_scale)


class Training(unittest.TestCase):
    ARGUMENTS = ["--scale", "2", "--batch", "2", "--crop", "16", "--pictures", "2", "--seed", "7", "--noise", "0.1"]

    def test_a_resumed_run_ends_with_the_same_bits(self):
        with tempfile.TemporaryDirectory() as folder:
            out = [Path(folder) / name for name in ("whole", "parts")]
            whole = train_srpo.train(train_srpo.parse([*self.ARGUMENTS, "--steps", "3", "--out", str(out[0])]),
                                     report=lambda line: None)
            parts = [*self.ARGUMENTS, "--steps", "3", "--out", str(out[1])]
            train_srpo.train(train_srpo.parse(parts), report=lambda line: None, stop_after=1)
            again = train_srpo.train(train_srpo.parse([*parts, "--resume"]), report=lambda line: None)
        self.assertEqual(again["step"], 3)
        for name, value in whole["model"].items():
            self.assertTrue(torch.equal(value, again["model"][name]), name)

    def test_train_quantize_export_evaluate(self):
        with tempfile.TemporaryDirectory() as folder:
            folder = Path(folder)
            two, three, out = folder / "two", folder / "three", folder / "model"
            self.assertEqual(quietly(train_srpo.main, [*self.ARGUMENTS, "--steps", "2", "--out", two]), (0, ""))
            arguments = ["--scale", "3", *self.ARGUMENTS[2:], "--steps", "1", "--fused", "--init", two / "last.pt",
                         "--out", three]
            self.assertEqual(quietly(train_srpo.main, arguments), (0, ""))
            self.assertEqual(quietly(export_srpo.main, ["--weights", three / "last.pt", "--out", out]), (0, ""))
            data = (out / "model.tosa").read_bytes()
            self.assertEqual(data[4:8], b"TOSA")
            frame = json.loads((out / "frame.json").read_text())
            self.assertEqual([p.get("name", "graph") for p in frame["passes"]], ["pre", "graph", "post"])
            golden = np.load(out / "golden" / "offsets.npy")
            self.assertEqual((golden.dtype, golden.shape), (np.dtype(np.int8), (1, 192, 192, 2)))
            # The folder makes itself again from its own float weights.
            self.assertEqual(quietly(export_srpo.main, ["--weights", out / "weights.npz", "--out", folder / "again"]),
                             (0, ""))
            self.assertEqual((folder / "again" / "model.tosa").read_bytes(), data)
            model, record = srpo.load_model(out / "weights.npz")
            self.assertEqual((record["seed"], record["starts_from"]["scale"]), (7, 2))
            report = evaluate_srpo.measure(model, quantize.quantize(model), [shapes.random_scene(SEED, 32, 32)])
            self.assertEqual(set(report), {*evaluate_srpo.METHODS, "int8"})

    def test_refused_arguments_give_one_line_and_exit_code_1(self):
        with tempfile.TemporaryDirectory() as folder:
            junk = Path(folder) / "junk.pt"
            junk.write_bytes(b"junk")
            (Path(folder) / "bad").mkdir()
            (Path(folder) / "bad" / "last.pt").write_bytes(b"junk")
            for run, arguments in (
                (train_srpo.main, ["--scale", "2", "--crop", "4", "--out", folder]),
                (train_srpo.main, ["--scale", "2", "--resume", "--out", Path(folder) / "none"]),
                (train_srpo.main, ["--scale", "2", "--pictures", "1", "--resume", "--out", Path(folder) / "bad"]),
                (train_srpo.main, ["--scale", "3", "--pictures", "1", "--init", junk, "--out", folder]),
                (export_srpo.main, ["--weights", Path(folder) / "none.npz", "--out", folder]),
                (export_srpo.main, ["--weights", junk, "--out", folder]),
                (evaluate_srpo.main, ["--weights", junk]),
                (shapes.main, ["--seed", "-1", "--out", folder]),
            ):
                code, errors = quietly(run, arguments)
                self.assertEqual(code, 1, arguments)
                self.assertEqual(errors.count("\n"), 1, errors)


class Models(unittest.TestCase):
    def test_the_committed_graphs_come_from_the_committed_weights(self):
        for s in (2, 3):
            folder = ROOT / "models" / f"srpo_x{s}"
            model, _ = srpo.load_model(folder / "weights.npz")
            network = quantize.quantize(model)
            graph = export_srpo.build_graph(network)
            self.assertEqual(graph.operators(), ["CONV2D", "RESCALE", "CLAMP"] * 2 + ["RESIZE", "CONV2D", "RESCALE"])
            frame = json.loads((folder / "frame.json").read_text())
            self.assertEqual(frame["tensors"][1]["scale"], network.offset_scale)
            golden = [np.load(folder / "golden" / f"{name}.npy") for name in ("input", "offsets")]
            # Calibration runs in float, so another machine may choose a neighbouring scale.
            self.assertLess(np.abs(network.run(golden[0]).astype(int) - golden[1]).mean(), 0.5)


if __name__ == "__main__":
    print(f"seed {SEED}")
    torch.set_num_threads(1)
    unittest.main()
