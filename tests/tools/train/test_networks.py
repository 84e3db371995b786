"""The networks of tests/bench/networks.py, in small, on the device and in the interpreter: python3 -m unittest discover tests/tools/train"""

import contextlib
import io
import os
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[3]
sys.path[:0] = [str(ROOT / "tests" / "bench"), str(ROOT / "tools" / "train")]

import networks  # noqa: E402
from tosa_writer import GraphWriter  # noqa: E402

PROGRAM = os.environ.get("SHALE_PROGRAM", str(ROOT / "build" / "tools" / "shale"))
SEED = 5


class Networks(unittest.TestCase):
    def test_small_forms_run_exactly_and_say_something(self):
        with tempfile.TemporaryDirectory() as folder:
            for path in networks.write(Path(folder), SEED, small=True):
                with self.subTest(path.stem):
                    out = Path(folder) / path.stem
                    run = subprocess.run(
                        [PROGRAM, "run", path, "--random", "1", "--check", "--validation", "-o", out],
                        capture_output=True, text=True)
                    self.assertEqual(run.returncode, 0, run.stderr)
                    self.assertIn("equal to the interpreter", run.stdout + run.stderr)
                    (result,) = out.glob("*.npy")
                    codes = np.load(result).astype(int)
                    self.assertGreater(codes.std(), 5)
                    self.assertLess(np.mean(np.abs(codes) >= 127), 0.3)

    def test_files_follow_from_the_seed(self):
        with tempfile.TemporaryDirectory() as folder:
            files = [[p.read_bytes() for p in networks.write(Path(folder) / name, seed, small=True)]
                     for name, seed in (("a", SEED), ("b", SEED), ("c", SEED + 1))]
        self.assertEqual(files[0], files[1])
        for one, other in zip(files[0], files[2]):
            self.assertNotEqual(one, other)

    def test_softmax_adds_up(self):
        network = networks.Network(SEED)
        graph = network.graph
        graph.output(network.softmax(graph.input("logits", (1, 4, 16))))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "softmax.tosa"
            path.write_bytes(graph.pack())
            logits = np.random.default_rng(SEED).integers(-100, 100, (1, 4, 16)).astype(np.int8)
            np.save(Path(folder) / "logits.npy", logits)
            subprocess.run([PROGRAM, "run", path, "--input", f"logits={folder}/logits.npy", "-o", f"{folder}/out"],
                           check=True, capture_output=True)
            (result,) = (Path(folder) / "out").glob("*.npy")
            found = np.load(result) / 127
        exact = np.exp(logits / 32.0)
        exact /= exact.sum(axis=2, keepdims=True)
        np.testing.assert_allclose(found, exact, atol=0.02)

    def test_the_writer_refuses_what_does_not_fit(self):
        graph = GraphWriter()
        a, b = graph.input("a", (1, 3, 4)), graph.input("b", (1, 5, 2))
        with self.assertRaisesRegex(ValueError, r"'y': INT8 \[1, 3, 4\] by INT8 \[1, 5, 2\]"):
            graph.matmul("y", a, b)
        x = graph.input("x", (1, 3, 4, 8))
        with self.assertRaisesRegex(ValueError, "'z': weights expect 4 input channels, 'x' has 8"):
            graph.transpose_conv2d("z", x, np.zeros((2, 2, 2, 4)), np.zeros(2), input_zp=0)

    def test_a_folder_that_cannot_be_is_an_error(self):
        errors = io.StringIO()
        with tempfile.NamedTemporaryFile() as file, contextlib.redirect_stderr(errors):
            self.assertEqual(networks.main([file.name + "/sub"]), 1)
        self.assertIn("networks: error: ", errors.getvalue())


if __name__ == "__main__":
    unittest.main()
