"""The passes around the MNSS network, differentiable: what the shaders of shaders/frame/mnss compute.

Colours are what a display shows, 0..1. Conventions, the same in the shaders:
- The sample in texel l of a frame lies at l + 0.5 + j (render pixels); it is the centre of the output pixel s * l + cell,
  cell = clamp(floor((0.5 + j) s), 0, s - 1), if the frame has the pattern of the paper. Any other jitter works, too: the
  sample is inserted into the output pixel that it lies in.
- Upsampling, so that no jitter enters: output pixel p lies at (p + 0.5) / s - 0.5 - j in texel units, bilinear, texel
  indices clamped. Motion m in uv: what is at uv was at uv - m.
- Nearness is 1 / z of view depth z, at least 1e-4 m, linear on the screen; its difference is that to the larger of both.
- The difference of a texel: |colour - history at uv - m| and the nearness's; 1 where that was off the screen, 0 in a
  frame without a past; stored in 8 bits. Outside of the picture it is 0.
Source: MNSS (TVCG 2023). Ours: the nearness in place of the depth itself, whose differences far away are lost; its
upsampling in the frame before by that frame's jitter; what is off the screen; 8 bits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F

import mnss
import nss_passes
from nss_passes import Frame


@dataclass
class State:
    """What a frame leaves to the next one: history `[n, 3, H, W]`, nearness `[n, 1, h, w]`, its jitter."""

    history: torch.Tensor
    nearness: torch.Tensor
    jitter: tuple[float, float]

    def detached(self) -> "State":
        """The same values without their past."""
        return State(self.history.detach(), self.nearness, self.jitter)


@dataclass
class Pre:
    """Results of the passes before the network, in their order; inserted `[n, 3, H, W]` is its input."""

    difference: torch.Tensor
    weight: torch.Tensor
    rectified: torch.Tensor
    antialiased: torch.Tensor
    inserted: torch.Tensor
    nearness: torch.Tensor


class _Rounded(torch.autograd.Function):
    """To 8 bits; the gradient passes."""

    @staticmethod
    def forward(ctx, x):
        return torch.floor(x * 255.0 + 0.5) / 255.0

    @staticmethod
    def backward(ctx, gradient):
        return gradient


def display(x: torch.Tensor) -> torch.Tensor:
    """Exposed linear colour to 8-bit display values: x / (1 + x), then the sRGB curve."""
    x = nss_passes.sanitise(x)
    x = x / (1.0 + x)
    x = torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x.clamp(min=1e-9) ** (1 / 2.4) - 0.055)
    return _Rounded.apply(x)


def cell(jitter: tuple[float, float], scale: int) -> tuple[int, int]:
    """Column and row, in its tile, of the output pixel that holds the sample."""
    return tuple(min(max(math.floor((0.5 + j) * scale), 0), scale - 1) for j in jitter)


def positions(size: tuple[int, int], scale: int, jitter: tuple[float, float]) -> torch.Tensor:
    """uv `[1, 2, H, W]`, for `nss_passes.bilinear`, of the output pixels in a picture of `size` (w, h) whose samples
    have this jitter."""
    w, h = size
    x = ((torch.arange(w * scale) + 0.5) / scale - jitter[0]) / w
    y = ((torch.arange(h * scale) + 0.5) / scale - jitter[1]) / h
    return torch.stack([x[None, :].expand(h * scale, w * scale), y[:, None].expand(h * scale, w * scale)])[None]


def upsample(image: torch.Tensor, scale: int, jitter: tuple[float, float]) -> torch.Tensor:
    """Render texels `[n, c, h, w]` at the output pixels."""
    at = positions((image.shape[3], image.shape[2]), scale, jitter)
    return nss_passes.bilinear(image, at)


def nearness(frame: Frame) -> torch.Tensor:
    """1 / metres, `[n, 1, h, w]`."""
    z = nss_passes.view_z(frame.depth[:, 0], frame.camera)[:, None]
    z = torch.nan_to_num(z, nan=1e8, posinf=1e8, neginf=0.0).clamp(0.0, 1e8)
    return 1.0 / z.clamp(min=1e-4)


def difference(frame: Frame, colour: torch.Tensor, near: torch.Tensor, state: State | None, scale: int) -> torch.Tensor:
    """`[n, 4, h, w]` in 8-bit steps of 0..1."""
    if state is None:
        return torch.zeros_like(colour[:, :1]).expand(-1, 4, -1, -1)
    w, h = frame.size
    column, row = cell(frame.jitter, scale)
    x = (torch.arange(w) * scale + column + 0.5) / (w * scale)
    y = (torch.arange(h) * scale + row + 0.5) / (h * scale)
    before = torch.stack([x[None, :].expand(h, w), y[:, None].expand(h, w)])[None] - frame.motion
    past = nss_passes.bilinear(state.history, before)
    shift = before.new_tensor([state.jitter[0] / w, state.jitter[1] / h]).view(1, 2, 1, 1)
    past_near = nss_passes.bilinear(state.nearness, before - shift)
    depth = (near - past_near).abs() / torch.maximum(near, past_near)
    off = ~((before >= 0) & (before < 1)).all(1, keepdim=True)
    return _Rounded.apply(torch.cat([(colour - past).abs(), depth], 1).masked_fill(off, 1.0).clamp(0.0, 1.0))


def pre(model: mnss.Mnss, frame: Frame, colour: torch.Tensor, state: State | None) -> Pre:
    """The passes before the network; colour is the frame's as a display shows it."""
    scale, near = model.scale, nearness(frame)
    delta = difference(frame, colour, near, state, scale)
    now = upsample(colour, scale, frame.jitter)
    if state is None:
        weight, rectified = torch.ones_like(colour[:, :1]), now
    else:
        weight = model.weight(delta)
        share = upsample(weight, scale, frame.jitter)
        at = nss_passes.uv_grid(now.shape[3], now.shape[2], now) - upsample(frame.motion, scale, frame.jitter)
        past = nss_passes.bilinear(state.history, at)
        rectified = past + share * (now - past)
    smooth = model.antialiased(torch.cat([colour, F.avg_pool2d(rectified, scale)], 1))
    column, row = cell(frame.jitter, scale)
    inserted = nss_passes._Place.apply(rectified, smooth, row, column, scale, scale)
    return Pre(delta, weight, rectified, smooth, inserted, near)


def next_state(frame: Frame, before: Pre, shown: torch.Tensor) -> State:
    """State for the next frame."""
    return State(shown, before.nearness, frame.jitter)


def sharpened(picture: torch.Tensor, beta: float) -> torch.Tensor:
    """Corners -beta, edges 0, centre 1 + 4 beta; clamped to 0..1. `[n, 3, H, W]`, borders clamped."""
    padded = F.pad(picture, (1, 1, 1, 1), mode="replicate")
    corners = padded[:, :, :-2, :-2] + padded[:, :, :-2, 2:] + padded[:, :, 2:, :-2] + padded[:, :, 2:, 2:]
    return ((1.0 + 4.0 * beta) * picture - beta * corners).clamp(0.0, 1.0)


def input_codes(inserted: torch.Tensor) -> torch.Tensor:
    """The int8 input of the network, NHWC."""
    codes = torch.floor(inserted * 255.0 + 0.5).clamp(0.0, 255.0) - 128.0
    return codes.to(torch.int8).permute(0, 2, 3, 1).contiguous()


def from_codes(codes: torch.Tensor, correction: torch.Tensor | None = None) -> torch.Tensor:
    """int8 NHWC, corrected where there is a correction, to values in 0..1, NCHW."""
    sums = codes.float() + 128.0 + (0.0 if correction is None else correction.float())
    return (sums.clamp(0.0, 255.0) / 255.0).permute(0, 3, 1, 2).contiguous()
