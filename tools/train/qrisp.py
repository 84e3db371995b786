"""The QRISP networks from one description: float, quantization-aware, exact INT8, and .tosa.

`convs(size, scale)` lists F: a first convolution, m between, and three heads on the same features that are together the
paper's last convolution: alpha (sigmoid, s^2 channels), candidate (3 s^2), feature (s^2). `Qrisp` runs it in float
on `[n, 6 + 4 s^2, h, w]` in 0..1; with ranges (`calibrated`) it fakes the INT8 arithmetic with straight-through
gradients. `Int8Qrisp` is the integer network, bit for bit what TOSA defines; `build_graph` writes it.

Conditioning: weights and biases of the first convolution and of the heads depend on the jitter of the frame. They are
base + start(j) + sum of code_r(j) * basis_r; code is a perceptron 2-64-64-8 that is gone after training: `conv_at`
gives the numbers for a jitter, and a weight set is those of one offset of the sequence. start(j) is fixed: the
candidate begins as bilinear enlargement of the samples where they lie, alpha as their share by distance. A network that
`corrects` leaves that enlargement to the post pass, which has it in float, and its candidate is what is added to it.

Quantization: input and warped history 1/255, zero point -128; ReLU results zero point -128, one range per tensor that
all sets share, so that one requantization fits all; weights symmetric per output channel and set, [-127, 127];
alpha by a table, scale 1/254, zero point -127; candidate and feature saturate in 0..1, each a tensor with a
quantization of its own; a correction in -128/255..127/255, zero point 0.
Source: network notes, sections 2.2 to 2.5. Ours: the small perceptron in place of 7 layers of 2048, the start, the
heads as three tensors, the saturation in place of a linear candidate and feature, the correction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

import nss
import precisions
import quantize
import training
from tosa_writer import GraphWriter

#: Features and convolutions between the first and the last, by the paper's letter.
SIZES = {"s": (16, 1), "m": (32, 3), "l": (64, 5)}
SCALES = (2, 3, 4)
HEADS = ("alpha", "candidate", "feature")
#: Kernels that the perceptron mixes, and its hidden width.
RANK, HIDDEN = 8, 64
INPUT_SCALE = (1.0 / 255.0, -128)
ALPHA_SCALE, UNIT_SCALE, CORRECTION_SCALE = (1.0 / 254.0, -127), (1.0 / 255.0, -128), (1.0 / 255.0, 0)
#: Render size whose output has 1920x1080 pixels, (rows, columns), is that of the .tosa files: 1080 / s, 1920 / s.
OUTPUT = (1080, 1920)
#: Share of a sample in the output pixel that it lies on, before training, and what distance takes off.
START_SHARE, START_FALL, START_LEAST = 0.25, 0.4, 0.03

Jitter = tuple[float, float]


@dataclass(frozen=True)
class Conv:
    """3x3, pad 1, bias; act: relu, sigmoid or unit (saturates in 0..1). conditioned: depends on the jitter."""

    name: str
    source: str
    inputs: int
    outputs: int
    act: str
    conditioned: bool


def input_channels(scale: int) -> int:
    """Colour 3, nearness 1, jitter 2, warped colour 3 s^2, warped feature s^2."""
    return 6 + 4 * scale**2


def output_scales(corrects: bool) -> dict[str, precisions.Scale]:
    """What the codes of the heads mean."""
    return {"alpha": ALPHA_SCALE, "candidate": CORRECTION_SCALE if corrects else UNIT_SCALE, "feature": UNIT_SCALE}


def convs(size: str, scale: int) -> list[Conv]:
    """F in execution order."""
    features, between = SIZES[size]
    phases = scale**2
    graph = [Conv("first", "input", input_channels(scale), features, "relu", True)]
    for i in range(between):
        graph.append(Conv(f"middle{i}", graph[-1].name, features, features, "relu", False))
    last = graph[-1].name
    acts = {"alpha": ("sigmoid", phases), "candidate": ("unit", 3 * phases), "feature": ("unit", phases)}
    return graph + [Conv(name, last, features, count, act, True) for name, (act, count) in acts.items()]


def parameters(size: str, scale: int) -> int:
    """Weights and biases of one weight set."""
    return sum((9 * c.inputs + 1) * c.outputs for c in convs(size, scale))


def macs_per_pixel(size: str, scale: int) -> int:
    """Multiply-accumulates per render pixel, border taps included."""
    return sum(9 * c.inputs * c.outputs for c in convs(size, scale))


def jitter_sequence(count: int) -> list[Jitter]:
    """The first offsets of Halton(2, 3), from index 1 on, on a grid of eighths: those of the scene renderer."""

    def halton(index: int, base: int) -> float:
        value, part = 0.0, 1.0
        while index > 0:
            part /= base
            value += part * (index % base)
            index //= base
        return (math.floor(8 * value) + 0.5) / 8 - 0.5

    return [(halton(i, 2), halton(i, 3)) for i in range(1, count + 1)]


def nearest(offsets: list[Jitter], jitter: Jitter) -> int:
    """The set that a frame takes: the first of the nearest offsets."""
    away = [(jitter[0] - x) ** 2 + (jitter[1] - y) ** 2 for x, y in offsets]
    return away.index(min(away))


# ---- float and quantization-aware -------------------------------------------------------------------------


class _Saturated(torch.autograd.Function):
    """Saturates in the range of int8 codes, in their steps if asked; the gradient passes, so that nothing stays stuck outside."""

    @staticmethod
    def forward(ctx, x, scale, stepped):
        step, zero = scale
        x = x.clamp(step * (-128 - zero), step * (127 - zero))
        return torch.floor(x / step + 0.5) * step if stepped else x

    @staticmethod
    def backward(ctx, gradient):
        return gradient, None, None


class Qrisp(nn.Module):
    """Float network. conditioned: whether the weights depend on the jitter; ranges: tensor -> (low, high), empty while
    training in float; half: whether all but the heads run in bfloat16; corrects: whether the candidate is a correction."""

    def __init__(self, size: str, scale: int, conditioned: bool = True, corrects: bool = False):
        super().__init__()
        self.size, self.scale, self.conditioned, self.corrects = size, scale, conditioned, corrects
        self.outputs = output_scales(corrects)
        self.nodes = convs(size, scale)
        self.convs = nn.ModuleDict({c.name: nn.Conv2d(c.inputs, c.outputs, 3, padding=1) for c in self.nodes})
        self.code = nn.Sequential(nn.Linear(2, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU(),
                                  nn.Linear(HIDDEN, RANK))
        self.basis = nn.ParameterDict()
        for c in self.nodes:
            if c.conditioned and conditioned:
                self.basis[f"{c.name}_weight"] = nn.Parameter(torch.empty(RANK, c.outputs, c.inputs, 3, 3))
                self.basis[f"{c.name}_bias"] = nn.Parameter(torch.zeros(RANK, c.outputs))
        self.ranges: dict[str, tuple[float, float]] = {}
        self.observed: dict[str, list[tuple[float, float]]] | None = None
        self.half = False
        _initialise(self)

    def correct_nothing(self) -> None:
        """The candidate becomes 0 in every frame."""
        with torch.no_grad():
            for name, kernel in [*self.convs["candidate"].named_parameters(), *self.basis.items()]:
                if name in ("weight", "bias") or name.startswith("candidate_"):
                    kernel.zero_()

    def weights_at(self, name: str, jitter: Jitter) -> tuple[torch.Tensor, torch.Tensor]:
        """Weight and bias of a convolution in a frame with this jitter."""
        conv = self.convs[name]
        weight, bias = conv.weight, conv.bias
        if name in HEADS:
            start = _start(self, name, jitter if self.conditioned else (0.0, 0.0))
            weight, bias = weight + start[0], bias + start[1]
        if f"{name}_weight" not in self.basis:
            return weight, bias
        code = self.code(weight.new_tensor([jitter]) * 2.0)[0]
        return (weight + torch.einsum("r,roiuv->oiuv", code, self.basis[f"{name}_weight"]),
                bias + code @ self.basis[f"{name}_bias"])

    def conv_at(self, name: str, jitter: Jitter) -> SimpleNamespace:
        """The same without a gradient, with the members of a convolution."""
        weight, bias = self.weights_at(name, jitter)
        return SimpleNamespace(weight=weight.detach(), bias=bias.detach())

    def forward(self, x: torch.Tensor, jitter: Jitter) -> dict[str, torch.Tensor]:
        """Heads by name, at input size: in 0..1, a correction in -128/255..127/255."""
        fake = bool(self.ranges)
        if fake:
            x = torch.fake_quantize_per_tensor_affine(x, *INPUT_SCALE, -128, 127)
        values = {"input": x}
        for node in self.nodes:
            weight, bias = self.weights_at(node.name, jitter)
            if fake:
                step = (weight.detach().abs().amax(dim=(1, 2, 3)) / 127.0).clamp(min=1e-9)
                weight = torch.fake_quantize_per_channel_affine(weight, step, torch.zeros_like(step, dtype=torch.int32),
                                                                0, -127, 127)
            y = training.convolve(values[node.source], weight, bias, self.half and node.name not in HEADS)
            if node.act == "unit":
                y = _Saturated.apply(y, self.outputs[node.name], fake)
            elif fake:
                y = self._faked(node, y)
            else:
                y = F.relu(y) if node.act == "relu" else y
                self._observe(node.name, y)
                y = torch.sigmoid(y) if node.act == "sigmoid" else y
            values[node.name] = y
        return {name: values[name] for name in HEADS}

    def _faked(self, node: Conv, y: torch.Tensor) -> torch.Tensor:
        if node.act == "relu":
            return torch.fake_quantize_per_tensor_affine(y, self.ranges[node.name][1] / 255.0, -128, -128, 127)
        scale, zero = nss.logit_parameters(*self.ranges[node.name])
        y = torch.sigmoid(torch.fake_quantize_per_tensor_affine(y, scale, zero, -128, 127))
        return torch.fake_quantize_per_tensor_affine(y, *ALPHA_SCALE, -127, 127)

    def _observe(self, name: str, y: torch.Tensor) -> None:
        if self.observed is not None:
            values = y.detach().flatten()
            values = values[:: max(1, values.numel() // 100_000)]
            rest = max(1, int(values.numel() * (1.0 - nss.COVERED)))
            self.observed.setdefault(name, []).append(
                (float(values.kthvalue(rest).values), float(values.kthvalue(values.numel() + 1 - rest).values)))

    def calibrated(self) -> None:
        """Fixes the ranges from what `observed` collected. Errors: ValueError when nothing was.

        They hold the brightest sequence: colours go through every layer, so that a range of a mean sequence would clip what is
        bright.
        """
        if not self.observed:
            raise ValueError("no activations were observed")
        self.ranges = {name: (min(low for low, _ in seen), max(*(high for _, high in seen), 1e-3))
                       for name, seen in self.observed.items()}
        self.observed = None


def _start(model: Qrisp, name: str, jitter: Jitter):
    """What the heads begin with: weight `[o, features, 3, 3]` and bias `[o]`, or 0.

    Phase p of s lies (p + 0.5) / s - 0.5 from the middle of its render pixel, the pixel's sample at its jitter. The
    samples' colours arrive as features 0 to 2.
    """
    s = model.scale
    away = [[(p + 0.5) / s - 0.5 - j for p in range(s)] for j in jitter]  # x, y
    conv = model.convs[name]
    if name == "feature" or (name == "candidate" and model.corrects):
        return 0.0, 0.0
    if name == "alpha":
        near = [[d - math.floor(d + 0.5) for d in axis] for axis in away]
        share = conv.weight.new_tensor([[START_SHARE - START_FALL * (x * x + y * y) for x in near[0]] for y in near[1]])
        return 0.0, torch.logit(share.clamp(min=START_LEAST)).reshape(-1)
    tent = conv.weight.new_tensor([[[max(0.0, 1.0 - abs(d - tap)) for tap in (-1, 0, 1)] for d in axis]
                                   for axis in away])
    taps = torch.einsum("yv,xu->yxvu", tent[1], tent[0]).reshape(s * s, 3, 3)
    weight = torch.zeros_like(conv.weight)
    for c in range(3):
        weight[c * s * s : (c + 1) * s * s, c] = taps
    return weight, 0.0


def _initialise(model: Qrisp) -> None:
    """He weights, small at the heads; features 0 to 2 carry the colour from the input to the heads."""
    with torch.no_grad():
        for node in model.nodes:
            conv = model.convs[node.name]
            nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
            conv.bias.zero_()
            if node.name in HEADS:
                conv.weight.mul_(0.05)
            else:
                conv.weight[:3].zero_()
                for c in range(3):
                    conv.weight[c, c, 1, 1] = 1.0
            if node.name == "feature":
                conv.bias.fill_(0.5)
        for name, kernel in model.basis.items():
            if name.endswith("_weight"):
                nn.init.normal_(kernel, std=0.05 / math.sqrt(9 * kernel.shape[2]))


# ---- exact INT8 -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Int8Qrisp:
    """Integer network: of each set the layers by name, and the table of alpha. The layers between are the same."""

    size: str
    scale: int
    offsets: list[Jitter]
    sets: list[dict[str, quantize.Layer]]
    table: np.ndarray

    def run(self, codes: torch.Tensor, which: int) -> dict[str, torch.Tensor]:
        """int8 `[n, h, w, c]` to int8 NHWC heads by name, by a set."""
        values = {"input": codes.permute(0, 3, 1, 2).float()}
        for node in convs(self.size, self.scale):
            y = nss.convolve_exactly(self.sets[which][node.name], values[node.source])
            values[node.name] = torch.from_numpy(self.table.astype(np.float32))[y.long() + 128] \
                if node.act == "sigmoid" else y
        return {name: values[name].to(torch.int8).permute(0, 2, 3, 1).contiguous() for name in HEADS}


def to_int8(model: Qrisp, offsets: list[Jitter]) -> Int8Qrisp:
    """Quantizes a weight set per offset. Errors: ValueError without ranges or when a factor cannot be rescaled."""
    scales, sets = code_scales(model), []
    for offset in offsets if model.conditioned else [(0.0, 0.0)]:
        layers = {}
        for node in model.nodes:
            own = scales[f"{node.name}/logit" if node.act == "sigmoid" else node.name]
            layers[node.name] = sets[0][node.name] if sets and not node.conditioned else quantize._layer(
                node.name, model.conv_at(node.name, offset), scales[node.source][0], *own, node.act == "relu")
        sets.append(layers)
    return Int8Qrisp(model.size, model.scale, list(offsets), sets, nss.sigmoid_table(*scales["alpha/logit"]))


def build_graph(network: Int8Qrisp, which: int, rows: int, columns: int) -> GraphWriter:
    """The .tosa graph of a set at this network size."""
    graph = GraphWriter()
    values = {"input": graph.input("input", (1, rows, columns, input_channels(network.scale)))}
    for node in convs(network.size, network.scale):
        layer = network.sets[which][node.name]
        x = graph.conv2d(f"{node.name}/acc", values[node.source], layer.weight, layer.bias, input_zp=layer.input_zp,
                         pad=(1, 1, 1, 1))
        name = f"{node.name}/logit" if node.act == "sigmoid" else node.name
        x = graph.rescale(name, x, layer.multiplier, layer.shift, output_zp=layer.output_zp)
        values[node.name] = graph.table(node.name, x, network.table) if node.act == "sigmoid" else x
    for name in HEADS:
        graph.output(values[name])
    return graph


# ---- float and INT16 ---------------------------------------------------------------------------------------


def build_real_graph(model: Qrisp, offset: Jitter, rows: int, columns: int, dtype: str) -> GraphWriter:
    """The graph of a set in FP32 or FP16, with the weights as they were trained."""
    graph = GraphWriter()
    codes = graph.input("input", (1, rows, columns, input_channels(model.scale)))
    values = {"input": precisions.real_input(graph, codes, INPUT_SCALE, dtype)}
    for node in model.nodes:
        suffix = "logit" if node.act == "sigmoid" else "acc"
        x = precisions.real_conv(graph, f"{node.name}/{suffix}", values[node.source],
                                 model.conv_at(node.name, offset), (1, 1, 1, 1))
        if node.act == "relu":
            values[node.name] = precisions.relu(graph, node.name, x)
            continue
        x = graph.sigmoid(f"{node.name}/real", x) if node.act == "sigmoid" else x
        values[node.name] = precisions.real_output(graph, node.name, x, model.outputs[node.name])
    for name in HEADS:
        graph.output(values[name])
    return graph


def build_short_graph(model: Qrisp, offset: Jitter, rows: int, columns: int) -> GraphWriter:
    """The graph of a set with int16 activations. Errors: ValueError when there are no ranges."""
    graph, scales = GraphWriter(), short_scales(model)
    codes = graph.input("input", (1, rows, columns, input_channels(model.scale)))
    x, scale = precisions.short_input(graph, codes, INPUT_SCALE)
    values, steps = {"input": x}, {name: s for name, (s, _) in scales.items()} | {"input": scale}
    for node in model.nodes:
        result = f"{node.name}/logit" if node.act == "sigmoid" else node.name
        x = precisions.short_conv(
            graph, f"{node.name}/acc", f"{node.name}/rescale" if node.act == "relu" else result, values[node.source],
            steps[node.source], model.conv_at(node.name, offset), scales[result],
            "INT8" if node.act == "unit" else "INT16", (1, 1, 1, 1))
        if node.act == "relu":
            x = precisions.relu(graph, node.name, x)
        elif node.act == "sigmoid":
            x = precisions.short_sigmoid(graph, node.name, x, nss.SHORT_LOGIT_SCALE, ALPHA_SCALE)
        values[node.name] = x
    for name in HEADS:
        graph.output(values[name])
    return graph


def code_scales(model: Qrisp) -> dict[str, precisions.Scale]:
    """Scale and zero point of every tensor of the INT8 form. Errors: ValueError when there are no ranges."""
    if not model.ranges:
        raise ValueError("the model has no activation ranges yet")
    scales = {"input": INPUT_SCALE, **model.outputs}
    for node in model.nodes:
        if node.act == "relu":
            scales[node.name] = (model.ranges[node.name][1] / 255.0, -128)
        elif node.act == "sigmoid":
            scales[f"{node.name}/logit"] = nss.logit_parameters(*model.ranges[node.name])
    return scales


def short_scales(model: Qrisp) -> dict[str, precisions.Scale]:
    """The same of the INT16 form."""
    return {name: (nss.SHORT_LOGIT_SCALE, 0) if name.endswith("/logit") else
            (scale if name == "input" or name in HEADS else (model.ranges[name][1] / precisions.INT16_MAX, 0))
            for name, scale in code_scales(model).items()}


def tensor_scales(model: Qrisp) -> dict[str, dict[str, precisions.Scale]]:
    """For quantization.json."""
    ends = {"input": INPUT_SCALE, **model.outputs}
    return {"int8": code_scales(model), "int16": short_scales(model), "fp32": ends, "fp16": ends}


# ---- files ------------------------------------------------------------------------------------------------


def describe(model: Qrisp) -> dict:
    """What a record holds to make the network again."""
    return {"size": model.size, "scale": model.scale, "conditioned": model.conditioned,
            **({"corrects": True} if model.corrects else {})}


def save_weights(path, model: Qrisp, record: dict) -> None:
    """Weights, ranges and training record as .npz; the same model gives the same bytes."""
    training.save_model(path, model, {**record, **describe(model)})


def load_model(path) -> tuple[Qrisp, dict]:
    """Model and record from a .npz or an own checkpoint (a pickle). Errors: ValueError, OSError."""

    def make(record: dict) -> Qrisp:
        return Qrisp(record["size"], record["scale"], record["conditioned"], record.get("corrects", False))

    return training.load_model(path, "a QRISP", make, lambda r: (float(r[0]), float(r[1])))
