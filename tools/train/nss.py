"""The NSS networks from one description: float, quantization-aware, exact INT8, and .tosa.

`nodes(mode)` lists the graph of section 1 of the NSS notes in order. `Nss` runs it in float on `[n, 12, h, w]` in
0..1, h and w multiples of 8; with ranges (`calibrated`), it fakes the INT8 arithmetic with straight-through gradients.
`Int8Nss` is the integer network, bit for bit what TOSA defines; `build_graph` writes it with these numbers.

Quantization: input scale 1/255, zero point -128; weights symmetric per output channel, [-127, 127]; ReLU results
zero point -128 with one range per tensor, shared by the inputs of a CONCAT; logits with a free zero point; sigmoid
results scale 1/254, zero point -127, codes [-127, 127], by a table.
Source: NSS notes 1 to 1.4; ranges from calibration (a high quantile) instead of a moving minimum and maximum: ours.
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
from nss_passes import MODES, Mode
from tosa_writer import GraphWriter

INPUT_CHANNELS = 12
PARAMETERS = {"v1_high": 148456, "v1_low": 142676, "v0_1": 131720}
#: Stored size of the .tosa files: the network input of a 960x540 picture, (rows, columns).
STORED = {"v1_high": (544, 960), "v1_low": (272, 480), "v0_1": (544, 960)}
#: Share of a tensor's values that its range covers.
COVERED = 0.9999
#: Logits beyond this reach change no output code.
LOGIT_REACH = 6.5


@dataclass(frozen=True)
class Conv:
    """3x3, pad 1, bias; relu or sigmoid."""

    name: str
    source: str
    inputs: int
    outputs: int
    stride: int = 1
    sigmoid: bool = False


@dataclass(frozen=True)
class Up:
    """Every texel twice in both axes."""

    name: str
    source: str


@dataclass(frozen=True)
class Concat:
    """Channels one after the other."""

    name: str
    sources: tuple[str, ...]


def nodes(mode: Mode) -> list[Conv | Up | Concat]:
    """The graph in execution order."""
    v1 = mode.generation == 1
    wide = 32 if v1 else 16
    graph: list[Conv | Up | Concat] = [
        Conv("conv0", "input", INPUT_CHANNELS, 32, 2), Conv("conv1", "conv0", 32, 32),
        Conv("conv2", "conv1", 32, 32, 2), Conv("conv3", "conv2", 32, 32),
        Conv("conv4", "conv3", 32, 64, 2), Conv("conv5", "conv4", 64, 64), Conv("conv6", "conv5", 64, 32),
        Up("up0", "conv6"), Conv("conv7", "up0", 32, 16), Concat("concat0", ("conv7", "conv3")),
        Conv("conv8", "concat0", 48, wide),
    ]
    if v1:
        graph.append(Conv("kernel", "conv8", 32, mode.kernel**2, sigmoid=True))
    graph += [
        Up("up1", "conv8"), Conv("conv9", "up1", wide, 16), Concat("concat1", ("conv9", "conv1")),
        Conv("conv10", "concat1", 48, 16), Conv("conv11", "conv10", 16, 16), Up("up2", "conv11"),
    ]
    return graph + [Conv(name, "up2", 16, 4, sigmoid=True) for name in outputs(mode) if name != "kernel"]


def outputs(mode: Mode) -> list[str]:
    """Graph outputs in order."""
    return ["temporal", "kernel"] if mode.generation else ["k0", "k1", "k2", "k3", "temporal", "feedback"]


def sizes(mode: Mode, rows: int, columns: int) -> dict[str, tuple[int, int, int]]:
    """(rows, columns, channels) of every tensor."""
    out = {"input": (rows, columns, INPUT_CHANNELS)}
    for node in nodes(mode):
        if isinstance(node, Conv):
            h, w, _ = out[node.source]
            out[node.name] = (h // node.stride, w // node.stride, node.outputs)
        elif isinstance(node, Up):
            h, w, c = out[node.source]
            out[node.name] = (2 * h, 2 * w, c)
        else:
            h, w, _ = out[node.sources[0]]
            out[node.name] = (h, w, sum(out[s][2] for s in node.sources))
    return out


def macs(mode: Mode, rows: int, columns: int) -> dict[str, int]:
    """Multiply-accumulates of every convolution, border taps included."""
    shape = sizes(mode, rows, columns)
    return {n.name: shape[n.name][0] * shape[n.name][1] * 9 * n.inputs * n.outputs
            for n in nodes(mode) if isinstance(n, Conv)}


def range_groups(mode: Mode) -> dict[str, str]:
    """ReLU tensor -> tensor whose range it shares (both inputs of a CONCAT)."""
    groups = {n.name: n.name for n in nodes(mode) if isinstance(n, Conv) and not n.sigmoid}
    for node in nodes(mode):
        if isinstance(node, Concat):
            groups[node.sources[0]] = groups[node.sources[1]]
    return groups


# ---- float and quantization-aware -------------------------------------------------------------------------


class Nss(nn.Module):
    """Float network. ranges: tensor -> (low, high), empty while training in float."""

    def __init__(self, mode: Mode):
        super().__init__()
        self.mode = mode
        self.nodes = nodes(mode)
        self.convs = nn.ModuleDict({
            n.name: nn.Conv2d(n.inputs, n.outputs, 3, stride=n.stride, padding=1)
            for n in self.nodes if isinstance(n, Conv)
        })
        self.ranges: dict[str, tuple[float, float]] = {}
        self.observed: dict[str, list[tuple[float, float]]] | None = None
        self.heads = [n.name for n in self.nodes if isinstance(n, Conv) and n.source == "up2"]
        self.register_buffer("phases", srpo_phase_map(), persistent=False)
        _initialise(self)

    def _weight(self, name: str) -> torch.Tensor:
        weight = self.convs[name].weight
        if not self.ranges:
            return weight
        scale = (weight.detach().abs().amax(dim=(1, 2, 3)) / 127.0).clamp(min=1e-9)
        zero = torch.zeros(len(scale), dtype=torch.int32, device=weight.device)
        return torch.fake_quantize_per_channel_affine(weight, scale, zero, 0, -127, 127)

    def _relu(self, name: str, x: torch.Tensor) -> torch.Tensor:
        if self.ranges:
            scale = self.ranges[name][1] / 255.0
            return torch.fake_quantize_per_tensor_affine(x, scale, -128, -128, 127)
        x = F.relu(x, inplace=True)
        self._observe(name, x)
        return x

    def _sigmoid(self, name: str, x: torch.Tensor) -> torch.Tensor:
        self._observe(name, x)
        if not self.ranges:
            return torch.sigmoid(x)
        scale, zero = logit_parameters(*self.ranges[name])
        x = torch.sigmoid(torch.fake_quantize_per_tensor_affine(x, scale, zero, -128, 127))
        return torch.fake_quantize_per_tensor_affine(x, 1.0 / 254.0, -127, -127, 127)

    def _observe(self, name: str, x: torch.Tensor) -> None:
        if self.observed is not None:
            values = x.detach().flatten()
            values = values[:: max(1, values.numel() // 200_000)]
            rest = max(1, int(values.numel() * (1.0 - COVERED)))
            self.observed.setdefault(name, []).append(
                (float(values.kthvalue(rest).values), float(values.kthvalue(values.numel() + 1 - rest).values)))

    def forward(self, x: torch.Tensor) -> dict[str, torch.Tensor]:
        """Outputs by name in 0..1; v0_1: k0 to k3 are joined as "kernel"."""
        if self.ranges:
            x = torch.fake_quantize_per_tensor_affine(x, 1.0 / 255.0, -128, -128, 127)
        values = {"input": x.contiguous(memory_format=torch.channels_last)}
        for node in self.nodes:
            if isinstance(node, Concat):
                values[node.name] = torch.cat([values[s] for s in node.sources], 1)
            elif isinstance(node, Up):
                if node.name != "up2":
                    values[node.name] = F.interpolate(values[node.source], scale_factor=2, mode="nearest")
            elif node.source != "up2":
                conv = self.convs[node.name]
                y = F.conv2d(values[node.source], self._weight(node.name), conv.bias, node.stride, 1)
                values[node.name] = (self._sigmoid if node.sigmoid else self._relu)(node.name, y)
        values.update(self._heads(values["conv11"]))
        if self.mode.generation == 0:
            values["kernel"] = torch.cat([values[f"k{i}"] for i in range(4)], 1)
        return {name: values[name] for name in ("kernel", "temporal", "feedback") if name in values}

    def _heads(self, x: torch.Tensor) -> dict[str, torch.Tensor]:
        """All full-resolution heads: resize by 2 and 3x3 is one 3x3 filter per phase (see srpo.py)."""
        weight = torch.cat([self._weight(name) for name in self.heads])
        bias = torch.cat([self.convs[name].bias for name in self.heads])
        m = self.phases
        taps = torch.einsum("puk,qvl,oikl->opqiuv", m, m, weight).reshape(-1, weight.shape[1], 3, 3)
        y = F.pixel_shuffle(F.conv2d(x, taps, bias.repeat_interleave(4), padding=1).contiguous(), 2)
        return {name: self._sigmoid(name, part) for name, part in zip(self.heads, y.split(4, 1))}

    def calibrated(self) -> None:
        """Fixes the ranges from what `observed` collected. Errors: ValueError when nothing was."""
        if not self.observed:
            raise ValueError("no activations were observed")
        groups, ranges = range_groups(self.mode), {}
        for node in self.nodes:
            if isinstance(node, Conv):
                seen = np.array(self.observed[node.name])
                ranges[node.name] = (float(seen[:, 0].mean()), float(max(seen[:, 1].mean(), 1e-3)))
        for name, leader in groups.items():
            if name != leader:
                both = max(ranges[name][1], ranges[leader][1])
                ranges[name] = ranges[leader] = (0.0, both)
        self.ranges, self.observed = ranges, None


def srpo_phase_map() -> torch.Tensor:
    """`[2, 3, 3]`: tap k of phase p falls on low-resolution neighbour u - 1 where the entry is 1."""
    out = torch.zeros(2, 3, 3)
    for phase in range(2):
        for tap in range(3):
            out[phase, (phase + tap - 1) // 2 + 1, tap] = 1.0
    return out


def logit_parameters(low: float, high: float) -> tuple[float, int]:
    """Scale and zero point of a logit tensor."""
    low, high = max(min(low, -1.0), -LOGIT_REACH), min(max(high, 1.0), LOGIT_REACH)
    scale = (high - low) / 255.0
    return scale, int(np.clip(math.floor(-128 - low / scale + 0.5), -128, 127))


def _initialise(model: Nss) -> None:
    """He weights; heads start as a plain temporal accumulator with a Gaussian kernel."""
    k, first = model.mode.kernel, model.mode.first
    offsets = torch.arange(k, dtype=torch.float32) + first
    kernel = torch.exp(-(offsets[:, None] ** 2 + offsets[None, :] ** 2) / (2 * 0.9**2)) * 0.8 + 0.01
    kernel = torch.logit(kernel).t().reshape(-1)  # channel = dy + K * dx, symmetric anyway
    start = {"temporal": torch.tensor([1.1, -0.3, 0.0, 0.0]), "kernel": kernel, "feedback": torch.zeros(4)}
    if model.mode.generation == 0:
        start["temporal"] = torch.tensor([2.0, -0.3, 0.0, 0.0])
    start.update({f"k{i}": kernel[4 * i : 4 * i + 4] for i in range(4)} if k == 4 else {})
    with torch.no_grad():
        for name, conv in model.convs.items():
            nn.init.kaiming_normal_(conv.weight, nonlinearity="relu")
            conv.bias.zero_()
            if name in start:
                conv.weight.mul_(0.2)
                conv.bias.copy_(start[name])


def central_kernel(weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """v1_high weights for v1_low: the offsets -1..2 of the 6x6 kernel -2..3."""
    channels = [(dy + 2) + 6 * (dx + 2) for dx in range(-1, 3) for dy in range(-1, 3)]
    out = dict(weights)
    for part in ("weight", "bias"):
        out[f"convs.kernel.{part}"] = weights[f"convs.kernel.{part}"][channels]
    return out


def shared_layers(model: Nss, weights: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """The model's own weights, replaced by those of the same name and shape."""
    own = model.state_dict()
    return {name: weights[name] if name in weights and weights[name].shape == value.shape else value
            for name, value in own.items()}


# ---- exact INT8 -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Int8Nss:
    """Integer network: `layers` by name; `tables` for sigmoid heads."""

    mode: Mode
    layers: dict[str, quantize.Layer]
    tables: dict[str, np.ndarray]

    def run(self, codes: torch.Tensor) -> dict[str, torch.Tensor]:
        """int8 `[n, h, w, 12]` to int8 NHWC outputs by name."""
        values = {"input": codes.permute(0, 3, 1, 2).float()}
        for node in nodes(self.mode):
            if isinstance(node, Concat):
                values[node.name] = torch.cat([values[s] for s in node.sources], 1)
            elif isinstance(node, Up):
                values[node.name] = F.interpolate(values[node.source], scale_factor=2, mode="nearest")
            else:
                values[node.name] = self._convolve(node, values[node.source])
        return {name: values[name].to(torch.int8).permute(0, 2, 3, 1).contiguous() for name in outputs(self.mode)}

    def _convolve(self, node: Conv, x: torch.Tensor) -> torch.Tensor:
        out = convolve_exactly(self.layers[node.name], x, node.stride)
        if node.name in self.tables:
            return torch.from_numpy(self.tables[node.name].astype(np.float32))[out.long() + 128]
        return out


def convolve_exactly(layer: quantize.Layer, x: torch.Tensor, stride: int = 1, padding: int = 1) -> torch.Tensor:
    """int8 codes as floats `[n, c, h, w]` through CONV2D, RESCALE and CLAMP, to codes as floats."""
    # Sums of integers: exact in float32 below 2^24, in float64 below 2^53.
    bound = int((np.abs(layer.weight).reshape(len(layer.bias), -1).sum(1) * 255).max())
    kind = torch.float32 if bound < 2**24 else torch.float64
    weight = torch.from_numpy(layer.weight.transpose(0, 3, 1, 2).copy()).to(kind)
    total = F.conv2d((x - layer.input_zp).to(kind), weight, None, stride, padding).long()

    def channels(values: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(values, np.int64)).view(1, -1, 1, 1)

    shift = channels(layer.shift)
    total = (total + channels(layer.bias)) * channels(layer.multiplier) + (torch.ones_like(shift) << (shift - 1))
    return ((total >> shift) + layer.output_zp).clamp(-128, 127).float()


def sigmoid_table(scale: float, zero: int) -> np.ndarray:
    """Entry q + 128 of the TABLE operator: clamp(round(254 sigmoid((q - zp) s)) - 127, -127, 127)."""
    q = np.arange(-128, 128, dtype=float)
    y = np.floor(254.0 / (1.0 + np.exp(-(q - zero) * scale)) + 0.5) - 127
    return np.clip(y, -127, 127).astype(np.int64)


def to_int8(model: Nss) -> Int8Nss:
    """Quantizes with the model's ranges. Errors: ValueError when it has none or a factor cannot be rescaled."""
    if not model.ranges:
        raise ValueError("the model has no activation ranges yet")
    scales = {"input": 1.0 / 255.0}
    layers, tables = {}, {}
    for node in model.nodes:
        if isinstance(node, Up):
            scales[node.name] = scales[node.source]
        elif isinstance(node, Concat):
            scales[node.name] = scales[node.sources[0]]
        else:
            zero = -128
            if node.sigmoid:
                scales[node.name], zero = logit_parameters(*model.ranges[node.name])
                tables[node.name] = sigmoid_table(scales[node.name], zero)
            else:
                scales[node.name] = model.ranges[node.name][1] / 255.0
            layers[node.name] = quantize._layer(node.name, model.convs[node.name], scales[node.source],
                                                scales[node.name], zero, not node.sigmoid)
    return Int8Nss(model.mode, layers, tables)


def build_graph(network: Int8Nss, rows: int, columns: int) -> GraphWriter:
    """The .tosa graph at this network size."""
    graph = GraphWriter()
    values = {"input": graph.input("input", (1, rows, columns, INPUT_CHANNELS))}
    for node in nodes(network.mode):
        if isinstance(node, Concat):
            values[node.name] = graph.concat(node.name, [values[s] for s in node.sources], 3)
        elif isinstance(node, Up):
            values[node.name] = graph.resize_nearest(node.name, values[node.source], 2)
        else:
            layer = network.layers[node.name]
            pad = (1, 0, 1, 0) if node.stride == 2 else (1, 1, 1, 1)
            x = graph.conv2d(f"{node.name}/acc", values[node.source], layer.weight, layer.bias,
                             input_zp=layer.input_zp, pad=pad, stride=(node.stride, node.stride))
            name = f"{node.name}/logit" if node.sigmoid else node.name
            x = graph.rescale(name, x, layer.multiplier, layer.shift, output_zp=layer.output_zp)
            values[node.name] = graph.table(node.name, x, network.tables[node.name]) if node.sigmoid else x
    for name in outputs(network.mode):
        graph.output(values[name])
    return graph


# ---- float and INT16 ---------------------------------------------------------------------------------------

INPUT_SCALE = (1.0 / 255.0, -128)
OUTPUT_SCALE = (1.0 / 254.0, -127)
#: Logits of int16 codes: a power of two beyond LOGIT_REACH.
SHORT_LOGIT_SCALE = 8.0 / 32768.0


def _pad(node: Conv) -> tuple[int, int, int, int]:
    return (1, 0, 1, 0) if node.stride == 2 else (1, 1, 1, 1)


def build_real_graph(model: Nss, rows: int, columns: int, dtype: str) -> GraphWriter:
    """The graph in FP32 or FP16, with the weights as they were trained."""
    graph = GraphWriter()
    codes = graph.input("input", (1, rows, columns, INPUT_CHANNELS))
    values = {"input": precisions.real_input(graph, codes, INPUT_SCALE, dtype)}
    for node in model.nodes:
        if isinstance(node, Concat):
            values[node.name] = graph.concat(node.name, [values[s] for s in node.sources], 3)
        elif isinstance(node, Up):
            values[node.name] = graph.resize_nearest(node.name, values[node.source], 2)
        else:
            name = f"{node.name}/logit" if node.sigmoid else f"{node.name}/acc"
            x = precisions.real_conv(graph, name, values[node.source], model.convs[node.name], _pad(node),
                                     (node.stride, node.stride))
            if node.sigmoid:
                x = graph.sigmoid(f"{node.name}/real", x)
                values[node.name] = precisions.real_output(graph, node.name, x, OUTPUT_SCALE)
            else:
                values[node.name] = precisions.relu(graph, node.name, x)
    for name in outputs(model.mode):
        graph.output(values[name])
    return graph


def short_scales(model: Nss) -> dict[str, precisions.Scale]:
    """Scale and zero point of every tensor of the INT16 form."""
    scales = {"input": INPUT_SCALE}
    for node in model.nodes:
        if isinstance(node, Up):
            scales[node.name] = scales[node.source]
        elif isinstance(node, Concat):
            scales[node.name] = scales[node.sources[0]]
        elif node.sigmoid:
            scales[f"{node.name}/logit"] = (SHORT_LOGIT_SCALE, 0)
            scales[node.name] = OUTPUT_SCALE
        else:
            scales[node.name] = (model.ranges[node.name][1] / precisions.INT16_MAX, 0)
    return scales


def build_short_graph(model: Nss, rows: int, columns: int) -> GraphWriter:
    """The graph with int16 activations. Errors: ValueError when there are no ranges."""
    if not model.ranges:
        raise ValueError("the model has no activation ranges yet")
    graph, scales = GraphWriter(), short_scales(model)
    codes = graph.input("input", (1, rows, columns, INPUT_CHANNELS))
    x, scale = precisions.short_input(graph, codes, INPUT_SCALE)
    values, steps = {"input": x}, {name: s for name, (s, _) in scales.items()} | {"input": scale}
    for node in model.nodes:
        if isinstance(node, Concat):
            values[node.name] = graph.concat(node.name, [values[s] for s in node.sources], 3)
        elif isinstance(node, Up):
            values[node.name] = graph.resize_nearest(node.name, values[node.source], 2)
        else:
            result = f"{node.name}/logit" if node.sigmoid else node.name
            x = precisions.short_conv(
                graph, f"{node.name}/acc", result if node.sigmoid else f"{node.name}/rescale", values[node.source],
                steps[node.source], model.convs[node.name], scales[result], "INT16", _pad(node),
                (node.stride, node.stride))
            if node.sigmoid:
                values[node.name] = precisions.short_sigmoid(graph, node.name, x, SHORT_LOGIT_SCALE, OUTPUT_SCALE)
            else:
                values[node.name] = precisions.relu(graph, node.name, x)
    for name in outputs(model.mode):
        graph.output(values[name])
    return graph


def code_scales(network: Int8Nss) -> dict[str, precisions.Scale]:
    """Scale and zero point of every tensor of the INT8 form."""
    scales = {"input": INPUT_SCALE}
    for node in nodes(network.mode):
        if isinstance(node, Up):
            scales[node.name] = scales[node.source]
        elif isinstance(node, Concat):
            scales[node.name] = scales[node.sources[0]]
        else:
            layer = network.layers[node.name]
            own = (layer.output_scale, layer.output_zp)
            scales[f"{node.name}/logit" if node.sigmoid else node.name] = own
            if node.sigmoid:
                scales[node.name] = OUTPUT_SCALE
    return scales


def tensor_scales(model: Nss, network: Int8Nss) -> dict[str, dict[str, precisions.Scale]]:
    """For quantization.json."""
    ends = {name: OUTPUT_SCALE for name in outputs(model.mode)} | {"input": INPUT_SCALE}
    return {"int8": code_scales(network), "int16": short_scales(model), "fp32": ends, "fp16": ends}


# ---- files ------------------------------------------------------------------------------------------------


def save_weights(path, model: Nss, record: dict) -> None:
    """Weights, ranges and training record as .npz; the same model gives the same bytes."""
    training.save_model(path, model, {**record, "mode": model.mode.name})


def load_model(path) -> tuple[Nss, dict]:
    """Model and record from a .npz or an own checkpoint (a pickle). Errors: ValueError, OSError."""
    return training.load_model(path, "an NSS", lambda record: Nss(MODES[record["mode"]]), lambda r: (float(r[0]), float(r[1])))


def load_average(paths: list) -> tuple[Nss, dict]:
    """The mean of networks that started from the same weights, and a record that holds theirs. One path: that network.

    Errors: ValueError, OSError.
    """
    models, records = zip(*(load_model(path) for path in paths))
    if len(models) == 1:
        return models[0], records[0]
    if len({(model.mode.name, *sorted(model.ranges)) for model in models}) > 1:
        raise ValueError(f"{paths[0]}: not the same kind of network as the others")
    states, mean = [model.state_dict() for model in models], models[0]
    mean.load_state_dict({name: sum(state[name] for state in states) / len(states) for name in states[0]})
    mean.ranges = {name: tuple(sum(model.ranges[name][end] for model in models) / len(models) for end in (0, 1))
                   for name in mean.ranges}
    return mean, {"mode": mean.mode.name, "averaged": list(records)}
