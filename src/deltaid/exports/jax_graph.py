# JAX is an extra, so a machine that checks types may lack it.
# pyright: reportMissingImports=false
"""A CasADi SX function as a JAX function: its instruction list in operations of jax.numpy.

JAX traces the list once for each shape of the arguments and compiles the result, so under `jax.jit`
no call runs this Python code. All of JAX's transformations see plain operations.

Forward kinematics z(q) is a closed form, or Newton's method along a line from home. Its derivative
is T = ∂z/∂q of the closed loops, so neither of them is differentiated.
"""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from deltaid.errors import KinematicsError
from deltaid.kernel.llvm_ir import LIBM_BINARY, LIBM_UNARY, operation_name, steps_of
from deltaid.mechanism.forward import (
    AT_THE_END,
    CLOSED,
    CLOSED_SINGLE,
    COARSE,
    ON_THE_WAY,
    OTHER_MODE,
)
from deltaid.mechanism.mechanism import ClosedForm, Mechanism

Operation = Callable[..., jax.Array]


def _truth(condition: Operation) -> Operation:
    """A comparison that returns 1 or 0, as CasADi represents truth values."""
    return lambda *args: jnp.where(condition(*args), 1.0, 0.0)


# Functions of the C library with another name in jax.numpy, or none; C's remainder rounds the
# quotient to nearest, Python's rounds it down.
_LIBM: dict[str, Operation] = {
    "asin": jnp.arcsin,
    "acos": jnp.arccos,
    "atan": jnp.arctan,
    "asinh": jnp.arcsinh,
    "acosh": jnp.arccosh,
    "atanh": jnp.arctanh,
    "atan2": jnp.arctan2,
    "erf": jax.scipy.special.erf,
    "remainder": lambda a, b: a - b * jnp.round(a / b),
}


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
    **{
        op: _LIBM[name] if name in _LIBM else getattr(jnp, name)
        for op, name in {**LIBM_UNARY, **LIBM_BINARY}.items()
    },
}


def as_jax(inputs: Sequence[ca.SX], output: ca.SX) -> Callable[..., jax.Array]:
    """A function of vectors, one for each input, that returns the output as a matrix or a vector.

    The function raises a KinematicsError for arrays of other shapes, which JAX would accept.

    Raises:
        NotImplementedError: the graph has an operation that the kernels lack too.
    """
    dense = ca.densify(output)
    rows, columns = dense.shape
    graph = ca.Function("f", list(inputs), [ca.cse(ca.vec(dense))])
    steps = steps_of(graph)
    known = (*_OPERATIONS, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT)
    if strange := [op for op, *_ in steps if op not in known]:
        raise NotImplementedError(f"CasADi's {operation_name(strange[0])} has no JAX form here")

    def function(*args: ArrayLike) -> jax.Array:
        given = [jnp.asarray(arg) for arg in args]
        shapes = [(symbols.numel(),) for symbols in inputs]
        for k, (array, shape) in enumerate(zip(given, shapes, strict=True), start=1):
            if array.shape != shape:  # JAX reads beyond an array's end as its last entry
                raise KinematicsError(
                    f"has shape {array.shape}, but one sample is taken, here of shape {shape}",
                    where=f"argument {k}",
                    cure="jax.vmap(function) takes many samples, one a row",
                )
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
        # No jnp.stack: XLA would recompute shared expressions for each entry, recursively.
        stacked, place = jnp.zeros(len(out), jnp.result_type(float, *given)), jnp.arange(len(out))
        for i, x in enumerate(out):
            stacked = jnp.where(place == i, x, stacked)
        return stacked if columns == 1 else stacked.reshape(columns, rows).T

    return function


def forward_kinematics(mechanism: Mechanism, home: np.ndarray) -> Operation:
    """z(q); NaN if a loop does not close or a limb is in its other working mode."""
    form = mechanism.forward
    find = _by_newton(mechanism, home) if form is None else _closed_form(mechanism, form)
    T = as_jax([mechanism.z], mechanism.speeds.inverse_jacobian)
    z: Any = jax.custom_jvp(find)

    def derivative(at: tuple[Any], along: tuple[Any]) -> tuple[jax.Array, jax.Array]:
        pose = z(*at)
        return pose, T(pose) @ along[0]

    z.defjvp(derivative)
    return z


def _closed_form(mechanism: Mechanism, form: ClosedForm) -> Operation:
    n = mechanism.dof
    graph = as_jax([mechanism.q_symbols], ca.vertcat(form.z, form.margin, form.modes))

    def find(q: ArrayLike) -> jax.Array:
        out = graph(q)
        return jnp.where((out[n] > 0) & jnp.all(out[n + 1 :] > -OTHER_MODE), out[:n], jnp.nan)

    return find


def _by_newton(mechanism: Mechanism, home: np.ndarray) -> Operation:
    n, both = mechanism.dof, [mechanism.z, mechanism.q_symbols]
    slope = ca.jacobian(mechanism.closure, mechanism.z)
    step = as_jax(both, mechanism.z - mechanism.newton_step)
    check = as_jax(both, ca.vertcat(mechanism.closure, ca.det(slope), mechanism.modes))
    q_home = np.asarray(ca.Function("q", [mechanism.z], [mechanism.q])(home)).ravel()
    sign = float(np.sign(check(home, q_home)[n]))
    turns = np.array([middle is not None for middle in mechanism.middles], dtype=float)
    shares = np.repeat(np.linspace(0, 1, COARSE + 1)[1:], ON_THE_WAY)
    shares = np.append(shares, np.ones(AT_THE_END))

    def find(given: ArrayLike) -> jax.Array:
        q = jnp.asarray(given)
        way = q - q_home
        way = way - 2 * np.pi * turns * jnp.round(way / (2 * np.pi))

        def iterate(z: jax.Array, share: jax.Array) -> tuple[jax.Array, None]:
            return step(z, jnp.where(share < 1, q_home + share * way, q)), None

        z, _ = jax.lax.scan(iterate, jnp.asarray(home, q.dtype), jnp.asarray(shares, q.dtype))
        if mechanism.period is not None:
            z = z.at[3].add(-(mechanism.period * jnp.round((z[3] - home[3]) / mechanism.period)))
        out = check(z, q)
        closed = CLOSED if q.dtype == jnp.float64 else CLOSED_SINGLE
        good = jnp.all(jnp.abs(out[:n]) < closed) & (sign * out[n] > 0)
        return jnp.where(good & jnp.all(out[n + 1 :] > -OTHER_MODE), z, jnp.nan)

    return find
