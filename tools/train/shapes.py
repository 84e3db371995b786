#!/usr/bin/python3
"""Procedural pictures without anti-aliasing: the training and test data of the SRPO networks.

A scene is a list of shapes with colour gradients, placed in low-resolution pixel units. `render` samples it
at pixel centres only, so one scene drawn at scale 1, 2 and 3 gives an aliased picture and its exact
high-resolution references. Everything follows from the seed.
Source: SRPO (ECCV 2022), training data: triangles, circles, rings, lines and Bezier curves with colour
gradients. The distributions of sizes, widths and colours are ours.

Examples:
  python3 tools/train/shapes.py --out models/pictures
  python3 tools/train/shapes.py --seed 7 --kind random --size 128x128 --out pictures
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from png import write_png

#: Seed of the picture in models/pictures. Training uses seeds below 1,000,000.
TEST_PICTURE_SEED = 20_221_023
#: First seed of the held-out set of random scenes.
HELD_OUT_SEED = 5_000_000


@dataclass(frozen=True)
class Gradient:
    """Colour from `c0` at point `a` to `c1` at point `b`; linear, or radial around `a`."""

    a: np.ndarray
    b: np.ndarray
    c0: np.ndarray
    c1: np.ndarray
    radial: bool

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Colours `[..., 3]` in [0, 255] at scene positions, x and y of one shape."""
        d = self.b - self.a
        length2 = float(d @ d) + 1e-9
        px, py = x - self.a[0], y - self.a[1]
        if self.radial:
            t = np.sqrt((px * px + py * py) / length2)
        else:
            t = (px * d[0] + py * d[1]) / length2
        t = np.clip(t, 0.0, 1.0)[..., None]
        return self.c0 + (self.c1 - self.c0) * t


@dataclass(frozen=True)
class Triangle:
    """Filled triangle, corners `[3, 2]`."""

    corners: np.ndarray
    paint: Gradient

    def pieces(self):
        """One (box, inside) pair; box is x0, y0, x1, y1 in scene units."""
        low, high = self.corners.min(axis=0), self.corners.max(axis=0)

        def inside(x, y):
            signs = []
            for i in range(3):
                p, q = self.corners[i], self.corners[(i + 1) % 3]
                signs.append((q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]))
            positive = (signs[0] >= 0) & (signs[1] >= 0) & (signs[2] >= 0)
            negative = (signs[0] <= 0) & (signs[1] <= 0) & (signs[2] <= 0)
            return positive | negative

        yield (low[0], low[1], high[0], high[1]), inside


@dataclass(frozen=True)
class Ring:
    """Points with inner <= distance <= outer from the centre; inner 0 makes a disc."""

    centre: np.ndarray
    inner: float
    outer: float
    paint: Gradient

    def pieces(self):
        cx, cy = self.centre

        def inside(x, y):
            d2 = (x - cx) ** 2 + (y - cy) ** 2
            return (d2 <= self.outer**2) & (d2 >= self.inner**2)

        yield (cx - self.outer, cy - self.outer, cx + self.outer, cy + self.outer), inside


@dataclass(frozen=True)
class Stroke:
    """Chain of points `[n, 2]` drawn with round ends and joints."""

    points: np.ndarray
    width: float
    paint: Gradient

    def pieces(self):
        r = self.width / 2
        for p, q in zip(self.points[:-1], self.points[1:]):
            d = q - p
            length2 = float(d @ d) + 1e-12

            def inside(x, y, p=p, d=d, length2=length2):
                t = np.clip(((x - p[0]) * d[0] + (y - p[1]) * d[1]) / length2, 0.0, 1.0)
                return (x - p[0] - t * d[0]) ** 2 + (y - p[1] - t * d[1]) ** 2 <= r * r

            low, high = np.minimum(p, q) - r, np.maximum(p, q) + r
            yield (low[0], low[1], high[0], high[1]), inside


@dataclass(frozen=True)
class Scene:
    """Background and shapes, later ones on top; width and height in low-resolution pixels."""

    width: int
    height: int
    background: Gradient
    shapes: list = field(default_factory=list)


def bezier(control: np.ndarray, segments: int = 24) -> np.ndarray:
    """Points `[segments + 1, 2]` on the Bezier curve of 3 or 4 control points."""
    t = np.linspace(0.0, 1.0, segments + 1)[:, None]
    points = [np.repeat(p[None, :], segments + 1, axis=0) for p in control]
    while len(points) > 1:
        points = [p + (q - p) * t for p, q in zip(points[:-1], points[1:])]
    return points[0]


def render(scene: Scene, scale: int = 1) -> np.ndarray:
    """Samples the scene at the pixel centres of a `scale` times finer grid: uint8 `[h, w, 3]`."""
    width, height = scene.width * scale, scene.height * scale
    xs = (np.arange(width) + 0.5) / scale
    ys = (np.arange(height) + 0.5) / scale
    out = scene.background.at(xs[None, :], ys[:, None])
    for shape in scene.shapes:
        for (x0, y0, x1, y1), inside in shape.pieces():
            i0, i1 = np.searchsorted(xs, x0), np.searchsorted(xs, x1, side="right")
            j0, j1 = np.searchsorted(ys, y0), np.searchsorted(ys, y1, side="right")
            if i0 >= i1 or j0 >= j1:
                continue
            x, y = xs[None, i0:i1], ys[j0:j1, None]
            hit_y, hit_x = np.nonzero(inside(x, y))
            if len(hit_y):
                out[j0 + hit_y, i0 + hit_x] = shape.paint.at(xs[i0 + hit_x], ys[j0 + hit_y])
    return np.floor(np.clip(out, 0.0, 255.0) + 0.5).astype(np.uint8)


class _Dice:
    """Random choices of one scene."""

    def __init__(self, seed: int, width: int, height: int):
        self.rng = np.random.default_rng(seed)
        self.size = np.array([width, height], float)

    def between(self, low: float, high: float) -> float:
        return float(self.rng.uniform(low, high))

    def log_between(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def point(self, margin: float = 8.0) -> np.ndarray:
        return self.rng.uniform(-margin, self.size + margin)

    def direction(self) -> np.ndarray:
        angle = self.rng.uniform(0, 2 * np.pi)
        return np.array([np.cos(angle), np.sin(angle)])

    def colour(self) -> np.ndarray:
        kind = self.rng.integers(4)
        if kind == 0:  # greys, black and white among them
            return np.full(3, self.rng.choice([0.0, 255.0, self.rng.uniform(0, 255)]))
        return self.rng.uniform(0, 255, 3)

    def gradient(self, centre: np.ndarray, reach: float, contrast: float = 1.0) -> Gradient:
        """Mostly mild gradients: `c1` lies between `c0` and a fresh colour."""
        step = self.direction() * reach
        c0 = self.colour()
        share = contrast * (0.0 if self.rng.random() < 0.25 else self.rng.random())
        c1 = c0 + (self.colour() - c0) * share
        return Gradient(centre - step, centre + step, c0, c1, bool(self.rng.random() < 0.3))


def _random_shape(dice: _Dice):
    kind = dice.rng.choice(["triangle", "disc", "ring", "line", "bezier"], p=[0.28, 0.14, 0.14, 0.2, 0.24])
    centre = dice.point()
    if kind == "triangle":
        reach = dice.log_between(4, 55)
        corners = centre + dice.rng.uniform(-reach, reach, (3, 2))
        return Triangle(corners, dice.gradient(centre, reach))
    if kind == "disc":
        r = dice.log_between(1.5, 30)
        return Ring(centre, 0.0, r, dice.gradient(centre, r))
    if kind == "ring":
        r = dice.log_between(3, 36)
        width = min(dice.log_between(0.8, 6), r)
        return Ring(centre, r - width, r, dice.gradient(centre, r))
    width = dice.log_between(0.8, 6)
    if kind == "line":
        reach = dice.log_between(6, 90)
        step = dice.direction() * reach
        return Stroke(np.stack([centre - step, centre + step]), width, dice.gradient(centre, reach))
    reach = dice.log_between(8, 50)
    control = centre + dice.rng.uniform(-reach, reach, (int(dice.rng.integers(3, 5)), 2))
    return Stroke(bezier(control), width, dice.gradient(centre, reach))


def random_scene(seed: int, width: int = 128, height: int = 128) -> Scene:
    """A scene of the training distribution; about 40 shapes for every 128x128 pixels."""
    dice = _Dice(seed, width, height)
    background = dice.gradient(dice.size / 2, float(dice.size.max()) / 2)
    area = width * height / (128 * 128)
    count = max(1, int(round(dice.between(24, 56) * area)))
    return Scene(width, height, background, [_random_shape(dice) for _ in range(count)])


def _glyph(dice: _Dice, at: np.ndarray, cell: np.ndarray, width: float, paint: Gradient) -> list:
    """One text-like sign: two to four strokes between the nodes of a 3 by 4 lattice, some of them bowed."""
    strokes = []
    for _ in range(int(dice.rng.integers(2, 5))):
        p = at + dice.rng.integers(0, [3, 4]) / np.array([2.0, 3.0]) * cell
        q = at + dice.rng.integers(0, [3, 4]) / np.array([2.0, 3.0]) * cell
        points = np.stack([p, q])
        if dice.rng.random() < 0.4:
            points = bezier(np.stack([p, (p + q) / 2 + dice.direction() * cell[0] * 0.8, q]), 12)
        strokes.append(Stroke(points, width, paint))
    return strokes


def test_scene(seed: int = TEST_PICTURE_SEED, width: int = 480, height: int = 270) -> Scene:
    """The composed test picture: gradients, a fan of thin lines, rings, curves, facets and text-like strokes."""
    dice = _Dice(seed, width, height)
    size = dice.size
    shapes = []
    sky = Gradient(size * [0.25, 0.2], size * [0.95, 1.1], np.array([250.0, 214, 165]),
                   np.array([38.0, 44, 92]), True)
    # Facets: a row of overlapping triangles along the lower edge, darker towards the front.
    for row in range(3):
        base = height * (0.72 + 0.12 * row)
        for i in range(9):
            x = width * (i + dice.between(-0.2, 0.7)) / 8
            reach = height * dice.between(0.10, 0.26)
            corners = np.array([[x, base - reach], [x - reach * 0.8, base + height * 0.4],
                                [x + reach * 0.8, base + height * 0.4]])
            light = np.array([96.0, 132, 120]) * (1.15 - 0.3 * row) + dice.rng.uniform(-24, 24, 3)
            shapes.append(Triangle(corners, Gradient(corners[0], corners[0] + [reach * 0.5, reach * 2],
                                                     light, light * 0.45, False)))
    # A sun of concentric rings whose width falls from 7 to 1 pixels.
    centre, r = size * [0.22, 0.30], 58.0
    shapes.append(Ring(centre, 0.0, r + 4, Gradient(centre, centre + r, np.array([255.0, 250, 225]),
                                                   np.array([245.0, 190, 110]), True)))
    for i in range(9):
        ring_width = 7.0 * (1 / 7) ** (i / 8)
        c0 = np.array([150.0, 30, 40]) + [8.0 * i, 6 * i, 9 * i]
        shapes.append(Ring(centre, r - ring_width, r, Gradient(centre - r, centre + r, c0, c0[::-1], False)))
        r -= ring_width + max(2.2, ring_width * 0.8)
    # A fan of lines, 0.8 to 2.4 pixels wide, through every slope.
    hub = size * [0.985, 0.03]
    for i in range(22):
        angle = np.pi * (0.52 + 0.46 * i / 21)
        end = hub + np.array([np.cos(angle), np.sin(angle)]) * width * 0.36
        shade = np.array([20.0, 24, 44]) if i % 2 else np.array([255.0, 255, 248])
        shapes.append(Stroke(np.stack([hub, end]), 0.8 + 1.6 * (i % 5) / 4,
                             Gradient(hub, end, shade, shade * 0.6 + 60, False)))
    # Flowing curves across the middle.
    for i in range(10):
        y = height * (0.42 + 0.035 * i)
        control = np.stack([np.array([width * t, y + dice.between(-60, 60)]) for t in (0.1, 0.4, 0.65, 1.02)])
        c0, c1 = dice.rng.uniform(30, 255, 3), dice.rng.uniform(0, 200, 3)
        shapes.append(Stroke(bezier(control, 64), 0.9 + 0.45 * i,
                             Gradient(control[0], control[-1], c0, c1, False)))
    # Text-like strokes in two sizes on a plate.
    low, high = size * [0.40, 0.06], size * [0.66, 0.36]
    plate = Gradient(low, high, np.array([244.0, 244, 238]), np.array([198.0, 206, 220]), False)
    corners = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    shapes += [Triangle(corners[[0, 1, 2]], plate), Triangle(corners[[0, 2, 3]], plate)]
    ink = Gradient(low, high, np.array([16.0, 18, 30]), np.array([60.0, 20, 90]), False)
    for row, (pitch, stroke_width) in enumerate([(13.0, 2.0), (13.0, 1.4), (9.0, 1.2), (9.0, 1.0)]):
        y = low[1] + 5 + [0, 23, 45, 61][row]
        cell = np.array([pitch * 0.6, pitch * 1.1])
        for column in range(int((high[0] - low[0] - 8) // pitch)):
            if dice.rng.random() < 0.12:
                continue
            at = np.array([low[0] + 5 + column * pitch, y])
            shapes += _glyph(dice, at, cell, stroke_width, ink)
    # A few loose discs with steep gradients.
    for _ in range(14):
        at, radius = size * dice.rng.uniform([0.03, 0.5], [0.97, 0.97]), dice.log_between(2, 14)
        c0, c1 = dice.rng.uniform(60, 255, 3), dice.rng.uniform(0, 160, 3)
        shapes.append(Ring(at, 0.0, radius, Gradient(at - radius, at + radius, c0, c1, False)))
    return Scene(width, height, sky, shapes)


def parse_size(text: str) -> tuple[int, int]:
    """Turns `480x270` into (480, 270), each within 8 to 4096."""
    try:
        width, height = (int(part) for part in text.split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected WIDTHxHEIGHT, found '{text}'") from None
    if not (8 <= width <= 4096 and 8 <= height <= 4096):
        raise argparse.ArgumentTypeError(f"width and height must lie in 8 to 4096, found {text}")
    return width, height


def main(arguments: list[str] | None = None) -> int:
    """Draws one scene at scales 1, 2 and 3 into a folder."""
    parser = argparse.ArgumentParser(
        description="Draws one aliased scene as raster_lr.png, raster_x2.png and raster_x3.png.",
        epilog="example: python3 tools/train/shapes.py --out models/pictures",
    )
    parser.add_argument("--seed", type=int, default=TEST_PICTURE_SEED, help="scene seed (default: %(default)s)")
    parser.add_argument("--kind", choices=["test", "random"], default="test",
                        help="composed test picture or a scene like those of training (default: test)")
    parser.add_argument("--size", type=parse_size, default=(480, 270), metavar="WxH",
                        help="low-resolution size in pixels (default: 480x270)")
    parser.add_argument("--out", type=Path, required=True, help="folder for the three files")
    options = parser.parse_args(arguments)
    if options.seed < 0:
        print(f"shapes: error: --seed must not be negative, found {options.seed}", file=sys.stderr)
        return 1
    make = test_scene if options.kind == "test" else random_scene
    scene = make(options.seed, *options.size)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        for scale, name in ((1, "raster_lr"), (2, "raster_x2"), (3, "raster_x3")):
            write_png(options.out / f"{name}.png", render(scene, scale))
    except OSError as error:
        print(f"shapes: error: {error.filename}: {error.strerror}", file=sys.stderr)
        return 1
    print(f"seed {options.seed}: {options.size[0]}x{options.size[1]} at scales 1, 2, 3 -> {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
