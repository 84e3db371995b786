#!/usr/bin/python3
"""Writes INT8 networks of kinds that others use, with random weights, as .tosa files: what the compiler makes of a stranger's graph.

  mobilenet_v2   inverted residuals by depthwise convolutions, 224x224 to 1000 classes
  transformer    a block: attention with a softmax by tables, and two layers behind it, on 196 tokens of 192
  unet           four levels, up again by transposed convolutions
  separable_sr   super resolution by 2 out of depthwise-separable convolutions

Ranges are such that random inputs neither vanish nor saturate. Weights follow from --seed alone. --small writes forms of a few
thousand positions, with every kind of operator of the large one.

Example: tests/bench/networks.py build/networks && build/tools/shale bench build/networks/mobilenet_v2.tosa --naive
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tools" / "train"))
from files import write_atomically  # noqa: E402
from tosa_writer import GraphWriter, Tensor  # noqa: E402

#: Of activations behind a rectifier.
ZERO_POINT = -128
#: What int8 codes spread by, uniform ones.
SPREAD = 73.0


class Network:
    """A graph whose layers take random weights."""

    def __init__(self, seed: int):
        self.graph = GraphWriter()
        self._random = np.random.default_rng(seed)
        self._count = 0

    def name(self, kind: str) -> str:
        self._count += 1
        return f"{kind}{self._count}"

    def _weights(self, shape) -> np.ndarray:
        return self._random.integers(-127, 128, shape)

    def _requantize(self, x: Tensor, products: int, zero_point: int) -> Tensor:
        """Sums of that many products of codes, back to the spread of codes; channels differ by up to 2."""
        shift = 30 + round(math.log2(math.sqrt(products) * SPREAD))
        multiplier = self._random.integers(2**30, 2**31 - 1, x.shape[-1])
        return self.graph.rescale(f"{x.name}/rescale", x, multiplier, np.full(x.shape[-1], shift),
                                  output_zp=zero_point)

    def conv(self, x: Tensor, channels: int, kernel: int = 3, stride: int = 1, relu: bool = True,
             input_zp: int = ZERO_POINT) -> Tensor:
        """Padded so that a stride of 1 keeps the size and one of 2 halves it."""
        ic = x.shape[-1]
        y = self.graph.conv2d(self.name("conv"), x, self._weights((channels, kernel, kernel, ic)),
                              self._random.integers(-2000, 2000, channels), input_zp=input_zp,
                              pad=self._pad(kernel, stride), stride=(stride, stride))
        return self._requantize(y, kernel * kernel * ic, ZERO_POINT if relu else 0)

    def depthwise(self, x: Tensor, stride: int = 1) -> Tensor:
        c = x.shape[-1]
        y = self.graph.depthwise_conv2d(self.name("depthwise"), x, self._weights((3, 3, c, 1)),
                                        self._random.integers(-2000, 2000, c), input_zp=ZERO_POINT,
                                        pad=self._pad(3, stride), stride=(stride, stride))
        return self._requantize(y, 9, ZERO_POINT)

    @staticmethod
    def _pad(kernel: int, stride: int) -> tuple[int, int, int, int]:
        whole = kernel - 1
        before = (whole - (stride - 1)) // 2 if whole else 0
        after = whole - (stride - 1) - before if whole else 0
        return (before, after, before, after)

    def up(self, x: Tensor, channels: int) -> Tensor:
        """Twice as large, by a transposed convolution."""
        ic = x.shape[-1]
        y = self.graph.transpose_conv2d(self.name("up"), x, self._weights((channels, 2, 2, ic)),
                                        self._random.integers(-2000, 2000, channels), input_zp=ZERO_POINT,
                                        stride=(2, 2))
        return self._requantize(y, ic, ZERO_POINT)

    def wide(self, x: Tensor, zero_point: int = 0) -> Tensor:
        """The codes without their zero point, as int32."""
        return self.graph.rescale(self.name("wide"), x, [2**30], [30], input_zp=zero_point, dtype="INT32")

    def add(self, a: Tensor, b: Tensor) -> Tensor:
        """The mean of two tensors whose codes have no zero point."""
        y = self.graph.add(self.name("add"), self.wide(a), self.wide(b))
        return self.graph.rescale(f"{y.name}/rescale", y, [2**30], [31])

    def matmul(self, a: Tensor, b: Tensor) -> Tensor:
        y = self.graph.matmul(self.name("matmul"), a, b)
        return self.graph.rescale(f"{y.name}/rescale", y, [2**30],
                                  [30 + round(math.log2(math.sqrt(a.shape[2]) * SPREAD))])

    def softmax(self, x: Tensor) -> Tensor:
        """Over the last axis: 0 to 127, for probabilities 0 to 1. exp and 1/x by tables."""
        axis, length = len(x.shape) - 1, x.shape[-1]
        name = self.name("softmax")
        logits = self.wide(x)
        below = self.graph.sub(f"{name}/below", logits, self.graph.reduce_max(f"{name}/max", logits, axis))
        # From 0 down to -255: the code 127 and those below it.
        codes = self.graph.rescale(f"{name}/codes", below, [2**30], [30], output_zp=127)
        exp = self.graph.table(f"{name}/exp", codes,
                               np.round(127 * np.exp((np.arange(256) - 255) / 32)).astype(int))
        parts = self.wide(exp)
        total = self.graph.reduce_sum(f"{name}/sum", parts, axis)
        # 127 to 127 * length, on 0 to 32767 of the second table.
        factor = 32767 / (127 * length)
        shift = 30 - math.floor(math.log2(factor))
        scaled = self.graph.rescale(f"{name}/total", total, [round(factor * 2**shift)], [shift], dtype="INT16")
        at = np.maximum((np.arange(513) - 256) * 128, 128)
        inverse = self.graph.table(f"{name}/inverse", scaled, np.minimum(32767, np.round(32767 * 128 / at)))
        product = self.graph.mul(f"{name}/product", parts, inverse)
        # inverse is 128 * 32767 * 128 * factor^-1 / total.
        share = 32767 * 128 * 128 / factor / 127
        shift = 30 + math.floor(math.log2(share))
        return self.graph.rescale(f"{name}/probability", product, [round(2**shift / share)], [shift])


def mobilenet_v2(network: Network, small: bool) -> Tensor:
    """Source: "MobileNetV2: Inverted Residuals and Linear Bottlenecks", table 2."""
    size, last, classes = (32, 64, 10) if small else (224, 1280, 1000)
    x = network.graph.input("image", (1, size, size, 3))
    x = network.conv(x, 8 if small else 32, stride=2)
    blocks = [(1, 8, 1, 1), (6, 16, 2, 2)] if small else [
        (1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1), (6, 160, 3, 2), (6, 320, 1, 1)]
    zero_point = ZERO_POINT
    for expansion, channels, count, stride in blocks:
        for index in range(count):
            y, steps = x, stride if index == 0 else 1
            if expansion > 1:
                y = network.conv(y, expansion * x.shape[-1], kernel=1, input_zp=zero_point)
            y = network.depthwise(y, steps)
            y = network.conv(y, channels, kernel=1, relu=False)
            x = network.add(x, y) if index > 0 else y
            zero_point = 0
    x = network.conv(x, last, kernel=1, input_zp=0)
    extent = x.shape[1]
    x = network.graph.avg_pool2d("pool", x, (extent, extent), (1, 1), input_zp=ZERO_POINT, output_zp=ZERO_POINT)
    return network.conv(x, classes, kernel=1, relu=False)


def transformer(network: Network, small: bool) -> Tensor:
    """Attention of several heads and a feed-forward pair, each with its residual."""
    tokens, width, heads = (12, 16, 2) if small else (196, 192, 3)
    graph, each = network.graph, width // heads
    x = graph.input("tokens", (1, tokens, 1, width))

    def of_heads(value: Tensor, perms) -> Tensor:
        split = graph.reshape(f"{value.name}/split", value, (tokens, heads, each))
        return graph.transpose(f"{value.name}/heads", split, perms)

    query, key, value = (network.conv(x, width, kernel=1, relu=False, input_zp=0) for _ in range(3))
    scores = network.matmul(of_heads(query, (1, 0, 2)), of_heads(key, (1, 2, 0)))
    mixed = network.matmul(network.softmax(scores), of_heads(value, (1, 0, 2)))
    joined = graph.transpose("joined", mixed, (1, 0, 2))
    y = network.conv(graph.reshape("tokens_again", joined, x.shape), width, kernel=1, relu=False, input_zp=0)
    x = network.add(x, y)
    y = network.conv(x, 4 * width, kernel=1, input_zp=0)
    return network.add(x, network.conv(y, width, kernel=1, relu=False))


def unet(network: Network, small: bool) -> Tensor:
    """Two convolutions a level, half the size and twice the channels below; up by transposed convolutions, over a concat."""
    size, channels, levels = (16, 8, 2) if small else (256, 16, 4)
    x = network.graph.input("image", (1, size, size, 4))
    skips = []
    for level in range(levels):
        x = network.conv(network.conv(x, channels << level), channels << level)
        if level + 1 < levels:
            skips.append(x)
            x = network.graph.max_pool2d(network.name("pool"), x, (2, 2), (2, 2))
    for level in reversed(range(levels - 1)):
        x = network.graph.concat(network.name("concat"), [network.up(x, channels << level), skips[level]], 3)
        x = network.conv(network.conv(x, channels << level), channels << level)
    return network.conv(x, 4, kernel=1, relu=False)


def separable_sr(network: Network, small: bool) -> Tensor:
    """Depthwise and pointwise convolutions in turn, then four pixels out of the channels of one."""
    height, width, channels, count = (12, 16, 8, 2) if small else (270, 480, 32, 6)
    graph = network.graph
    x = network.conv(graph.input("image", (1, height, width, 4)), channels)
    for _ in range(count):
        x = network.conv(network.depthwise(x), channels, kernel=1)
    x = network.conv(x, 16, relu=False)
    x = graph.reshape("split", x, (height, width, 2, 8))
    x = graph.transpose("shuffle", x, (0, 2, 1, 3))
    return graph.reshape("picture", x, (1, 2 * height, 2 * width, 4))


NETWORKS = {build.__name__: build for build in (mobilenet_v2, transformer, unet, separable_sr)}


def write(out: Path, seed: int, small: bool) -> list[Path]:
    """Writes all networks. Errors: OSError."""
    out.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, build in NETWORKS.items():
        network = Network(seed)
        network.graph.output(build(network, small))
        paths.append(out / f"{name}.tosa")
        write_atomically(paths[-1], network.graph.pack())
    return paths


def main(arguments: list[str] | None = None) -> int:
    """Command line; exit code 1 where nothing can be written."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder for the .tosa files")
    parser.add_argument("--seed", type=int, default=1, help="of the weights (default: 1)")
    parser.add_argument("--small", action="store_true", help="small forms, for tests")
    options = parser.parse_args(arguments)
    try:
        for path in write(options.out, options.seed, options.small):
            print(path)
    except OSError as error:
        print(f"networks: error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
