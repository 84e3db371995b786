"""The NFRU network from one description: float, quantization-aware, exact INT8, and .tosa.

A picture between two frames is the mean of four warped samples (previous and newest frame, by motion vectors and by optical
flow); the network says their weights: input `[1, rows, columns, 16]`, the samples' colours, two depths and two
disocclusions in 0..1; output four logits at the same size, whose softmax are the weights. 103,492 parameters.
While it is trained in float each convolution but the last has batch normalization, which `folded` puts into its weights: the
512 parameters of its scales and shifts then are none.
Quantization: input scale 1/255, zero point -128; weights symmetric per output channel, [-127, 127]; ReLU results zero point
-128, one range per tensor, those that are joined share one; logits zero point 0.
Source: Arm's NFRU v1 (nfru.md sections 4 and 5). Its release has weights per tensor; channels lose less: ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

import precisions
import quantize
import training
from nss import Concat, Up, convolve_exactly
from tosa_writer import GraphWriter, Tensor

CHANNELS = 16
#: The four samples: previous and newest frame by motion, previous and newest by flow.
SAMPLES = 4
OUTPUT = "weights"
#: Stored size of the .tosa files, (rows, columns): any other follows the frame.
STORED = (64, 64)
INPUT: precisions.Scale = (1.0 / 255.0, -128)
#: Share of a tensor's values that its range covers.
COVERED = 0.9999
MOMENTUM = 0.1


@dataclass(frozen=True)
class Conv:
    """Zero padding to the same size, or with stride 2 to half of it; bias; ReLU but for the output."""

    name: str
    source: str
    kernel: int
    inputs: int
    outputs: int
    stride: int = 1

    @property
    def pad(self) -> tuple[int, int, int, int]:
        """Top, bottom, left, right: of an even size, what a stride of 2 reads."""
        half = self.kernel // 2
        return (half, half - (self.stride - 1), half, half - (self.stride - 1))


NODES: tuple[Conv | Up | Concat, ...] = (
    Conv("conv1", "input", 3, CHANNELS, 32), Conv("conv2", "conv1", 5, 32, 16), Conv("conv3", "conv2", 3, 16, 16),
    Conv("skip1", "conv3", 3, 16, 16), Conv("conv5", "conv3", 5, 16, 16, 2),
    Conv("conv5a", "conv5", 1, 16, 16), Conv("conv5b", "conv5", 3, 16, 16),
    Conv("conv5c", "conv5", 7, 16, 16), Conv("conv5c_1", "conv5c", 7, 16, 16),
    Conv("conv5d", "conv5", 7, 16, 16), Conv("conv5d_1", "conv5d", 7, 16, 16), Conv("conv5d_2", "conv5d_1", 7, 16, 16),
    Concat("wide", ("conv5a", "conv5b", "conv5c_1", "conv5d_2")), Conv("conv5e", "wide", 1, 64, 16),
    Up("up", "conv5e"), Conv("conv6", "up", 3, 16, 16),
    Concat("joined", ("conv6", "skip1")), Conv("conv7", "joined", 3, 32, 16), Conv(OUTPUT, "conv7", 5, 16, SAMPLES),
)
CONVS = tuple(node for node in NODES if isinstance(node, Conv))


def parameters() -> dict[str, int]:
    """Weights and biases of each convolution."""
    return {c.name: c.kernel**2 * c.inputs * c.outputs + c.outputs for c in CONVS}


def macs(rows: int, columns: int) -> dict[str, int]:
    """Multiply-accumulates of each convolution on an input of this size, border taps included."""
    halved = {"conv5", "conv5a", "conv5b", "conv5c", "conv5c_1", "conv5d", "conv5d_1", "conv5d_2", "conv5e"}
    return {c.name: rows * columns // (4 if c.name in halved else 1) * c.kernel**2 * c.inputs * c.outputs for c in CONVS}


def range_groups() -> dict[str, str]:
    """ReLU tensor -> tensor whose range it shares: all inputs of a CONCAT."""
    groups = {c.name: c.name for c in CONVS if c.name != OUTPUT}
    for node in NODES:
        if isinstance(node, Concat):
            groups.update({source: node.sources[0] for source in node.sources})
    return groups


# ---- float and quantization-aware -------------------------------------------------------------------------


class Nfru(nn.Module):
    """`normalized`: with batch normalization, for training in float; folded() has none. ranges: largest value of each
    tensor, for the output that of its size; empty while training in float."""

    def __init__(self, normalized: bool = False):
        super().__init__()
        self.normalized = normalized
        self.convs = nn.ModuleDict({c.name: nn.Conv2d(c.inputs, c.outputs, c.kernel, c.stride, c.kernel // 2)
                                    for c in CONVS})
        self.norms = nn.ModuleDict({c.name: nn.BatchNorm2d(c.outputs, momentum=MOMENTUM)
                                    for c in CONVS if normalized and c.name != OUTPUT})
        self.ranges: dict[str, float] = {}
        self.observed: dict[str, list[float]] | None = None
        for conv in self.convs.values():
            nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
            nn.init.zeros_(conv.bias)
        with torch.no_grad():  # all samples alike
            self.convs[OUTPUT].weight.mul_(0.1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """`[n, 16, rows, columns]` in 0..1, even sides, to logits `[n, 4, rows, columns]`."""
        if self.ranges:
            x = torch.fake_quantize_per_tensor_affine(x, *INPUT, -128, 127)
        values = {"input": x}
        for node in NODES:
            if isinstance(node, Concat):
                values[node.name] = torch.cat([values[s] for s in node.sources], 1)
            elif isinstance(node, Up):
                values[node.name] = F.interpolate(values[node.source], scale_factor=2, mode="nearest")
            else:
                values[node.name] = self._convolve(node, values[node.source])
        return values[OUTPUT]

    def _convolve(self, node: Conv, x: torch.Tensor) -> torch.Tensor:
        conv = self.convs[node.name]
        x = F.conv2d(x, self._weight(conv), conv.bias, node.stride, node.kernel // 2)
        if self.normalized and node.name != OUTPUT:
            x = self.norms[node.name](x)
        if self.ranges and node.name == OUTPUT:
            return torch.fake_quantize_per_tensor_affine(x, self.ranges[OUTPUT] / 127.0, 0, -128, 127)
        if self.ranges:
            return torch.fake_quantize_per_tensor_affine(x, self.ranges[node.name] / 255.0, -128, -128, 127)
        x = x if node.name == OUTPUT else F.relu(x)
        if self.observed is not None:
            seen = x.detach().abs().flatten()
            rest = max(1, int(seen.numel() * (1.0 - COVERED)))
            self.observed.setdefault(node.name, []).append(float(seen.kthvalue(seen.numel() + 1 - rest).values))
        return x

    def _weight(self, conv: nn.Conv2d) -> torch.Tensor:
        if not self.ranges:
            return conv.weight
        step = (conv.weight.detach().abs().amax(dim=(1, 2, 3)) / 127.0).clamp(min=1e-9)
        zeros = torch.zeros(len(step), dtype=torch.int32, device=step.device)
        return torch.fake_quantize_per_channel_affine(conv.weight, step, zeros, 0, -127, 127)

    def folded(self) -> Nfru:
        """The same network, as it is in evaluation, with batch normalization in its weights."""
        result = Nfru()
        result.convs.load_state_dict(self.convs.state_dict())
        with torch.no_grad():
            for name, norm in self.norms.items():
                factor = norm.weight / torch.sqrt(norm.running_var + norm.eps)
                conv = result.convs[name]
                conv.weight.mul_(factor.view(-1, 1, 1, 1))
                conv.bias.copy_((conv.bias - norm.running_mean) * factor + norm.bias)
        return result.train(self.training)

    def calibrated(self) -> None:
        """Fixes the ranges from what `observed` collected. Errors: ValueError when nothing was, or before folded()."""
        if not self.observed or self.normalized:
            raise ValueError("ranges need observed activations of a network without batch normalization")
        ranges = {name: max(float(np.mean(seen)), 1e-3) for name, seen in self.observed.items()}
        groups = range_groups()
        for name, leader in groups.items():
            ranges[name] = max(ranges[other] for other, own in groups.items() if own == leader)
        self.ranges, self.observed = ranges, None


#: Borders of the straight pieces that stand for a logarithm: of a difference of colours, of how hidden a sample is.
PIECES = (0.0, 0.012, 0.04, 0.12)
HIDDEN_PIECES = (0.0, 0.8)


def _slopes(function, borders: tuple[float, ...], end: float) -> list[float]:
    """Factors of relu(x - border) whose sum is function(x) - function(0) at all borders and at the end."""
    ends, slope, out = (*borders[1:], end), 0.0, []
    for low, high in zip(borders, ends):
        next_slope = (function(high) - function(low)) / (high - low)
        out.append(next_slope - slope)
        slope = next_slope
    return out


def by_formula(seed: int = 0) -> Nfru:
    """A network that weighs nearly as nfru/pre.comp does by hand, which training starts from: each pair of samples by the inverse square
    of its difference, those by motion less where they are hidden. Channels that the formula does not need are random, and hardly
    count at first."""
    torch.manual_seed(seed)
    model = Nfru()
    weights = {name: (conv.weight, conv.bias) for name, conv in model.convs.items()}
    shares, used = (0.25, 0.5, 0.25), len(PIECES) * 2 + len(HIDDEN_PIECES) * 2

    def take(name: str, channel: int, parts: dict[int, float], bias: float = 0.0) -> None:
        weight, biases = weights[name]
        weight[channel] = 0.0
        for source, factor in parts.items():
            weight[channel, source, weight.shape[2] // 2, weight.shape[3] // 2] = factor
        biases[channel] = bias

    with torch.no_grad():
        for pair in (0, 1):  # differences of either sign
            for c in range(3):
                first, second = 6 * pair + c, 6 * pair + 3 + c
                take("conv1", first, {first: 1.0, second: -1.0})
                take("conv1", second, {first: -1.0, second: 1.0})
            take("conv2", pair, {6 * pair + c: shares[c % 3] for c in range(6)})
            take("conv1", 12 + pair, {14 + pair: 1.0})
            take("conv2", 2 + pair, {12 + pair: 1.0})
        pieces = [(source, border) for source in (0, 1) for border in PIECES]
        pieces += [(source, border) for source in (2, 3) for border in HIDDEN_PIECES]
        for channel, (source, border) in enumerate(pieces):
            take("conv3", channel, {source: 1.0}, -border)
            take("skip1", channel, {channel: 1.0})
            take("conv7", channel, {16 + channel: 1.0})
        likely = _slopes(lambda d: -2.0 * math.log(0.01 + d), PIECES, 1.0)
        seen = _slopes(lambda h: math.log(1.02 - h), HIDDEN_PIECES, 1.0)
        middle = -math.log(0.01)  # logits lie around 0
        for sample in range(SAMPLES):
            pair = sample // 2
            weight, biases = weights[OUTPUT]
            weight[sample, :used] = 0.0
            parts = {len(PIECES) * pair + k: slope for k, slope in enumerate(likely)}
            if pair == 0:
                first = 2 * len(PIECES) + len(HIDDEN_PIECES) * sample
                parts |= {first + k: slope for k, slope in enumerate(seen)}
            for source, factor in parts.items():
                weight[sample, source, 2, 2] = factor
            biases[sample] = middle
    return model


# ---- exact INT8 -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Int8Nfru:
    """The integer network: layers by name."""

    layers: dict[str, quantize.Layer]

    def run(self, codes: torch.Tensor) -> torch.Tensor:
        """int8 `[n, rows, columns, 16]` to int8 `[n, rows, columns, 4]`, bit for bit what TOSA defines."""
        values = {"input": codes.permute(0, 3, 1, 2).float()}
        for node in NODES:
            if isinstance(node, Concat):
                values[node.name] = torch.cat([values[s] for s in node.sources], 1)
            elif isinstance(node, Up):
                values[node.name] = F.interpolate(values[node.source], scale_factor=2, mode="nearest")
            else:
                values[node.name] = convolve_exactly(self.layers[node.name], values[node.source], node.stride,
                                                     node.kernel // 2)
        return values[OUTPUT].to(torch.int8).permute(0, 2, 3, 1).contiguous()


def scales(model: Nfru) -> dict[str, precisions.Scale]:
    """Scale and zero point of every tensor. Errors: ValueError when there are no ranges."""
    if not model.ranges:
        raise ValueError("the model has no activation ranges yet")
    found = {"input": INPUT}
    for node in NODES:
        if isinstance(node, Conv):
            own = model.ranges[node.name]
            found[node.name] = (own / 127.0, 0) if node.name == OUTPUT else (own / 255.0, -128)
        else:
            found[node.name] = found[node.source if isinstance(node, Up) else node.sources[0]]
    return found


def to_int8(model: Nfru) -> Int8Nfru:
    """Quantizes with the model's ranges. Errors: ValueError when it has none or a factor cannot be rescaled."""
    known = scales(model)
    return Int8Nfru({c.name: quantize._layer(c.name, model.convs[c.name], known[c.source][0], *known[c.name],
                                             c.name != OUTPUT) for c in CONVS})


def _joined(graph: GraphWriter, node: Up | Concat, values: dict[str, Tensor]) -> Tensor:
    """The nodes that are the same in every precision."""
    if isinstance(node, Concat):
        return graph.concat(node.name, [values[s] for s in node.sources], 3)
    return graph.resize_nearest(node.name, values[node.source], 2)


def build_graph(network: Int8Nfru, rows: int, columns: int) -> GraphWriter:
    """The .tosa graph at this size, even sides. ReLU is the lower end of the codes."""
    graph = GraphWriter()
    values = {"input": graph.input("input", (1, rows, columns, CHANNELS))}
    for node in NODES:
        if not isinstance(node, Conv):
            values[node.name] = _joined(graph, node, values)
        else:
            layer = network.layers[node.name]
            x = graph.conv2d(f"{node.name}/acc", values[node.source], layer.weight, layer.bias,
                             input_zp=layer.input_zp, pad=node.pad, stride=(node.stride, node.stride))
            values[node.name] = graph.rescale(node.name, x, layer.multiplier, layer.shift, output_zp=layer.output_zp)
    graph.output(values[OUTPUT])
    return graph


def build_real_graph(model: Nfru, rows: int, columns: int, dtype: str) -> GraphWriter:
    """The graph in FP32 or FP16, with the weights as they were trained. Errors: ValueError when there are no ranges."""
    graph, out = GraphWriter(), scales(model)[OUTPUT]
    values = {"input": precisions.real_input(graph, graph.input("input", (1, rows, columns, CHANNELS)), INPUT, dtype)}
    for node in NODES:
        if not isinstance(node, Conv):
            values[node.name] = _joined(graph, node, values)
            continue
        x = precisions.real_conv(graph, f"{node.name}/acc", values[node.source], model.convs[node.name], node.pad,
                                 (node.stride, node.stride))
        values[node.name] = (precisions.real_output(graph, OUTPUT, x, out) if node.name == OUTPUT
                             else precisions.relu(graph, node.name, x))
    graph.output(values[OUTPUT])
    return graph


def short_scales(model: Nfru) -> dict[str, precisions.Scale]:
    """Scale and zero point of every tensor of the INT16 form. Errors: ValueError when there are no ranges."""
    return {name: (scale, zero) if name in ("input", OUTPUT) else (scale * 255.0 / precisions.INT16_MAX, 0)
            for name, (scale, zero) in scales(model).items()}


def build_short_graph(model: Nfru, rows: int, columns: int) -> GraphWriter:
    """The graph with int16 activations. Errors: ValueError when there are no ranges."""
    graph, known = GraphWriter(), short_scales(model)
    x, step = precisions.short_input(graph, graph.input("input", (1, rows, columns, CHANNELS)), INPUT)
    values, steps = {"input": x}, {name: scale for name, (scale, _) in known.items()} | {"input": step}
    for node in NODES:
        if not isinstance(node, Conv):
            values[node.name] = _joined(graph, node, values)
            continue
        last = node.name == OUTPUT
        x = precisions.short_conv(graph, f"{node.name}/acc", OUTPUT if last else f"{node.name}/rescale", values[node.source],
                                  steps[node.source], model.convs[node.name], known[node.name], "INT8" if last else "INT16",
                                  node.pad, (node.stride, node.stride))
        values[node.name] = x if last else precisions.relu(graph, node.name, x)
    graph.output(values[OUTPUT])
    return graph


def tensor_scales(model: Nfru) -> dict[str, dict[str, precisions.Scale]]:
    """For quantization.json. Errors: ValueError when there are no ranges."""
    known = scales(model)
    ends = {"input": known["input"], OUTPUT: known[OUTPUT]}
    return {"int8": known, "int16": short_scales(model), "fp32": ends, "fp16": ends}


# ---- files ------------------------------------------------------------------------------------------------


def save_weights(path, model: Nfru, record: dict) -> None:
    """Weights, ranges and training record as .npz; the same model gives the same bytes."""
    training.save_model(path, model, {**record, "normalized": model.normalized})


def load_model(path) -> tuple[Nfru, dict]:
    """Model and record from a .npz or an own checkpoint (a pickle). Errors: ValueError, OSError."""
    return training.load_model(path, "an NFRU", lambda record: Nfru(record["normalized"]), float)
