"""The QRISP passes around the network, in PyTorch: what shaders/frame/qrisp computes, and differentiable.

One frame is `pre` -> network -> `post`; `State` carries what the next frame needs, `None` is a reset. Tensors are
`[n, c, rows, columns]`. Output size is s times render size, s = 2, 3 or 4. Source: network notes, sections 2.1 and 2.2.

Conventions, the same in the shaders:
- Pictures are as a display shows them: y = sqrt(x / (1 + x)) per channel of exposed colour x, NaN and negative 0, at
  most 65504. The history stays so, in half floats; the output is y^2 / (1 - y^2) over the exposure. A history of frames
  with another exposure is not converted.
- Jitter j in render pixels: texel l holds the scene position l + 0.5 + j. Motion m in uv: prev = uv - m. Motion
  vectors between jittered positions become motion by m + (j - j_prev) / render size: the notes' MV + J[t-1] - J[t],
  whose J moves the picture, ours the sample. Those of this project's renderer need no compensation.
- Block motion: of each 8x8 output pixels the motion of the one with the nearest depth, the first in rows where several
  are; an output pixel has the depth and the motion of the render pixel that it lies in. Kept in half floats.
- Warp: history at uv - m, clamped to the border; the feature bilinear, the colour, too, or with Options.cubic by five
  taps of Catmull-Rom (nss_passes), so that what moves keeps its detail from frame to frame. No test whether it is on
  the screen: alpha is the network's.
- Input channels: colour 3; nearness, the fourth root of what is left to the far end of the depth buffer, which
  steps evenly in powers of the distance; jitter + 0.5 (x, y); warped colour c s^2 + dy s + dx; warped feature.
  Padded to even sides, whose last column and row show the one before.
- Without a past: warped colour and feature 0, and the candidate alone is the result.
- With Options.corrects the candidate is added to the frame, enlarged bilinearly from its samples where they lie, clamped to 0..1.
- Feature: one channel at output size in 0..1, kept in steps of 1/255 as the network gives it.
Gradients: through network outputs, warped colours and features; everything else is constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F

import nss_passes
from nss_passes import Frame

BLOCK = 8
NO_OVERSHOOT = 0.875 ** 0.5  # displayed, of an exposed 7: above it a result stays within the frame around it and the past


@dataclass(frozen=True)
class Options:
    """What an ablation leaves out, how the history is read, and what a candidate is."""

    dilation: bool = True
    blending: bool = True
    cubic: bool = False
    corrects: bool = False

    @staticmethod
    def of(record: dict) -> Options:
        """Those that the weights with this record were trained with."""
        return Options(**{name: record.get(name, field.default) for name, field in Options.__dataclass_fields__.items()})


@dataclass
class State:
    """What a frame leaves to the next one: colour `[n, 3, H, W]` as displayed, feature `[n, 1, H, W]` in 0..1."""

    colour: torch.Tensor
    feature: torch.Tensor

    def detached(self) -> State:
        """The same values without their past."""
        return State(self.colour.detach(), self.feature.detach())


@dataclass
class Pre:
    """Result of the pre passes. input `[n, 6 + 4 s^2, even rows, even columns]` in 0..1; warped `[n, 3, H, W]`; motion
    `[n, 2, H, W]` or of blocks, uv."""

    input: torch.Tensor
    warped: torch.Tensor
    motion: torch.Tensor


def displayed(exposed: torch.Tensor) -> torch.Tensor:
    """Exposed linear colour to 0..1."""
    x = exposed.clamp(0.0, nss_passes.HALF_MAX)
    return torch.sqrt(x / (1.0 + x))


def linear(y: torch.Tensor) -> torch.Tensor:
    """Inverse of `displayed`."""
    square = y * y
    return (square / (1.0 - square.clamp(max=1.0 - 1e-7))).clamp(max=nss_passes.HALF_MAX)


def nearness(depth: torch.Tensor, reverse: bool) -> torch.Tensor:
    """Stored depth to 0..1, 1 at the camera."""
    return torch.sqrt(torch.sqrt((depth if reverse else 1.0 - depth).clamp(0.0, 1.0)))


def compensate(motion: torch.Tensor, jitter, previous) -> torch.Tensor:
    """uv motion `[n, 2, h, w]` from motion between jittered positions."""
    h, w = motion.shape[2:]
    change = motion.new_tensor([(jitter[0] - previous[0]) / w, (jitter[1] - previous[1]) / h])
    return motion + change.view(1, 2, 1, 1)


def render_texels(count: int, scale: int, device=None) -> torch.Tensor:
    """The render texel that each output pixel of an axis lies in."""
    return torch.div(torch.arange(count, device=device), scale, rounding_mode="floor")


def block_motion(frame: Frame, scale: int) -> torch.Tensor:
    """`[n, 2, ceil(H / 8), ceil(W / 8)]`."""
    w, h = frame.size
    y, x = render_texels(h * scale, scale), render_texels(w * scale, scale)
    depth = frame.depth.index_select(2, y.to(frame.depth.device)).index_select(3, x.to(frame.depth.device))
    _, by, bx, _ = nss_passes.block_nearest(depth, BLOCK, frame.reverse)
    by, bx = (torch.div(at, scale, rounding_mode="floor") for at in (by, bx))
    return nss_passes.fetch(frame.motion, by, bx)


def _enlarged(image: torch.Tensor, factor: int, rows: int, columns: int) -> torch.Tensor:
    return F.interpolate(image, scale_factor=factor, mode="nearest")[:, :, :rows, :columns]


def pre(frame: Frame, state: State | None, scale: int, options: Options = Options()) -> Pre:
    """The input tensor and what the post pass needs."""
    w, h = frame.size
    rows, columns, n = h * scale, w * scale, len(frame.colour)
    with torch.no_grad():
        motion = block_motion(frame, scale) if options.dilation else frame.motion
        motion = motion.clamp(-1.0, 1.0).half().float()
        colour = displayed(frame.colour * frame.exposure)
        near = nearness(frame.depth, frame.reverse)
        jitter = colour.new_tensor(frame.jitter).add(0.5).view(1, 2, 1, 1).expand(n, -1, h, w)
        r = nss_passes.uv_grid(columns, rows, colour) - _enlarged(motion, BLOCK if options.dilation else scale, rows,
                                                                   columns)
    if state is None:
        past = colour.new_zeros(n, 4, rows, columns)
    else:
        past = nss_passes.bilinear(torch.cat([state.colour, state.feature], 1), r)
        if options.cubic:
            past = torch.cat([nss_passes._CatmullRom.apply(state.colour, r).clamp(0.0, 1.0), past[:, 3:]], 1)
    tensor = torch.cat([colour, near, jitter, F.pixel_unshuffle(past, scale)], 1)
    tensor = F.pad(tensor, (0, w % 2, 0, h % 2), mode="replicate") if w % 2 or h % 2 else tensor
    return Pre(tensor, past[:, :3], motion)


def enlarged(frame: Frame, colour: torch.Tensor, scale: int) -> torch.Tensor:
    """`[n, 3, H, W]`, bilinear between the samples of a frame where they lie; their colours are `[n, 3, h, w]`."""
    w, h = frame.size
    uv = nss_passes.uv_grid(w * scale, h * scale, colour) - nss_passes._jitter_uv(frame, frame.jitter)
    return nss_passes.bilinear(colour, uv.expand(len(colour), -1, -1, -1))


def post(frame: Frame, before: Pre, outputs: dict[str, torch.Tensor], state: State | None, scale: int,
         options: Options = Options()) -> State:
    """What is shown, as `State.colour`, and the feature, from the heads."""
    w, h = frame.size
    alpha, candidate, feature = (F.pixel_shuffle(outputs[name][:, :, :h, :w], scale)
                                 for name in ("alpha", "candidate", "feature"))
    colour = displayed(frame.colour * frame.exposure)
    if options.corrects:
        candidate = (enlarged(frame, colour, scale) + candidate).clamp(0.0, 1.0)
    if state is not None and options.blending:
        candidate = before.warped + alpha * (candidate - before.warped)
    taps = F.max_pool2d(colour, 3, 1, 1)
    brightest = torch.maximum(_enlarged(taps, scale, h * scale, w * scale), before.warped).clamp(min=NO_OVERSHOOT)
    return State(torch.minimum(candidate, brightest), feature)


def output(frame: Frame, state: State) -> torch.Tensor:
    """Linear colour without exposure, `[n, 3, H, W]`."""
    return linear(state.colour) / frame.exposure


def stored(state: State) -> State:
    """State as the histories keep it."""
    return State(state.colour.half().float(), nss_passes.unorm8(state.feature))
