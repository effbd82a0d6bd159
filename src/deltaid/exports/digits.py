"""Where single precision has too few digits: which steps of a graph need twice as many.

Every step of a graph rounds its result. What that does to the outputs is known to first order: with
w̄ the derivative of an output by the step's result w, rounding w to 24 bits moves the output by up
to |w̄ w| 2⁻²⁴. Most steps of a robot's equations do little. Near a singularity a few, the loops
closed and the Jacobian inverted, do a thousand times as much, and these are carried as the sum of
two numbers (`text`). Which ones, is decided at states from all over the workspace and beyond it,
up to a condition of the Jacobian of `CONDITION`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np
from jaxtyping import Float

from deltaid.model.model import Model

# Up to which condition of the Jacobian results are to hold, and what share of an output's largest
# entry one rounding may move it by: roundings add up, most of them not all one way.
CONDITION, SHARE = 100.0, 2e-7
# How far states are drawn about the workspace's box, how many poses, how many are kept.
_BEYOND, _DRAWN, _KEPT = 2.5, 40_000, 80
# What one rounding to a float moves a number by at most, as a share of it.
_ROUNDING = float(np.finfo(np.float32).eps) / 2
# Operations that round nothing, and those that have a form for pairs (`text`).
_EXACT = {ca.OP_ASSIGN, ca.OP_NEG, ca.OP_TWICE, ca.OP_FABS, ca.OP_IF_ELSE_ZERO}
PAIRED = _EXACT | {
    ca.OP_ADD, ca.OP_SUB, ca.OP_MUL, ca.OP_SQ, ca.OP_DIV, ca.OP_INV, ca.OP_SQRT, ca.OP_SIN,
    ca.OP_COS, ca.OP_CONST,
}  # fmt: skip
_ROWS = 16  # of outputs at a time


@dataclass(frozen=True)
class OutputPart:
    """Neighbouring entries of a graph's output.

    Attributes:
        size: how many.
        like: name of the input whose largest entry their errors are counted by; empty for their
            own largest entry, None where a float's digits do.
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
        """Numbers of the instructions whose results need twice the digits.

        Args:
            f: a graph with one output, a column.
            names: of its inputs.
            parts: of the output; entries behind them need no more than a float's digits.
        """
        if not any(part.like is not None for part in parts):
            return frozenset()
        sizes = [None if part.like is None else self._largest(part.like) for part in parts]
        inputs = [self.states[name] for name in names]
        return _Judged(f, inputs, [part.size for part in parts], sizes).pairs()

    def _largest(self, name: str) -> np.ndarray:
        """The largest entry of an input; of the part itself if there is none of that name."""
        return np.abs(self.states[name]).max(axis=0) if name else np.zeros(0)


def care_for(subject: Model, table: str) -> Care:
    """States of a model, from regular ones to a condition of `CONDITION`.

    Args:
        table: name of the table of the parameters that are not zero.
    """
    kinematics, rng = subject.dynamics.kinematics, np.random.default_rng(0)
    z = _poses(subject, rng)
    qd, qdd = rng.standard_normal((2, *z.shape)) * np.array([2.0, 10.0])[:, None, None]
    qd[::4] = 0.0
    qdd[::8] = 0.0
    q = kinematics.inverse(z)
    tau = subject.dynamics.torque(z, qd, qdd, subject.p)
    p = np.repeat(subject.p[subject.p != 0][:, None], len(z), axis=1)
    states = {"z": z, "x": z, "q": q, "qd": qd, "qdd": qdd, "tau": tau}
    return Care({name: x.T for name, x in states.items()} | {table: p})


def _poses(subject: Model, rng: np.random.Generator) -> Float[np.ndarray, "states dof"]:
    """Poses on the home pose's branch, half of them near singularities."""
    kinematics, turn = subject.dynamics.kinematics, subject.robot.turn
    centre, half = subject.robot.workspace.inner_box
    r = centre + _BEYOND * half * rng.uniform(-1, 1, (_DRAWN, 3))
    psi = rng.uniform(turn.low, turn.high, (_DRAWN, kinematics.dof - 3))
    z = np.vstack([kinematics.home, np.hstack([r, psi])])
    found = kinematics.regularity(z)
    side = np.sign(found.determinant) == np.sign(found.determinant[0])
    good = (found.condition < CONDITION) & side
    good[0] = True  # home, so that there is one
    z, condition = z[good], found.condition[good]
    z = np.vstack([z[:_KEPT], z[np.argsort(condition)[::-1][:_KEPT]]])
    again, same = kinematics.forward_unchecked(kinematics.inverse(z))
    return z[same & ~(np.abs(again - z) > 1e-6).any(axis=1)]


class _Judged:
    """A graph at some states: what roundings of its steps do to its outputs."""

    def __init__(
        self,
        f: ca.Function,
        states: Sequence[Float[np.ndarray, "_ states"]],
        sizes: Sequence[int],
        largest: Sequence[np.ndarray | None],
    ) -> None:
        self._f, self._sizes, self._largest = f, sizes, largest
        self._n, self._operations = (
            states[0].shape[1],
            [f.instruction_id(k) for k in range(f.n_instructions())],
        )
        self._value: list[np.ndarray] = []
        self._slopes: list[list[np.ndarray]] = []
        self._reads: list[list[int]] = []  # instructions that an instruction reads
        self._out: dict[int, int] = {}  # entry of the output, instruction
        with np.errstate(all="ignore"):
            self._forward(states)

    def _forward(self, states: Sequence[np.ndarray]) -> None:
        """Values of all steps and their slopes by what they read."""
        f, writer = self._f, dict[int, int]()
        for k, op in enumerate(self._operations):
            read, to = f.instruction_input(k), f.instruction_output(k)
            value, slopes, reads = np.zeros(self._n), [], []
            if op == ca.OP_CONST:
                value = np.full(self._n, f.instruction_constant(k))
            elif op == ca.OP_INPUT:
                value = states[read[0]][read[1]]
            elif op == ca.OP_OUTPUT:
                self._out[to[1]] = writer[read[0]]
            else:
                reads = [writer[i] for i in read]
                value, *slopes = _operation(op, [self._value[i] for i in reads])
            if op != ca.OP_OUTPUT:
                writer[to[0]] = k
            self._value.append(value)
            self._slopes.append([_finite(slope) for slope in slopes])
            self._reads.append(reads)

    def pairs(self) -> frozenset[int]:
        """What moves an output too far by its rounding, or by reading a pair as a float."""
        with np.errstate(all="ignore"):
            own, read = self._shares()
        found = set[int]()
        for k, op in enumerate(self._operations):
            passed = zip(self._reads[k], read[k], strict=True)
            much = own[k] > SHARE or any(i in found and share > SHARE for i, share in passed)
            if much and op in PAIRED:
                found.add(k)
        return frozenset(found)

    def _shares(self) -> tuple[list[float], list[list[float]]]:
        """Of each instruction what rounding its result, and what it reads, moves outputs by, as a
        share of the largest entry."""
        count = len(self._operations)
        own, read = [0.0] * count, [[0.0] * len(reads) for reads in self._reads]
        unit = [np.abs(_finite(self._unit(k))) for k in range(count)]
        moved = [
            [
                _ROUNDING * np.abs(_finite(slope * self._value[i]))
                for i, slope in zip(*both, strict=True)
            ]
            for both in zip(self._reads, self._slopes, strict=True)
        ]
        for rows in self._scaled():
            bars = dict[int, np.ndarray]()
            for place, (k, scale) in enumerate(rows):
                bars.setdefault(k, np.zeros((len(rows), self._n)))[place] += 1 / scale
            for k in reversed(range(count)):
                bar = bars.pop(k, None)
                if bar is None:
                    continue
                most = np.abs(bar).max(axis=0)
                own[k] = max(own[k], float((most * unit[k]).max()))
                read[k] = [
                    max(r, float((most * m).max())) for r, m in zip(read[k], moved[k], strict=True)
                ]
                for i, slope in zip(self._reads[k], self._slopes[k], strict=True):
                    bars[i] = bars[i] + bar * slope if i in bars else bar * slope
        return own, read

    def _unit(self, k: int) -> np.ndarray:
        op, value = self._operations[k], self._value[k]
        if op == ca.OP_CONST:
            return value - value.astype(np.float32)
        if op == ca.OP_INPUT or op in _EXACT:
            return np.zeros(self._n)
        return _ROUNDING * value

    def _scaled(self) -> list[list[tuple[int, np.ndarray]]]:
        """Instructions that make outputs, some at a time, with the largest entry of their part."""
        rows, first = list[tuple[int, np.ndarray]](), 0
        for size, largest in zip(self._sizes, self._largest, strict=True):
            made = [self._out[i] for i in range(first, first + size) if i in self._out]
            first += size
            if largest is None or not made:
                continue
            if not largest.size:
                largest = np.max([np.abs(self._value[k]) for k in made], axis=0)
            scale = np.where(np.isfinite(largest) & (largest > 0), largest, np.inf)
            rows += [(k, scale) for k in made]
        return [rows[i : i + _ROWS] for i in range(0, len(rows), _ROWS)]


def _finite(x: np.ndarray) -> np.ndarray:
    """Zero where a state is outside of what an operation is defined for."""
    return np.where(np.isfinite(x), x, 0.0)


def _operation(op: int, args: list[np.ndarray]) -> list[np.ndarray]:
    """Value of an operation and its slopes by what it reads, state by state."""
    if op in _SIMPLE:
        return _SIMPLE[op](*args)
    found = _with_slopes(op, len(args), args[0].size).call([ca.DM(x) for x in args])
    return [np.asarray(x).ravel() for x in found]


# What a graph is mostly made of, without the way through CasADi.
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
    """An operation on columns, with its derivatives by what it reads."""
    x = [ca.SX.sym("x", size) for _ in range(count)]
    value = ca.SX.unary(op, x[0]) if count == 1 else ca.SX.binary(op, *x)
    slopes = [ca.densify(ca.jtimes(value, variable, ca.SX.ones(size))) for variable in x]
    return ca.Function("f", x, [ca.densify(value), *slopes])
