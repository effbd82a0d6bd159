"""Gauss and Newton's method for a geometry and the unknowns of its instruments, with a prior.

    min over u, v   Σ ‖(measured − predicted(G u, v)) / σ‖² + ‖u‖²

u are the free numbers in units of their spread before, v the unknowns of the instruments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.calibration.instruments import Instrument
from deltaid.calibration.loops import Loops
from deltaid.calibration.unknowns import Unknowns
from deltaid.errors import IdentificationError
from deltaid.estimation.problem import LinearProblem
from deltaid.sensors.planning.knowledge import Knowledge

# Steps, and the change of a number in units of its spread before that is none.
_STEPS, _STILL = 40, 1e-7
# What unknowns of an instrument may change by in a step [m or rad]; also keeps them determined.
FAR = 10.0


@dataclass(frozen=True, eq=False)
class InstrumentRows:
    """Rows of one instrument at some geometry, in units of its noise.

    Attributes:
        A: slopes by u and by the unknowns of all instruments.
        error: measured less predicted.
        values: how many values each reading has.
    """

    A: Float[np.ndarray, "rows variables"]
    error: Float[np.ndarray, " rows"]
    values: int


@dataclass(frozen=True, eq=False)
class GeometryFit:
    """Attributes:
    instruments: with the noise that residuals show.
    used: which readings of each.
    states: of each instrument's unknowns.
    u: free numbers in units of their spread before.
    rows: of each instrument's used readings, and behind them of torques.
    errors: of each instrument's readings, used or not [m].
    residuals: the same in units of their σ.
    knowledge: of u and the instruments' unknowns.
    grown: by how much each noise is larger than stated.
    """

    loops: Loops = field(repr=False)
    known: Unknowns = field(repr=False)
    instruments: tuple[Instrument, ...]
    used: tuple[Bool[np.ndarray, " _"], ...]
    states: tuple[np.ndarray, ...]
    u: Float[np.ndarray, " free"]
    rows: tuple[InstrumentRows, ...]
    errors: tuple[Float[np.ndarray, "_ _"], ...]
    residuals: tuple[Float[np.ndarray, "_ _"], ...]
    knowledge: Knowledge
    grown: tuple[float, ...]

    @property
    def theta(self) -> Float[np.ndarray, " numbers"]:
        """The numbers of the geometry."""
        return self.known.G @ self.u

    @property
    def root(self) -> Float[np.ndarray, "free variables"]:
        """L with Cov u = L Lᵀ."""
        return self.knowledge.inverse[: len(self.u)]

    @property
    def std(self) -> Float[np.ndarray, " numbers"]:
        """Standard deviations of the numbers."""
        return np.linalg.norm(self.known.G @ self.root, axis=1)

    def shares(self) -> Float[np.ndarray, "sources numbers"]:
        """Which share of each number the description and each instrument decided; they add up to 1.

        With C = (AᵀA + 1)⁻¹ the estimate is C (Σ AᵢᵀAᵢ u + u₀), whose diagonal weights these are.
        """
        n, C = len(self.u), self.knowledge.inverse @ self.knowledge.inverse.T
        parts = [C[:n, :n]] + [(C @ (part.A.T @ part.A))[:n, :n] for part in self.rows]
        to_free = np.linalg.pinv(self.known.G)
        return np.array([np.einsum("kf,fg,gk->k", self.known.G, W, to_free) for W in parts])


def solved(
    loops: Loops,
    known: Unknowns,
    instruments: Sequence[Instrument],
    used: Sequence[Bool[np.ndarray, " _"]],
    stated: Sequence[float],
    before: GeometryFit | None = None,
) -> GeometryFit:
    n = known.G.shape[1]
    u = np.zeros(n) if before is None else before.u
    states = None if before is None else before.states
    own = [len(instrument.unknowns) for instrument in instruments]
    D = np.eye(n + sum(own))
    D[n:] /= FAR
    for _ in range(_STEPS):
        tools = [tools_of(loops, known, instrument, u) for instrument in instruments]
        x, slopes = zip(*tools, strict=True)
        if states is None:
            states = tuple(
                start_of(instrument, ends, keep)
                for instrument, ends, keep in zip(instruments, x, used, strict=True)
            )
        every = _rows(known, instruments, x, slopes, states, own)
        rows = tuple(_kept(part, keep) for part, keep in zip(every, used, strict=True))
        rows += _of_torques(known, u, sum(own))
        problem = LinearProblem(
            np.vstack([part.A for part in rows]),
            np.concatenate([part.error for part in rows]),
            np.zeros(sum(len(part.error) for part in rows), dtype=int),
        ).with_known(D, np.concatenate([-u, np.zeros(sum(own))]))
        step = problem.x
        if np.abs(step[:n]).max() < _STILL:
            break
        u, first, moved = u + step[:n], n, []
        for instrument, state, size in zip(instruments, states, own, strict=True):
            moved.append(instrument.moved(state, step[first : first + size]))
            first += size
        states = tuple(moved)
    else:
        raise IdentificationError(
            f"the geometry does not settle, {np.abs(u).max():.0f} standard deviations from the "
            "description",
            where=", ".join(instrument.source for instrument in instruments),
            cure="check that these are readings of this robot by this instrument; or hold numbers "
            "that they cannot know, such as --hold upper_arm",
        )
    knowledge = Knowledge(D).and_rows(np.vstack([part.A for part in rows]))
    residuals = tuple(
        _studentised(part, keep, knowledge) for part, keep in zip(every, used, strict=True)
    )
    errors = tuple(
        x.noise * part.error.reshape(-1, part.values)
        for x, part in zip(instruments, every, strict=True)
    )
    grown = tuple(x.noise / noise for x, noise in zip(instruments, stated, strict=True))
    return GeometryFit(loops, known, tuple(instruments), tuple(used), states, u, rows, errors,
               residuals, knowledge, grown)  # fmt: skip


def _of_torques(
    known: Unknowns, u: Float[np.ndarray, " free"], own: int
) -> tuple[InstrumentRows, ...]:
    """Rows of torques, which say nothing of the instruments' unknowns."""
    if known.torques is None:
        return ()
    A = known.torques.A @ known.G
    return (InstrumentRows(np.pad(A, ((0, 0), (0, own))), known.torques.b - A @ u, 1),)


def start_of(
    instrument: Instrument, x: Sequence[np.ndarray], used: Bool[np.ndarray, " readings"]
) -> np.ndarray:
    """The state of an instrument that fits its used readings."""
    q, values, rows = (part[used] for part in (instrument.q, instrument.values, instrument.rows))
    kept = replace(instrument, q=q, values=values, rows=rows)
    return kept.start([points[used] for points in x])


def _kept(rows: InstrumentRows, keep: Bool[np.ndarray, " readings"]) -> InstrumentRows:
    kept = np.repeat(keep, rows.values)
    return InstrumentRows(rows.A[kept], rows.error[kept], rows.values)


def _studentised(
    rows: InstrumentRows, used: Bool[np.ndarray, " readings"], knowledge: Knowledge
) -> Float[np.ndarray, "readings values"]:
    """Residuals over their standard deviations: σ² less what the fit took, or more if unused."""
    taken = np.sum((rows.A @ knowledge.inverse) ** 2, axis=1)
    kept = np.repeat(used, rows.values)
    variance = np.where(kept, np.maximum(1 - taken, 1e-6), 1 + taken)
    return (rows.error / np.sqrt(variance)).reshape(-1, rows.values)


def ends_of(instrument: Instrument) -> Float[np.ndarray, "poses drives"]:
    """Drive coordinates of all ends, end after end."""
    return np.concatenate(list(instrument.q.swapaxes(0, 1)))


def tools_of(
    loops: Loops, known: Unknowns, instrument: Instrument, u: Float[np.ndarray, " free"]
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Tool points of each end of an instrument's readings, and their slopes by u."""
    q = ends_of(instrument)
    tools = loops.points(q, known.G @ u, loops.start(q))
    ends = instrument.q.shape[1]
    return np.split(tools.x, ends), np.split(tools.slopes @ known.G, ends)


def _rows(
    known: Unknowns,
    instruments: Sequence[Instrument],
    x: Sequence[Sequence[np.ndarray]],
    slopes: Sequence[Sequence[np.ndarray]],
    states: Sequence[np.ndarray],
    own: Sequence[int],
) -> list[InstrumentRows]:
    n, parts, first = known.G.shape[1], [], known.G.shape[1]
    for instrument, ends, by_u, state, size in zip(
        instruments, x, slopes, states, own, strict=True
    ):
        at = instrument.slopes(ends, state)
        values = at.error.shape[1]
        A = np.zeros((at.error.size, n + sum(own)))
        A[:, :n] = sum(
            (tool @ slope).reshape(-1, n) for tool, slope in zip(at.tools, by_u, strict=True)
        )
        A[:, first : first + size] = at.own.reshape(at.error.size, size)
        parts.append(
            InstrumentRows(A / instrument.noise, at.error.ravel() / instrument.noise, values)
        )
        first += size
    return parts
