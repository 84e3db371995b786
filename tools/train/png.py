"""Reads and writes 8-bit PNG pictures with nothing but zlib.

Arrays are uint8, row by row, `[h, w, 3]`. The writer stores unfiltered RGB rows, so the same array and the
same zlib give the same bytes. The reader takes non-interlaced 8-bit grey, RGB and RGBA files and drops alpha.
Source: PNG specification, second edition, sections 5, 9 and 11.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from files import write_atomically

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
_MAX_PIXELS = 1 << 26


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def write_png(path: Path | str, picture: np.ndarray) -> None:
    """Writes uint8 `[h, w, 3]` as an RGB file."""
    if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
        raise ValueError(f"{path}: expected uint8 [h, w, 3], found {picture.dtype} {list(picture.shape)}")
    height, width, _ = picture.shape
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = picture.reshape(height, 3 * width)
    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    data = zlib.compress(rows.tobytes(), 9)
    write_atomically(
        Path(path),
        _SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b"")
    )


def _unfilter(rows: np.ndarray, kinds: np.ndarray, step: int) -> np.ndarray:
    """Undoes the five row filters; `step` is the bytes of one pixel."""
    out = np.zeros_like(rows)
    above = np.zeros(rows.shape[1], np.int64)
    for y, kind in enumerate(kinds):
        row = rows[y].astype(np.int64)
        if kind == 1:
            row = row.reshape(-1, step).cumsum(axis=0).reshape(-1)
        elif kind == 2:
            row = row + above
        elif kind in (3, 4):
            for x in range(len(row)):
                left = int(row[x - step]) if x >= step else 0
                up = int(above[x])
                if kind == 3:
                    predicted = (left + up) // 2
                else:
                    corner = int(above[x - step]) if x >= step else 0
                    base = left + up - corner
                    choices = (abs(base - left), abs(base - up), abs(base - corner))
                    predicted = (left, up, corner)[choices.index(min(choices))]
                row[x] = (row[x] + predicted) & 255
        elif kind != 0:
            raise ValueError(f"row {y} has filter {kind}, expected 0 to 4")
        above = row & 255
        out[y] = above
    return out


def read_png(path: Path | str) -> np.ndarray:
    """Returns uint8 `[h, w, 3]`. Errors: ValueError with the path and what was found; OSError."""
    data = Path(path).read_bytes()
    try:
        if data[:8] != _SIGNATURE:
            raise ValueError("not a PNG file")
        at, body, header = 8, b"", None
        while at + 8 <= len(data):
            (size,) = struct.unpack_from(">I", data, at)
            kind = data[at + 4 : at + 8]
            content = data[at + 8 : at + 8 + size]
            if len(content) != size:
                raise ValueError(f"chunk at byte {at} is cut short")
            if kind == b"IHDR":
                header = struct.unpack(">IIBBBBB", content)
            elif kind == b"IDAT":
                body += content
            at += size + 12
        if header is None:
            raise ValueError("no header chunk")
        width, height, depth, colour, _, _, interlaced = header
        if depth != 8 or colour not in _CHANNELS or interlaced:
            raise ValueError(f"depth {depth}, colour type {colour}, interlace {interlaced} is not supported")
        if width < 1 or height < 1 or width * height > _MAX_PIXELS:
            raise ValueError(f"size {width}x{height} is out of range")
        step = _CHANNELS[colour]
        expected = height * (1 + width * step)
        raw = np.frombuffer(zlib.decompressobj().decompress(body, expected), np.uint8)
        if raw.size != expected:
            raise ValueError(f"expected {expected} bytes of rows, found {raw.size}")
        raw = raw.reshape(height, 1 + width * step)
        pixels = _unfilter(raw[:, 1:], raw[:, 0], step).reshape(height, width, step)
    except (ValueError, struct.error, zlib.error) as error:
        raise ValueError(f"{path}: {error}") from None
    if step <= 2:
        return np.repeat(pixels[:, :, :1], 3, axis=2)
    return np.ascontiguousarray(pixels[:, :, :3])
