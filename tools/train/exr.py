"""Reads OpenEXR pictures: scanlines; no compression, ZIPS or ZIP; half and float channels.

`read_exr` gives channels by name as `[rows, columns]`, half channels as float16. Multi-part, tiled and deep files,
sub-sampled channels and other compressions are refused. Source: the OpenEXR file layout and technical introduction.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

MAGIC = 20000630
LINES = {0: 1, 2: 1, 3: 16}
KINDS = {1: np.dtype("<f2"), 2: np.dtype("<f4")}
LARGEST = 1 << 16


class _Reader:
    """Bytes in order; running out of them is a ValueError."""

    def __init__(self, data: bytes):
        self.data, self.at = data, 0

    def take(self, count: int) -> bytes:
        if count < 0 or self.at + count > len(self.data):
            raise ValueError("the file ends too early")
        self.at += count
        return self.data[self.at - count : self.at]

    def unpack(self, layout: str) -> tuple:
        return struct.unpack("<" + layout, self.take(struct.calcsize("<" + layout)))

    def text(self) -> str:
        end = self.data.find(b"\0", self.at, self.at + 256)
        if end < 0:
            raise ValueError("a name has no end")
        out = self.data[self.at : end].decode("latin-1")
        self.at = end + 1
        return out


def _channels(data: bytes) -> list[tuple[str, np.dtype]]:
    reader, out = _Reader(data), []
    while name := reader.text():
        kind, _, step_x, step_y = reader.unpack("iIii")
        if kind not in KINDS or (step_x, step_y) != (1, 1):
            raise ValueError(f"channel {name} is neither half nor float, or is sub-sampled")
        out.append((name, KINDS[kind]))
    if not out:
        raise ValueError("there are no channels")
    return out


def _unzip(block: bytes, size: int) -> bytes:
    """Undoes zlib, the difference predictor and the split into two halves."""
    if len(block) == size:  # a block that did not shrink is stored as it is
        return block
    raw = np.frombuffer(zlib.decompress(block), np.uint8)
    if len(raw) != size:
        raise ValueError("a block has the wrong size")
    steps = raw.astype(np.int64)
    steps[1:] -= 128
    plain = np.cumsum(steps).astype(np.uint8)
    out = np.empty(size, np.uint8)
    half = (size + 1) // 2
    out[0::2], out[1::2] = plain[:half], plain[half:]
    return out.tobytes()


def _decode(data: bytes) -> dict[str, np.ndarray]:
    reader = _Reader(data)
    magic, version = reader.unpack("ii")
    if magic != MAGIC:
        raise ValueError("not an OpenEXR file")
    if version & 0xFF != 2 or version & 0x1A00:
        raise ValueError("tiled, deep and multi-part files are not supported")
    header: dict[str, bytes] = {}
    while name := reader.text():
        reader.text()
        header[name] = reader.take(reader.unpack("i")[0])
    missing = {"channels", "compression", "dataWindow"} - set(header)
    if missing:
        raise ValueError(f"the header lacks {', '.join(sorted(missing))}")
    compression = header["compression"][0]
    if compression not in LINES:
        raise ValueError(f"compression {compression} is not supported (only none, ZIPS, ZIP)")
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
    w, h = x1 - x0 + 1, y1 - y0 + 1
    if not (0 < w <= LARGEST and 0 < h <= LARGEST):
        raise ValueError(f"size {w} x {h}")
    channels = _channels(header["channels"])
    line = w * sum(kind.itemsize for _, kind in channels)
    if line * h > 1 << 32:
        raise ValueError(f"size {w} x {h} with {len(channels)} channels is too large")
    out = {name: np.zeros((h, w), kind) for name, kind in channels}
    per_block = LINES[compression]
    blocks = -(-h // per_block)
    offsets = np.frombuffer(reader.take(8 * blocks), "<u8")
    seen = set()
    for offset in offsets:
        reader.at = min(int(offset), len(data))
        y, size = reader.unpack("ii")
        first = y - y0
        if first % per_block or not 0 <= first < h or first in seen:
            raise ValueError(f"a block starts at line {y}")
        seen.add(first)
        count = min(per_block, h - first)
        block = reader.take(size)
        block = _unzip(block, line * count) if compression else block
        if len(block) != line * count:
            raise ValueError("a block has the wrong size")
        at = 0
        for row in range(first, first + count):
            for name, kind in channels:
                out[name][row] = np.frombuffer(block, kind, w, at)
                at += w * kind.itemsize
    return out


def read_exr(path) -> dict[str, np.ndarray]:
    """Channels by name. Errors: OSError, ValueError naming the file."""
    data = Path(path).read_bytes()
    try:
        return _decode(data)
    except (ValueError, struct.error, zlib.error) as error:
        raise ValueError(f"{path}: {error}") from None


def read_planes(path, names: str) -> np.ndarray:
    """The named one-letter channels as `[c, rows, columns]`. Errors: ValueError when one is missing."""
    channels = read_exr(path)
    missing = [name for name in names if name not in channels]
    if missing:
        raise ValueError(f"{path}: channel {', '.join(missing)} is missing, found {', '.join(sorted(channels))}")
    return np.stack([channels[name] for name in names])
