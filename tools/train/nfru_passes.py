"""The passes around the NFRU network, in PyTorch: what the shaders of shaders/frame/nfru compute.

A picture between two frames is made of what their programs left, which `read_pair` takes from the arrays of `shale play --dump`: the
splatted words, motion and depth of both frames, flow, and the frames as displayed. None of it depends on the network, so that
training computes samples and input once. Conventions, the same in the shaders:
- Times are in rendered frames, the newest at 1, the one before at 0. Motion m in uv: what is at uv was at uv - m a frame
  before. Flow in pixels of the lane, the picture that the network sees, a quarter of the output, on the previous frame's pixels.
- Samples are of the previous and the newest frame by motion, of the previous and the newest by flow. The network's input has
  means of 4x4 pixels around each, at the middles of the lane's pixels; padded to multiples of 8, mirrored.
- A sample off the screen shows its partner's colour and has no weight, unless all of them are.
- Depth has its near plane at 0. Of a depth test a half is the border: view depths that differ by a tenth.
Source: Arm's NFRU v1 (nfru.md section 3), Mob-FGSR's parabola (seed_networks.md section 4.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

import nss_passes
from nss_passes import bilinear, fetch

SAME_DEPTH = 0.1


@dataclass
class Pair:
    """Two frames and what leads between them; `[1, c, rows, columns]`."""

    filled: torch.Tensor  # int64 words, [1, 1, h, w]
    flow_splat: torch.Tensor  # int64 words, of the lane
    flow: torch.Tensor  # [1, 2, rows, columns], pixels of the lane
    depth: tuple[torch.Tensor, torch.Tensor]  # previous, newest
    motion: tuple[torch.Tensor, torch.Tensor]
    displayed: tuple[torch.Tensor, torch.Tensor]
    camera: torch.Tensor  # nss_passes.camera_vector, [1, 4]
    reverse: bool
    frames: int  # since the reset, the newest included
    time: float = 0.5

    @property
    def output(self) -> tuple[int, int]:
        """(w, h)."""
        return self.displayed[0].shape[3], self.displayed[0].shape[2]

    @property
    def lane(self) -> tuple[int, int]:
        """(w, h)."""
        return self.flow.shape[3], self.flow.shape[2]


def read_pair(folder: Path, shown: int, previous: int, frames: int, camera: torch.Tensor, reverse: bool, time: float = 0.5) -> Pair:
    """From what `shale play --generate N --dump FOLDER` wrote of the generated picture with the number `shown`, between the rendered
    frames number `previous` and the next; `frames` as in Pair. Errors: OSError, ValueError."""

    def image(number: int, name: str) -> torch.Tensor:
        array = np.load(folder / f"{number:04d}.{name}.npy")
        if array.dtype == np.int32:
            return torch.from_numpy(array.view(np.uint32).astype(np.int64))[None, None]
        return torch.from_numpy(array).permute(2, 0, 1)[None].contiguous()

    def both(name: str, channels: int) -> tuple[torch.Tensor, torch.Tensor]:
        return tuple(image(number, name)[:, :channels] for number in (previous, shown))

    return Pair(image(shown, "filled"), image(shown, "flow_splat"), image(shown, "flow"), both("dilated_depth", 1),
                both("dilated_motion", 2), both("displayed", 3), camera, reverse, frames, time)


def displayed(exposed: torch.Tensor) -> torch.Tensor:
    """Exposed linear colour to what is mixed: the root of x / (1 + x)."""
    x = nss_passes.sanitise(exposed)
    return torch.sqrt(x / (1.0 + x))


def on_screen(uv: torch.Tensor) -> torch.Tensor:
    """`[n, 1, rows, columns]`."""
    return ((uv >= 0) & (uv < 1)).all(1, keepdim=True)


def _texel(uv: torch.Tensor, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Row and column of the texel at uv, `[n, rows, columns]`, inside."""
    h, w = image.shape[2:]
    x, y = torch.floor(uv[:, 0] * w).long(), torch.floor(uv[:, 1] * h).long()
    return y.clamp(0, h - 1), x.clamp(0, w - 1)


def _view_z(pair: Pair, depth: torch.Tensor) -> torch.Tensor:
    d = 1.0 - depth if pair.reverse else depth
    z = nss_passes.view_z(d, pair.camera)
    return torch.nan_to_num(z, nan=1e8, posinf=1e8, neginf=0.0).clamp(0.0, 1e8)


def _apart(za: torch.Tensor, zb: torch.Tensor) -> torch.Tensor:
    """Difference of view depths, 1 at the border of what is the same."""
    return (za - zb).abs() / (SAME_DEPTH * torch.minimum(za, zb))


def _way_back(word: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Rows and columns from a word's target to its source, `[n, rows, columns]`."""
    return (word & 1023)[:, 0] - 512, (word >> 10 & 1023)[:, 0] - 512


def _motion_before(pair: Pair, y: torch.Tensor, x: torch.Tensor, m1: torch.Tensor) -> torch.Tensor:
    """The previous frame's motion of texels of the newest one, as parabola.glsl has it."""
    if pair.frames < 3:
        return m1
    h, w = pair.depth[1].shape[2:]
    size = m1.new_tensor([w, h]).view(1, 2, 1, 1)
    uv = (torch.stack([x, y], 1) + 0.5) / size - m1
    from_y, from_x = _texel(uv, pair.depth[0])
    m0 = fetch(pair.motion[0], from_y, from_x)
    now, change = m1 * size, (m1 - m0) * size
    near = _apart(_view_z(pair, fetch(pair.depth[1], y, x)), _view_z(pair, fetch(pair.depth[0], from_y, from_x))) < 1.0
    even = (change**2).sum(1, keepdim=True) <= 0.25 * (now**2).sum(1, keepdim=True)
    return torch.where(on_screen(uv) & near & even, m0, m1)


def places(pair: Pair, uv: torch.Tensor, y: torch.Tensor, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Where the things at uv, in the texels y, x, are in the previous and in the newest frame; their depth, -1 if unknown."""
    t, word = pair.time, fetch(pair.filled, y, x)
    h, w = pair.filled.shape[2:]
    rows, columns = _way_back(word)
    known, is_previous = word != 0, (word & 1 << 20) != 0
    source = (y - rows).clamp(0, h - 1), (x - columns).clamp(0, w - 1)
    m1 = fetch(pair.motion[1], *source)
    m0 = _motion_before(pair, *source, m1)
    by_newest = uv - (0.5 * t * (m1 + m0) + 0.5 * t * t * (m1 - m0))
    even = torch.where(known, fetch(pair.motion[0], *source), fetch(pair.motion[0], y, x))
    evenly = ~known | is_previous
    before = torch.where(evenly, uv - t * even, by_newest)
    now = torch.where(evenly, uv + (1.0 - t) * even, by_newest + m1)
    depth = torch.where(is_previous, fetch(pair.depth[0], *source), fetch(pair.depth[1], *source))
    return before, now, torch.where(known, depth, torch.full_like(depth, -1.0))


def flow_at(pair: Pair, uv: torch.Tensor) -> torch.Tensor:
    """Motion in uv from the previous frame to the newest one: that of the pixel's own word, else of the nearest of 3x3, the first
    of equal ones."""
    w, h = pair.lane
    y, x = _texel(uv, pair.flow_splat)
    offsets = [((y + dy).clamp(0, h - 1), (x + dx).clamp(0, w - 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)]
    words = torch.cat([fetch(pair.flow_splat, *at) for at in offsets], 1)
    largest = words.max(1, keepdim=True).values
    first = torch.where(words[:, 4:5] != 0, torch.full_like(largest, 4), (words == largest).int().argmax(1, keepdim=True))
    nearest = words.gather(1, first)
    target = [torch.stack([at[axis] for at in offsets], 1).gather(1, first)[:, 0] for axis in (0, 1)]
    rows, columns = _way_back(nearest)
    flow = fetch(pair.flow, (target[0] - rows).clamp(0, h - 1), (target[1] - columns).clamp(0, w - 1))
    return torch.where(nearest == 0, torch.zeros_like(flow), flow / flow.new_tensor([w, h]).view(1, 2, 1, 1))


def four_at(pair: Pair, uv: torch.Tensor, before: torch.Tensor, now: torch.Tensor) -> tuple[list[torch.Tensor], torch.Tensor]:
    """uv of the four samples, and which of them are on the screen, 0 or 1, `[n, 4, rows, columns]`."""
    flow = flow_at(pair, uv)
    at = [before, now, uv - pair.time * flow, uv + (1.0 - pair.time) * flow]
    return at, torch.cat([on_screen(each) for each in at], 1).float()


def pre(pair: Pair) -> torch.Tensor:
    """The network's input in 0..1, `[1, 16, rows, columns]`, padded."""
    w, h = pair.lane
    lane = nss_passes.uv_grid(w, h, pair.flow)
    columns = torch.tensor(nss_passes.mirror_index(w, nss_passes.round_up(w)))
    rows = torch.tensor(nss_passes.mirror_index(h, nss_passes.round_up(h)))
    uv = lane[:, :, rows][:, :, :, columns]
    before, now, depth = places(pair, uv, *_texel(uv, pair.filled))
    at, seen = four_at(pair, uv, before, now)
    texel = uv.new_tensor([1.0 / pair.output[0], 1.0 / pair.output[1]]).view(1, 2, 1, 1)
    shifts = [texel * uv.new_tensor([x, y]).view(1, 2, 1, 1) for y in (-1, 1) for x in (-1, 1)]
    means = [sum(bilinear(pair.displayed[i % 2], at[i] + shift) for shift in shifts) / 4 for i in range(4)]
    colours = []
    for i in (0, 2):
        first, second = seen[:, i : i + 1], seen[:, i + 1 : i + 2]
        colours += [torch.where(first < second, means[i + 1], means[i]), torch.where(second < first, means[i], means[i + 1])]
    depths = [fetch(pair.depth[i], *_texel(at[i], pair.depth[i])) for i in (0, 1)]
    z = [_view_z(pair, d) for d in depths]
    splatted = torch.where(depth < 0, torch.maximum(*z), _view_z(pair, depth))
    hidden = [torch.where(seen[:, i : i + 1] > 0, (0.5 * _apart(z[i], splatted)).clamp(0.0, 1.0), torch.ones_like(z[i]))
              for i in (0, 1)]
    logs = [1.0 - torch.log(1200.0 * (1.0 - d) + 1.0) / math.log(1201.0) for d in depths]
    return torch.cat([*colours, *logs, *hidden], 1).clamp(0.0, 1.0)


def samples(pair: Pair) -> tuple[torch.Tensor, torch.Tensor]:
    """The four samples of each output pixel as displayed, `[1, 4, 3, H, W]`, and which of them count by time and screen,
    `[1, 4, H, W]`, up to a factor."""
    w, h = pair.output
    uv = nss_passes.uv_grid(w, h, pair.flow)
    # As the shader has it, in whole numbers.
    rows, columns = pair.filled.shape[2:]
    y = ((2 * torch.arange(h) + 1) * rows // (2 * h))[None, :, None].expand(1, h, w)
    x = ((2 * torch.arange(w) + 1) * columns // (2 * w))[None, None, :].expand(1, h, w)
    before, now, _ = places(pair, uv, y, x)
    at, seen = four_at(pair, uv, before, now)
    in_time = seen.new_tensor([1.0 - pair.time, pair.time] * 2).view(1, 4, 1, 1)
    counted = seen * in_time
    counted = torch.where(counted.sum(1, keepdim=True) > 0, counted, in_time.expand_as(counted))
    return torch.stack([nss_passes._catmull_rom(pair.displayed[i % 2], at[i]) for i in range(4)], 1), counted


def enlarged(logits: torch.Tensor, lane: tuple[int, int], output: tuple[int, int]) -> torch.Tensor:
    """Logits `[n, 4, rows, columns]` of the padded lane at each output pixel."""
    uv = nss_passes.uv_grid(*output, logits)
    return nss_passes.bilinear_padded(logits, uv, lane)


def post(logits: torch.Tensor, taken: torch.Tensor, counted: torch.Tensor) -> torch.Tensor:
    """The picture as displayed, `[n, 3, H, W]`: logits of each pixel `[n, 4, H, W]`, samples `[n, 4, 3, H, W]` and what each counts."""
    top = torch.where(counted > 0, logits, torch.full_like(logits, -1e3)).amax(1, keepdim=True)
    weights = torch.exp((logits - top.detach()).clamp(-60.0, 0.0)) * counted
    return ((weights / weights.sum(1, keepdim=True)).unsqueeze(2) * taken).sum(1)


def input_codes(values: torch.Tensor) -> torch.Tensor:
    """The int8 input of the network, NHWC."""
    codes = torch.floor(values * 255.0 + 0.5).clamp(0.0, 255.0) - 128.0
    return codes.to(torch.int8).permute(0, 2, 3, 1).contiguous()
