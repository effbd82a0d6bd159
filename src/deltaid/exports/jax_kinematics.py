# JAX is an extra, so a machine that checks types may lack it.
# pyright: reportMissingImports=false
"""Forward kinematics z(q) in JAX: closed form, or Newton's method along a line from home.

Its derivative is T = ∂z/∂q of the closed loops, so neither is differentiated.
"""

from collections.abc import Callable
from typing import Any

import casadi as ca
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from deltaid.exports.jax_graph import as_jax
from deltaid.mechanism.mechanism import ClosedForm, Mechanism
from deltaid.mechanism.rotation import inverse

# Steps along the way from home, Newton iterations at each and at the end, as in mechanism.newton.
_ON_THE_WAY, _AT_EACH, _AT_THE_END = 6, 2, 8
# Residual [m, rad] below which loops are closed, in doubles, and in units of rounding otherwise;
# distance [m] by which rounding may put a limb in its other working mode.
_CLOSED, _ROUNDINGS, _MODE = 1e-12, 100.0, 1e-9

Function = Callable[..., jax.Array]
Pair = tuple[jax.Array, jax.Array]


def forward_kinematics(mechanism: Mechanism, home: np.ndarray) -> Function:
    """z(q); NaN where no loop closes or a limb is in its other working mode."""
    form = mechanism.forward
    find = _by_newton(mechanism, home) if form is None else _closed_form(mechanism, form)
    T = as_jax([mechanism.z], mechanism.speeds.inverse_jacobian)
    z: Any = jax.custom_jvp(find)

    def derivative(at: tuple[Any], along: tuple[Any]) -> Pair:
        pose = z(*at)
        return pose, T(pose) @ along[0]

    z.defjvp(derivative)
    return z


def _closed_form(mechanism: Mechanism, form: ClosedForm) -> Function:
    n = mechanism.dof
    graph = as_jax([mechanism.q_symbols], ca.vertcat(form.z, form.margin, form.modes))

    def find(q: ArrayLike) -> jax.Array:
        out = graph(q)
        good = (out[n] > 0) & jnp.all(out[n + 1 :] > -_MODE)
        return jnp.where(good, out[:n], jnp.nan)

    return find


def _by_newton(mechanism: Mechanism, home: np.ndarray) -> Function:
    n, both = mechanism.dof, [mechanism.z, mechanism.q_symbols]
    slope = ca.jacobian(mechanism.closure, mechanism.z)
    step = as_jax(both, mechanism.z - inverse(slope) @ mechanism.closure)
    check = as_jax(both, ca.vertcat(mechanism.closure, ca.det(slope), mechanism.modes))
    q_home = np.asarray(ca.Function("q", [mechanism.z], [mechanism.q])(home)).ravel()
    sign = float(np.sign(check(home, q_home)[n]))
    turns = np.array([middle is not None for middle in mechanism.middles], dtype=float)
    shares = np.repeat(np.linspace(0, 1, _ON_THE_WAY + 1)[1:], _AT_EACH)
    shares = np.append(shares, np.ones(_AT_THE_END))

    def find(given: ArrayLike) -> jax.Array:
        q = jnp.asarray(given)
        way = q - q_home
        way = way - 2 * np.pi * turns * jnp.round(way / (2 * np.pi))

        def iterate(z: jax.Array, share: jax.Array) -> tuple[jax.Array, None]:
            return step(z, jnp.where(share < 1, q_home + share * way, q)), None

        z, _ = jax.lax.scan(iterate, jnp.asarray(home, q.dtype), jnp.asarray(shares, q.dtype))
        if mechanism.period is not None:
            turned = mechanism.period * jnp.round((z[3] - home[3]) / mechanism.period)
            z = z.at[3].add(-turned)
        out = check(z, q)
        closed = max(_CLOSED, _ROUNDINGS * float(jnp.finfo(q.dtype).eps))
        good = jnp.all(jnp.abs(out[:n]) < closed) & (sign * out[n] > 0)
        return jnp.where(good & jnp.all(out[n + 1 :] > -_MODE), z, jnp.nan)

    return find
