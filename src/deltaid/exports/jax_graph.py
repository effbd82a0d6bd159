# JAX is an extra, so a machine that checks types may lack it.
# pyright: reportMissingImports=false
"""A CasADi SX function as a JAX function: its instruction list, one operation of jax.numpy each.

JAX traces the list once for each shape and compiles what comes out; so nothing here is run at a
call under `jax.jit`. All of JAX's transformations see plain operations.
"""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from deltaid.errors import KinematicsError
from deltaid.kernel.llvm_ir import LIBM_BINARY, LIBM_UNARY, operation_name

Operation = Callable[..., jax.Array]
# An instruction: its operation, the slots that it reads and writes, and its constant.
Step = tuple[int, list[int], list[int], float]


def _libm(name: str) -> Operation:
    """The function of jax.numpy for one of C's library."""
    if name == "erf":
        return jax.scipy.special.erf
    if name == "remainder":  # C rounds the quotient to the nearest, Python down
        return lambda a, b: a - b * jnp.round(a / b)
    if name == "atan2":
        return jnp.arctan2
    for start, other in (("asin", "arcsin"), ("acos", "arccos"), ("atan", "arctan")):
        if name.startswith(start):
            return getattr(jnp, name.replace(start, other))
    return getattr(jnp, name)


def _truth(condition: Operation) -> Operation:
    """CasADi's logic has the numbers 1 and 0."""
    return lambda *args: jnp.where(condition(*args), 1.0, 0.0)


_OPERATIONS: dict[int, Operation] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_SQRT: jnp.sqrt,
    ca.OP_FABS: jnp.abs,
    ca.OP_FLOOR: jnp.floor,
    ca.OP_CEIL: jnp.ceil,
    ca.OP_SIGN: jnp.sign,
    ca.OP_FMIN: jnp.fmin,
    ca.OP_FMAX: jnp.fmax,
    ca.OP_COPYSIGN: jnp.copysign,
    ca.OP_LT: _truth(lambda a, b: a < b),
    ca.OP_LE: _truth(lambda a, b: a <= b),
    ca.OP_EQ: _truth(lambda a, b: a == b),
    ca.OP_NE: _truth(lambda a, b: a != b),
    ca.OP_NOT: _truth(lambda a: a == 0),
    ca.OP_AND: _truth(lambda a, b: (a != 0) & (b != 0)),
    ca.OP_OR: _truth(lambda a, b: (a != 0) | (b != 0)),
    ca.OP_IF_ELSE_ZERO: lambda a, b: jnp.where(a != 0, b, 0.0),
    **{op: _libm(name) for op, name in {**LIBM_UNARY, **LIBM_BINARY}.items()},
}


def as_jax(inputs: Sequence[ca.SX], output: ca.SX) -> Callable[..., jax.Array]:
    """A function of vectors, one for each input, with the output as a matrix, or a vector.

    The function raises a KinematicsError for arrays of other shapes, which JAX would not.

    Raises:
        NotImplementedError: the graph has an operation that no kernel has either.
    """
    dense = ca.densify(output)
    rows, columns = dense.shape
    graph = ca.Function("f", list(inputs), [ca.cse(ca.vec(dense))])
    steps = [_step(graph, k) for k in range(graph.n_instructions())]

    sizes = [symbols.numel() for symbols in inputs]

    def function(*args: ArrayLike) -> jax.Array:
        given = [jnp.asarray(arg) for arg in args]
        _require_shapes(given, sizes)
        kind = jnp.result_type(float, *given)
        value: dict[int, Any] = {}
        out: list[Any] = [0.0] * (rows * columns)
        for op, read, written, constant in steps:
            if op == ca.OP_CONST:
                value[written[0]] = constant
            elif op == ca.OP_INPUT:
                value[written[0]] = given[read[0]][read[1]]
            elif op == ca.OP_OUTPUT:
                out[written[1]] = value[read[0]]
            else:
                value[written[0]] = _OPERATIONS[op](*(value[i] for i in read))
        # Not by jnp.stack: XLA computes what several entries share anew for each of them, and all
        # that these share, and so on.
        stacked, place = jnp.zeros(len(out), kind), jnp.arange(len(out))
        for i, x in enumerate(out):
            stacked = jnp.where(place == i, x, stacked)
        return stacked if columns == 1 else stacked.reshape(columns, rows).T

    return function


def _require_shapes(given: list[jax.Array], sizes: list[int]) -> None:
    """One vector of its length for each input; beyond an array's end JAX reads its last entry."""
    for k, (array, size) in enumerate(zip(given, sizes, strict=True), start=1):
        if array.shape != (size,):
            raise KinematicsError(
                f"has shape {array.shape}, but one sample is taken, here of shape ({size},)",
                where=f"argument {k}",
                cure="jax.vmap(function) takes many samples, one a row",
            )


def _step(graph: ca.Function, k: int) -> Step:
    """An instruction: its operation, the slots that it reads and writes, and its constant."""
    op = graph.instruction_id(k)
    if op not in (*_OPERATIONS, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT):
        raise NotImplementedError(f"CasADi's {operation_name(op)} has no JAX form here")
    constant = graph.instruction_constant(k) if op == ca.OP_CONST else 0.0
    return op, graph.instruction_input(k), graph.instruction_output(k), constant
