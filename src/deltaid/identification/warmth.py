"""Friction that changes with temperature, or while a robot warms up, as columns of the regression.

Viscous and Coulomb friction of each joint grow with a course g(t) of the recording,

    τ ≈ Y p + Σ (a_v ϑ̇ + a_c sign(ϑ̇)) g(t) ∂ϑ/∂q,

the recorded temperature, or exp(−t / T) with one time constant for all joints. g has no mean over
the samples that count, so p is the friction of the mean over the recording, which is what a model
without temperature can say.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import RecordingError
from deltaid.estimation.additions import Addition, Values
from deltaid.estimation.span import Rows
from deltaid.identification.friction_rows import FrictionRows, friction_rows
from deltaid.identification.gains import shown_by_torques
from deltaid.identification.lag_stage import without_lags
from deltaid.identification.setup import Progress, Setup
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter

# Time constants that are tried, as shares of the recording's time; the last is nearly a line.
_CONSTANTS = np.geomspace(0.05, 2.0, 12)
# Finer grids about the best: how far they reach, as ratios, and so many on each.
_FINER, _NEAR = (1.4, 1.08), 9
# As for terms of friction laws: how seldom chance does as much, and how much it must be.
_SEEN, _LEAST = 4.5, 3e-4
_DEPENDENT = 1e-6
# Coefficients that change; backwards they have others in a law for each direction.
_CHANGING = ("viscous", "coulomb", "viscous_back", "coulomb_back")

Further = Float[np.ndarray, "further samples"]


@dataclass(frozen=True, eq=False)
class Course:
    """g(t) of one recording.

    Attributes:
        recording: which.
        start: when it began [s].
        constant: T [s]; None where a temperature is recorded.
        mean: of the temperature or of the exponential, which is taken off.
        span: from the first to the last, or of a temperature from the lowest to the highest.
    """

    recording: Recording
    start: float
    constant: float | None
    mean: float
    span: float

    @property
    def share(self) -> float:
        """The time constant as a share of the recording's time."""
        return (self.constant or 0.0) * self.recording.log.rate / self.recording.log.samples

    def of(self, w: Samples) -> Float[np.ndarray, " samples"]:
        """g."""
        if self.constant is None:
            return temperature(self.recording, w) - self.mean
        return np.exp(-(w.time - self.start) / self.constant) - self.mean


@dataclass(frozen=True, eq=False)
class Warmth(Addition):
    """Changes of all joints' friction along recordings, the same in all for the same course.

    Attributes:
        dynamics: of the robot.
        courses: of the change in each recording that has them.
        several: whether the fit has others.
    """

    dynamics: Dynamics
    courses: tuple[Course, ...]
    several: bool = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """For each joint the change of viscous and that of Coulomb friction."""
        where = f"@{self.courses[0].recording.path}" if self.several else ""
        by = "/K" if self.courses[0].constant is None else ""
        own = self.dynamics.layout.parameters[self.dynamics.layout.friction]
        return tuple(
            Parameter(
                kind="temperature",
                owner=f"{one.owner}{where}",
                symbol=f"{one.symbol}_change",
                unit=f"{one.unit}{by}",
                low=-np.inf,
                high=np.inf,
                prior=0.0,
                scale=one.scale / self.span,
            )
            for one in own
            if one.symbol in _CHANGING
        )

    @property
    def span(self) -> float:
        """How far the course comes at most."""
        return max(abs(one.span) for one in self.courses)

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Where viscous and Coulomb friction act."""
        rows, columns = self.dynamics.regressor_pattern
        own = self._own
        places = np.searchsorted(own, columns[self._entries])
        return rows[self._entries], places

    def entries(self, w: Samples, own: Values, recording: Recording) -> Further:
        """Those of friction times g."""
        for one in self.courses:
            if one.recording.log.sha256 == recording.log.sha256:
                return own[self._entries] * one.of(w)
        return np.zeros((len(self._entries), own.shape[1]))

    def on(self, dynamics: Dynamics) -> "Warmth":
        return replace(self, dynamics=dynamics)

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        """How friction changes, in one sentence."""
        first, robot = self.courses[0], self.dynamics.robot
        shares = []
        for parameter, one in zip(self.parameters, judged, strict=True):
            if parameter.symbol == "coulomb_change":
                joint = parameter.owner.split("@")[0]
                shares.append((joint, 100 * one.value * first.span / robot.friction[joint].coulomb))
        course = "with its temperature, from the lowest to the highest"
        if first.constant is not None:
            course = f"as it warms up, T = {first.constant:.3g} s, from the beginning to the end"
        each = ", ".join(f"{joint} {share:+.2g} %" for joint, share in shares)
        return (
            Correction(
                kind="temperature",
                log=first.recording.path.name if first.constant is not None else "",
                value=first.constant,
                unit="s" if first.constant is not None else "",
                text=f"the robot's friction changes {course}; Coulomb's by these shares of what is "
                f"described: {each}. The model has the friction of the mean",
            ),
        )

    @property
    def _own(self) -> np.ndarray:
        """Which parameters of the robot are viscous and Coulomb friction."""
        parameters = self.dynamics.layout.parameters
        return np.array(
            [k for k, one in enumerate(parameters)
             if one.kind == "friction" and one.symbol in _CHANGING]
        )  # fmt: skip

    @property
    def _entries(self) -> np.ndarray:
        _, columns = self.dynamics.regressor_pattern
        return np.flatnonzero(np.isin(columns, self._own))


def changing_friction(setup: Setup, progress: Progress) -> Setup:
    """Friction that changes along recordings, where they show it beyond chance.

    With a temperature that is recorded as that asks for, else with one time constant. What was
    found before is looked for anew: with another law, there may be nothing left of it.
    """
    if setup.settings.friction != "choose" or not setup.robot.friction:
        return setup
    if any(setup.is_disturbed(k) for k in range(len(setup.recordings))):
        return setup
    progress("looking for friction that changes with time")
    lasting = tuple(one for one in setup.additions if not isinstance(one, Warmth))
    setup = setup.changed(additions=lasting)
    try:
        rows = friction_rows(
            setup.dynamics, setup.recordings, shown_by_torques(without_lags(lasting))
        )
    except RecordingError:
        return setup
    return setup.changed(additions=(*setup.additions, *_found(rows)))


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def _found(rows: FrictionRows) -> list[Warmth]:
    motions = [one.motion() for one in rows.traces]
    recordings, several = [one.recording for one in rows.traces], len(rows.traces) > 1
    warm = [one for one in recordings if one.log.columns.temperature is not None]
    found = list[Warmth]()
    if warm:
        known = [
            temperature(one, w) for one, w in zip(recordings, motions, strict=True) if one in warm
        ]
        mean, together = float(np.mean(np.concatenate(known))), np.concatenate(known)
        courses = tuple(Course(one, 0.0, None, mean, float(np.ptp(together))) for one in warm)
        if np.ptp(together) > 0 and _seen(rows, motions, [courses]) == courses:
            found.append(Warmth(rows.dynamics, courses, len(warm) < len(recordings)))
    for one, w in zip(recordings, motions, strict=True):
        if one not in warm and len(w.time):
            best = _warming(rows, motions, one)
            found += [Warmth(rows.dynamics, (best,), several)] if best is not None else []
    return found


def _seen(
    rows: FrictionRows, motions: Sequence[Samples], tried: Sequence[tuple[Course, ...]]
) -> tuple[Course, ...] | None:
    """The courses with which friction as a whole changes most; None if that is chance.

    A course is slow against the filter's memory, so it may come after the filter.
    """
    columns = rows.bare(np.stack([_column(rows, motions, one) for one in tried], axis=1))
    lengths = np.linalg.norm(columns, axis=0)
    told = lengths > _DEPENDENT * np.sqrt(len(columns))
    if not told.any():
        return None
    directions = columns / np.where(told, lengths, np.inf)
    k = int(np.argmax((directions.T @ rows.left) ** 2))
    judged = rows.judged(directions[:, [k]], rows.left, constants=min(len(tried) - 1, 1))
    useful = judged.surprise > _SEEN and rows.share(rows.left - judged.after) > _LEAST
    return tried[k] if useful else None


def _column(rows: FrictionRows, motions: Sequence[Samples], courses: tuple[Course, ...]) -> Rows:
    """All friction times g."""
    g = [np.zeros(len(w.time)) for w in motions]
    for k, (one, w) in enumerate(zip(rows.traces, motions, strict=True)):
        for course in courses:
            if course.recording is one.recording:
                g[k] = course.of(w)
    return rows.drive_rows.stack(rows.friction * np.concatenate(g))


def _warming(rows: FrictionRows, motions: Sequence[Samples], recording: Recording) -> Course | None:
    """The time constant with which a recording's friction changes; None if it does not."""
    start, shares, best = recording.log.clock.first, _CONSTANTS, None
    for spacing in (*_FINER, None):
        seen = _seen(rows, motions, [(_exponential(recording, start, x),) for x in shares])
        if seen is None:
            return None
        best = seen[0]
        if spacing is not None:
            shares = best.share * np.geomspace(1 / spacing, spacing, _NEAR)
    return best


def _exponential(recording: Recording, start: float, share: float) -> Course:
    """A time constant as a share of a recording's time."""
    length = recording.log.samples / recording.log.rate
    end = float(np.exp(-1 / share))
    return Course(recording, start, share * length, share * (1 - end), end - 1)


def temperature(recording: Recording, w: Samples) -> Float[np.ndarray, " samples"]:
    """As recorded [°C]."""
    columns = recording.log.columns
    channel = columns.temperature
    assert channel is not None
    return channel.scale * (w.extra[:, columns.beside(channel.column)] - channel.zero)
