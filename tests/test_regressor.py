"""Columns of the regressor, and the size of compiled graphs, which must not grow."""

import casadi as ca
import numpy as np
import pytest

from composed import Make, random_states, twin
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.equations import build_task_motion
from deltaid.dynamics.parameters import prior_parameters
from deltaid.dynamics.task_dynamics import cholesky_solve
from deltaid.exports.functions import parameter_table
from deltaid.exports.model_functions import bias
from deltaid.model.model import Model, load
from geometries import generic_states


def test_friction_is_of_the_described_joints_only() -> None:
    """In the joints' order, whatever the order in the description."""
    made = twin(Make(telescope=True, springs=False))
    robot = made.robot
    some = {joint: robot.friction[joint] for joint in ("slide", "drive2")}
    robot = robot.changed(friction=some, rotor_inertia={"drive4": 1e-3, "drive1": 2e-2})
    dynamics, p = Dynamics(robot), prior_parameters(robot)
    names = ["viscous.drive2", "viscous.slide", "coulomb.drive2", "coulomb.slide"]
    names += ["rotor.drive1", "rotor.drive4"]
    assert list(dynamics.layout.names[60:]) == names
    slide, drive = some["slide"], some["drive2"]
    values = [drive.viscous, slide.viscous, drive.coulomb, slide.coulomb, 2e-2, 1e-3]
    np.testing.assert_array_equal(p[60:], values)
    _, q, qd, qdd = random_states(made.oracle, np.random.default_rng(8), 1)
    Y = dynamics.regressor(q, qd, qdd)[0]
    np.testing.assert_array_equal(Y[:, 64], qdd[0] * [1, 0, 0, 0])
    np.testing.assert_array_equal(Y[:, 65], qdd[0] * [0, 0, 0, 1])


@pytest.mark.parametrize(
    ("robot", "rotor", "columns", "nonzero", "rank"),
    [("irb360", True, 71, 48, 37), ("irb360", False, 70, 47, 37), ("clavel", False, 36, 20, 18)],
)
def test_regressor_counts(
    robot: str, rotor: bool, columns: int, nonzero: int, rank: int, request: pytest.FixtureRequest
) -> None:
    """Columns, columns not identically zero, and rank at generic motions, as in the paper."""
    dynamics: Dynamics = request.getfixturevalue(robot)
    if dynamics.robot.rotor_inertia and not rotor:
        dynamics = Dynamics(dynamics.robot.changed(rotor_inertia={}))
    _, q, qd, qdd = generic_states(dynamics, 300)
    Y = dynamics.regressor(q, qd, qdd).reshape(-1, len(dynamics.layout.names))
    lengths = np.linalg.norm(Y, axis=0)
    seen = lengths > 1e-12 * lengths.max()
    assert lengths[seen].min() > 1e-6 * lengths.max()  # nothing is doubtful
    values = np.linalg.svd(Y[:, seen] / lengths[seen], compute_uv=False)
    assert (Y.shape[1], seen.sum()) == (columns, nonzero)
    assert values[rank - 1] > 1e-5 * values[0]
    assert values[rank] < 1e-12 * values[0]


_SLOW = (ca.OP_DIV, ca.OP_SQRT, ca.OP_INV)
_NO_OPERATION = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)


def operations(inputs: ca.SX, output: ca.SX) -> tuple[int, int]:
    """Scalar operations of a graph as it is compiled, and how many are divisions or roots."""
    f = ca.Function("f", [inputs], ca.cse([ca.vec(ca.densify(output))]))
    kinds = [f.instruction_id(k) for k in range(f.n_instructions())]
    return sum(k not in _NO_OPERATION for k in kinds), sum(k in _SLOW for k in kinds)


def graphs(model: Model) -> dict[str, tuple[int, int]]:
    """Regressor, inverse dynamics, mass matrix, terms of (1) with p as inputs; excitation's
    regressor; forward dynamics as exported, with p as a table without zeros."""
    e, mechanism = model.dynamics.equations, model.dynamics.kinematics.mechanism
    motion, x = build_task_motion(model.robot, mechanism), ca.vertcat(e.z, e.qd, e.qdd, e.load, e.p)
    table, tau = parameter_table(model, "p"), ca.SX.sym("tau", e.qd.numel())
    exported = cholesky_solve(e.M, tau - bias(model, e))
    terms = ca.vertcat(*(ca.vec(ca.densify(term)) for term in (e.M, e.C, e.g, e.f)))
    return {
        "regressor": operations(x, e.Y.T.nz[:]),
        "torque": operations(x, e.torque),
        "mass matrix": operations(x, e.M),
        "terms": operations(x, terms),
        "excitation": operations(ca.vertcat(motion.z, motion.zd, motion.zdd), motion.Y.T.nz[:]),
        "forward dynamics": operations(
            ca.vertcat(e.z, e.qd, tau, table.array.symbols), ca.substitute(exported, e.p, table.p)
        ),
    }


# Operations, and divisions and roots among them.
LARGEST = {
    "clavel-delta3": {
        "regressor": (1154, 13),
        "torque": (962, 13),
        "mass matrix": (631, 13),
        "terms": (2569, 13),
        "excitation": (1160, 16),
        "forward dynamics": (1033, 19),
    },
    "irb360-6-1600": {
        "regressor": (1858, 24),
        "torque": (1483, 24),
        "mass matrix": (1017, 20),
        "terms": (4318, 34),
        "excitation": (1862, 27),
        "forward dynamics": (1608, 32),
    },
    "h4": {
        "regressor": (2122, 18),
        "torque": (1687, 18),
        "mass matrix": (1254, 18),
        "terms": (5217, 18),
        "excitation": (2134, 22),
        "forward dynamics": (1872, 26),
    },
    "par4-linear": {
        "regressor": (1963, 14),
        "torque": (1506, 14),
        "mass matrix": (1155, 14),
        "terms": (4996, 14),
        "excitation": (1967, 18),
        "forward dynamics": (1692, 22),
    },
}


@pytest.mark.parametrize("name", sorted(LARGEST))
def test_graphs_have_not_grown(name: str) -> None:
    for kind, (count, slow) in graphs(load(name)).items():
        assert count <= LARGEST[name][kind][0], kind
        assert slow <= LARGEST[name][kind][1], kind
