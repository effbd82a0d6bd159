"""Steps of a graph that need twice the digits of single precision.

Every step of a graph rounds its result. To first order, with w̄ the derivative of an output by the
step's result w, rounding w to 24 bits changes the output by up to |w̄ w| 2⁻²⁴. Most steps have
little effect. Near a singularity, the few that close the loops and invert the Jacobian have a
thousandfold effect; these are stored as sums of two floats (`text`). They are selected at states
from the whole workspace and beyond, up to a condition of the Jacobian of `CONDITION`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.kernel.llvm_ir import steps_of
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.model import Model

# Largest condition of the Jacobian with accurate results; largest effect of one rounding relative
# to an output's largest entry, small because roundings partly add up.
CONDITION, SHARE = 100.0, 2e-7
# Half size of the box of states over that of the workspace; number of drawn poses; number of those
# kept.
_BEYOND, _DRAWN, _KEPT = 2.5, 40_000, 80
# Largest difference of task coordinates that are the same [m, rad].
_SAME = 1e-6
# Largest relative error of one rounding to float.
_ROUNDING = float(np.finfo(np.float32).eps) / 2
# Operations without rounding, and those with a form for pairs (`text`).
_EXACT = {ca.OP_ASSIGN, ca.OP_NEG, ca.OP_TWICE, ca.OP_FABS, ca.OP_IF_ELSE_ZERO}
PAIRED = _EXACT | {
    ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_SQ, ca.OP_DIV, ca.OP_INV, ca.OP_SQRT, ca.OP_SIN,
    ca.OP_COS, ca.OP_CONST,
}  # fmt: skip


@dataclass(frozen=True)
class OutputPart:
    """Adjacent entries of a graph's output.

    Attributes:
        size: number of entries.
        like: name of the input whose largest entry is the scale of their errors; empty for their
            own largest entry, None where the precision of a float suffices.
    """

    size: int
    like: str | None = ""


@dataclass(frozen=True)
class Care:
    """States of a robot at which the steps of its graphs are judged.

    Attributes:
        states: values of a graph's inputs by their names, entries × states.
    """

    states: Mapping[str, Float[np.ndarray, "_ states"]]

    def pairs(
        self, f: ca.Function, names: Sequence[str], parts: Sequence[OutputPart]
    ) -> frozenset[int]:
        """Instructions whose results need twice the digits.

        These are instructions that change an output too much if their result is rounded, or if they
        read a pair as a float.

        Args:
            f: a graph with one output, a column.
            names: of its inputs.
            parts: of the output; entries after them need only the precision of a float.
        """
        if not any(part.like is not None for part in parts):
            return frozenset()
        with np.errstate(all="ignore"):
            steps, out = _evaluated(f, [self.states[name] for name in names])
            own, read = _shares(steps, self._rows(steps, out, parts))
        inexact = set[int]()
        for k, step in enumerate(steps):
            passed = zip(step.reads, read[k], strict=True)
            much = own[k] > SHARE or any(i in inexact and share > SHARE for (i, _), share in passed)
            if much and step.op in PAIRED:
                inexact.add(k)
        return frozenset(inexact)

    def _rows(
        self, steps: Sequence["_RoundedStep"], out: Mapping[int, int], parts: Sequence[OutputPart]
    ) -> list[tuple[int, np.ndarray]]:
        """Instructions that compute outputs, each with the scale of its error."""
        rows, end = list[tuple[int, np.ndarray]](), 0
        for part in parts:
            first, end = end, end + part.size
            made = [out[i] for i in range(first, end) if i in out]
            if part.like is None or not made:
                continue
            counted = self.states[part.like] if part.like else [steps[k].value for k in made]
            largest = np.abs(counted).max(axis=0)
            scale = np.where(np.isfinite(largest) & (largest > 0), largest, np.inf)
            rows += [(k, scale) for k in made]
        return rows


def care_for(subject: Model, table: str) -> Care:
    """States of a model, from regular ones up to a condition of `CONDITION`.

    Args:
        table: name of the table of nonzero parameters.
    """
    kinematics, rng = subject.dynamics.kinematics, np.random.default_rng(0)
    z = _poses(subject, rng)
    qd, qdd = rng.standard_normal((2, *z.shape)) * np.array([2.0, 10.0])[:, None, None]
    qd[::4] = 0.0
    qdd[::8] = 0.0
    tau = subject.dynamics.torque(z, qd, qdd, subject.p)
    p = np.repeat(subject.p[subject.p != 0][:, None], len(z), axis=1)
    states = {"z": z, "x": z, "q": kinematics.inverse(z), "qd": qd, "qdd": qdd, "tau": tau}
    return Care({name: x.T for name, x in states.items()} | {table: p})


def _poses(subject: Model, rng: np.random.Generator) -> Float[np.ndarray, "states dof"]:
    """Poses on the home pose's branch, half of them near singularities."""
    kinematics = subject.dynamics.kinematics
    z = np.vstack([kinematics.home, random_poses(subject, rng, _BEYOND, _DRAWN)])
    regularity = kinematics.regularity(z)
    side = np.sign(regularity.determinant) == np.sign(regularity.determinant[0])
    good = (regularity.condition < CONDITION) & side
    good[0] = True  # home, so that at least one pose remains
    z, condition = z[good], regularity.condition[good]
    z = np.vstack([z[:_KEPT], z[np.argsort(condition)[::-1][:_KEPT]]])
    return on_home_branch(kinematics, z)


def random_poses(
    subject: Model, rng: np.random.Generator, size: float, count: int
) -> Float[np.ndarray, "states dof"]:
    """Random task coordinates in a box of `size` times the workspace, turned by at most the
    described angles."""
    robot = subject.robot
    centre, half = map(robot.task.of_point, robot.workspace.inner_box)
    r = centre + size * half * rng.uniform(-1, 1, (count, len(centre)))
    psi = rng.uniform(robot.turn.low, robot.turn.high, (count, subject.dynamics.dof - len(centre)))
    return np.hstack([r, min(size, 1.0) * psi])


def on_home_branch(
    kinematics: Kinematics, z: Float[np.ndarray, "states dof"]
) -> Float[np.ndarray, "some dof"]:
    """Poses that forward kinematics finds again from their drive coordinates."""
    again, reached = kinematics.forward_unchecked(kinematics.inverse(z))
    return z[reached & (np.abs(again - z) < _SAME).all(axis=1)]


# Replaces undefined and infinite values by zero.
_finite = partial(np.nan_to_num, posinf=0.0, neginf=0.0)


@dataclass(frozen=True)
class _RoundedStep:
    """An instruction, evaluated at some states.

    Attributes:
        value: its result.
        reads: indices of the instructions that it reads, each with the derivative by it.
        rounding: change of the result by rounding it to a float.
    """

    op: int
    value: np.ndarray
    reads: Sequence[tuple[int, np.ndarray]]
    rounding: np.ndarray


def _evaluated(
    f: ca.Function, states: Sequence[Float[np.ndarray, "_ states"]]
) -> tuple[list[_RoundedStep], dict[int, int]]:
    """All instructions of a graph with values, and the one behind each entry of the output."""
    steps, writer, out = list[_RoundedStep](), dict[int, int](), dict[int, int]()
    for k, (op, read, to, constant) in enumerate(steps_of(f)):
        value = rounding = np.zeros(states[0].shape[1])
        reads = list[tuple[int, np.ndarray]]()
        if op == ca.OP_CONST:
            value = value + constant
            rounding = value - value.astype(np.float32)
        elif op == ca.OP_INPUT:
            value = states[read[0]][read[1]]
        elif op == ca.OP_OUTPUT:
            out[to[1]] = writer[read[0]]
        else:
            value, *slopes = _operation(op, [steps[writer[i]].value for i in read])
            reads = [(writer[i], _finite(x)) for i, x in zip(read, slopes, strict=True)]
            rounding = _ROUNDING * value if op not in _EXACT else rounding
        if op != ca.OP_OUTPUT:
            writer[to[0]] = k
        steps.append(_RoundedStep(op, value, reads, np.abs(_finite(rounding))))
    return steps, out


def _shares(
    steps: Sequence[_RoundedStep], rows: Sequence[tuple[int, np.ndarray]]
) -> tuple[list[float], list[list[float]]]:
    """Effect on outputs of rounding each instruction's result, and what it reads, relative to the
    largest entry."""
    own, read = [0.0] * len(steps), [[0.0] * len(step.reads) for step in steps]
    moved = [
        [_ROUNDING * np.abs(_finite(slope * steps[i].value)) for i, slope in step.reads]
        for step in steps
    ]
    bars = dict[int, np.ndarray]()
    for row, (k, scale) in enumerate(rows):
        bars.setdefault(k, np.zeros((len(rows), scale.size)))[row] += 1 / scale
    for k in reversed(range(len(steps))):
        if (bar := bars.pop(k, None)) is None:
            continue
        most = np.abs(bar).max(axis=0)
        own[k] = float((most * steps[k].rounding).max())
        read[k] = [float((most * m).max()) for m in moved[k]]
        for i, slope in steps[k].reads:
            bars[i] = bars[i] + bar * slope if i in bars else bar * slope
    return own, read


def _operation(op: int, args: list[np.ndarray]) -> list[np.ndarray]:
    """Value of an operation and its derivatives by the operands, for each state."""
    if op in _SIMPLE:
        return _SIMPLE[op](*args)
    results = _with_slopes(op, len(args), args[0].size).call([ca.DM(x) for x in args])
    return [np.asarray(x).ravel() for x in results]


# The most frequent operations, in NumPy for speed.
_ONE = np.ones(1)
_SIMPLE: Mapping[int, Callable[..., list[np.ndarray]]] = {
    ca.OP_ADD: lambda a, b: [a + b, _ONE, _ONE],
    ca.OP_SUB: lambda a, b: [a - b, _ONE, -_ONE],
    ca.OP_MUL: lambda a, b: [a * b, b, a],
    ca.OP_SQ: lambda a: [a * a, 2 * a],
    ca.OP_NEG: lambda a: [-a, -_ONE],
}


@cache
def _with_slopes(op: int, count: int, size: int) -> ca.Function:
    """An operation on columns, with its derivatives by the operands."""
    x = [ca.SX.sym("x", size) for _ in range(count)]
    value = ca.SX.unary(op, x[0]) if count == 1 else ca.SX.binary(op, *x)
    slopes = [ca.densify(ca.jtimes(value, variable, ca.SX.ones(size))) for variable in x]
    return ca.Function("f", x, [ca.densify(value), *slopes])
