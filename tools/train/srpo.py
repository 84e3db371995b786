"""SRPO: the network, its training loss, and the exact picture arithmetic around it.

conv 5x5 3->16, ReLU, conv 5x5 16->16, ReLU, nearest resize by the scale, conv 5x5 16->2: 8,434 parameters.
The network sees a raster picture in [0, 1] and yields for every high-resolution pixel an offset in
low-resolution pixels, channel 0 right, channel 1 down, added to the pixel that covers it.
Two worlds live here: torch (`[n, c, h, w]`, differentiable) for training, numpy (`[h, w, c]`, rounded
offsets) for evaluation. The numpy side is the meaning of shaders/frame/srpo/post.comp.
Source: SRPO (ECCV 2022); Lanczos support, border rules and offset units are ours.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

import training

PARAMETERS = 8434
FEATURES = 16
LANCZOS_SUPPORT = 3
MASK_SIGMA = 1.5


class Srpo(nn.Module):
    """Offsets in low-resolution pixels: `[n, 3, h, w]` in [0, 1] -> `[n, 2, s*h, s*w]`."""

    def __init__(self, scale: int):
        super().__init__()
        if scale not in (2, 3):
            raise ValueError(f"scale must be 2 or 3, found {scale}")
        self.scale = scale
        self.conv1 = nn.Conv2d(3, FEATURES, 5, padding=2)
        self.conv2 = nn.Conv2d(FEATURES, FEATURES, 5, padding=2)
        self.conv3 = nn.Conv2d(FEATURES, 2, 5, padding=2)
        self.register_buffer("phase_map", phase_map(scale), persistent=False)

    def features(self, x: torch.Tensor) -> torch.Tensor:
        """What the nearest resize enlarges: `[n, 16, h, w]`, at least 0."""
        return F.relu(self.conv2(F.relu(self.conv1(x))))

    def forward_literal(self, x: torch.Tensor) -> torch.Tensor:
        """The network as defined, with the last convolution on the enlarged features."""
        return self.conv3(F.interpolate(self.features(x), scale_factor=self.scale, mode="nearest"))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Same values as `forward_literal` up to float rounding, 2.8 times less work for x2.

        Nearest resize followed by 5x5 equals one 3x3 filter per phase before the resize. Source: ours,
        shown in tests/tools/train/test_srpo.py.
        """
        s, m = self.scale, self.phase_map
        taps = torch.einsum("puk,qvl,oikl->opqiuv", m, m, self.conv3.weight)
        weight = taps.reshape(2 * s * s, FEATURES, 3, 3)
        bias = self.conv3.bias.repeat_interleave(s * s)
        return F.pixel_shuffle(F.conv2d(self.features(x), weight, bias, padding=1), s)


def phase_map(scale: int) -> torch.Tensor:
    """`[s, 3, 5]`: tap k of phase p falls on low-resolution neighbour u - 1 where the entry is 1."""
    out = torch.zeros(scale, 3, 5)
    for phase in range(scale):
        for tap in range(5):
            out[phase, (phase + tap - 2) // scale + 1, tap] = 1.0
    return out


def parameter_count(model: nn.Module) -> int:
    """Trainable numbers of the model."""
    return sum(p.numel() for p in model.parameters())


def project_bilinear(lr: torch.Tensor, offsets: torch.Tensor, scale: int) -> torch.Tensor:
    """Training projection: bilinear sample of `lr` at floor(position / s) + offset, border clamped."""
    _, _, h, w = lr.shape
    ys = torch.div(torch.arange(h * scale), scale, rounding_mode="floor").to(lr.dtype)
    xs = torch.div(torch.arange(w * scale), scale, rounding_mode="floor").to(lr.dtype)
    x = (xs[None, None, :] + offsets[:, 0]) * (2.0 / max(w - 1, 1)) - 1.0
    y = (ys[None, :, None] + offsets[:, 1]) * (2.0 / max(h - 1, 1)) - 1.0
    return F.grid_sample(lr, torch.stack([x, y], dim=3), padding_mode="border", align_corners=True)


def _hard(value: torch.Tensor, soft: torch.Tensor) -> torch.Tensor:
    """`value` forwards, the gradient of `soft` backwards."""
    return value.detach() + (soft - soft.detach())


def moved_softly(offsets: torch.Tensor) -> torch.Tensor:
    """`[n, 1, h, w]` in (0, 1): a smooth stand-in for "the rounded offset is not zero"."""
    return torch.sigmoid(8.0 * (offsets.abs().amax(dim=1, keepdim=True) - 0.5))


def fuse_straight_through(lr: torch.Tensor, offsets: torch.Tensor, scale: int) -> torch.Tensor:
    """The displayed picture for training: forwards what `fuse` gives, before clamping.

    Backwards the projection is bilinear and "moved" is `moved_softly`.
    Source: ours; the paper trains on the projection alone.
    """
    _, _, h, w = lr.shape
    with torch.no_grad():
        rows, columns = (torch.from_numpy(lanczos_matrix(n, scale)).to(lr.dtype) for n in (h, w))
        smooth = torch.matmul(torch.matmul(rows, lr), columns.t())
        rounded = torch.sign(offsets) * torch.floor(offsets.abs() + 0.5)
        shown = project_bilinear(lr, rounded, scale)
        moved = (rounded != 0).any(dim=1, keepdim=True).to(lr.dtype)
    projected = _hard(shown, project_bilinear(lr, offsets, scale))
    moved = _hard(moved, moved_softly(offsets))
    kernel = torch.from_numpy(mask_kernel()).to(lr.dtype)[None, None]
    alpha = F.conv2d(moved, kernel, padding=1)
    return alpha * projected + (1 - alpha) * smooth


def gaussian_window(size: int = 11, sigma: float = 1.5) -> np.ndarray:
    """Normalised 1-D Gaussian weights."""
    x = np.arange(size) - (size - 1) / 2
    w = np.exp(-(x * x) / (2 * sigma * sigma))
    return w / w.sum()


def _weighted_shifts(x: torch.Tensor, weights: list[float]) -> torch.Tensor:
    """Valid separable correlation of the last two axes."""
    n = len(weights) - 1
    for axis in (2, 3):
        length = x.shape[axis] - n
        out = x.narrow(axis, 0, length) * weights[0]
        for k in range(1, n + 1):
            out.add_(x.narrow(axis, k, length), alpha=weights[k])
        x = out
    return x


class _Blur(torch.autograd.Function):
    """Valid Gaussian blur; shifted sums, far faster on a CPU than one-channel convolutions."""

    @staticmethod
    def forward(ctx, x: torch.Tensor) -> torch.Tensor:
        return _weighted_shifts(x, gaussian_window().tolist())

    @staticmethod
    def backward(ctx, gradient: torch.Tensor) -> torch.Tensor:
        # The window is symmetric, so the adjoint is the same blur of the gradient padded with zeros.
        return _weighted_shifts(F.pad(gradient, (10, 10, 10, 10)), gaussian_window().tolist())


def ssim_loss(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """1 - mean SSIM over the valid region; 11x11 Gaussian window, sigma 1.5, values in [0, 1]."""
    with torch.no_grad():
        mb = _Blur.apply(b)
        vb = _Blur.apply(b * b) - mb * mb
    ma = _Blur.apply(a)
    va = _Blur.apply(a * a) - ma * ma
    cov = _Blur.apply(a * b) - ma * mb
    c1, c2 = 0.01**2, 0.03**2
    top = (2 * ma * mb + c1) * (2 * cov + c2)
    bottom = (ma * ma + mb * mb + c1) * (va + vb + c2)
    return 1.0 - (top / bottom).mean()


# ---- numpy: what the shaders compute ---------------------------------------------------------------------


def round_half_away(x: np.ndarray) -> np.ndarray:
    """Nearest integer as int64; halves go away from zero."""
    return (np.sign(x) * np.floor(np.abs(x) + 0.5)).astype(np.int64)


def project(lr: np.ndarray, rounded: np.ndarray, scale: int) -> np.ndarray:
    """lr[clamp(y // s + R_y), clamp(x // s + R_x)]; rounded is int `[s*h, s*w, 2]`, (x, y)."""
    h, w, _ = lr.shape
    y = np.clip(np.arange(h * scale)[:, None] // scale + rounded[:, :, 1], 0, h - 1)
    x = np.clip(np.arange(w * scale)[None, :] // scale + rounded[:, :, 0], 0, w - 1)
    return lr[y, x]


def nearest(lr: np.ndarray, scale: int) -> np.ndarray:
    """Every pixel repeated scale by scale times."""
    return np.repeat(np.repeat(lr, scale, axis=0), scale, axis=1)


def lanczos_matrix(size: int, scale: int) -> np.ndarray:
    """`[size * scale, size]` weights of one axis: support 3, normalised, border clamped."""
    a = LANCZOS_SUPPORT
    out = np.zeros((size * scale, size))
    for i in range(size * scale):
        centre = (i + 0.5) / scale - 0.5
        first = int(np.floor(centre)) - a + 1
        taps = np.arange(first, first + 2 * a)
        d = centre - taps
        weights = np.where(np.abs(d) < a, np.sinc(d) * np.sinc(d / a), 0.0)
        np.add.at(out[i], np.clip(taps, 0, size - 1), weights / weights.sum())
    return out


def lanczos(lr: np.ndarray, scale: int) -> np.ndarray:
    """Separable Lanczos enlargement of `[h, w, c]`, not clamped to [0, 1]."""
    h, w, _ = lr.shape
    rows = np.tensordot(lanczos_matrix(h, scale), lr, axes=(1, 0))
    return np.tensordot(lanczos_matrix(w, scale), rows, axes=(1, 1)).transpose(1, 0, 2)


def mask_kernel() -> np.ndarray:
    """3x3 Gaussian, sigma 1.5, sum 1."""
    w = gaussian_window(3, MASK_SIGMA)
    return np.outer(w, w)


def mask(rounded: np.ndarray) -> np.ndarray:
    """alpha `[h, w]`: the Gaussian share of the 3x3 neighbours with a non-zero offset, 0 outside."""
    moved = np.pad(np.any(rounded != 0, axis=2).astype(float), 1)
    h, w = rounded.shape[:2]
    kernel = mask_kernel()
    return sum(kernel[j, i] * moved[j : j + h, i : i + w] for j in range(3) for i in range(3))


def fuse(lr: np.ndarray, offsets: np.ndarray, scale: int) -> np.ndarray:
    """The displayed picture `[s*h, s*w, 3]` from lr in [0, 1] and real-valued offsets, clamped to [0, 1]."""
    rounded = round_half_away(offsets)
    alpha = mask(rounded)[:, :, None]
    mixed = alpha * project(lr, rounded, scale) + (1 - alpha) * lanczos(lr, scale)
    return np.clip(mixed, 0.0, 1.0)


def to_codes(picture: np.ndarray) -> np.ndarray:
    """[0, 1] to 8-bit codes, as an rgba8_unorm store does."""
    return np.floor(np.clip(picture, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """dB between two uint8 pictures, over all pixels and channels; identical pictures give infinity."""
    mse = np.mean(((a.astype(float) - b.astype(float)) / 255.0) ** 2)
    return float("inf") if mse == 0 else float(-10.0 * np.log10(mse))


def ssim(a: np.ndarray, b: np.ndarray) -> float:
    """SSIM of two uint8 pictures: per RGB channel, 11x11 Gaussian, zero padding by 5, full-size map."""
    window = gaussian_window()

    def blur(x: np.ndarray) -> np.ndarray:
        h, w, _ = x.shape
        x = np.pad(x, ((5, 5), (0, 0), (0, 0)))
        x = sum(window[k] * x[k : k + h] for k in range(11))
        x = np.pad(x, ((0, 0), (5, 5), (0, 0)))
        return sum(window[k] * x[:, k : k + w] for k in range(11))

    a, b = a / 255.0, b / 255.0
    ma, mb = blur(a), blur(b)
    va, vb, cov = blur(a * a) - ma * ma, blur(b * b) - mb * mb, blur(a * b) - ma * mb
    top = (2 * ma * mb + 1e-4) * (2 * cov + 9e-4)
    bottom = (ma * ma + mb * mb + 1e-4) * (va + vb + 9e-4)
    return float(np.mean(top / bottom))


def float_offsets(model: Srpo, lr: np.ndarray) -> np.ndarray:
    """Offsets `[s*h, s*w, 2]` of one uint8 picture."""
    x = torch.from_numpy(lr.astype(np.float32) / 255.0).permute(2, 0, 1)[None]
    with torch.no_grad():
        return model.forward_literal(x)[0].permute(1, 2, 0).numpy().astype(float)


def save_weights(path, model: Srpo, record: dict) -> None:
    """Weights and training record as .npz; the same model gives the same bytes."""
    training.save_model(path, model, record)


def load_model(path) -> tuple[Srpo, dict]:
    """Model and record from a .npz or an own checkpoint (a pickle). Errors: ValueError, OSError."""
    return training.load_model(path, "an SRPO", lambda record: Srpo(int(record["scale"])), None)
