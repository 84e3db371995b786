"""The NSS passes around the network, in PyTorch: what the shaders of models/nss_* compute, and differentiable.

Three modes (`MODES`): v1_high, v1_low and v0_1. One frame is `pre` -> network -> `post`; `State` carries what the
next frame needs, `None` is a reset. Tensors are `[n, c, rows, columns]`. Source: section numbers of the NSS notes.

Conventions, the same in the shaders:
- Render size w x h, output W x H. Network size: v1_high and v0_1 the render size, v1_low ceil(render / 2); "padded"
  rounds it up to multiples of 8. Texel c >= size of the padded image is texel 2 * size - 1 - c (in general c mod
  2 * size, mirrored): of the input tensor and of the state images, too.
- Jitter j (x, y) in render pixels: texel l holds the scene position l + 0.5 + j. Motion m in uv, x right, y down:
  prev = uv - m. "Bilinear at r" is texel coordinate r * size - 0.5 with tap indices clamped to the image.
- Colour: NaN or negative -> 0, at most 65504, then x = min(e * c, 65504), all before any interpolation.
  T(x) = x / (1 + max); the inverse divides by 1 - min(max, 1 - 1e-7) and stops at 65504.
- The history is the previous output: linear, exposure removed, half floats. Pre passes: bilinear of the stored values,
  then e, then T. Post passes: every texel first becomes T(min(e * c, 65504)), then the interpolation.
- Motion shorter than or equal to 0.1 px is 0: render pixels in the pre passes, OUTPUT pixels in the post passes
  (v0_1: squared length 0.01). The pre pass stores where the nearest depth is; motion is fetched there.
- Nearest depth: centre first, then row by row; strictly nearer wins; taps clamp. Windows: v1 -1..2, v0_1 -1..1.
- Sparse kernel: `tap_table`. Channel (dy - first) + K * (dx - first), first = -2 (K = 6) or -1 (K = 4).
- POST PASSES WORK IN T-MAPPED COLOUR (`Mode.tonemapped`), unlike the notes, which filter exposed linear colour: samples
  c = T(min(e * colour, 65504)), m1 and m2 their moments, history H interpolated between T-mapped texels and clamped to
  0..1, sigma, clamp and lerps as in 3.3 and 3.4, the centre mixed as lerp(R, T(centre), alpha) with no further
  conversion, and output = Tinv(result) / e. Measured on a first frame: +0.1 to +0.7 dB, +3.4 dB at night, because the
  truth is averaged after T. An output pixel without a centre sample shows Tinv(R) / e. With False the notes' way is
  computed: everything linear, only the centre is mixed between T(R) and T(centre).

Choices of ours where the notes leave room:
- v1 scatter and low-resolution disocclusion: each block's nearest texel (row order, strictly nearer) gives depth and
  motion; the scattered position is the centre uv of the SCATTER texel, that is of the block, minus this motion (the
  nearest texel's own centre would smear static edges towards the first texel of each block). Blocks at the border
  clamp. Taps outside the image are dropped. Texel uv is always (c + 0.5) / size of the image it belongs to.
- v1_low disocclusion: uv of the low-resolution texel minus the motion of its nearest texel; the view-depth range
  of the block is added to req; stored as R8_UNORM; the pre pass reads it bilinearly at uv.
- v1_low: history lanes are reprojected and T-mapped one by one, then averaged. Feedback, instability, motion detector
  use the lane with the nearest dilated depth (lanes (0,0), (1,0), (0,1), (1,1); strictly nearer wins).
- Instability: neighbours are the current colours of the four neighbouring network texels, clamped. The previous
  state is bilinear in the dequantised SNORM values. The moire and flat-blue gates are left out.
- Reset (state None): history, feedback and states count as 0, theta and the history are off (v1 shows the filtered
  colour exactly, v0_1 still applies alpha).
- v0_1: colour is read at the exact texel; the luma state, feedback and history are bilinear at r; the previous dilated
  depth lives at render size and is read at r - j_prev / size.
- Depth clip: eps = 2^-23 (infinite far plane); `Frame.full` is the size behind "length(render)".
Gradients: through the network outputs, the history colours and the feedback; everything else is constant.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field

import torch
import torch.nn.functional as F

HALF_MAX = 65504.0
EPSILON = 2.0**-23


@dataclass(frozen=True)
class Mode:
    """What distinguishes the variants. Sizes in texels per axis."""

    name: str
    generation: int
    divisor: int  # render texels per network texel
    scatter: int  # render texels per texel of the depth scatter (v1)
    kernel: int  # kernel width, output pixels
    max_taps: int
    weight_floor: float
    kpn_shift: int  # render texel index >> shift = KPN texel index (v1)
    catmull_rom: bool = True
    tonemapped: bool = True  # post pass in T-mapped colours; False is the notes' exposed linear colour

    @property
    def first(self) -> int:
        """Smallest kernel offset."""
        return 1 - self.kernel // 2

    def network_size(self, w: int, h: int) -> tuple[int, int]:
        """Width and height of the network image without padding."""
        return -(-w // self.divisor), -(-h // self.divisor)


MODES = {
    mode.name: mode
    for mode in (
        Mode("v1_high", 1, 1, 2, 6, 9, 1e-7, 2),
        Mode("v1_low", 1, 2, 4, 4, 4, 6.1e-5, 3, catmull_rom=False),
        Mode("v0_1", 0, 1, 0, 4, 16, 1e-7, 0),
    )
}


@dataclass
class Frame:
    """One rendered frame. camera: D of section 2.1, `[n, 4]`; full: (w, h) of the whole picture if this is a crop."""

    colour: torch.Tensor  # [n, 3, h, w] linear
    depth: torch.Tensor  # [n, 1, h, w] as stored
    motion: torch.Tensor  # [n, 2, h, w] uv (x, y) of THIS picture
    jitter: tuple[float, float]
    exposure: torch.Tensor  # [n, 1, 1, 1]
    camera: torch.Tensor
    reverse: bool = False
    full: tuple[int, int] | None = None

    @property
    def size(self) -> tuple[int, int]:
        """(w, h)."""
        return self.colour.shape[3], self.colour.shape[2]


@dataclass
class State:
    """What a frame leaves to the next one. history `[n, 3, H, W]`; feedback `[n, 4, padded]` in 0..1; memory: v1
    instability `[n, 4, padded]` (SNORM values), v0_1 luma `[n, 2, padded]`; depth, jitter: v0_1 only."""

    history: torch.Tensor
    feedback: torch.Tensor
    memory: torch.Tensor
    depth: torch.Tensor | None = None
    jitter: tuple[float, float] = (0.0, 0.0)

    def detached(self) -> "State":
        """The same values without their past."""
        return State(self.history.detach(), self.feedback.detach(), self.memory, self.depth, self.jitter)


@dataclass
class Pre:
    """Result of the pre passes. input `[n, 12, padded]` in 0..1; motion: raw uv motion at the nearest depth,
    `[n, 2, h, w]`; disocclusion at network size."""

    input: torch.Tensor
    motion: torch.Tensor
    disocclusion: torch.Tensor
    memory: torch.Tensor
    depth: torch.Tensor


@dataclass
class Post:
    """Result of the post pass. output: linear, exposure removed; filtered: linear, exposed; both `[n, 3, H, W]`."""

    output: torch.Tensor
    filtered: torch.Tensor
    theta: torch.Tensor
    alpha: torch.Tensor
    extra: dict = field(default_factory=dict)


# ---- arithmetic shared by the passes ----------------------------------------------------------------------


def sanitise(colour: torch.Tensor) -> torch.Tensor:
    """NaN and negative values to 0, at most 65504."""
    return torch.nan_to_num(colour, nan=0.0, posinf=HALF_MAX, neginf=0.0).clamp(0.0, HALF_MAX)


def karis(x: torch.Tensor) -> torch.Tensor:
    """T: exposed linear colour to 0..1."""
    return x / (1.0 + x.amax(dim=1, keepdim=True))


def karis_inverse(x: torch.Tensor) -> torch.Tensor:
    """Inverse of `karis`."""
    return (x / (1.0 - x.amax(dim=1, keepdim=True).clamp(max=1.0 - 1e-7))).clamp(max=HALF_MAX)


def camera_vector(fov_x: float, fov_y: float, near: float, far: float, reverse: bool) -> list[float]:
    """D of section 2.1: view z = D1 / (depth - D0). far <= 0 is infinite; angles in radians."""
    infinite = far <= 0
    low, high = (far, near) if reverse else (near, far)
    if infinite:
        c, k = (EPSILON, near) if reverse else (-1.0 - EPSILON, -near - EPSILON)
    else:
        q = high / (low - high)
        c, k = q, q * low
    return [-c, k, math.tan(fov_x / 2), math.tan(fov_y / 2)]


def view_z(depth: torch.Tensor, camera: torch.Tensor) -> torch.Tensor:
    """View-space distance of stored depth `[n, ...]`."""
    d = camera.view(-1, 4, *([1] * (depth.dim() - 1)))
    return d[:, 1] / (depth - d[:, 0])


def uv_grid(w: int, h: int, like: torch.Tensor) -> torch.Tensor:
    """(c + 0.5) / size of every texel: `[1, 2, h, w]`."""
    x = (torch.arange(w, dtype=torch.float32, device=like.device) + 0.5) / w
    y = (torch.arange(h, dtype=torch.float32, device=like.device) + 0.5) / h
    return torch.stack([x[None, :].expand(h, w), y[:, None].expand(h, w)])[None]


def bilinear(image: torch.Tensor, r: torch.Tensor) -> torch.Tensor:
    """Bilinear samples at uv `r` `[n, 2, rows, columns]`, clamped to the border."""
    grid = r.permute(0, 2, 3, 1) * 2.0 - 1.0
    return F.grid_sample(image, grid.expand(image.shape[0], -1, -1, -1), padding_mode="border", align_corners=False)


def bilinear_padded(image: torch.Tensor, r: torch.Tensor, size: tuple[int, int]) -> torch.Tensor:
    """`bilinear` in a padded image at uv of its un-padded part, (w, h)."""
    ratio = r.new_tensor([size[0] / image.shape[3], size[1] / image.shape[2]]).view(1, 2, 1, 1)
    return bilinear(image, r * ratio)


def fetch(image: torch.Tensor, y: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Texels image[n, :, y, x] for indices `[n, rows, columns]`, clamped."""
    n, c, h, w = image.shape
    index = y.clamp(0, h - 1) * w + x.clamp(0, w - 1)
    flat = index.view(n, 1, -1).expand(n, c, -1)
    return image.reshape(n, c, h * w).gather(2, flat).view(n, c, *index.shape[1:])


def mirror_index(size: int, padded: int) -> list[int]:
    """Source texel of every texel of a padded axis."""
    out = []
    for c in range(padded):
        c %= 2 * size
        out.append(c if c < size else 2 * size - 1 - c)
    return out


def round_up(value: int, step: int = 8) -> int:
    """The next multiple of `step`."""
    return -(-value // step) * step


def mirror_pad(image: torch.Tensor) -> torch.Tensor:
    """To multiples of 8 at the right and bottom, by mirroring."""
    h, w = image.shape[2:]
    if w % 8:
        image = image[:, :, :, mirror_index(w, round_up(w))]
    if h % 8:
        image = image[:, :, mirror_index(h, round_up(h))]
    return image


def nearest_depth(depth: torch.Tensor, window: range, reverse: bool) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Nearest depth of the window around each texel: depth `[n, 1, h, w]` and its texel (y, x), each `[n, h, w]`."""
    n, _, h, w = depth.shape
    low, high = -window[0], window[-1]
    padded = F.pad(depth, (low, high, low, high), mode="replicate")
    padded = -padded if reverse else padded
    best = padded[:, :, low : low + h, low : low + w].clone()
    code = torch.zeros_like(best)
    offsets = [(dy, dx) for dy in window for dx in window if (dy, dx) != (0, 0)]
    for index, (dy, dx) in enumerate(offsets, start=1):
        tap = padded[:, :, low + dy : low + dy + h, low + dx : low + dx + w]
        code.masked_fill_(tap < best, index)
        torch.minimum(best, tap, out=best)
    table = torch.tensor([(0, 0)] + offsets, device=depth.device)[code[:, 0].long()]
    y = (torch.arange(h, device=depth.device)[:, None] + table[..., 0]).clamp(0, h - 1)
    x = (torch.arange(w, device=depth.device)[None, :] + table[..., 1]).clamp(0, w - 1)
    return (-best if reverse else best), y, x


def block_nearest(depth: torch.Tensor, block: int, reverse: bool) -> tuple[torch.Tensor, ...]:
    """Nearest depth of each block: depth `[n, 1, ceil(h/b), ceil(w/b)]`, its texel (y, x), view order aside also
    the farthest depth of the block."""
    n, _, h, w = depth.shape
    rows, columns = -(-h // block), -(-w // block)
    padded = F.pad(depth, (0, columns * block - w, 0, rows * block - h), mode="replicate")
    padded = -padded if reverse else padded
    cells = padded.view(n, 1, rows, block, columns, block)
    best = cells[:, :, :, 0, :, 0].clone()
    worst, code = best.clone(), torch.zeros_like(best)
    for dy in range(block):
        for dx in range(block):
            tap = cells[:, :, :, dy, :, dx]
            code.masked_fill_(tap < best, dy * block + dx)
            torch.minimum(best, tap, out=best)
            torch.maximum(worst, tap, out=worst)
    code = code[:, 0].long()
    y = torch.arange(rows, device=depth.device)[:, None] * block + torch.div(code, block, rounding_mode="floor")
    x = torch.arange(columns, device=depth.device)[None, :] * block + code % block
    if reverse:
        best, worst = -best, -worst
    return best, y.clamp(max=h - 1), x.clamp(max=w - 1), worst


def cut_short_motion(motion: torch.Tensor, w: int, h: int) -> torch.Tensor:
    """Motion of at most 0.1 pixel of a w x h picture becomes 0."""
    px, py = motion[:, 0:1] * w, motion[:, 1:2] * h
    return motion * (torch.sqrt(px * px + py * py) > 0.1)


def _bilinear_taps(r: torch.Tensor, w: int, h: int):
    """Four (y, x, weight, inside) of a bilinear fetch at uv `r`."""
    px, py = r[:, 0] * w - 0.5, r[:, 1] * h - 0.5
    x0, y0 = torch.floor(px), torch.floor(py)
    fx, fy = px - x0, py - y0
    x0, y0 = x0.long(), y0.long()
    for dy, wy in ((0, 1.0 - fy), (1, fy)):
        for dx, wx in ((0, 1.0 - fx), (1, fx)):
            y, x = y0 + dy, x0 + dx
            yield y, x, wy * wx, (y >= 0) & (y < h) & (x >= 0) & (x < w)


def scatter_depth(frame: Frame, block: int) -> tuple[torch.Tensor, tuple]:
    """2.4 b: `[n, 1, ceil(h/b), ceil(w/b)]`, what the current surfaces looked like one frame ago; and the blocks."""
    blocks = block_nearest(frame.depth, block, frame.reverse)
    depth, y, x, _ = blocks
    n, _, rows, columns = depth.shape
    w, h = frame.size
    motion = cut_short_motion(fetch(frame.motion, y, x), w, h)
    position = uv_grid(columns, rows, depth) - motion
    # uint(depth * (2^31 - 1)) in 32-bit arithmetic multiplies by 2^31; the clear value reads back as 1 or 0.
    value = torch.floor(depth[:, 0] * 2.0**31) / 2.0**31
    size = rows * columns
    flat = depth.new_full((n * (size + 1),), 0.0 if frame.reverse else 1.0)
    base = (torch.arange(n, device=depth.device) * (size + 1)).view(n, 1, 1)
    for ty, tx, weight, inside in _bilinear_taps(position, columns, rows):
        index = torch.where(inside & (weight > 0.1), ty * columns + tx, torch.full_like(ty, size)) + base
        flat.scatter_reduce_(0, index.reshape(-1), value.reshape(-1), "amax" if frame.reverse else "amin")
    return flat.view(n, size + 1)[:, :size].reshape(n, 1, rows, columns), blocks


def depth_clip(previous: torch.Tensor, r: torch.Tensor, z: torch.Tensor, frame: Frame, tolerance=0.0) -> torch.Tensor:
    """2.2: disocclusion `[n, 1, rows, columns]`; previous depth image, uv in it, current z `[n, rows, columns]`."""
    rows, columns = previous.shape[2:]
    fw, fh = frame.full or frame.size
    length = math.hypot(fw, fh)
    power = 1.0 + 2.0 * min(length / math.hypot(1920, 1080), 1.0)
    d = frame.camera
    scale = (1.37e-5 * length * torch.sqrt(d[:, 2] ** 2 + d[:, 3] ** 2 + 1.0)).view(-1, 1, 1)
    z_image = view_z(previous[:, 0], d)[:, None]
    kept, total = torch.zeros_like(z), torch.zeros_like(z)
    for y, x, weight, inside in _bilinear_taps(r, columns, rows):
        z_previous = fetch(z_image, y, x)[:, 0]
        difference = z - z_previous
        counts = inside & (weight > 0.1) & (difference > 0)
        required = scale * torch.maximum(z, z_previous) + tolerance
        closeness = (required / difference.clamp(min=1e-30)).clamp(0.0, 1.0) ** power
        kept += torch.where(counts, weight * closeness, torch.zeros_like(kept))
        total += torch.where(counts | ~inside, weight, torch.zeros_like(total))
    mask = torch.where(total > 0, (1.0 - kept / total.clamp(min=1e-30)).clamp(0.0, 1.0), torch.zeros_like(total))
    return mask[:, None]


def snorm8(x: torch.Tensor) -> torch.Tensor:
    """What an 8-bit SNORM store keeps."""
    return torch.floor(x.clamp(-1.0, 1.0) * 127.0 + 0.5) / 127.0


def unorm8(x: torch.Tensor) -> torch.Tensor:
    """What an 8-bit UNORM store keeps."""
    return torch.floor(x.clamp(0.0, 1.0) * 255.0 + 0.5) / 255.0


# ---- instability, section 2.5 -----------------------------------------------------------------------------


def work_colour(exposed: torch.Tensor) -> torch.Tensor:
    """(Y, Co, Cg) of the square root of exposed linear colour."""
    r, g, b = torch.sqrt(exposed.clamp(min=0.0)).unbind(1)
    co = r - b
    t = b + co * 0.5
    cg = g - t
    return torch.stack([t + cg * 0.5, co, cg], 1)


def _distance(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    d = (a - b) ** 2
    return torch.sqrt(d[:, 0:1] + 1.5625 * (d[:, 1:2] + d[:, 2:3]))


def _ramp(x: torch.Tensor, low: float, high: float) -> torch.Tensor:
    return ((x - low) / (high - low)).clamp(0.0, 1.0)


def _lerp(a, b, t):
    return a + (b - a) * t


def instability(current: torch.Tensor, state: torch.Tensor, disoccluded: torch.Tensor):
    """current (Y, Co, Cg), reprojected SNORM state: channel 11 and the new state, un-padded."""
    previous = torch.cat([(state[:, 0:1] + 1.0) * 4.0, state[:, 1:3] * 8.0], 1)
    p = (state[:, 3:4] + 1.0) * 0.5
    around = F.pad(current, (1, 1, 1, 1), mode="replicate")
    h, w = current.shape[2:]
    four = torch.cat([
        _distance(current, around[:, :, y : y + h, x : x + w]) for y, x in ((0, 1), (2, 1), (1, 2), (1, 0))
    ], 1)
    support = (four.sum(1, keepdim=True) - four.amax(1, keepdim=True)).clamp(min=0.0) / 3.0
    s = 0.75 * _lerp(_distance(current, previous), support, 0.30)
    recall = _ramp(s, 0.065, 0.42)
    mean = _ramp(s, 0.07, 0.23)
    entry = torch.sqrt(recall) * torch.sqrt(_ramp((s - p).clamp(min=0.0), 0.025, 0.16)) * mean
    heat = _ramp(p, 0.11, 0.21)
    floor, ceiling = _lerp(0.177, 0.157, heat), _lerp(0.33, 0.305, heat)
    sg = ((_lerp(p, s, 0.3) - floor) / (ceiling - floor)).clamp(0.0, 1.0) ** 2
    hold = 0.12 * _ramp(p, 0.18, 0.28) ** 2
    raw = torch.maximum(entry, 0.8 * p * torch.maximum(sg, hold))
    decay = torch.maximum(sg, 0.5 * heat * heat)
    rate = torch.where(raw > p, _lerp(0.08, 0.22, torch.sqrt(recall * mean)), _lerp(0.24, 0.05, decay))
    new = _lerp(p, raw, rate)
    visible = _lerp(p, new, torch.where(new > p, torch.full_like(p, 0.75), torch.full_like(p, 0.80)))
    fresh = disoccluded | (state.abs().sum(1, keepdim=True) < 1e-4)
    new, visible = new.masked_fill(fresh, 0.0), visible.masked_fill(fresh, 0.0)
    stored = torch.cat([current[:, 0:1] / 4.0 - 1.0, current[:, 1:3] / 8.0, 2.0 * new - 1.0], 1)
    return visible, snorm8(stored)


# ---- pre passes -------------------------------------------------------------------------------------------


def pre(mode: Mode, frame: Frame, state: State | None) -> Pre:
    """The input tensor and what the post pass and the next frame need."""
    return _pre_v1(mode, frame, state) if mode.generation else _pre_v0(frame, state)


def _exposed(frame: Frame) -> torch.Tensor:
    return (frame.colour * frame.exposure).clamp(max=HALF_MAX)


def _history_channels(state: State | None, frame: Frame, r: torch.Tensor) -> torch.Tensor:
    if state is None:
        return r.new_zeros(r.shape[0], 3, *r.shape[2:])
    return karis((bilinear(state.history, r) * frame.exposure).clamp(0.0, HALF_MAX))


def _jitter_uv(frame: Frame, jitter: tuple[float, float]) -> torch.Tensor:
    w, h = frame.size
    return frame.colour.new_tensor([jitter[0] / w, jitter[1] / h]).view(1, 2, 1, 1)


def _pre_v1(mode: Mode, frame: Frame, state: State | None) -> Pre:
    w, h = frame.size
    n = frame.colour.shape[0]
    nw, nh = mode.network_size(w, h)
    fw, fh = frame.full or frame.size
    with torch.no_grad():
        exposed = _exposed(frame)
        scattered, blocks = scatter_depth(frame, mode.scatter)
        depth, ny, nx = nearest_depth(frame.depth, range(-1, 3), frame.reverse)
        raw = fetch(frame.motion, ny, nx)
        lanes = cut_short_motion(raw, w, h)
        uv = uv_grid(nw, nh, depth)
        if mode.divisor == 1:
            motion, r_history = lanes, uv - lanes
            disocclusion = depth_clip(scattered, r_history, view_z(depth[:, 0], frame.camera), frame)
        else:
            disocclusion = bilinear(_low_disocclusion(frame, scattered, blocks), uv.expand(n, -1, -1, -1))
            _, ly, lx, _ = block_nearest(depth, 2, frame.reverse)
            motion = fetch(lanes, ly, lx)
            r_history = uv_grid(w, h, depth) - lanes
        r = uv - motion
        disoccluded = disocclusion > 0.01
        now = bilinear(exposed, (uv - _jitter_uv(frame, frame.jitter)).expand(n, -1, -1, -1))
        unit = math.hypot(1.0 / fw, 1.0 / fh)
        speed = torch.sqrt((motion[:, 0:1] * (w / fw)) ** 2 + (motion[:, 1:2] * (h / fh)) ** 2)
        detector = torch.sqrt((speed.clamp(unit, 200 * unit) - unit) / (199 * unit))
        if state is None:
            memory = torch.zeros_like(now[:, 0:1]).expand(-1, 4, -1, -1)
        else:
            memory = bilinear_padded(state.memory, r, (nw, nh))
        visible, memory = instability(work_colour(now), memory, disoccluded)
    history = _history_channels(state, frame, r_history)
    if mode.divisor == 2:
        history = F.avg_pool2d(F.pad(history, (0, w % 2, 0, h % 2), mode="replicate"), 2)
    if state is None:
        feedback = torch.zeros_like(memory)
    else:
        feedback = bilinear_padded(state.feedback, r, (nw, nh)).masked_fill(disoccluded, 0.0)
    tensor = torch.cat([history, karis(now), detector, feedback, visible], 1)
    return Pre(mirror_pad(tensor), raw, disocclusion, mirror_pad(memory), depth)


def _low_disocclusion(frame: Frame, scattered: torch.Tensor, blocks: tuple) -> torch.Tensor:
    """2.4 c at ceil(render / 4), as R8_UNORM keeps it."""
    depth, y, x, farthest = blocks
    w, h = frame.size
    z, z_far = view_z(depth[:, 0], frame.camera), view_z(farthest[:, 0], frame.camera)
    motion = cut_short_motion(fetch(frame.motion, y, x), w, h)
    r = uv_grid(depth.shape[3], depth.shape[2], depth) - motion
    return unorm8(depth_clip(scattered, r, z, frame, tolerance=z_far - z))


def _pre_v0(frame: Frame, state: State | None) -> Pre:
    w, h = frame.size
    n = frame.colour.shape[0]
    with torch.no_grad():
        depth, ny, nx = nearest_depth(frame.depth, range(-1, 2), frame.reverse)
        raw = fetch(frame.motion, ny, nx)
        squared = (raw[:, 0:1] * w) ** 2 + (raw[:, 1:2] * h) ** 2
        motion = raw * (squared > 0.01)
        uv = uv_grid(w, h, depth)
        r = uv - motion
        if state is None:
            disocclusion = torch.zeros_like(depth)
        else:
            earlier = r - _jitter_uv(frame, state.jitter)
            disocclusion = depth_clip(state.depth, earlier, view_z(depth[:, 0], frame.camera), frame)
        moved = (motion[:, 0:1] * w) ** 2 + (motion[:, 1:2] * h) ** 2
        disocclusion = torch.where(moved <= 0.25, disocclusion * 0.725223958, disocclusion)
        now = karis(_exposed(frame))
        luma = 0.2126 * now[:, 0:1] + 0.7152 * now[:, 1:2] + 0.0722 * now[:, 2:3]
        if state is None:
            memory = torch.zeros_like(luma).expand(-1, 2, -1, -1)
        else:
            memory = bilinear_padded(state.memory, r, (w, h))
        change = (luma - memory[:, 1:2]).abs()
        change = (change.masked_fill(change < 0.05, 0.0).clamp(max=0.3) / 0.3) ** 1.5
        level = memory[:, 0:1]
        level = _lerp(level, change, _lerp(0.1, 0.01, level.clamp(0.0, 0.3) / 0.3))
        level = level.masked_fill(disocclusion > 0.01, 0.0)
        memory = unorm8(torch.cat([level, luma], 1))
    history = _history_channels(state, frame, r)
    if state is None:
        feedback = now.new_zeros(n, 4, h, w)
    else:
        feedback = bilinear_padded(state.feedback, r, (w, h))
    tensor = torch.cat([history, now, disocclusion, feedback, level], 1)
    return Pre(mirror_pad(tensor), raw, disocclusion, mirror_pad(memory), depth)


# ---- sparse kernel, section 3.2 ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Tap:
    """lr: texel relative to the first one of the tile (x, y); offset: kernel offset (x, y)."""

    lr: tuple[int, int]
    offset: tuple[int, int]
    channel: int

    @property
    def centre(self) -> bool:
        """The sample lies on the output pixel itself."""
        return self.offset == (0, 0)


@dataclass(frozen=True)
class TapTable:
    """taps[ay][ax] for every cell of the tile: `tile` output pixels over `step` render texels, both (x, y).

    A cell without a valid tap holds one tap with channel -1: the nearest sample, weight 1.
    """

    tile: tuple[int, int]
    step: tuple[int, int]
    taps: tuple[tuple[tuple[Tap, ...], ...], ...]


def _axis_cells(w: int, big: int, jitter: float, first: int,
                kernel: int) -> tuple[int, int, list[dict[int, int]], list[int]]:
    """Tile, step; for each output pixel of the tile the texel of every valid offset; and the nearest texel."""
    divisor = math.gcd(w, big)
    tile, step = big // divisor, w // divisor
    j = math.floor(jitter * 65536 + 0.5)
    span = range(-(kernel + 2) * step // tile - 3, step + (kernel + 2) * step // tile + 4)
    cells = {((2 * l + 1) * 32768 + j) * big // (w * 65536): l for l in reversed(span)}
    valid = [{d: cells[o + d] for d in range(first, first + kernel) if o + d in cells} for o in range(tile)]
    closest = [((2 * o + 1) * w * 65536 - 2 * big * j) // (2 * big * 65536) for o in range(tile)]
    return tile, step, valid, closest


@functools.lru_cache(maxsize=256)
def tap_table(mode: Mode, render: tuple[int, int], output: tuple[int, int], jitter: tuple[float, float]) -> TapTable:
    """Which kernel channels meet a sample, exactly: sample l is in cell floor(((2l+1) 32768 + J) W / (w 65536)),
    J = floor(65536 j + 0.5). Candidates by growing dx^2 + dy^2, then dy, then dx; the first `max_taps` stay. Should
    two samples share a cell (ratio below 1), the first one counts."""
    k, first = mode.kernel, mode.first
    tw, sw, columns, near_x = _axis_cells(render[0], output[0], jitter[0], first, k)
    th, sh, rows, near_y = _axis_cells(render[1], output[1], jitter[1], first, k)
    order = sorted(((dx, dy) for dy in range(first, first + k) for dx in range(first, first + k)),
                   key=lambda d: (d[0] ** 2 + d[1] ** 2, d[1], d[0]))
    table = []
    for ay in range(th):
        line = []
        for ax in range(tw):
            taps = [Tap((columns[ax][dx], rows[ay][dy]), (dx, dy), (dy - first) + k * (dx - first))
                    for dx, dy in order if dx in columns[ax] and dy in rows[ay]]
            line.append(tuple(taps[: mode.max_taps]) or (Tap((near_x[ax], near_y[ay]), (k, k), -1),))
        table.append(tuple(line))
    return TapTable((tw, th), (sw, sh), tuple(table))


class _SparseMean(torch.autograd.Function):
    """Per tile cell the weighted mean of the values at its taps; gradient to the weights only.

    weights `[n, K*K, ...]` and values `[n, 1 + c, ...]` (channel 0 is 1) are padded; places: per cell a list of
    (channel, slices of the weights, slices of the values). Returns `[n, c, rows, columns]` per cell. Channel -1 has
    weight 1.
    """

    @staticmethod
    def forward(ctx, weights, values, places):
        means, inverses = [], []
        for taps in places:
            total = None
            for channel, where, at in taps:
                value = values[(slice(None), slice(None), *at)]
                if channel < 0:
                    total = value.clone()
                    continue
                weight = weights[(slice(None), slice(channel, channel + 1), *where)]
                if total is None:
                    total = weight * value
                else:
                    total.addcmul_(weight, value)
            inverses.append(1.0 / total[:, 0:1])
            means.append(total[:, 1:] * inverses[-1])
        ctx.save_for_backward(values, *means, *inverses)
        ctx.places, ctx.shape = places, weights.shape
        return tuple(means)

    @staticmethod
    def backward(ctx, *gradients):
        values, *rest = ctx.saved_tensors
        count = len(ctx.places)
        out = values.new_zeros(ctx.shape)
        for taps, gradient, mean, inverse in zip(ctx.places, gradients, rest[:count], rest[count:]):
            gradient = torch.cat([-(gradient * mean).sum(1, keepdim=True), gradient], 1) * inverse
            for channel, where, at in taps:
                if channel >= 0:
                    value = values[(slice(None), slice(None), *at)]
                    out[(slice(None), channel, *where)] += (gradient * value).sum(1)
        return out, None, None


class _Enlarge(torch.autograd.Function):
    """Every texel `block` times in both axes."""

    @staticmethod
    def forward(ctx, image, block):
        ctx.block = block
        n, c, h, w = image.shape
        return image.reshape(n, c, h, 1, w, 1).expand(n, c, h, block, w, block).reshape(n, c, h * block, w * block)

    @staticmethod
    def backward(ctx, gradient):
        return F.avg_pool2d(gradient, ctx.block) * float(ctx.block**2), None


class _ClampAround(torch.autograd.Function):
    """x clamped to centre +- reach."""

    @staticmethod
    def forward(ctx, x, centre, reach):
        low, high = centre - reach, centre + reach
        ctx.save_for_backward(x < low, x > high)
        return torch.minimum(torch.maximum(x, low), high)

    @staticmethod
    def backward(ctx, gradient):
        below, above = ctx.saved_tensors
        outside = below | above
        at_edge = gradient * outside
        return gradient - at_edge, at_edge, torch.where(above, at_edge, -at_edge)


def interleave(cells: list[list[torch.Tensor]]) -> torch.Tensor:
    """Cells [ay][ax] of `[n, c, rows, columns]` to one picture."""
    lines = [torch.stack(line, dim=4).flatten(3) for line in cells]
    return torch.stack(lines, dim=3).flatten(2, 3)


def sparse_filter(mode: Mode, frame: Frame, table: TapTable, kernel: torch.Tensor, output: tuple[int, int]):
    """3.2: filtered colour and, for v1, its second moment, exposed; and the centre samples.

    kernel: v1 `[n, K*K, KPN size]`; v0_1 `[n, 16, padded]` (K0 to K3 joined). Returns (m1, m2, centres) with centres
    a list of (ay, ax, colours of that cell).
    """
    w, h = frame.size
    (tw, th), (sw, sh) = table.tile, table.step
    rows, columns = output[1] // th, output[0] // tw
    exposed = karis(_exposed(frame)) if mode.tonemapped else _exposed(frame)
    planes = [torch.ones_like(exposed[:, :1]), exposed] + ([exposed * exposed] if mode.generation else [])
    reach = [part for line in table.taps for taps in line for tap in taps for part in (*tap.lr, -tap.lr[0], -tap.lr[1])]
    m = max(reach) + 1
    values = F.pad(torch.cat(planes, 1), (m, m, m, m), mode="replicate")
    if mode.generation:
        block = 1 << mode.kpn_shift
        rim = -(-m // block)
        kernel = kernel[:, :, : -(-h // block), : -(-w // block)].clamp(min=mode.weight_floor).contiguous()
        weights = _Enlarge.apply(F.pad(kernel, (rim, rim, rim, rim), mode="replicate"), block)
        shift = rim * block - m
    else:
        weights = upsample(kernel, frame.size, output).clamp(min=mode.weight_floor)
        shift = 0

    def place(tap: Tap, more: int = 0) -> tuple[slice, slice]:
        y, x = m + more + tap.lr[1], m + more + tap.lr[0]
        return slice(y, y + (rows - 1) * sh + 1, sh), slice(x, x + (columns - 1) * sw + 1, sw)

    places, centres = [], []
    for ay in range(th):
        for ax in range(tw):
            own = (slice(ay, None, th), slice(ax, None, tw))
            places.append([(tap.channel, place(tap, shift) if mode.generation else own, place(tap))
                           for tap in table.taps[ay][ax]])
            centres += [(ay, ax, values[(slice(None), slice(1, 4), *place(tap))])
                        for tap in table.taps[ay][ax] if tap.centre]
    means = _SparseMean.apply(weights, values, places)
    moments = interleave([means[ay * tw : (ay + 1) * tw] for ay in range(th)])
    m1, m2 = moments.split(3, 1) if mode.generation else (moments, None)
    return m1, m2, centres


def upsample(image: torch.Tensor, size: tuple[int, int], output: tuple[int, int]) -> torch.Tensor:
    """Padded image of `size` (w, h) bilinearly at the uv of all output pixels."""
    scale = (output[1] / size[1], output[0] / size[0])
    wide = F.interpolate(image, scale_factor=scale, mode="bilinear", align_corners=False)
    return wide[:, :, : output[1], : output[0]]


# ---- history ----------------------------------------------------------------------------------------------


NO_OVERSHOOT = 0.875  # kNoOvershoot of shaders/include/color.glsl


def _catmull_rom(image: torch.Tensor, r: torch.Tensor) -> torch.Tensor:
    """Five-tap Catmull-Rom without corners, with dering (3.1)."""
    h, w = image.shape[2:]
    size = r.new_tensor([w, h]).view(1, 2, 1, 1)
    position = r * size - 0.5
    base = torch.floor(position)
    f = position - base
    f2 = f * f
    f3 = f2 * f
    w0 = f2 - 0.5 * (f3 + f)
    w1 = 1.5 * f3 - 2.5 * f2 + 1.0
    w3 = 0.5 * (f3 - f2)
    w2 = 1.0 - w0 - w1 - w3
    w12 = w1 + w2
    centre = (base + 0.5 + w2 / w12) / size
    low, high = (base - 0.5) / size, (base + 2.5) / size
    places = ((centre, centre, w12, w12), (low, centre, w0, w12), (high, centre, w3, w12),
              (centre, low, w12, w0), (centre, high, w12, w3))
    result, total, taps = 0.0, 0.0, []
    for px, py, wx, wy in places:
        tap = bilinear(image, torch.cat([px[:, :1], py[:, 1:]], 1))
        weight = wx[:, :1] * wy[:, 1:]
        taps.append(tap)
        result = result + tap * weight
        total = total + weight
    result = result / total
    n, y, x = ((result < 0) | (result > NO_OVERSHOOT)).any(1).nonzero(as_tuple=True)
    if len(n):  # few pixels
        near = torch.stack([tap[n, :, y, x] for tap in taps])
        result[n, :, y, x] = torch.minimum(torch.maximum(result[n, :, y, x], near.amin(0)), near.amax(0))
    return result


class _CatmullRom(torch.autograd.Function):
    """`_catmull_rom` forwards; backwards as if bilinear, a fifth of the work."""

    @staticmethod
    def forward(ctx, image, r):
        ctx.save_for_backward(image, r)
        return _catmull_rom(image, r)

    @staticmethod
    def backward(ctx, gradient):
        image, r = ctx.saved_tensors
        grid = r.permute(0, 2, 3, 1) * 2.0 - 1.0
        return torch.ops.aten.grid_sampler_2d_backward(gradient, image, grid, 0, 1, False, [True, False])[0], None


def output_motion(raw: torch.Tensor, output: tuple[int, int]) -> torch.Tensor:
    """uv motion of every output pixel: that of its render texel's nearest depth, 0 below 0.1 output pixel."""
    w, h = raw.shape[3], raw.shape[2]
    x = torch.div((2 * torch.arange(output[0]) + 1) * w, 2 * output[0], rounding_mode="floor").to(raw.device)
    y = torch.div((2 * torch.arange(output[1]) + 1) * h, 2 * output[1], rounding_mode="floor").to(raw.device)
    return cut_short_motion(raw.index_select(2, y).index_select(3, x), *output)


# ---- post passes ------------------------------------------------------------------------------------------


def post(mode: Mode, frame: Frame, before: Pre, outputs: dict, state: State | None, output: tuple[int, int],
         table: TapTable | None = None) -> Post:
    """3.3 and 3.4. outputs: "temporal" `[n, 4, padded]` and "kernel" as `sparse_filter` wants it, all in 0..1."""
    table = table or tap_table(mode, frame.size, output, frame.jitter)
    m1, m2, centres = sparse_filter(mode, frame, table, outputs["kernel"], output)
    size = mode.network_size(*frame.size)
    p = upsample(outputs["temporal"], size, output)
    theta, alpha, gamma, _ = p.split(1, 1)
    if mode.generation:
        up, down = theta * theta, (1.0 - theta) ** 2
        theta = up / (up + down)
    alpha = 0.35 * alpha + 0.05
    if state is None:
        mixed = m1
    else:
        with torch.no_grad():
            r = uv_grid(*output, m1) - output_motion(before.motion, output)
            onscreen = ((r >= 0) & (r < 1)).all(1, keepdim=True)
        history = (state.history * frame.exposure).clamp(0.0, HALF_MAX)
        history = karis(history) if mode.tonemapped else history
        history = _CatmullRom.apply(history, r) if mode.catmull_rom else bilinear(history, r)
        history = history.clamp(0.0, 1.0 if mode.tonemapped else HALF_MAX)
        share = theta * onscreen
        if mode.generation:
            sigma = 2.0 * gamma * torch.sqrt((m2 - m1 * m1).abs().clamp(min=1e-7))
            mixed = _lerp(_ClampAround.apply(history, m1, sigma), history, share)
        else:
            mixed = _lerp(m1, history, share)
    if state is not None or not mode.generation:
        mixed = _mix_centres(mode, mixed, alpha, centres, table)
    if mode.tonemapped:
        mixed, m1 = karis_inverse(mixed), karis_inverse(m1)
    return Post(mixed * (1.0 / frame.exposure), m1, theta, alpha, {"temporal": p})


def _mix_centres(mode: Mode, mixed: torch.Tensor, alpha: torch.Tensor, centres: list, table: TapTable) -> torch.Tensor:
    """Blends the samples that lie on an output pixel into it, T-mapped."""
    (tw, th) = table.tile
    for ay, ax, colour in centres:
        part = mixed[:, :, ay::th, ax::tw]
        share = alpha[:, :, ay::th, ax::tw]
        if mode.tonemapped:
            blended = _lerp(part, colour, share)
        else:
            blended = karis_inverse(_lerp(karis(part), karis(colour), share))
        mixed = _Place.apply(mixed, blended, ay, ax, th, tw)
    return mixed


class _Place(torch.autograd.Function):
    """A copy of `image` with one tile cell replaced."""

    @staticmethod
    def forward(ctx, image, part, ay, ax, th, tw):
        ctx.cell = (ay, ax, th, tw)
        out = image.clone()
        out[:, :, ay::th, ax::tw] = part
        return out

    @staticmethod
    def backward(ctx, gradient):
        ay, ax, th, tw = ctx.cell
        rest = gradient.clone()
        rest[:, :, ay::th, ax::tw] = 0.0
        return rest, gradient[:, :, ay::th, ax::tw], None, None, None, None


def next_state(frame: Frame, before: Pre, outputs: dict, after: Post, half: bool = False) -> State:
    """State for the next frame; half: round the history as an RGBA16F store does."""
    history = after.output
    if half:
        history = history.clamp(0.0, HALF_MAX).half().float()
    feedback = outputs.get("feedback", outputs["temporal"])
    return State(history, feedback, before.memory, before.depth, frame.jitter)


# ---- quantized boundary of the network --------------------------------------------------------------------


def input_codes(tensor: torch.Tensor) -> torch.Tensor:
    """The int8 input tensor, NHWC: scale 1/255, zero point -128."""
    codes = torch.floor(tensor * 255.0 + 0.5).clamp(0.0, 255.0) - 128.0
    return codes.to(torch.int8).permute(0, 2, 3, 1).contiguous()


def from_codes(codes: torch.Tensor) -> torch.Tensor:
    """Sigmoid output codes NHWC (scale 1/254, zero point -127) to values in 0..1, NCHW."""
    return ((codes.float() + 127.0) / 254.0).permute(0, 3, 1, 2).contiguous()
