"""LLVM vector code of a CasADi SX function, several samples per instruction.

The function's instruction list is straight-line code on scalars. Each scalar becomes a vector
<W x double> that holds the same quantity of W neighbouring samples, and the list becomes the body
of a loop over samples. Samples lie in columns: entry k of an input or output is contiguous over
samples, `stride` doubles before entry k+1. `uniform` inputs are the same for all samples.
"""

import struct
from collections.abc import Callable

import casadi as ca

KERNEL_NAME = "kernel"

# Functions without a vector form: libm's are called for each sample.
LIBM_UNARY = {
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin",
    ca.OP_ACOS: "acos",
    ca.OP_ATAN: "atan",
    ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh",
    ca.OP_TANH: "tanh",
    ca.OP_ASINH: "asinh",
    ca.OP_ACOSH: "acosh",
    ca.OP_ATANH: "atanh",
    ca.OP_EXP: "exp",
    ca.OP_EXPM1: "expm1",
    ca.OP_LOG: "log",
    ca.OP_LOG1P: "log1p",
    ca.OP_ERF: "erf",
}
LIBM_BINARY = {
    ca.OP_ATAN2: "atan2",
    ca.OP_POW: "pow",
    ca.OP_CONSTPOW: "pow",
    ca.OP_HYPOT: "hypot",
    ca.OP_FMOD: "fmod",
    ca.OP_REMAINDER: "remainder",
}
_LIBM = LIBM_UNARY | LIBM_BINARY
LIBM_NAMES = tuple(sorted({*_LIBM.values()}))

_ARITHMETIC = {ca.OP_ADD: "fadd", ca.OP_SUB: "fsub", ca.OP_MUL: "fmul", ca.OP_DIV: "fdiv"}
_INTRINSIC = {
    ca.OP_SQRT: "sqrt", ca.OP_FABS: "fabs", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil",
    ca.OP_FMIN: "minnum", ca.OP_FMAX: "maxnum", ca.OP_COPYSIGN: "copysign",
}  # fmt: skip
_COMPARISON = {ca.OP_LT: "olt", ca.OP_LE: "ole", ca.OP_EQ: "oeq", ca.OP_NE: "une"}

# Values of a basic block: LLVM's time grows with the square of a block's length.
_BLOCK = 2000

_TEMPLATE = """\
{declarations}
define void @{name}(ptr {apart}%out, i64 %out_stride, ptr {apart}%in, i64 %in_stride,
                    ptr noalias %uniform, i64 %n) #0 {{
entry:
{uniform_loads}
  %empty = icmp eq i64 %n, 0
  br i1 %empty, label %done, label %loop
loop:
  %i = phi i64 [ 0, %entry ], [ %next, %{last} ]
{body}
  %next = add i64 %i, {width}
  %more = icmp ult i64 %next, %n
  br i1 %more, label %loop, label %done
done:
  ret void
}}
attributes #0 = {{ nounwind "prefer-vector-width"="{bits}" "min-legal-vector-width"="{bits}" }}
"""


# An instruction: operation, slots that it reads, slots that it writes, constant.
Step = tuple[int, list[int], list[int], float]


def steps_of(f: ca.Function) -> list[Step]:
    """Instructions of an SX function, in order."""
    steps = [(f.instruction_id(k), k) for k in range(f.n_instructions())]
    constants = {k: f.instruction_constant(k) for op, k in steps if op == ca.OP_CONST}
    return [
        (op, f.instruction_input(k), f.instruction_output(k), constants.get(k, 0.0))
        for op, k in steps
    ]


def vector_ir(function: ca.Function, width: int, *, apart: bool = True) -> str:
    """LLVM assembly of `void kernel(out, out_stride, in, in_stride, uniform, n)`.

    Args:
        function: an SX function with two dense inputs, batched and uniform, and one dense output.
        width: samples per vector instruction; `n` must be a multiple of it.
        apart: whether `in` and `out` never overlap in memory.

    Raises:
        NotImplementedError: the function has one of `operations_unknown`.
    """
    return _Emitter(function, width).text(apart)


class _Emitter:
    """Translates the instruction list once, keeping the SSA value of every work-vector slot."""

    def __init__(self, function: ca.Function, width: int) -> None:
        self._function = function
        self._width = width
        # one lane is a scalar: LLVM takes much longer over vectors of one element
        self._vector, self._mask, self._suffix = (
            ("double", "i1", "f64") if width == 1
            else (f"<{width} x double>", f"<{width} x i1>", f"v{width}f64")
        )  # fmt: skip
        self._lines: list[str] = []
        self._count = 0
        self._block = "loop"
        self._slots: dict[int, str] = {}
        self._uniform_used: set[int] = set()
        self._declared: set[str] = set()

    def text(self, apart: bool) -> str:
        for step in steps_of(self._function):
            self._instruction(step)
        return _TEMPLATE.format(
            declarations="\n".join(sorted(self._declared)),
            name=KERNEL_NAME,
            apart="noalias " if apart else "",
            uniform_loads=self._uniform_loads(),
            body="\n".join(self._lines),
            last=self._block,
            width=self._width,
            bits=64 * self._width,
        )

    def _instruction(self, step: Step) -> None:
        op, inputs, outputs, constant = step
        if op == ca.OP_CONST:
            self._slots[outputs[0]] = self._constant(constant)
        elif op == ca.OP_INPUT:
            self._slots[outputs[0]] = self._input(*inputs)
        elif op == ca.OP_OUTPUT:
            pointer = self._pointer("out", outputs[1])
            value = f"{self._vector} {self._slots[inputs[0]]}"
            self._lines.append(f"  store {value}, ptr {pointer}, align 8")
        else:
            self._slots[outputs[0]] = self._operation(op, [self._slots[i] for i in inputs])

    def _operation(self, op: int, args: list[str]) -> str:
        """Emit one scalar operation on all lanes; returns the name of its value."""
        V, operands = self._vector, ", ".join(args)
        if op in _ARITHMETIC:
            return self._value(f"{_ARITHMETIC[op]} contract {V} {operands}")
        if op in _INTRINSIC:
            name = f"@llvm.{_INTRINSIC[op]}.{self._suffix}"
            self._declared.add(f"declare {V} {name}({', '.join([V] * len(args))})")
            return self._value(f"call {V} {name}({', '.join(f'{V} {arg}' for arg in args)})")
        if op in _LIBM:
            return self._per_lane(_LIBM[op], args)
        if op in _COMPARISON:
            return self._truth(f"fcmp {_COMPARISON[op]} {V} {operands}")
        if op not in _WRITTEN_OUT:
            raise NotImplementedError(f"CasADi's {operation_name(op)} has no vector form here")
        return _WRITTEN_OUT[op](self, V, *args)

    def _logic(self, word: str, a: str, b: str) -> str:
        V, zero = self._vector, self._constant(0.0)
        masks = [self._value(f"fcmp une {V} {x}, {zero}") for x in (a, b)]
        mask = self._value(f"{word} {self._mask} {masks[0]}, {masks[1]}")
        return self._value(f"uitofp {self._mask} {mask} to {V}")

    def _sign(self, a: str) -> str:
        """(a > 0) − (a < 0), and NaN for NaN."""
        V, zero = self._vector, self._constant(0.0)
        positive = self._truth(f"fcmp ogt {V} {a}, {zero}")
        negative = self._truth(f"fcmp olt {V} {a}, {zero}")
        sign = self._value(f"fsub {V} {positive}, {negative}")
        unordered = self._value(f"fcmp uno {V} {a}, {a}")
        return self._value(f"select {self._mask} {unordered}, {V} {a}, {V} {sign}")

    def _if_else_zero(self, condition: str, a: str) -> str:
        V, zero = self._vector, self._constant(0.0)
        mask = self._value(f"fcmp une {V} {condition}, {zero}")
        return self._value(f"select {self._mask} {mask}, {V} {a}, {V} {zero}")

    def _truth(self, comparison: str) -> str:
        """Emit a comparison as 0.0 or 1.0, as CasADi defines it."""
        mask = self._value(comparison)
        return self._value(f"uitofp {self._mask} {mask} to {self._vector}")

    def _per_lane(self, name: str, args: list[str]) -> str:
        kinds, result = ", ".join(["double"] * len(args)), "undef"
        self._declared.add(f"declare double @{name}({kinds}) memory(none) nounwind willreturn")
        if self._width == 1:
            return self._value(f"call double @{name}({', '.join(f'double {a}' for a in args)})")
        for lane in range(self._width):
            scalars = [
                self._value(f"extractelement {self._vector} {arg}, i64 {lane}") for arg in args
            ]
            called = self._value(
                f"call double @{name}({', '.join(f'double {s}' for s in scalars)})"
            )
            result = self._value(
                f"insertelement {self._vector} {result}, double {called}, i64 {lane}"
            )
        return result

    def _input(self, index: int, entry: int) -> str:
        if index == 1:
            self._uniform_used.add(entry)
            return f"%uniform{entry}"
        return self._value(f"load {self._vector}, ptr {self._pointer('in', entry)}, align 8")

    def _pointer(self, array: str, entry: int) -> str:
        row = self._value(f"mul i64 %{array}_stride, {entry}")
        offset = self._value(f"add i64 {row}, %i")
        return self._value(f"getelementptr double, ptr %{array}, i64 {offset}")

    def _constant(self, value: float) -> str:
        """A constant in all lanes, written as bits so that nothing is rounded."""
        (bits,) = struct.unpack("<Q", struct.pack("<d", value))
        if self._width == 1:
            return f"0x{bits:016X}"
        return f"<{', '.join([f'double 0x{bits:016X}'] * self._width)}>"

    def _uniform_loads(self) -> str:
        V, lines = self._vector, []
        for k in sorted(self._uniform_used):
            lines.append(f"  %up{k} = getelementptr double, ptr %uniform, i64 {k}")
            if self._width == 1:
                lines.append(f"  %uniform{k} = load double, ptr %up{k}")
                continue
            lines += [
                f"  %us{k} = load double, ptr %up{k}",
                f"  %uv{k} = insertelement {V} undef, double %us{k}, i64 0",
                f"  %uniform{k} = shufflevector {V} %uv{k}, {V} undef, "
                f"<{self._width} x i32> zeroinitializer",
            ]
        return "\n".join(lines)

    def _value(self, expression: str) -> str:
        self._count += 1
        name = f"%v{self._count}"
        self._lines.append(f"  {name} = {expression}")
        if self._count % _BLOCK == 0:
            self._block = f"part{self._count // _BLOCK}"
            self._lines += [f"  br label %{self._block}", f"{self._block}:"]
        return name


# Operations composed of several instructions; arguments: emitter, vector type, operands.
_WRITTEN_OUT: dict[int, Callable[..., str]] = {
    ca.OP_ASSIGN: lambda e, V, a: a,
    ca.OP_NEG: lambda e, V, a: e._value(f"fneg {V} {a}"),
    ca.OP_SQ: lambda e, V, a: e._value(f"fmul contract {V} {a}, {a}"),
    ca.OP_TWICE: lambda e, V, a: e._value(f"fadd contract {V} {a}, {a}"),
    ca.OP_INV: lambda e, V, a: e._value(f"fdiv {V} {e._constant(1.0)}, {a}"),
    ca.OP_SIGN: lambda e, V, a: e._sign(a),
    ca.OP_NOT: lambda e, V, a: e._truth(f"fcmp oeq {V} {a}, {e._constant(0.0)}"),
    ca.OP_AND: lambda e, V, a, b: e._logic("and", a, b),
    ca.OP_OR: lambda e, V, a, b: e._logic("or", a, b),
    ca.OP_IF_ELSE_ZERO: lambda e, V, a, b: e._if_else_zero(a, b),
}
_KNOWN = {
    ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, *_ARITHMETIC, *_INTRINSIC, *_COMPARISON, *_LIBM,
    *_WRITTEN_OUT,
}  # fmt: skip


def operation_name(op: int) -> str:
    """CasADi's name of an operation, such as 'erfinv'."""
    names = (name for name, value in vars(ca).items() if name.startswith("OP_") and value == op)
    return next(names, f"OP_{op}").removeprefix("OP_").lower()


def operations_unknown(function: ca.Function) -> tuple[str, ...]:
    """Names of the operations of an SX function that have no vector form here."""
    present = {op for op, *_ in steps_of(function)}
    return tuple(sorted(operation_name(op) for op in present - _KNOWN))
