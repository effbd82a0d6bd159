"""Fit of the geometry to the readings of all instruments, without outliers.

Gauss and Newton's method for a geometry and the unknowns of its instruments, with a prior:

    min over u, v   Σ ‖(measured − predicted(G u, v)) / σ‖² + ‖u‖²

u are the free numbers in units of their prior, v the unknowns of the instruments. Readings far from
any geometry near the description are excluded first, then outliers of the fit, the worst first.
Excluded readings that the final fit predicts are used again, because outliers may hide each other
and make others look like outliers. Where residuals of an instrument exceed its noise by more than
chance, they define its noise, unless a number far from its description explains them better.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from deltaid.calibration.loops import Loops
from deltaid.calibration.readings import Instrument
from deltaid.calibration.rows import (
    Residuals,
    U,
    Used,
    WeightedRows,
    noise_levels,
    step_of,
)
from deltaid.calibration.unknowns import Unknowns
from deltaid.errors import IdentificationError, KinematicsError
from deltaid.estimation.scatter import ROBUST
from deltaid.identification.study import FAR
from deltaid.levels import CERTAIN, FAINT, ROUNDS
from deltaid.model.verdict import percent
from deltaid.sensors.planning.knowledge import Knowledge

# Share up to which outliers, unmodelled torque, a misfit or the remaining error count as small.
LITTLE = 0.2
# Noise above this multiple of the stated one, together with residuals far above what the
# description's uncertainty explains, means another robot or instrument.
GROWN = 2.0
_CURE = (
    "check that the description is of this robot, units, columns, the drives' zeros, and that the "
    "instrument stood still; or state how far its numbers may be off with --lengths and --angles"
)


@dataclass(frozen=True, eq=False)
class UsedReadings(WeightedRows):
    """An instrument's readings in a fit, with the state of the instrument's unknowns and the noise
    of the fit [m]: the instrument's noise, or more where residuals show more."""

    instrument: Instrument
    state: np.ndarray
    noise: float

    @classmethod
    def begun(cls, instrument: Instrument, used: Used, state: np.ndarray) -> "UsedReadings":
        """Readings without any rows yet."""
        return cls(
            slopes=np.zeros((len(used), 1, 0)),
            errors=np.zeros((len(used), 1)),
            used=used,
            instrument=instrument,
            state=state,
            noise=instrument.noise,
        )

    @property
    def grown(self) -> float:
        """Noise as a multiple of the stated one."""
        return self.noise / self.instrument.noise

    def weighted(
        self, loops: Loops, known: Unknowns, u: U, own: Int[np.ndarray, " own"], width: int
    ) -> "UsedReadings":
        """Readings with linearised rows, in which `own` are the columns of the instrument's
        unknowns."""
        x, by_u = tool_slopes(loops, known, self.instrument, u)
        error, by_tools, by_own = self.instrument.slopes(x, self.state)
        A = np.zeros((*error.shape, width))
        A[..., : len(u)], A[..., own] = by_tools @ by_u, by_own
        return replace(self, slopes=A / self.noise, errors=error / self.noise)

    def misfit(self, what: str) -> IdentificationError:
        return IdentificationError(what, where=self.instrument.source, cure=_CURE)


@dataclass(frozen=True, eq=False)
class GeometryFit:
    """A fitted geometry: readings of each instrument, rows of these and of torques, free numbers
    in units of their prior, and the information on these and the instruments' unknowns."""

    loops: Loops = field(repr=False)
    known: Unknowns = field(repr=False)
    readings: tuple[UsedReadings, ...]
    rows: tuple[WeightedRows, ...]
    u: U
    knowledge: Knowledge

    @cached_property
    def residuals(self) -> tuple[Residuals, ...]:
        """Residuals of each instrument in units of their σ: smaller for readings that the fit uses,
        larger for others."""
        residuals = []
        for part in self.readings:
            taken = np.sum((part.slopes @ self.knowledge.inverse) ** 2, axis=2)
            variance = np.where(part.used[:, None], np.maximum(1 - taken, 1e-6), 1 + taken)
            residuals.append(part.errors / np.sqrt(variance))
        return tuple(residuals)

    @property
    def far(self) -> Float[np.ndarray, " numbers"]:
        """Distance of each number from its description, in units of its prior deviation."""
        spreads = [number.spread or np.inf for number in self.known.numbers]
        return np.abs(self.known.G @ self.u) / spreads

    @property
    def root(self) -> Float[np.ndarray, "free variables"]:
        """L with Cov u = L Lᵀ."""
        return self.knowledge.inverse[: len(self.u)]

    def shares(self) -> Float[np.ndarray, "sources numbers"]:
        """Share of each number that the description and each instrument decided; they sum to 1.

        With C = (AᵀA + 1)⁻¹ the estimate is C (Σ AᵢᵀAᵢ u + u₀); shares are the diagonals of its
        weights.
        """
        n, C, G = len(self.u), self.knowledge.inverse @ self.knowledge.inverse.T, self.known.G
        parts = [C, *(C @ (part.used_slopes.T @ part.used_slopes) for part in self.rows)]
        to_free = np.linalg.pinv(G)
        return np.array([np.einsum("kf,fg,gk->k", G, W[:n, :n], to_free) for W in parts])

    def again(self, readings: Sequence[UsedReadings], noise: float = 1.0) -> "GeometryFit":
        """Fit other readings from this solution on, with the noise of torques times `noise`."""
        known, rows = self.known, self.known.torques
        if rows is not None:
            rows = replace(rows, A=rows.A / noise, b=rows.b / noise, grown=rows.grown * noise)
            known = replace(known, torques=rows)
        return _solved(self.loops, known, readings, self.u)


def instrument_columns(n: int, instruments: Sequence[Instrument]) -> list[Int[np.ndarray, " own"]]:
    """Columns of each instrument's unknowns, behind n free numbers."""
    ends = n + np.cumsum([0, *(len(instrument.unknowns) for instrument in instruments)])
    return [np.arange(*pair) for pair in pairwise(ends)]


def tool_slopes(
    loops: Loops, known: Unknowns, instrument: Instrument, u: U
) -> tuple[Float[np.ndarray, "readings ends 3"], Float[np.ndarray, "readings coordinates free"]]:
    """Tool points of an instrument's readings, and their slopes by u."""
    rows, ends, drives = instrument.q.shape
    x, slopes = loops.points(instrument.q.reshape(-1, drives), known.G @ u)
    return x.reshape(rows, ends, 3), (slopes @ known.G).reshape(rows, 3 * ends, -1)


def _solved(loops: Loops, known: Unknowns, readings: Sequence[UsedReadings], u: U) -> GeometryFit:
    n, columns = len(u), instrument_columns(len(u), [part.instrument for part in readings])
    width = n + sum(map(len, columns))
    for _ in range(ROUNDS):
        readings = [
            part.weighted(loops, known, u, places, width)
            for part, places in zip(readings, columns, strict=True)
        ]
        rows = list[WeightedRows](readings)
        if known.torques is not None:  # torques do not depend on the instruments' unknowns
            by_u, every = known.torques.A @ known.G, np.ones(len(known.torques.b), dtype=bool)
            slopes = np.pad(by_u, ((0, 0), (0, width - n)))[:, None]
            rows.append(WeightedRows(slopes, (known.torques.b - by_u @ u)[:, None], every))
        step, knowledge = step_of(rows, u)
        if np.abs(step[:n]).max() < FAINT:
            return GeometryFit(loops, known, tuple(readings), tuple(rows), u, knowledge)
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
        "that they cannot know, such as --hold upper_arm"
        + ("; or state where the tool is, with --tool" if known.apart else ""),
    )


def fit(loops: Loops, known: Unknowns, instruments: Sequence[Instrument]) -> GeometryFit:
    """The geometry that explains the readings, without outliers. Raises an IdentificationError
    where none exists, or more than a fifth of an instrument's readings are outliers."""
    readings = [_readings_near_description(loops, known, instrument) for instrument in instruments]
    try:
        solution = _solved(loops, known, readings, np.zeros(known.G.shape[1]))
        return _with_predicted(_without_outliers(solution))
    except KinematicsError as error:
        for instrument in instruments if len(instruments) > 1 else ():
            fit(loops, replace(known, torques=None), [instrument])  # names the file at fault
        raise IdentificationError(
            f"no geometry near the described one explains the readings: {error.what}",
            where=", ".join(instrument.source for instrument in instruments),
            cure="check units, the drives' signs, zeros and order, and the readings' signs",
        ) from None


def _readings_near_description(
    loops: Loops, known: Unknowns, instrument: Instrument
) -> UsedReadings:
    """Readings that some geometry near the described one explains."""
    u, used = np.zeros(known.G.shape[1]), instrument.is_first
    own = len(u) + np.arange(len(instrument.unknowns))
    x, _ = tool_slopes(loops, known, instrument, u)
    while True:
        near = UsedReadings.begun(instrument, used, instrument.start(x, used))
        rows = near.weighted(loops, known, u, own, len(u) + len(own))
        far = rows.errors / np.sqrt(1 + np.sum(rows.slopes[..., : len(u)] ** 2, axis=2))
        worst = _outliers(far, used, robust=True)
        if not worst.any():
            return near
        used = used & ~worst


def _without_outliers(solution: GeometryFit) -> GeometryFit:
    """The fit without readings that the stated noise does not explain, a fifth at most."""
    while True:
        pairs = list(zip(solution.readings, solution.residuals, strict=True))
        worst = [_outliers(far, part.used, robust=False) for part, far in pairs]
        if not any(map(np.any, worst)):
            break
        solution = solution.again([
            replace(part, used=part.used & ~outliers)
            for part, outliers in zip(solution.readings, worst, strict=True)
        ])  # fmt: skip
    for part, far in pairs:
        if _outliers(far, part.used, robust=True, every=True).any():
            raise part.misfit(
                f"more than {percent(LITTLE)} of the {part.instrument.readings} fit no geometry "
                "near the described one"
            )
    return solution


def _with_predicted(solution: GeometryFit) -> GeometryFit:
    """The fit with the noise that residuals show, and with all readings that the others predict."""
    while True:
        grown = noise_levels(solution.rows, solution.u)
        readings = []
        for part, far, more in zip(solution.readings, solution.residuals, grown, strict=False):
            explained = np.abs(far).max(axis=1) < CERTAIN * more
            readings.append(
                replace(
                    part,
                    used=part.used | (part.instrument.is_first & explained),
                    noise=part.noise * more,
                )
            )
        pairs = zip(readings, solution.readings, strict=True)
        same = all(np.array_equal(now.used, before.used) for now, before in pairs)
        if same and max(grown, default=1.0) <= 1.0:
            break
        solution = solution.again(readings, grown[-1])
    for part in solution.readings:
        before = float(np.median(np.linalg.norm(part.used_slopes[:, : len(solution.u)], axis=1)))
        if part.grown > GROWN and part.rms > FAR * before:
            raise part.misfit(
                f"{part.instrument.readings} misfit every geometry near the described one by "
                f"{1e3 * part.rms * part.noise:.3g} mm"
            )
        most = int(np.argmax(solution.far))
        if solution.far[most] > CERTAIN and part.level(solution.knowledge) > 1.0:
            number, times = solution.known.names[most], solution.far[most]
            raise part.misfit(
                f"{part.instrument.readings} misfit every geometry near the described one; the "
                f"best has {number} off by {times:.0f} times what the description allows"
            )
    return solution


def _outliers(residuals: Residuals, used: Used, *, robust: bool, every: bool = False) -> Used:
    """Readings that noise (if robust, the spread of the used ones) does not explain and that are at
    least half as far off as the worst; no more than may be excluded, unless `every`."""
    size = np.where(used, np.abs(residuals).max(axis=1), 0.0)
    spread = float(ROBUST * np.median(np.abs(residuals[used]))) if robust else 0.0
    spared = len(used) if every else int(used.sum() - np.ceil((1 - LITTLE) * len(used)))
    among = np.argsort(np.argsort(-size)) < spared
    return among & (size > max(CERTAIN * max(1.0, spread), 0.5 * size.max(initial=0.0)))
