"""The v1 passes in one go on the CPU: fused.cpp, compiled on first use, in place of `nss_passes.pre`, `.post` and the
spatial loss.

They have the values and gradients of what they replace up to rounding (tests/tools/train compares them) and are several
times as fast; `available()` says whether there is a compiler. On other devices, and for v0_1, the passes of
nss_passes.py run; the pre passes are those of v1_high alone.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import subprocess
import tempfile
from pathlib import Path

import torch

import nss_passes as passes

SOURCE = Path(__file__).with_name("fused.cpp")
FLAGS = ("-std=c++20", "-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC", "-w")
_SIZES = ("n", "w", "h", "out_w", "out_h", "kernel_w", "kernel_h", "channels", "padded_w", "padded_h", "network_w",
          "network_h", "shift", "cubic", "tile_w", "tile_h", "step_x", "step_y", "max_taps")
_PICTURES = ("taps", "colour", "motion", "exposure", "kernel", "temporal", "history", "output", "filtered", "theta",
             "alpha", "g_output", "g_filtered", "g_theta", "g_alpha", "g_kernel", "g_temporal", "g_history")


class _Post(ctypes.Structure):
    _fields_ = ([(name, ctypes.c_int32) for name in _SIZES] + [("floor", ctypes.c_float)]
                + [(name, ctypes.c_void_p) for name in _PICTURES])


@functools.cache
def _library() -> ctypes.CDLL | None:
    """The compiled passes, kept in the user's cache folder under a name that changes with source and flags."""
    compiler = os.environ.get("CXX", "c++")
    key = hashlib.sha256(SOURCE.read_bytes() + repr((compiler, FLAGS)).encode()).hexdigest()[:16]
    folder = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "shale"
    path = folder / f"fused-{key}.so"
    try:
        if not path.exists():
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder) as scratch:
                built = Path(scratch) / "fused.so"
                subprocess.run([compiler, *FLAGS, str(SOURCE), "-o", str(built)], check=True, capture_output=True)
                built.replace(path)
        return ctypes.CDLL(str(path))
    except (OSError, subprocess.CalledProcessError):
        return None


def available() -> bool:
    """Whether the passes could be compiled and loaded."""
    return _library() is not None


@functools.lru_cache(maxsize=256)
def _taps(table: passes.TapTable, count: int) -> torch.Tensor:
    cells = [[[*tap.lr, tap.channel, int(tap.centre)] for tap in taps] + [[0, 0, -2, 0]] * (count - len(taps))
             for line in table.taps for taps in line]
    return torch.tensor(cells, dtype=torch.int32)


def _address(tensor: torch.Tensor | None) -> int | None:
    return None if tensor is None else tensor.data_ptr()


class _Pre(ctypes.Structure):
    _fields_ = ([(name, ctypes.c_int32) for name in ("n", "w", "h", "out_w", "out_h", "padded_w", "padded_h",
                                                     "reverse")]
                + [(name, ctypes.c_float) for name in ("jitter_x", "jitter_y", "full_w", "full_h")]
                + [(name, ctypes.c_void_p) for name in (
                    "colour", "depth", "motion", "exposure", "camera", "history", "memory", "feedback", "input", "raw",
                    "disocclusion", "kept", "nearest", "g_input", "g_history", "g_feedback")])


class _FusedPre(torch.autograd.Function):
    @staticmethod
    def forward(ctx, history, feedback, sizes, given):
        colour = given["colour"]
        n, _, h, w = colour.shape
        made = {name: colour.new_empty(n, c, h, w) for name, c in (("input", 12), ("raw", 2), ("disocclusion", 1),
                                                                   ("kept", 4), ("nearest", 1))}
        given = given | {"history": history, "feedback": feedback}
        _library().shale_pre(ctypes.byref(_Pre(**sizes, **{k: _address(v) for k, v in (given | made).items()})))
        ctx.sizes, ctx.names = sizes, [*given, "raw", "disocclusion"]
        ctx.save_for_backward(*given.values(), made["raw"], made["disocclusion"])
        results = tuple(made.values())
        ctx.mark_non_differentiable(*results[1:])
        return results

    @staticmethod
    def backward(ctx, gradient, *_):
        given = dict(zip(ctx.names, ctx.saved_tensors))
        back = [torch.zeros_like(given[name]) if needed else None
                for name, needed in zip(("history", "feedback"), ctx.needs_input_grad)]
        given |= {"g_input": gradient.contiguous(), "g_history": back[0], "g_feedback": back[1]}
        _library().shale_pre(ctypes.byref(_Pre(**ctx.sizes, **{k: _address(v) for k, v in given.items()})))
        return *back, None, None


def pre(mode: passes.Mode, frame: passes.Frame, state: passes.State | None) -> passes.Pre:
    """`nss_passes.pre`, fused where it can be."""
    if mode.name != "v1_high" or frame.colour.device.type != "cpu" or not available():
        return passes.pre(mode, frame, state)
    (w, h), (fw, fh) = frame.size, frame.full or frame.size
    given = {"colour": frame.colour, "depth": frame.depth, "motion": frame.motion,
             "exposure": frame.exposure.reshape(-1), "camera": frame.camera, "memory": state and state.memory}
    given = {name: value if value is None else value.contiguous() for name, value in given.items()}
    history, feedback = (state.history.contiguous(), state.feedback.contiguous()) if state else (None, None)
    big = history.shape if state else (0, 0, 0, 0)
    padded = feedback.shape if state else (0, 0, 0, 0)
    sizes = {"n": len(frame.colour), "w": w, "h": h, "out_w": big[3], "out_h": big[2], "padded_w": padded[3],
             "padded_h": padded[2], "reverse": int(frame.reverse), "jitter_x": frame.jitter[0],
             "jitter_y": frame.jitter[1], "full_w": fw, "full_h": fh}
    tensor, raw, disocclusion, memory, nearest = _FusedPre.apply(history, feedback, sizes, given)
    return passes.Pre(passes.mirror_pad(tensor), raw, disocclusion, passes.mirror_pad(memory), nearest)


class _Spatial(ctypes.Structure):
    _fields_ = ([(name, ctypes.c_int32) for name in ("count", "h", "w")]
                + [(name, ctypes.c_float) for name in ("low", "grid")]
                + [(name, ctypes.c_void_p) for name in ("output", "filtered", "truth", "exposure", "wanted", "error",
                                                        "slope", "steep", "filtered_slope")]
                + [("value", ctypes.c_double * 2)])


class _SpatialLoss(torch.autograd.Function):
    @staticmethod
    def forward(ctx, output, filtered, truth, exposure, low, grid):
        given = dict(zip(("output", "filtered", "truth", "exposure"),
                         (output.contiguous(), filtered.contiguous(), truth.contiguous(), exposure.contiguous())))
        made = {name: torch.empty_like(given["output"]) for name in ("wanted", "error", "slope", "steep",
                                                                     "filtered_slope")}
        n, c, h, w = output.shape
        call = _Spatial(n * c, h, w, low, grid, **{k: _address(v) for k, v in (given | made).items()})
        _library().shale_spatial(ctypes.byref(call))
        ctx.save_for_backward(made["slope"], made["steep"], made["filtered_slope"])
        ctx.mark_non_differentiable(made["wanted"])
        return output.new_tensor(call.value[0]), output.new_tensor(call.value[1]), made["error"], made["wanted"]

    @staticmethod
    def backward(ctx, spatial, filtered, error, _):
        slope, steep, filtered_slope = ctx.saved_tensors
        return torch.addcmul(error, slope, spatial).mul_(steep), filtered_slope * filtered, None, None, None, None


def losses(output: torch.Tensor, filtered: torch.Tensor, truth: torch.Tensor, exposure: torch.Tensor, low: float,
           grid: float) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """train_nss.losses on the CPU."""
    return _SpatialLoss.apply(output, filtered, truth, exposure, low, grid)


class _Fused(torch.autograd.Function):
    @staticmethod
    def forward(ctx, kernel, temporal, history, sizes, taps, colour, motion, exposure):
        kernel = kernel.permute(0, 2, 3, 1).contiguous()
        temporal = temporal.contiguous()
        history = None if history is None else history.contiguous()
        n, big = sizes["n"], (sizes["out_h"], sizes["out_w"])
        results = [colour.new_empty(n, c, *big) for c in (3, 3, 1, 1)]
        given = {"taps": taps, "colour": colour, "motion": motion, "exposure": exposure, "kernel": kernel,
                 "temporal": temporal, "history": history}
        where = dict(zip(("output", "filtered", "theta", "alpha"), results))
        _library().shale_post(ctypes.byref(_Post(**sizes, **{k: _address(v) for k, v in (given | where).items()})))
        ctx.save_for_backward(kernel, temporal, history, taps, colour, motion, exposure)
        ctx.sizes = sizes
        return tuple(results)

    @staticmethod
    def backward(ctx, *gradients):
        kernel, temporal, history, taps, colour, motion, exposure = ctx.saved_tensors
        gradients = [g.contiguous() for g in gradients]
        back = [torch.zeros_like(kernel), torch.zeros_like(temporal),
                torch.zeros_like(history) if ctx.needs_input_grad[2] else None]
        given = {"taps": taps, "colour": colour, "motion": motion, "exposure": exposure, "kernel": kernel,
                 "temporal": temporal, "history": history}
        given |= dict(zip(("g_output", "g_filtered", "g_theta", "g_alpha"), gradients))
        given |= dict(zip(("g_kernel", "g_temporal", "g_history"), back))
        _library().shale_post(ctypes.byref(_Post(**ctx.sizes, **{k: _address(v) for k, v in given.items()})))
        return back[0].permute(0, 3, 1, 2), back[1], back[2], None, None, None, None, None


def post(mode: passes.Mode, frame: passes.Frame, before: passes.Pre, outputs: dict, state: passes.State | None,
         output: tuple[int, int]) -> passes.Post:
    """`nss_passes.post`, fused where it can be."""
    if not mode.generation or not mode.tonemapped or frame.colour.device.type != "cpu" or not available():
        return passes.post(mode, frame, before, outputs, state, output)
    table = passes.tap_table(mode, frame.size, output, frame.jitter)
    kernel, temporal = outputs["kernel"], outputs["temporal"]
    block = 1 << mode.kpn_shift
    w, h = frame.size
    # The kernel is clamped to the part of it that the picture without padding covers.
    kernel = kernel[:, :, : -(-h // block), : -(-w // block)]
    network = mode.network_size(w, h)
    sizes = dict(zip(_SIZES, (
        len(frame.colour), w, h, *output, kernel.shape[3], kernel.shape[2], kernel.shape[1], temporal.shape[3],
        temporal.shape[2], *network, mode.kpn_shift, int(mode.catmull_rom), *table.tile, *table.step,
        mode.max_taps))) | {"floor": mode.weight_floor}
    results = _Fused.apply(kernel, temporal, None if state is None else state.history, sizes,
                           _taps(table, mode.max_taps), frame.colour.contiguous(), before.motion.contiguous(),
                           frame.exposure.reshape(-1).contiguous())
    return passes.Post(*results)
