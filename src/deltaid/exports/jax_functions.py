# JAX is an extra, so a machine that checks types may lack it.
# pyright: reportMissingImports=false
"""A model as JAX functions: its graphs, ready to differentiate, vectorise and compile."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.errors import KinematicsError
from deltaid.exports.model_functions import acceleration, bias
from deltaid.libraries import require
from deltaid.model.model import ModelLike, load
from deltaid.shown import Named

if TYPE_CHECKING:
    import jax

    Function = Callable[..., jax.Array]
else:
    Function = Callable[..., Any]


@dataclass(frozen=True, eq=False)
class JaxFunctions(Named):
    """A model's functions of one sample each, compiled by `jax.jit`; `jax.vmap` vectorises them.

    They are pure functions of arrays, so `jax.grad`, `jax.jacfwd`, `jax.vmap` and `jax.jit` accept
    them. Numbers are float32 unless doubles are enabled (`jax.config.update("jax_enable_x64",
    True)`). Arrays of another shape than one sample's raise a KinematicsError when a function is
    traced; if a pose is out of reach, results are NaN.

    The last argument `p` is optional and by default the model's own; results can be differentiated
    by a given p. Its order is that of `model.layout.names`.

    Attributes:
        p: the model's parameters.
        home: z of the home pose.
        forward_kinematics: q → z, NaN if the loops do not close in the described working mode; its
            derivative is exact.
        inverse_kinematics: z → q.
        jacobian: z → J = ∂q/∂z.
        task_velocity: z, q̇ → ż = J⁻¹ q̇.
        inverse_dynamics: q, q̇, q̈, p → τ.
        inverse_dynamics_at: z, q̇, q̈, p → τ, without forward kinematics.
        forward_dynamics: q, q̇, τ, p → q̈.
        forward_dynamics_at: z, q̇, τ, p → q̈.
        mass_matrix: z, p → M.
        bias: z, q̇, p → C q̇ + g + f, without friction that depends on load.
        gravity: z, p → g, with springs.
    """

    p: Float[np.ndarray, " parameters"]
    home: Float[np.ndarray, " dof"]
    forward_kinematics: Function
    inverse_kinematics: Function
    jacobian: Function
    task_velocity: Function
    inverse_dynamics: Function
    inverse_dynamics_at: Function
    forward_dynamics: Function
    forward_dynamics_at: Function
    mass_matrix: Function
    bias: Function
    gravity: Function


def jax_functions(model: ModelLike) -> JaxFunctions:
    """Kinematics and dynamics of a model as functions of JAX.

    Args:
        model: a model or a robot, by value, name or file.

    Raises:
        DeltaidError: JAX is not installed, or the model does not exist.
    """
    require("jax", by="jax_functions", name="JAX", install="pip install jax")
    import jax

    from deltaid.exports.jax_graph import as_jax, forward_kinematics

    subject = load(model)
    e, m = subject.dynamics.equations, subject.dynamics.kinematics.mechanism
    tau = ca.SX.sym("tau", m.dof)
    z_of = forward_kinematics(m, subject.home)
    torque = as_jax([e.z, e.qd, e.qdd, e.p], e.torque)
    speeding = as_jax([e.z, e.qd, tau, e.p], acceleration(subject, e, tau))

    def with_own_parameters(function: Function, *names: str) -> Function:
        """The compiled function, with the model's own p by default."""
        compiled: Any = jax.jit(function)

        def call(*args: Any, p: Any = subject.p) -> Any:
            if len(args) not in (len(names), len(names) + 1):
                raise KinematicsError(
                    f"takes {len(names)} arrays and perhaps the parameters, but got {len(args)}",
                    where="function of JAX",
                    cure=f"give {', '.join(names)}, and p where it is not the model's own",
                )
            return compiled(*args, p) if len(args) == len(names) else compiled(*args)

        return call

    return JaxFunctions(
        p=subject.p,
        home=subject.home,
        forward_kinematics=jax.jit(z_of),
        inverse_kinematics=jax.jit(as_jax([m.z], m.q)),
        jacobian=jax.jit(as_jax([m.z], e.J)),
        task_velocity=jax.jit(as_jax([m.z, e.qd], e.T @ e.qd)),
        inverse_dynamics=with_own_parameters(
            lambda q, qd, qdd, p: torque(z_of(q), qd, qdd, p), "q", "qd", "qdd"
        ),
        inverse_dynamics_at=with_own_parameters(torque, "z", "qd", "qdd"),
        forward_dynamics=with_own_parameters(
            lambda q, qd, tau, p: speeding(z_of(q), qd, tau, p), "q", "qd", "tau"
        ),
        forward_dynamics_at=with_own_parameters(speeding, "z", "qd", "tau"),
        mass_matrix=with_own_parameters(as_jax([e.z, e.p], e.M), "z"),
        bias=with_own_parameters(as_jax([e.z, e.qd, e.p], bias(subject, e)), "z", "qd"),
        gravity=with_own_parameters(as_jax([e.z, e.p], e.g), "z"),
    )
