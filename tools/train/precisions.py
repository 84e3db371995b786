"""What the float and the INT16 forms of every network share: layers, the INT8 boundary, quantization.json.

Every form of a network has the inputs and outputs of its INT8 form, int8 codes with the same scale and zero
point, so the passes around it stay as they are; and the same names for the results of its layers.

float: CAST, SUB the zero point, MUL by the scale; at the end MUL, ADD, CAST, which rounds to nearest even and
saturates. The boundary is FP32; FP16 begins after it, with FP32 accumulators.
INT16: weights symmetric per output channel in [-127, 127]; activations int16 with zero point 0; accumulators
INT48, rescaled by 16-bit multipliers. Source: TOSA 1.0, EXT-INT16; scales are ours.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from quantize import scale_to_multiplier
from tosa_writer import GraphWriter, Tensor

#: Model file in a folder by the name that `shale --precision` takes.
FILES = {"int8": "model.tosa", "int16": "model.int16.tosa", "fp32": "model.fp32.tosa", "fp16": "model.fp16.tosa"}
FLOATS = {"fp32": "FP32", "fp16": "FP16"}
INT16_MAX = 32767
#: Steps of an int16 input to one of the int8 code: a shift, so that nothing is lost.
INPUT_STEPS = 128

Scale = tuple[float, int]  # real = scale * (code - zero point)


# ---- float ------------------------------------------------------------------------------------------------


def _scalar(graph: GraphWriter, name: str, value: float) -> Tensor:
    return graph.const(name, np.full((1, 1, 1, 1), value), "FP32")


def real_input(graph: GraphWriter, x: Tensor, scale: Scale, dtype: str) -> Tensor:
    """int8 codes as FP32 or FP16 numbers."""
    name = x.name
    y = graph.sub(f"{name}/centred", graph.cast(f"{name}/cast", x, "FP32"), _scalar(graph, f"{name}/zero", scale[1]))
    y = graph.mul(f"{name}/real", y, _scalar(graph, f"{name}/scale", scale[0]))
    return y if dtype == "FP32" else graph.cast(f"{name}/narrow", y, dtype)


def real_output(graph: GraphWriter, name: str, x: Tensor, scale: Scale) -> Tensor:
    """Numbers as int8 codes: the graph output `name`."""
    y = x if x.dtype == "FP32" else graph.cast(f"{name}/wide", x, "FP32")
    y = graph.mul(f"{name}/steps", y, _scalar(graph, f"{name}/per_step", 1.0 / scale[0]))
    if scale[1] != 0:
        y = graph.add(f"{name}/moved", y, _scalar(graph, f"{name}/zero", scale[1]))
    return graph.cast(name, y, "INT8")


def real_conv(graph: GraphWriter, name: str, x: Tensor, conv: torch.nn.Conv2d, pad, stride=(1, 1)) -> Tensor:
    """CONV2D with the float weights."""
    weight, bias = _weights(conv)
    return graph.conv2d(name, x, weight, bias, input_zp=0, pad=pad, stride=stride)


def relu(graph: GraphWriter, name: str, x: Tensor) -> Tensor:
    """CLAMP from 0 on."""
    return graph.clamp(name, x, 0, np.inf if x.dtype in ("FP32", "FP16") else INT16_MAX)


def _weights(conv: torch.nn.Conv2d) -> tuple[np.ndarray, np.ndarray]:
    """OHWI and bias in float64."""
    return (conv.weight.detach().numpy().astype(float).transpose(0, 2, 3, 1),
            conv.bias.detach().numpy().astype(float))


# ---- INT16 ------------------------------------------------------------------------------------------------


def short_input(graph: GraphWriter, x: Tensor, scale: Scale) -> tuple[Tensor, float]:
    """int8 codes as int16 ones; their scale."""
    y = graph.rescale(f"{x.name}/wide", x, 2**30, 30 - (INPUT_STEPS.bit_length() - 1), input_zp=scale[1],
                      dtype="INT16")
    return y, scale[0] / INPUT_STEPS


def short_conv(graph: GraphWriter, accumulator: str, name: str, x: Tensor, input_scale: float,
               conv: torch.nn.Conv2d, scale: Scale, dtype: str, pad, stride=(1, 1)) -> Tensor:
    """CONV2D of int16 by int8 weights, rescaled to `dtype` codes of this scale."""
    weight, bias = _weights(conv)
    step = np.maximum(np.abs(weight).reshape(len(bias), -1).max(axis=1) / 127.0, 1e-9)
    codes = np.clip(np.floor(weight / step[:, None, None, None] + 0.5), -127, 127).astype(np.int64)
    y = graph.conv2d(accumulator, x, codes, np.floor(bias / (input_scale * step) + 0.5).astype(np.int64),
                     input_zp=0, pad=pad, stride=stride)
    multiplier, shift = scale_to_multiplier(input_scale * step / scale[0], 15)
    return graph.rescale(name, y, multiplier, shift, output_zp=scale[1], dtype=dtype)


def short_sigmoid(graph: GraphWriter, name: str, x: Tensor, input_scale: float, scale: Scale) -> Tensor:
    """TABLE of int16 and the RESCALE of its 7 bits more to int8 codes: the graph output `name`."""
    at = (np.arange(513) - 256) * 128.0 * input_scale
    entries = np.floor(INT16_MAX / (1.0 + np.exp(-at)) + 0.5).astype(np.int64)
    y = graph.table(f"{name}/table", x, entries)
    mantissa, exponent = np.frexp(1.0 / (INT16_MAX * 128.0 * scale[0]))
    return graph.rescale(name, y, int(np.floor(mantissa * 2.0**31 + 0.5)), 31 - int(exponent), output_zp=scale[1])


# ---- files ------------------------------------------------------------------------------------------------


def quantization_json(tensors: dict[str, dict[str, Scale]]) -> bytes:
    """quantization.json from precision -> tensor -> scale: what the codes of each file's tensors mean."""
    files = {FILES[precision]: {name: {"scale": float(scale), "zero_point": int(zero)}
                                for name, (scale, zero) in scales.items()}
             for precision, scales in tensors.items()}
    return (json.dumps({"schema": "shale-quantization/1", "files": files}, indent=1) + "\n").encode()


def file_in(folder: Path, precision: str) -> Path:
    """The model file of a precision."""
    return folder / FILES[precision]
