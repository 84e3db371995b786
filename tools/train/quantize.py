"""Static post-training INT8 quantization of SRPO, and the exact integer network in numpy.

Input: 8-bit colour, scale 1/255, zero point -128, so no information is lost. Weights: per output channel,
symmetric, [-127, 127]. Activations after ReLU: zero point -128, range from calibration pictures. Offsets:
zero point 0 and a power-of-two scale, so that the rounding boundaries at +-0.5 are codes themselves.
Source: TOSA 1.0, CONV2D, RESCALE, RESIZE; the choice of ranges is ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

import shapes
import srpo

INPUT_SCALE = 1.0 / 255.0
INPUT_ZERO_POINT = -128
#: Seeds of the calibration pictures; training and the held-out sets use others.
CALIBRATION_SEED = 3_000_000
CALIBRATION_COUNT = 24
#: Share of activations that the int8 range covers; the rest saturates.
COVERED = 0.9999


@dataclass(frozen=True)
class Layer:
    """One convolution and its requantization; weight `[oc, kh, kw, ic]`, other arrays `[oc]`."""

    name: str
    weight: np.ndarray
    bias: np.ndarray
    multiplier: np.ndarray
    shift: np.ndarray
    input_zp: int
    output_zp: int
    output_scale: float
    relu: bool


@dataclass(frozen=True)
class Int8Srpo:
    """The integer network: conv, conv, nearest resize, conv."""

    scale: int
    layers: tuple[Layer, Layer, Layer]

    @property
    def offset_scale(self) -> float:
        """Low-resolution pixels of one output code."""
        return self.layers[2].output_scale

    def run(self, codes: np.ndarray) -> np.ndarray:
        """int8 `[1, h, w, 3]` to int8 `[1, s*h, s*w, 2]`, bit for bit what TOSA defines."""
        x = codes[0].astype(np.int64)
        for index, layer in enumerate(self.layers):
            if index == 2:
                x = srpo.nearest(x, self.scale)
            x = run_layer(layer, x)
        return x[None].astype(np.int8)

    def offsets(self, lr: np.ndarray) -> np.ndarray:
        """Real-valued offsets `[s*h, s*w, 2]` of one uint8 picture."""
        return self.run(input_codes(lr))[0].astype(float) * self.offset_scale


def input_codes(lr: np.ndarray) -> np.ndarray:
    """uint8 `[h, w, 3]` to the int8 network input `[1, h, w, 3]`."""
    return (lr.astype(np.int64) - 128).astype(np.int8)[None]


def scale_to_multiplier(scale: np.ndarray, bits: int = 31) -> tuple[np.ndarray, np.ndarray]:
    """Real factors above 0 as multiplier / 2^shift, multiplier in [2^(bits-1), 2^bits), shift in [2, 62].

    Errors: ValueError.
    """
    mantissa, exponent = np.frexp(np.asarray(scale, float))
    multiplier = np.floor(mantissa * 2.0**bits + 0.5).astype(np.int64)
    shift = bits - exponent.astype(np.int64)
    carry = multiplier == 2**bits
    multiplier, shift = np.where(carry, 2**(bits - 1), multiplier), np.where(carry, shift - 1, shift)
    if np.any(np.asarray(scale) <= 0) or shift.min() < 2 or shift.max() > 62:
        raise ValueError(f"factor {np.asarray(scale).min()} to {np.asarray(scale).max()} cannot be rescaled")
    return multiplier, shift


def apply_scale_32(value: np.ndarray, multiplier: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """TOSA apply_scale_32 with single rounding, int64. Errors: ValueError where TOSA gives no result."""
    limit = np.int64(1) << (shift - 1)
    if np.any(value < -limit) or np.any(value >= limit):
        raise ValueError("an accumulator leaves the range of its shift")
    return (value * multiplier + limit) >> shift


def convolve(x: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Zero-padded 'same' convolution of integers, `[h, w, ic]` to int64 `[h, w, oc]`.

    Summed in float64, which is exact here: every partial sum is an integer far below 2^53.
    """
    oc, kh, kw, ic = weight.shape
    h, w, _ = x.shape
    padded = np.pad(x.astype(float), ((kh // 2, kh // 2), (kw // 2, kw // 2), (0, 0)))
    taps = torch.from_numpy(padded.transpose(2, 0, 1)[None].copy())
    kernel = torch.from_numpy(weight.astype(float).transpose(0, 3, 1, 2).copy())
    total = torch.nn.functional.conv2d(taps, kernel)[0].numpy()
    return total.transpose(1, 2, 0).astype(np.int64)


def run_layer(layer: Layer, x: np.ndarray) -> np.ndarray:
    """int64 codes `[h, w, ic]` through CONV2D, RESCALE and CLAMP."""
    total = convolve(x - layer.input_zp, layer.weight) + layer.bias
    if np.any(np.abs(total) >= 2**31):
        raise ValueError(f"{layer.name}: an accumulator leaves int32")
    return np.clip(apply_scale_32(total, layer.multiplier, layer.shift) + layer.output_zp, -128, 127)


def calibration_pictures() -> list[np.ndarray]:
    """uint8 pictures that fix the activation ranges."""
    return [shapes.render(shapes.random_scene(CALIBRATION_SEED + i)) for i in range(CALIBRATION_COUNT)]


def _activations(model: srpo.Srpo, pictures: list[np.ndarray]) -> list[np.ndarray]:
    """All values after each of the three layers, flattened."""
    seen: list[list[np.ndarray]] = [[], [], []]
    for picture in pictures:
        x = torch.from_numpy(picture.astype(np.float32) / 255.0).permute(2, 0, 1)[None]
        with torch.no_grad():
            first = torch.relu(model.conv1(x))
            second = torch.relu(model.conv2(first))
            third = model(x)
        for values, tensor in zip(seen, (first, second, third)):
            values.append(tensor.numpy().reshape(-1))
    return [np.concatenate(values) for values in seen]


def _layer(name: str, conv: torch.nn.Conv2d, input_scale: float, output_scale: float, output_zp: int,
           relu: bool) -> Layer:
    weight = conv.weight.detach().numpy().astype(float).transpose(0, 2, 3, 1)
    bias = conv.bias.detach().numpy().astype(float)
    # A channel of tiny weights still needs a step at which its bias fits int32.
    step = np.maximum(np.abs(weight).reshape(len(bias), -1).max(axis=1) / 127.0,
                      np.maximum(np.abs(bias) / (input_scale * 2.0**30), 1e-9))
    codes = np.clip(np.floor(weight / step[:, None, None, None] + 0.5), -127, 127).astype(np.int64)
    multiplier, shift = scale_to_multiplier(input_scale * step / output_scale)
    return Layer(name, codes, np.floor(bias / (input_scale * step) + 0.5).astype(np.int64), multiplier, shift,
                 INPUT_ZERO_POINT, output_zp, output_scale, relu)


def quantize(model: srpo.Srpo, pictures: list[np.ndarray] | None = None) -> Int8Srpo:
    """Post-training quantization from calibration pictures (by default the fixed ones)."""
    first, second, third = _activations(model, pictures or calibration_pictures())
    scales = [max(float(np.quantile(values[values > 0], COVERED)) if np.any(values > 0) else 1.0, 1e-6) / 255.0
              for values in (first, second)]
    reach = max(float(np.quantile(np.abs(third), COVERED)), 2.0**-10)
    offset_scale = 2.0 ** float(np.clip(np.ceil(np.log2(reach / 127.0)), -12, 0))
    return Int8Srpo(model.scale, (
        _layer("conv1", model.conv1, INPUT_SCALE, scales[0], -128, True),
        _layer("conv2", model.conv2, scales[0], scales[1], -128, True),
        _layer("conv3", model.conv3, scales[1], offset_scale, 0, False),
    ))
