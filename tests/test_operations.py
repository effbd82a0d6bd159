"""The size of the compiled graphs: what makes them larger makes every command slower."""

import casadi as ca
import pytest

from deltaid.dynamics.equations import build_task_motion
from deltaid.dynamics.task_dynamics import cholesky_solve
from deltaid.exports.functions import parameter_table
from deltaid.exports.model_functions import bias
from deltaid.model.model import Model, load

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
