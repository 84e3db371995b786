"""Writes TOSA 1.0 FlatBuffers files.

One block, `main`, in one region, `main`. Zero points, multipliers and shifts are CONST operands, resize and
reshape parameters CONST_SHAPE operands, made at the operator that needs them. Every operator carries its
attribute table. The same calls give the same bytes. Shapes are static and NHWC; weights OHWI, depthwise HWCM.
Source: TOSA 1.0, serialization schema (ir/schema/tosa.fbs) and operator definitions.
"""

from __future__ import annotations

from dataclasses import dataclass

import flatbuffers
import numpy as np

DTYPE = {"BOOL": 1, "INT8": 3, "INT16": 4, "INT32": 5, "INT48": 6, "FP32": 7, "FP16": 8}
NUMPY = {"BOOL": np.bool_, "INT8": np.int8, "INT16": np.int16, "INT32": np.int32, "INT48": np.int64,
         "FP32": np.float32, "FP16": np.float16}
#: By the type of the input: the types of weights, of bias and result, and of the accumulator.
CONVOLUTION = {"INT8": ("INT8", "INT32", "INT32"), "INT16": ("INT8", "INT48", "INT48"),
               "FP32": ("FP32", "FP32", "FP32"), "FP16": ("FP16", "FP16", "FP32")}
RESIZE_MODE = {"NEAREST": 1, "BILINEAR": 2}
PROPAGATE = 1
SINGLE_ROUND = 1

#: Operator number, which is also the number of its attribute table in the union.
OP = {
    "AVG_POOL2D": 2, "CONV2D": 3, "DEPTHWISE_CONV2D": 5, "MATMUL": 7, "MAX_POOL2D": 8, "TRANSPOSE_CONV2D": 10, "CLAMP": 11, "SIGMOID": 13, "ADD": 15, "MUL": 28,
    "SUB": 30, "TABLE": 31, "REDUCE_MAX": 51, "REDUCE_SUM": 54, "CONCAT": 55, "RESHAPE": 57, "SLICE": 59, "TRANSPOSE": 61, "RESIZE": 64,
    "CAST": 65, "RESCALE": 66, "CONST": 67, "CONST_SHAPE": 75,
}

#: Fields of the attribute tables in id order; operators that are not listed have none.
ATTRIBUTES = {
    "AVG_POOL2D": [("kernel", "ints"), ("stride", "ints"), ("pad", "ints"), ("acc_type", "uint")],
    "CONV2D": [("pad", "ints"), ("stride", "ints"), ("dilation", "ints"), ("local_bound", "bool"),
               ("acc_type", "uint")],
    "DEPTHWISE_CONV2D": [("pad", "ints"), ("stride", "ints"), ("dilation", "ints"), ("local_bound", "bool"),
                         ("acc_type", "uint")],
    "MAX_POOL2D": [("kernel", "ints"), ("stride", "ints"), ("pad", "ints"), ("nan_mode", "uint")],
    "TRANSPOSE_CONV2D": [("out_pad", "ints"), ("stride", "ints"), ("local_bound", "bool"), ("acc_type", "uint")],
    "CLAMP": [("min_val", "bytes"), ("max_val", "bytes"), ("nan_mode", "uint")],
    "REDUCE_MAX": [("axis", "int"), ("nan_mode", "uint")],
    "REDUCE_SUM": [("axis", "int")],
    "CONCAT": [("axis", "int")],
    "TRANSPOSE": [("perms", "ints")],
    "RESIZE": [("mode", "uint")],
    "RESCALE": [("scale32", "bool"), ("rounding_mode", "uint"), ("per_channel", "bool"),
                ("input_unsigned", "bool"), ("output_unsigned", "bool")],
}


@dataclass(frozen=True)
class Tensor:
    """A value of the graph; operators take and return these."""

    name: str
    shape: tuple[int, ...]
    dtype: str


@dataclass(frozen=True)
class _Operator:
    op: str
    attributes: dict
    inputs: list[str]
    outputs: list[str]


class GraphWriter:
    """Collects operators in order and packs them. Errors: ValueError naming the tensor."""

    def __init__(self):
        self._operators: list[_Operator] = []
        self._tensors: list[tuple[Tensor, bytes | None]] = []
        self._shapes: list[tuple[str, list[int]]] = []
        self._names: set[str] = set()
        self._inputs: list[str] = []
        self._outputs: list[str] = []

    # ---- values ----

    def _claim(self, name: str) -> str:
        if not name or name in self._names:
            raise ValueError(f"tensor name '{name}' is empty or used twice")
        self._names.add(name)
        return name

    def _tensor(self, name: str, shape, dtype: str, data: bytes | None = None) -> Tensor:
        shape = tuple(int(d) for d in shape)
        if dtype not in DTYPE or any(d < 1 for d in shape):
            raise ValueError(f"tensor '{name}': type {dtype}, shape {list(shape)} cannot be written")
        tensor = Tensor(self._claim(name), shape, dtype)
        self._tensors.append((tensor, data))
        return tensor

    def input(self, name: str, shape, dtype: str = "INT8") -> Tensor:
        """A graph input; their order is the order of calls."""
        self._inputs.append(name)
        return self._tensor(name, shape, dtype)

    def output(self, tensor: Tensor) -> None:
        """Makes a tensor a graph output; their order is the order of calls."""
        self._outputs.append(tensor.name)

    def const(self, name: str, values, dtype: str) -> Tensor:
        """A CONST operator; values outside the type are refused, floats rounded to it."""
        array = np.asarray(values)
        with np.errstate(over="ignore"):  # what becomes infinite is refused below
            stored = array.astype(NUMPY[dtype])
        if dtype in ("FP32", "FP16"):
            if not np.all(np.isfinite(stored)):
                raise ValueError(f"constant '{name}' has values outside {dtype}")
        elif dtype == "INT48" and np.any(np.abs(stored) >= 2**47):
            raise ValueError(f"constant '{name}' has values outside {dtype}")
        elif not np.array_equal(stored.astype(np.int64), array.astype(np.int64)):
            raise ValueError(f"constant '{name}' has values outside {dtype}")
        stored = np.ascontiguousarray(stored).astype(stored.dtype.newbyteorder("<"))
        data = stored.reshape(-1, 1).view(np.uint8)[:, :6].tobytes() if dtype == "INT48" else stored.tobytes()
        tensor = self._tensor(name, array.shape, dtype, data)
        self._operators.append(_Operator("CONST", {}, [], [name]))
        return tensor

    def _shape(self, name: str, values) -> str:
        self._shapes.append((self._claim(name), [int(v) for v in values]))
        self._operators.append(_Operator("CONST_SHAPE", {}, [], [name]))
        return name

    def _emit(self, op: str, name: str, inputs, shape, dtype: str, **attributes) -> Tensor:
        names = [i.name if isinstance(i, Tensor) else i for i in inputs]
        result = self._tensor(name, shape, dtype)
        self._operators.append(_Operator(op, attributes, names, [name]))
        return result

    # ---- operators ----

    def conv2d(self, name: str, x: Tensor, weight, bias, *, input_zp: int, weight_zp: int = 0,
               pad=(0, 0, 0, 0), stride=(1, 1), dilation=(1, 1)) -> Tensor:
        """CONV2D by weights `[oc, kh, kw, ic]`, types as in CONVOLUTION; pad is top, bottom, left, right."""
        weight = np.asarray(weight)
        oc, kh, kw, ic = weight.shape
        return self._convolution("CONV2D", name, x, weight, bias, (kh, kw, ic, oc), input_zp, weight_zp, pad,
                                 stride, dilation)

    def depthwise_conv2d(self, name: str, x: Tensor, weight, bias, *, input_zp: int, weight_zp: int = 0,
                         pad=(0, 0, 0, 0), stride=(1, 1), dilation=(1, 1)) -> Tensor:
        """DEPTHWISE_CONV2D with weights `[kh, kw, c, m]`; output channel is c * m_count + m."""
        weight = np.asarray(weight)
        kh, kw, c, m = weight.shape
        return self._convolution("DEPTHWISE_CONV2D", name, x, weight, bias, (kh, kw, c, c * m), input_zp,
                                 weight_zp, pad, stride, dilation)

    def _convolution(self, op, name, x, weight, bias, sizes, input_zp, weight_zp, pad, stride, dilation) -> Tensor:
        kh, kw, ic, oc = sizes
        n, h, w, c = x.shape
        if c != ic:
            raise ValueError(f"'{name}': weights expect {ic} input channels, '{x.name}' has {c}")
        oh = self._extent(name, h - 1 + pad[0] + pad[1] - (kh - 1) * dilation[0], stride[0])
        ow = self._extent(name, w - 1 + pad[2] + pad[3] - (kw - 1) * dilation[1], stride[1])
        return self._weighted(op, name, x, weight, bias, (n, oh, ow, oc), input_zp, weight_zp, pad=pad, stride=stride,
                              dilation=dilation)

    def transpose_conv2d(self, name: str, x: Tensor, weight, bias, *, input_zp: int, weight_zp: int = 0,
                         out_pad=(0, 0, 0, 0), stride=(1, 1)) -> Tensor:
        """TRANSPOSE_CONV2D by weights `[oc, kh, kw, ic]`; out_pad is top, bottom, left, right of the result."""
        weight = np.asarray(weight)
        oc, kh, kw, ic = weight.shape
        n, h, w, c = x.shape
        if c != ic:
            raise ValueError(f"'{name}': weights expect {ic} input channels, '{x.name}' has {c}")
        shape = (n, (h - 1) * stride[0] + out_pad[0] + out_pad[1] + kh,
                 (w - 1) * stride[1] + out_pad[2] + out_pad[3] + kw, oc)
        return self._weighted("TRANSPOSE_CONV2D", name, x, weight, bias, shape, input_zp, weight_zp, out_pad=out_pad,
                              stride=stride)

    def _weighted(self, op, name, x, weight, bias, shape, input_zp, weight_zp, **attributes) -> Tensor:
        kind, result, accumulator = CONVOLUTION[x.dtype]
        operands = [x, self.const(f"{name}/weight", weight, kind), self.const(f"{name}/bias", bias, result),
                    self.const(f"{name}/input_zp", [input_zp], x.dtype),
                    self.const(f"{name}/weight_zp", [weight_zp], kind)]
        return self._emit(op, name, operands, shape, result, acc_type=DTYPE[accumulator], **attributes)

    def matmul(self, name: str, a: Tensor, b: Tensor, *, a_zp: int = 0, b_zp: int = 0) -> Tensor:
        """MATMUL of int8 `[n, h, c]` and `[n, c, w]` to int32 `[n, h, w]`."""
        if a.dtype != "INT8" or b.dtype != "INT8" or a.shape[0] != b.shape[0] or a.shape[2] != b.shape[1]:
            raise ValueError(f"'{name}': {a.dtype} {list(a.shape)} by {b.dtype} {list(b.shape)}")
        operands = [a, b, self.const(f"{name}/a_zp", [a_zp], "INT8"), self.const(f"{name}/b_zp", [b_zp], "INT8")]
        return self._emit("MATMUL", name, operands, (a.shape[0], a.shape[1], b.shape[2]), "INT32")

    def _reduce(self, op: str, name: str, x: Tensor, axis: int, **attributes) -> Tensor:
        shape = [1 if i == axis else d for i, d in enumerate(x.shape)]
        return self._emit(op, name, [x], shape, x.dtype, axis=axis, **attributes)

    def reduce_max(self, name: str, x: Tensor, axis: int) -> Tensor:
        """REDUCE_MAX over an axis, which stays with extent 1."""
        return self._reduce("REDUCE_MAX", name, x, axis, nan_mode=PROPAGATE)

    def reduce_sum(self, name: str, x: Tensor, axis: int) -> Tensor:
        """REDUCE_SUM of int32 over an axis, which stays with extent 1."""
        return self._reduce("REDUCE_SUM", name, x, axis)

    @staticmethod
    def _extent(name: str, span: int, stride: int) -> int:
        if span < 0 or span % stride:
            raise ValueError(f"'{name}': the window does not fit the input exactly")
        return span // stride + 1

    def rescale(self, name: str, x: Tensor, multiplier, shift, *, input_zp: int = 0, output_zp: int = 0,
                dtype: str = "INT8") -> Tensor:
        """RESCALE, single rounding; per channel when several multipliers are given.

        Multipliers of INT48 are 16 bits wide, all others 32.
        """
        wide = x.dtype != "INT48"
        multiplier, shift = np.atleast_1d(multiplier), np.atleast_1d(shift)
        per_channel = len(multiplier) > 1
        if len(shift) != len(multiplier) or (per_channel and len(multiplier) != x.shape[-1]):
            raise ValueError(f"'{name}': {len(multiplier)} multipliers, {len(shift)} shifts, {x.shape[-1]} channels")
        if shift.min() < 2 or shift.max() > 62 or multiplier.min() < 0:
            raise ValueError(f"'{name}': shifts must lie in 2 to 62 and multipliers must not be negative")
        operands = [x, self.const(f"{name}/multiplier", multiplier, "INT32" if wide else "INT16"),
                    self.const(f"{name}/shift", shift, "INT8"),
                    self.const(f"{name}/input_zp", [input_zp], x.dtype),
                    self.const(f"{name}/output_zp", [output_zp], dtype)]
        return self._emit("RESCALE", name, operands, x.shape, dtype, scale32=wide, rounding_mode=SINGLE_ROUND,
                          per_channel=per_channel, input_unsigned=False, output_unsigned=False)

    def clamp(self, name: str, x: Tensor, low, high) -> Tensor:
        """CLAMP to stored values low to high."""
        kind = np.dtype(NUMPY[x.dtype]).newbyteorder("<")
        return self._emit("CLAMP", name, [x], x.shape, x.dtype, min_val=np.array(low, kind).tobytes(),
                          max_val=np.array(high, kind).tobytes(), nan_mode=PROPAGATE)

    def resize(self, name: str, x: Tensor, mode: str, scale, offset, border) -> Tensor:
        """RESIZE; scale is (y_n, y_d, x_n, x_d), offset and border (y, x). Bilinear int8 gives int32."""
        n, h, w, c = x.shape
        oh = self._extent(name, (h - 1) * scale[0] - offset[0] + border[0], scale[1])
        ow = self._extent(name, (w - 1) * scale[2] - offset[1] + border[1], scale[3])
        operands = [x, self._shape(f"{name}/scale", scale), self._shape(f"{name}/offset", offset),
                    self._shape(f"{name}/border", border)]
        return self._emit("RESIZE", name, operands, (n, oh, ow, c), x.dtype if mode == "NEAREST" else "INT32",
                          mode=RESIZE_MODE[mode])

    def resize_nearest(self, name: str, x: Tensor, factor: int) -> Tensor:
        """Repeats every pixel factor by factor times.

        Half-pixel centres: with scale (factor, 1) and offset 0 the upper half of each group would round up to
        the next pixel, because TOSA takes the nearer one and ties go up.
        """
        n, border = 2 * factor, factor - 1
        return self.resize(name, x, "NEAREST", (n, 2, n, 2), (-border, -border), (border, border))

    def concat(self, name: str, parts: list[Tensor], axis: int) -> Tensor:
        """CONCAT of tensors that agree but for one axis."""
        shape = list(parts[0].shape)
        for part in parts[1:]:
            if [d for i, d in enumerate(part.shape) if i != axis] != [d for i, d in enumerate(shape) if i != axis]:
                raise ValueError(f"'{name}': '{part.name}' does not fit '{parts[0].name}'")
        shape[axis] = sum(part.shape[axis] for part in parts)
        return self._emit("CONCAT", name, parts, shape, parts[0].dtype, axis=axis)

    def table(self, name: str, x: Tensor, entries) -> Tensor:
        """TABLE of 256 int8 entries, entry i for the stored value i - 128; or of 513 int16 entries.

        Those are entry i for the value (i - 256) * 128, straight between them, to int32 with 7 bits more.
        """
        length, result = (256, "INT8") if x.dtype == "INT8" else (513, "INT32")
        if np.shape(entries) != (length,):
            raise ValueError(f"'{name}': a table has {length} entries, found shape {list(np.shape(entries))}")
        return self._emit("TABLE", name, [x, self.const(f"{name}/table", entries, x.dtype)], x.shape, result)

    def sigmoid(self, name: str, x: Tensor) -> Tensor:
        """SIGMOID of floats."""
        return self._emit("SIGMOID", name, [x], x.shape, x.dtype)

    def cast(self, name: str, x: Tensor, dtype: str) -> Tensor:
        """CAST; a float becomes the nearest integer, ties to even, saturated."""
        return self._emit("CAST", name, [x], x.shape, dtype)

    def _pool(self, op, name, x, kernel, stride, pad, zero_points, **attributes) -> Tensor:
        n, h, w, c = x.shape
        oh = self._extent(name, h + pad[0] + pad[1] - kernel[0], stride[0])
        ow = self._extent(name, w + pad[2] + pad[3] - kernel[1], stride[1])
        operands = [x] + [self.const(f"{name}/{key}", [value], x.dtype) for key, value in zero_points]
        return self._emit(op, name, operands, (n, oh, ow, c), x.dtype, kernel=kernel, stride=stride, pad=pad,
                          **attributes)

    def avg_pool2d(self, name: str, x: Tensor, kernel, stride, *, input_zp: int, output_zp: int,
                   pad=(0, 0, 0, 0)) -> Tensor:
        """AVG_POOL2D over kernel (y, x)."""
        return self._pool("AVG_POOL2D", name, x, kernel, stride, pad,
                          [("input_zp", input_zp), ("output_zp", output_zp)], acc_type=DTYPE["INT32"])

    def max_pool2d(self, name: str, x: Tensor, kernel, stride, *, pad=(0, 0, 0, 0)) -> Tensor:
        """MAX_POOL2D over kernel (y, x)."""
        return self._pool("MAX_POOL2D", name, x, kernel, stride, pad, [], nan_mode=PROPAGATE)

    def _broadcast(self, name: str, a: Tensor, b: Tensor) -> tuple[int, ...]:
        if len(a.shape) != len(b.shape) or any(p != q and 1 not in (p, q) for p, q in zip(a.shape, b.shape)):
            raise ValueError(f"'{name}': shapes {list(a.shape)} and {list(b.shape)} do not broadcast")
        return tuple(max(p, q) for p, q in zip(a.shape, b.shape))

    def add(self, name: str, a: Tensor, b: Tensor) -> Tensor:
        """ADD of two int32 or float tensors."""
        return self._emit("ADD", name, [a, b], self._broadcast(name, a, b), a.dtype)

    def sub(self, name: str, a: Tensor, b: Tensor) -> Tensor:
        """SUB of two int32 or float tensors."""
        return self._emit("SUB", name, [a, b], self._broadcast(name, a, b), a.dtype)

    def mul(self, name: str, a: Tensor, b: Tensor, shift: int = 0) -> Tensor:
        """MUL of two integer tensors to int32, or of two float tensors; shift only for int32."""
        operands = [a, b, self.const(f"{name}/shift", [shift], "INT8")]
        dtype = a.dtype if a.dtype in ("FP32", "FP16") else "INT32"
        return self._emit("MUL", name, operands, self._broadcast(name, a, b), dtype)

    def slice(self, name: str, x: Tensor, start, size) -> Tensor:
        """SLICE of size elements from start on, per axis."""
        if any(s < 0 or n < 1 or s + n > d for s, n, d in zip(start, size, x.shape)):
            raise ValueError(f"'{name}': slice {list(start)} + {list(size)} leaves {list(x.shape)}")
        operands = [x, self._shape(f"{name}/start", start), self._shape(f"{name}/size", size)]
        return self._emit("SLICE", name, operands, size, x.dtype)

    def reshape(self, name: str, x: Tensor, shape) -> Tensor:
        """RESHAPE with the same number of elements."""
        if int(np.prod(shape)) != int(np.prod(x.shape)):
            raise ValueError(f"'{name}': {list(x.shape)} has not as many elements as {list(shape)}")
        return self._emit("RESHAPE", name, [x, self._shape(f"{name}/shape", shape)], shape, x.dtype)

    def transpose(self, name: str, x: Tensor, perms) -> Tensor:
        """TRANSPOSE; output axis i is input axis perms[i]."""
        return self._emit("TRANSPOSE", name, [x], [x.shape[p] for p in perms], x.dtype, perms=perms)

    # ---- packing ----

    def operators(self, constants: bool = False) -> list[str]:
        """Operator names in order, without constants unless asked."""
        return [o.op for o in self._operators if constants or not o.op.startswith("CONST")]

    def pack(self) -> bytes:
        """The file. Errors: ValueError when an output is missing."""
        if not self._inputs or not self._outputs:
            raise ValueError("a graph needs at least one input and one output")
        builder = flatbuffers.Builder(1 << 16)
        pack = _Packer(builder)
        operators = pack.offsets([self._operator(pack, o) for o in self._operators])
        tensors = pack.offsets([
            pack.table([("offset", pack.text(t.name)), ("offset", pack.ints(t.shape)), ("uint", DTYPE[t.dtype]),
                        ("offset", None if data is None else pack.octets(data))])
            for t, data in self._tensors
        ])
        shapes = pack.offsets([
            pack.table([("offset", pack.text(name)), ("uint", len(values)),
                        ("offset", pack.octets(np.array(values, "<i8").tobytes()))])
            for name, values in self._shapes
        ])
        inputs, outputs = pack.texts(self._inputs), pack.texts(self._outputs)
        main = pack.text("main")
        block = pack.table([("offset", main), ("offset", operators), ("offset", tensors), ("offset", inputs),
                            ("offset", outputs), ("offset", shapes)])
        region = pack.table([("offset", main), ("offset", pack.offsets([block]))])
        version = pack.version(1, 0, 0)
        root = pack.table([("offset", version), ("offset", pack.offsets([region]))])
        builder.Finish(root, file_identifier=b"TOSA")
        return bytes(builder.Output())

    @staticmethod
    def _operator(pack: _Packer, operator: _Operator) -> int:
        layout = ATTRIBUTES.get(operator.op, [])
        unknown = set(operator.attributes) - {name for name, _ in layout}
        if unknown:
            raise ValueError(f"{operator.op} has no attribute {sorted(unknown)}")
        fields = []
        for name, kind in layout:
            value = operator.attributes.get(name, () if kind in ("ints", "bytes") else 0)
            if kind == "ints":
                fields.append(("offset", pack.ints(value)))
            elif kind == "bytes":
                fields.append(("offset", pack.octets(value)))
            else:
                fields.append((kind, value))
        attribute = pack.table(fields)
        inputs, outputs = pack.texts(operator.inputs), pack.texts(operator.outputs)
        number = OP[operator.op]
        return pack.table([("uint", number), ("ubyte", number), ("offset", attribute), ("offset", inputs),
                           ("offset", outputs)])


class _Packer:
    """Vectors and tables of a FlatBuffers builder; children are packed before their parents."""

    def __init__(self, builder: flatbuffers.Builder):
        self._builder = builder
        self._strings: dict[str, int] = {}

    def text(self, value: str) -> int:
        """Equal strings are stored once."""
        if value not in self._strings:
            self._strings[value] = self._builder.CreateString(value)
        return self._strings[value]

    def offsets(self, items: list[int]) -> int:
        self._builder.StartVector(4, len(items), 4)
        for item in reversed(items):
            self._builder.PrependUOffsetTRelative(item)
        return self._builder.EndVector()

    def texts(self, values: list[str]) -> int:
        return self.offsets([self.text(value) for value in values])

    def ints(self, values) -> int:
        self._builder.StartVector(4, len(values), 4)
        for value in reversed(list(values)):
            self._builder.PrependInt32(int(value))
        return self._builder.EndVector()

    def octets(self, data: bytes) -> int:
        """A byte vector whose first byte is 8-aligned in the file."""
        self._builder.StartVector(1, len(data), 8)
        for value in reversed(data):
            self._builder.PrependByte(value)
        return self._builder.EndVector()

    def table(self, fields: list[tuple[str, object]]) -> int:
        """A table from (kind, value) in id order; zeros and None are left to their defaults."""
        b = self._builder
        b.StartObject(len(fields))
        slots = {"uint": b.PrependUint32Slot, "int": b.PrependInt32Slot, "bool": b.PrependBoolSlot,
                 "ubyte": b.PrependUint8Slot}
        for slot, (kind, value) in enumerate(fields):
            if kind == "offset":
                if value is not None:
                    b.PrependUOffsetTRelativeSlot(slot, value, 0)
            else:
                slots[kind](slot, bool(value) if kind == "bool" else int(value), 0)
        return b.EndObject()

    def version(self, major: int, minor: int, patch: int) -> int:
        """Version fields default to -1 and draft to true, so all are stored."""
        b = self._builder
        b.StartObject(4)
        for slot, value in enumerate((major, minor, patch)):
            b.PrependInt32Slot(slot, value, -1)
        b.PrependBoolSlot(3, False, True)
        return b.EndObject()
