"""Functions of exported code: kinematics, inverse and forward dynamics, the terms of (1);
optionally those of `--with constraint-forces,passive-joints,regressor,online`.

All are functions of task coordinates z, which forward kinematics computes once per cycle, so a
controller that needs torque, mass matrix and gravity closes the loops only once.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace

import casadi as ca
import numpy as np

from deltaid.dynamics.equations import Equations
from deltaid.dynamics.joint_columns import carried, losses
from deltaid.dynamics.task_dynamics import cholesky_solve
from deltaid.errors import Doubt, unknown
from deltaid.exports.digits import Care, care_for
from deltaid.exports.functions import (
    Demand,
    ExportedCycle,
    ExportedFunction,
    Newton,
    Output,
    ParameterTable,
    parameter_table,
)
from deltaid.exports.options import FURTHER
from deltaid.exports.straight_line import Array
from deltaid.exports.text import SINGLE, Precision
from deltaid.exports.tree import spanning_tree
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.mechanism.tree_joints import tree_joints
from deltaid.model.model import Model
from deltaid.online.cycle import standard_parts, step_graph
from deltaid.online.settings import IDENTIFY_FIRST, OnlineSettings

# Default settings of exported online functions.
DEFAULT = OnlineSettings()
# Largest number of Newton steps. Four suffice from some millimetres away; without convergence after
# this number the start is far away, or there is no solution.
_NEWTON_STEPS = 20


def code_parts(
    subject: Model,
    table: str,
    precision: Precision,
    further: tuple[str, ...],
    online: OnlineSettings,
) -> tuple[ParameterTable, list[ExportedFunction], list[ExportedCycle], Care | None]:
    """Parts of code in any language: the table of parameters; functions, each after those it calls;
    functions with a state; and the states that decide where digits are doubled.

    Args:
        table: name of the table.
        further: names of additional functions, in any order.
        online: settings of the function of that name.

    Raises:
        DeltaidError: a function does not exist, or the robot lacks what it needs.
    """
    if strange := [name for name in further if name not in FURTHER]:
        raise unknown(strange[0], FURTHER, "further function", "--with")
    parameters, m = (
        parameter_table(subject, table, precision),
        subject.dynamics.kinematics.mechanism,
    )
    functions = [
        ExportedFunction(
            "inverse_kinematics",
            "q(z).",
            (Array("z", m.z),),
            (Output("q", m.q),),
            (Demand(m.reach, precision.closed, "OUT_OF_REACH"),),
        ),
        _forward(subject, precision),
        *_inverse_dynamics(subject, parameters, precision),
        *_terms(subject, parameters),
        *(build(subject, parameters) for name, build in _FURTHER.items() if name in further),
    ]
    cycles = [online_cycle(subject, online)] if "online" in further else []
    care = care_for(subject, table) if precision is SINGLE else None
    return parameters, functions, cycles, care


def _forward(subject: Model, precision: Precision) -> ExportedFunction:
    m = subject.dynamics.kinematics.mechanism
    doc, newton = "z(q) in closed form; what z holds before does not matter.", None
    if m.forward is not None:
        z, loops = m.forward.z, Demand(m.forward.margin, 0.0, "NOT_CLOSED")
        modes = m.forward.modes
    else:
        slope, z, modes = ca.jacobian(m.closure, m.z), m.z, m.modes
        q_home = ca.Function("q", [m.z], [m.q])(subject.home)
        at_home = ca.Function("d", [m.z, m.q_symbols], [ca.det(slope)])(subject.home, q_home)
        loops = Demand(float(np.sign(float(at_home))) * ca.det(slope), 0.0, "OTHER_MODE")
        newton = Newton(
            z, m.closure, m.newton_step, _NEWTON_STEPS, precision.last, precision.closed
        )
        doc = (
            f"z(q) by Newton's method, {_NEWTON_STEPS} steps at most. z holds a pose nearby "
            "before, such as that of the last cycle or home."
        )
    demands = (loops, Demand(modes, -precision.mode, "OTHER_MODE"))
    inputs, outputs = (Array("q", m.q_symbols),), (Output("z", z),)
    return ExportedFunction(
        "forward_kinematics", doc, inputs, outputs, demands, newton, unfit="NOT_CLOSED"
    )


def _function(
    table: ParameterTable,
    p: ca.SX,
    name: str,
    doc: str,
    inputs: tuple[Array, ...],
    output: Output,
) -> ExportedFunction:
    """A function of the table's parameters, in place of the symbols p."""
    value = ca.substitute([output.value], [p], [table.p])[0]
    return ExportedFunction(name, doc, (*inputs, table.array), (replace(output, value=value),))


def _inverse_dynamics(
    subject: Model, table: ParameterTable, precision: Precision
) -> Iterator[ExportedFunction]:
    e, mechanism = subject.dynamics.equations, subject.dynamics.kinematics.mechanism
    z, q = Array("z", e.z), Array("q", mechanism.q_symbols)
    rates, single = (Array("qd", e.qd), Array("qdd", e.qdd)), precision is SINGLE
    doc = "tau(z, qd, qdd), from the pose."
    yield _function(table, e.p, "inverse_dynamics_at", doc, (z, *rates), Output("tau", e.torque))
    if single:
        near = ca.substitute(e.torque, e.z, mechanism.z - mechanism.newton_step)
        doc = (
            "tau(q, qd, qdd), where z is the pose of q but for its rounding, which near "
            "singularities takes more digits of torques than it has."
        )
        inputs = (z, q, *rates)
        yield _function(table, e.p, "inverse_dynamics_near", doc, inputs, Output("tau", near))
    yield ExportedFunction(
        "inverse_dynamics",
        "tau(q, qd, qdd), by way of z as in forward_kinematics.",
        (q, *rates),
        (),
        after="inverse_dynamics_near" if single else "inverse_dynamics_at",
        closing=single,
    )


def _terms(subject: Model, table: ParameterTable) -> Iterator[ExportedFunction]:
    """Forward dynamics and the terms of (1)."""
    e, losing = subject.dynamics.equations, ""
    z, qd, tau = Array("z", e.z), Array("qd", e.qd), ca.SX.sym("tau", subject.dynamics.dof)
    if subject.robot.load_drives:
        losing = " (but for losses that depend on load)"
    for name, doc, inputs, out, value in (
        (
            "forward_dynamics",
            "qdd(z, qd, tau): M qdd = tau - C qd - g - f, by Cholesky. Friction is as at speed "
            "qd, so a drive at rest has none; who integrates this must treat the zero of a speed.",
            (z, qd, Array("tau", tau)),
            "qdd",
            acceleration(subject, e, tau),
        ),
        ("jacobian", "J = dq/dz, row by row: qd = J zd.", (z,), "J", e.J),
        ("mass_matrix", "M, symmetric.", (z,), "M", e.M),
        (
            "bias",
            f"h = C qd + g + f: gravity, velocity forces, springs, friction{losing}.",
            (z, qd),
            "h",
            bias(subject, e),
        ),
        ("gravity", "g: gravity and springs.", (z,), "g", e.g),
    ):
        yield _function(table, e.p, name, doc, inputs, Output(out, value))


def bias(subject: Model, e: Equations) -> ca.SX:
    """C q̇ + g + f: the torque without acceleration and without load-dependent losses."""
    names, p = subject.dynamics.layout.names, ca.SX(e.p)
    for drive in subject.robot.load_drives:
        p[names.index(f"load.{drive}")] = 0
    return ca.substitute([e.torque], [e.qdd, e.p], [ca.SX.zeros(e.qdd.numel()), p])[0]


def acceleration(subject: Model, e: Equations, tau: ca.SX) -> ca.SX:
    """q̈(z, q̇, τ, p): M q̈ = τ − C q̇ − g − f by Cholesky's method.

    One graph shares all common terms of M and the forces. Results are NaN where M is not positive
    definite. Load-dependent friction takes its share of the torques that gears carry.
    """
    robot = subject.robot
    losing = [robot.drives.index(drive) for drive in robot.load_drives]
    right = ca.horzcat(tau - bias(subject, e), ca.SX.eye(tau.numel())[:, losing])
    responses = cholesky_solve(e.M, right)
    if not losing:
        return responses
    qdd, G = responses[:, 0], responses[:, 1:]
    return qdd - G @ losses(robot, carried(robot, tau, e.qd, qdd, e.p), G, e.qd, e.p)


def _constraint_forces(subject: Model, table: ParameterTable) -> ExportedFunction:
    forces = ConstraintForces(subject.robot)
    e, entries = forces.equations, tuple(zip(forces.names, forces.units, strict=True))
    F = Output("F", ca.vertcat(*[channel.value for channel in e.channels]), entries)
    doc = "Forces in struts, joints and bearings; deltaid's docs/forces.md has frames and signs."
    inputs = (Array("z", e.z), Array("qd", e.qd), Array("qdd", e.qdd))
    return _function(table, e.p, "constraint_forces", doc, inputs, F)


def _passive_joints(subject: Model, table: ParameterTable) -> ExportedFunction:
    joints = tree_joints(subject.robot, subject.dynamics.kinematics.mechanism, passive=True)
    slides = {j.name for body in spanning_tree(subject).bodies for j in body.joints if j.slides}
    positions = tuple((name, "m" if name in slides else "rad") for name in joints.names)
    return ExportedFunction(
        "passive_joints",
        "Coordinates x and rates xd of the joints without a drive; names, signs and zeros as in "
        "the exports to URDF and MJCF.",
        (Array("z", joints.z), Array("qd", joints.qd)),
        (
            Output("x", joints.position, positions),
            Output("xd", joints.velocity, tuple((name, f"{unit}/s") for name, unit in positions)),
        ),
    )


def _regressor(subject: Model, table: ParameterTable) -> ExportedFunction:
    e, layout = subject.dynamics.equations, subject.dynamics.layout
    Y = ca.substitute([e.Y], [e.load], [e.carried])[0]
    inputs = (Array("z", e.z), Array("qd", e.qd), Array("qdd", e.qdd))
    losing = (
        " Losses that depend on load take the load of the table's parameters."
        if subject.robot.load_drives
        else ""
    )
    doc = f"Y, row by row (a drive each): tau = Y p for any parameters p.{losing}"
    columns = tuple(zip(layout.names, layout.units, strict=True))
    return _function(table, e.p, "regressor", doc, inputs, Output("Y", Y, columns))


_FURTHER: Mapping[str, Callable[[Model, ParameterTable], ExportedFunction]] = {
    "constraint-forces": _constraint_forces,
    "passive-joints": _passive_joints,
    "regressor": _regressor,
}


NO_CONTACT = Doubt(
    "the online cycle finds loads, and no contacts",
    cause="the model is a robot's prior: without an identification nothing says how far its "
    "torques may be off",
    cure=IDENTIFY_FIRST,
)


def online_cycle(subject: Model, settings: OnlineSettings) -> ExportedCycle:
    """One cycle: payload, friction and, for an identified model, contact.

    Raises:
        DeltaidError: settings and robot are incompatible.
    """
    more = standard_parts(subject)
    return ExportedCycle(
        "online",
        f"Payload, friction{' and contact' if more else ''} while the robot runs: one cycle of "
        f"{settings.period:.9g} s. The parameters of the model are inside, not in the table.",
        step_graph(subject, settings, more),
    )
