"""Gauss and Newton's method for a geometry and the unknowns of its instruments, with a prior.

    min over u, v   Σ ‖(measured − predicted(G u, v)) / σ‖² + ‖u‖²

u are the free numbers in units of their spread before, v the unknowns of the instruments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

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
class WeightedRows:
    """Rows of an instrument, or of torques, at some geometry, in units of their noise.

    Attributes:
        slopes: of the prediction by u and by the unknowns of all instruments.
        errors: measured less predicted.
        used: which readings the fit uses.
    """

    slopes: Float[np.ndarray, "readings values variables"]
    errors: Float[np.ndarray, "readings values"]
    used: Bool[np.ndarray, " readings"]

    @cached_property
    def used_slopes(self) -> Float[np.ndarray, "rows variables"]:
        """Slopes of the used readings."""
        return self.slopes[self.used].reshape(-1, self.slopes.shape[2])

    @cached_property
    def used_errors(self) -> Float[np.ndarray, " rows"]:
        """Errors of the used readings."""
        return self.errors[self.used].ravel()

    def studentised(self, knowledge: Knowledge) -> Float[np.ndarray, "readings values"]:
        """Errors over their deviations: σ² less what the fit took, or more if unused."""
        taken = np.sum((self.slopes @ knowledge.inverse) ** 2, axis=2)
        variance = np.where(self.used[:, None], np.maximum(1 - taken, 1e-6), 1 + taken)
        return self.errors / np.sqrt(variance)


@dataclass(frozen=True, eq=False)
class UsedReadings:
    """An instrument's readings in a fit.

    Attributes:
        used: which of them.
        state: of the instrument's unknowns.
        noise: what residuals show, at least the instrument's [m].
    """

    instrument: Instrument
    used: Bool[np.ndarray, " readings"]
    state: np.ndarray
    noise: float

    @property
    def grown(self) -> float:
        """By how much the noise is larger than stated."""
        return self.noise / self.instrument.noise

    def rows(
        self,
        x: Float[np.ndarray, "readings ends 3"],
        by_u: Float[np.ndarray, "readings coordinates free"],
        own: Int[np.ndarray, " own"],
        width: int,
    ) -> WeightedRows:
        """Rows at tool points.

        Args:
            x, by_u: tool points, and their slopes.
            own: columns of the instrument's unknowns.
            width: how many columns there are.
        """
        at = self.instrument.slopes(x, self.state)
        A = np.zeros((*at.error.shape, width))
        A[..., : by_u.shape[2]] = at.tools @ by_u
        A[..., own] = at.own
        return WeightedRows(A / self.noise, at.error / self.noise, self.used)


@dataclass(frozen=True, eq=False)
class GeometryFit:
    """Attributes:
    readings: of each instrument.
    u: free numbers in units of their spread before.
    rows: of each instrument, and behind them of torques.
    knowledge: of u and the instruments' unknowns.
    """

    loops: Loops = field(repr=False)
    known: Unknowns = field(repr=False)
    readings: tuple[UsedReadings, ...]
    u: Float[np.ndarray, " free"]
    rows: tuple[WeightedRows, ...]
    knowledge: Knowledge

    @property
    def instruments(self) -> tuple[Instrument, ...]:
        """Whose readings are fitted."""
        return tuple(readings.instrument for readings in self.readings)

    @cached_property
    def residuals(self) -> tuple[Float[np.ndarray, "_ _"], ...]:
        """Of each instrument's readings, used or not, in units of their σ."""
        rows = self.rows[: len(self.readings)]
        return tuple(part.studentised(self.knowledge) for part in rows)

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
        parts = [C[:n, :n]] + [
            (C @ (part.used_slopes.T @ part.used_slopes))[:n, :n] for part in self.rows
        ]
        to_free = np.linalg.pinv(self.known.G)
        return np.array([np.einsum("kf,fg,gk->k", self.known.G, W, to_free) for W in parts])


def own_columns(n: int, instruments: Sequence[Instrument]) -> list[Int[np.ndarray, " own"]]:
    """Columns of each instrument's unknowns, behind n free numbers."""
    ends = n + np.cumsum([0, *(len(instrument.unknowns) for instrument in instruments)])
    return [np.arange(*pair) for pair in pairwise(ends)]


def solved(
    loops: Loops, known: Unknowns, readings: Sequence[UsedReadings], u: Float[np.ndarray, " free"]
) -> GeometryFit:
    """The fit to used readings, from some u and the states of the instruments."""
    n, columns = len(u), own_columns(len(u), [part.instrument for part in readings])
    width = n + sum(map(len, columns))
    D = np.eye(width)
    D[n:] /= FAR
    for _ in range(_STEPS):
        tools = [tools_of(loops, known, part.instrument, u) for part in readings]
        rows = [
            part.rows(*points, places, width)
            for part, points, places in zip(readings, tools, columns, strict=True)
        ]
        if known.torques is not None:  # which say nothing of the instruments' unknowns
            by_torques = np.pad(known.torques.A @ known.G, ((0, 0), (0, width - n)))
            error = known.torques.b - by_torques[:, :n] @ u
            rows.append(
                WeightedRows(by_torques[:, None], error[:, None], np.ones(len(error), dtype=bool))
            )
        A = np.vstack([part.used_slopes for part in rows])
        error = np.concatenate([part.used_errors for part in rows])
        problem = LinearProblem(A, error, np.zeros(len(error), dtype=int))
        step = problem.with_known(D, np.pad(-u, (0, width - n))).x
        if np.abs(step[:n]).max() < _STILL:
            return GeometryFit(
                loops, known, tuple(readings), u, tuple(rows), Knowledge(D).and_rows(A)
            )
        u = u + step[:n]
        readings = [
            replace(part, state=part.instrument.moved(part.state, step[places]))
            for part, places in zip(readings, columns, strict=True)
        ]
    raise IdentificationError(
        f"the geometry does not settle, {np.abs(u).max():.0f} standard deviations from the "
        "description",
        where=", ".join(part.instrument.source for part in readings),
        cure="check that these are readings of this robot by this instrument; or hold numbers "
        "that they cannot know, such as --hold upper_arm",
    )


def tools_of(
    loops: Loops, known: Unknowns, instrument: Instrument, u: Float[np.ndarray, " free"]
) -> tuple[Float[np.ndarray, "readings ends 3"], Float[np.ndarray, "readings coordinates free"]]:
    """Tool points of an instrument's readings, and their slopes by u."""
    rows, ends, drives = instrument.q.shape
    q = instrument.q.reshape(-1, drives)
    tools = loops.points(q, known.G @ u)
    return tools.x.reshape(rows, ends, 3), (tools.slopes @ known.G).reshape(rows, 3 * ends, -1)
