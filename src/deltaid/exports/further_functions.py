"""Functions of an export by choice: `--with constraint-forces,passive-joints,regressor,online`."""

from collections.abc import Callable, Mapping

import casadi as ca
import numpy as np

from deltaid.dynamics.equations import Equations
from deltaid.errors import Doubt, unknown
from deltaid.exports.functions import ExportedCycle, ExportedFunction, Output, ParameterTable
from deltaid.exports.options import FURTHER
from deltaid.exports.spanning_tree import spanning_tree
from deltaid.exports.straight_line import Array
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.mechanism.tree_joints import tree_joints
from deltaid.model.model import Model
from deltaid.online.cycle import standard_parts, step_graph
from deltaid.online.settings import OnlineSettings


def further_functions(
    subject: Model, table: ParameterTable, names: tuple[str, ...]
) -> list[ExportedFunction]:
    """The functions of those names, each once, in the order of the list of them.

    Raises:
        DeltaidError: there is none of that name, or the robot has not what it needs.
    """
    for name in names:
        if name not in FURTHER:
            raise unknown(name, FURTHER, "further function", "--with")
    return [build(subject, table) for name, build in _FURTHER.items() if name in names]


def further_cycles(
    subject: Model, names: tuple[str, ...], settings: OnlineSettings
) -> list[ExportedCycle]:
    """The same for functions that keep a state."""
    return [online_cycle(subject, settings)] if "online" in names else []


def _constraint_forces(subject: Model, table: ParameterTable) -> ExportedFunction:
    forces = ConstraintForces(subject.robot)
    e = forces.equations
    F = ca.substitute([ca.vertcat(*[channel.value for channel in e.channels])], [e.p], [table.p])[0]
    entries = tuple(zip(forces.names, forces.units, strict=True))
    doc = "Forces in struts, joints and bearings; deltaid's docs/forces.md has frames and signs."
    inputs = (Array("z", e.z), Array("qd", e.qd), Array("qdd", e.qdd), table.array)
    return ExportedFunction("constraint_forces", doc, inputs, (Output("F", F, entries),))


def _passive_joints(subject: Model, table: ParameterTable) -> ExportedFunction:
    mechanism = subject.dynamics.kinematics.mechanism
    joints = tree_joints(subject.robot, mechanism, passive=True)
    slides = {j.name for body in spanning_tree(subject).bodies for j in body.joints if j.slides}
    units = ["m" if name in slides else "rad" for name in joints.names]
    positions = tuple(zip(joints.names, units, strict=True))
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
    e: Equations = subject.dynamics.equations
    layout = subject.dynamics.layout
    Y = ca.substitute([e.Y], [e.load], [ca.substitute([e.carried], [e.p], [table.p])[0]])[0]
    inputs = (Array("z", e.z), Array("qd", e.qd), Array("qdd", e.qdd), table.array)
    losing = (
        " Losses that depend on load take the load of the table's parameters."
        if subject.robot.load_drives
        else ""
    )
    doc = f"Y, row by row (a drive each): tau = Y p for any parameters p.{losing}"
    columns = tuple(zip(layout.names, layout.units, strict=True))
    return ExportedFunction("regressor", doc, inputs, (Output("Y", Y, columns),))


_FURTHER: Mapping[str, Callable[[Model, ParameterTable], ExportedFunction]] = {
    "constraint-forces": _constraint_forces,
    "passive-joints": _passive_joints,
    "regressor": _regressor,
}


NO_CONTACT = Doubt(
    "the online cycle finds loads, and no contacts",
    cause="the model is a robot's prior: without an identification nothing says how far its "
    "torques may be off",
    cure="identify a model from a recording first, `deltaid identify`",
)


def online_cycle(subject: Model, settings: OnlineSettings) -> ExportedCycle:
    """One cycle: payload, friction and, for an identified model, contact.

    What becomes of the state where an input is no finite number follows from the graph itself: NaN
    in place of inputs folds to constants whatever depends on them.

    Raises:
        DeltaidError: settings and robot do not fit each other.
    """
    more = standard_parts(subject)
    graph = step_graph(subject, settings, more)
    none = ca.SX(ca.DM(np.full(graph.inputs.size, np.nan)))
    spoilt, spoilt_y = ca.substitute([graph.following, graph.y], [graph.u], [none])
    return ExportedCycle(
        "online",
        f"Payload, friction{' and contact' if more else ''} while the robot runs: one cycle of "
        f"{settings.period:.9g} s. The parameters of the model are inside, not in the table.",
        graph,
        spoilt,
        spoilt_y,
    )
