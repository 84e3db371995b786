"""The MNSS networks from one description: float, quantization-aware, exact INT8, and .tosa.

Three networks, of which two are so small that the passes around the third compute them in float32:
inpaint, conv 3x3 4->1, sigmoid, at render size (37 parameters); aa, conv 1x1 6->3, ReLU, at render size (21); and
the reconstruction rec1 to rec4, conv 3x3 3->16->32->32->3, ReLU between them, at output size (15,203), which is the graph.
Its result corrects the picture that went in: shown = clamp(input + correction).
Quantization of the graph: input scale 1/255, zero point -128, the codes of an 8-bit picture; output scale 1/255, zero point
0; weights symmetric per output channel, [-127, 127]; ReLU results zero point -128 with one range per tensor.
Source: MNSS (TVCG 2023). Its figure alone tells the channels of the reconstruction; these are those of the reading
closest to its text. A form of the inpainting net with one weight a pixel, ranges from calibration, and the correction, with
which the roundings of three tensors of 8 bits weigh on what is changed and not on the whole picture: ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

import precisions
import quantize
import training
from tosa_writer import GraphWriter

SCALES = (2, 3)
#: Stored size of the .tosa files, (rows, columns): any other follows the frame.
STORED = (64, 64)
#: Scale and zero point of the graph's input, 8-bit colour, and of its output, in the same steps.
CODES: precisions.Scale = (1.0 / 255.0, -128)
CORRECTION: precisions.Scale = (1.0 / 255.0, 0)
#: Share of a tensor's values that its range covers.
COVERED = 0.9999
#: Start of the inpainting net: the weight of the current frame without any difference, and what differences add.
START_BIAS, START_SLOPE = -2.0, 2.0


@dataclass(frozen=True)
class Conv:
    """Stride 1, zero padding to the same size, bias."""

    name: str
    kernel: int
    inputs: int
    outputs: int


INPAINT = Conv("inpaint", 3, 4, 1)
AA = Conv("aa", 1, 6, 3)
RECONSTRUCTION = (Conv("rec1", 3, 3, 16), Conv("rec2", 3, 16, 32), Conv("rec3", 3, 32, 32), Conv("rec4", 3, 32, 3))
OUTPUT = "correction"


def parameters(convs: tuple[Conv, ...] = RECONSTRUCTION) -> int:
    """Weights and biases."""
    return sum(c.kernel**2 * c.inputs * c.outputs + c.outputs for c in convs)


def macs(rows: int, columns: int, convs: tuple[Conv, ...] = RECONSTRUCTION) -> int:
    """Multiply-accumulates on pictures of this size, border taps included."""
    return rows * columns * sum(c.kernel**2 * c.inputs * c.outputs for c in convs)


def tensor_name(conv: Conv) -> str:
    """Of a layer's result in the graph; the last one's is the output."""
    return OUTPUT if conv is RECONSTRUCTION[-1] else conv.name


# ---- float and quantization-aware -------------------------------------------------------------------------


class Mnss(nn.Module):
    """The three networks. ranges: largest value of each inner tensor of the graph, empty while training in float; half:
    whether its inner convolutions run in bfloat16."""

    def __init__(self, scale: int):
        super().__init__()
        if scale not in SCALES:
            raise ValueError(f"scale must be 2 or 3, found {scale}")
        self.scale = scale
        self.convs = nn.ModuleDict({c.name: nn.Conv2d(c.inputs, c.outputs, c.kernel, padding=c.kernel // 2)
                                    for c in (INPAINT, AA, *RECONSTRUCTION)})
        self.ranges: dict[str, float] = {}
        self.observed: dict[str, list[float]] | None = None
        self.half = False
        _initialise(self)

    def weight(self, difference: torch.Tensor) -> torch.Tensor:
        """Share of the current frame `[n, 1, h, w]` from the difference `[n, 4, h, w]`."""
        return torch.sigmoid(self.convs[INPAINT.name](difference))

    def antialiased(self, colours: torch.Tensor) -> torch.Tensor:
        """`[n, 3, h, w]` in 0..1 from the current colour and the mean of the history, `[n, 6, h, w]`."""
        return self.convs[AA.name](colours).clamp(0.0, 1.0)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Reconstruction: `[n, 3, H, W]` in 0..1 to the same."""
        if self.ranges:
            x = torch.fake_quantize_per_tensor_affine(x, *CODES, -128, 127)
        picture = x
        for conv in RECONSTRUCTION:
            layer = self.convs[conv.name]
            last = conv is RECONSTRUCTION[-1]
            x = training.convolve(x, self._weight(layer), layer.bias, self.half and not last)
            if self.ranges:
                scale = CORRECTION if last else (self.ranges[conv.name] / 255.0, -128)
                x = torch.fake_quantize_per_tensor_affine(x, *scale, -128, 127)
            elif not last:
                x = F.relu(x)
                self._observe(conv.name, x)
        return (picture + x).clamp(0.0, 1.0)

    def _weight(self, layer: nn.Conv2d) -> torch.Tensor:
        if not self.ranges:
            return layer.weight
        step = (layer.weight.detach().abs().amax(dim=(1, 2, 3)) / 127.0).clamp(min=1e-9)
        return torch.fake_quantize_per_channel_affine(layer.weight, step, torch.zeros(len(step), dtype=torch.int32), 0,
                                                      -127, 127)

    def _observe(self, name: str, x: torch.Tensor) -> None:
        if self.observed is not None:
            values = x.detach().flatten()
            rest = max(1, int(values.numel() * (1.0 - COVERED)))
            self.observed.setdefault(name, []).append(float(values.kthvalue(values.numel() + 1 - rest).values))

    def calibrated(self) -> None:
        """Fixes the ranges from what `observed` collected. Errors: ValueError when nothing was.

        They hold the brightest sequence: the picture goes through every layer, so that a range of a mean sequence would clip
        what is bright.
        """
        if not self.observed:
            raise ValueError("no activations were observed")
        self.ranges = {name: max(*seen, 1e-3) for name, seen in self.observed.items()}
        self.observed = None


def _initialise(model: Mnss) -> None:
    """Starts as an accumulator that shows what is inserted: He weights whose results count nothing yet. Source: ours."""
    with torch.no_grad():
        for conv in RECONSTRUCTION:
            layer = model.convs[conv.name]
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
            layer.bias.zero_()
            if conv is RECONSTRUCTION[-1]:
                layer.weight.zero_()
        inpaint, aa = model.convs[INPAINT.name], model.convs[AA.name]
        inpaint.weight.fill_(START_SLOPE)
        inpaint.bias.fill_(START_BIAS)
        aa.weight.zero_()
        aa.bias.zero_()
        for c in range(3):
            aa.weight[c, c] = 1.0


# ---- exact INT8 -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Int8Mnss:
    """The integer reconstruction."""

    layers: tuple[quantize.Layer, ...]

    def run(self, codes: np.ndarray) -> np.ndarray:
        """int8 `[1, H, W, 3]` to the correction, int8 `[1, H, W, 3]`, bit for bit what TOSA defines."""
        x = codes[0].astype(np.int64)
        for layer in self.layers:
            x = quantize.run_layer(layer, x)
        return x[None].astype(np.int8)


def _scales(model: Mnss, steps: int) -> list[float]:
    """Real value of one code of each layer's result, where `steps` of them make its range."""
    if not model.ranges:
        raise ValueError("the model has no activation ranges yet")
    return [CORRECTION[0] if conv is RECONSTRUCTION[-1] else model.ranges[conv.name] / steps for conv in RECONSTRUCTION]


def to_int8(model: Mnss) -> Int8Mnss:
    """Quantizes with the model's ranges. Errors: ValueError when it has none or a factor cannot be rescaled."""
    layers, before = [], CODES[0]
    for conv, scale in zip(RECONSTRUCTION, _scales(model, 255)):
        last = conv is RECONSTRUCTION[-1]
        layers.append(quantize._layer(conv.name, model.convs[conv.name], before, scale, CORRECTION[1] if last else -128,
                                      not last))
        before = scale
    return Int8Mnss(tuple(layers))


PAD = (1, 1, 1, 1)


def build_graph(network: Int8Mnss, rows: int, columns: int) -> GraphWriter:
    """The .tosa graph at this output size. ReLU is the lower end of the codes."""
    graph = GraphWriter()
    x = graph.input("input", (1, rows, columns, 3))
    for conv, layer in zip(RECONSTRUCTION, network.layers):
        x = graph.conv2d(f"{conv.name}/acc", x, layer.weight, layer.bias, input_zp=layer.input_zp, pad=PAD)
        x = graph.rescale(tensor_name(conv), x, layer.multiplier, layer.shift, output_zp=layer.output_zp)
    graph.output(x)
    return graph


# ---- float and INT16 --------------------------------------------------------------------------------------


def build_real_graph(model: Mnss, rows: int, columns: int, dtype: str) -> GraphWriter:
    """The graph in FP32 or FP16, with the weights as they were trained."""
    graph = GraphWriter()
    x = precisions.real_input(graph, graph.input("input", (1, rows, columns, 3)), CODES, dtype)
    for conv in RECONSTRUCTION:
        x = precisions.real_conv(graph, f"{conv.name}/acc", x, model.convs[conv.name], PAD)
        if conv is not RECONSTRUCTION[-1]:
            x = precisions.relu(graph, conv.name, x)
    graph.output(precisions.real_output(graph, OUTPUT, x, CORRECTION))
    return graph


def build_short_graph(model: Mnss, rows: int, columns: int) -> GraphWriter:
    """The graph with int16 activations. Errors: ValueError when there are no ranges."""
    graph = GraphWriter()
    x, scale = precisions.short_input(graph, graph.input("input", (1, rows, columns, 3)), CODES)
    for conv, own in zip(RECONSTRUCTION, _scales(model, precisions.INT16_MAX)):
        last = conv is RECONSTRUCTION[-1]
        x = precisions.short_conv(graph, f"{conv.name}/acc", OUTPUT if last else f"{conv.name}/rescale", x, scale,
                                  model.convs[conv.name], CORRECTION if last else (own, 0), "INT8" if last else "INT16",
                                  PAD)
        if not last:
            x = precisions.relu(graph, conv.name, x)
        scale = own
    graph.output(x)
    return graph


def tensor_scales(model: Mnss) -> dict[str, dict[str, precisions.Scale]]:
    """For quantization.json."""
    ends = {"input": CODES, OUTPUT: CORRECTION}
    inner = [conv.name for conv in RECONSTRUCTION[:-1]]
    return {"int8": {**ends, **{n: (s, -128) for n, s in zip(inner, _scales(model, 255))}},
            "int16": {**ends, **{n: (s, 0) for n, s in zip(inner, _scales(model, precisions.INT16_MAX))}},
            "fp32": ends, "fp16": ends}


# ---- files ------------------------------------------------------------------------------------------------


def save_weights(path, model: Mnss, record: dict) -> None:
    """Weights, ranges and training record as .npz; the same model gives the same bytes."""
    training.save_model(path, model, {**record, "scale": model.scale})


def load_model(path) -> tuple[Mnss, dict]:
    """Model and record from a .npz or an own checkpoint (a pickle). Errors: ValueError, OSError."""
    return training.load_model(path, "an MNSS", lambda record: Mnss(record["scale"]), float)
