"""Friction that changes with temperature, or while a robot warms up, as columns of the regression.

Viscous and Coulomb friction of each joint grow with a course g(t) of the recording,

    τ ≈ Y p + Σ (a_v ϑ̇ + a_c sign(ϑ̇)) g(t) ∂ϑ/∂q,

the recorded temperature, or exp(−t / T) with one time constant for all joints. The mean of g over
the samples is zero, so p has the mean friction of the recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from threadpoolctl import threadpool_limits

from deltaid.estimation.additions import Addition, Own, Values
from deltaid.estimation.problem import lengths
from deltaid.identification.friction_choice import SURPRISING, rows_for_friction
from deltaid.identification.friction_rows import FrictionRows
from deltaid.identification.setup import Progress, Setup
from deltaid.levels import FAINT
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PriorParameter

# Time constants that are tried, as shares of the recording's duration; the last is nearly linear.
_CONSTANTS = np.geomspace(0.05, 2.0, 12)
# Ranges of finer grids about the best constant, as ratios.
_FINER = (1.4, 1.08)
# Friction coefficients that change; a law for each direction has two more.
_CHANGING = [("friction", term) for term in ("viscous", "coulomb", "viscous_back", "coulomb_back")]


@dataclass(frozen=True, eq=False)
class Course:
    """g(t) of one recording."""

    recording: PreparedRecording
    start: float  # of the recording [s]
    constant: float | None  # T [s]; None where a temperature is recorded
    mean: float  # of the temperature or exponential, which is subtracted
    span: float  # change from beginning to end, or from lowest to highest temperature

    def values(self, w: SampleBlock) -> Float[np.ndarray, " samples"]:
        if self.constant is None:
            return temperature(self.recording, w) - self.mean
        since = np.maximum(w.time - self.start, 0.0)  # a clock may pass midnight
        return np.exp(-since / self.constant) - self.mean


@dataclass(frozen=True, eq=False)
class Warmth(Addition):
    """Changes of all joints' friction along recordings, with the same coefficients in all."""

    courses: tuple[Course, ...]  # one a recording with these changes
    several: bool = False  # whether the fit has other recordings
    is_corrected = True

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        """For each joint the change of viscous and that of Coulomb friction."""
        first, span = self.courses[0], max(abs(course.span) for course in self.courses)
        where = f"@{first.recording.path}" if self.several else ""
        per_kelvin = "/K" if first.constant is None else ""
        return tuple(
            PriorParameter(
                kind="temperature",
                owner=f"{entry.owner}{where}",
                symbol=f"{entry.symbol}_change",
                unit=f"{entry.unit}{per_kelvin}",
                low=-np.inf,
                high=np.inf,
                prior=0.0,
                scale=entry.scale / span,
            )
            for entry in (self.dynamics.layout.parameters[k] for k in self._changing)
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        rows, columns = (part[self._entries] for part in self.dynamics.regressor_pattern)
        return rows, np.searchsorted(self._changing, columns)

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        changing = own[self._entries]
        for course in self.courses:
            if course.recording.log.sha256 == recording.log.sha256:
                return changing * course.values(w)
        return np.zeros_like(changing)

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        first, laws = self.courses[0], self.dynamics.robot.friction
        shares: dict[str, list[str]] = {}
        for parameter, change in zip(self.parameters, judged, strict=True):
            joint, coefficient = parameter.owner.split("@")[0], parameter.symbol[: -len("_change")]
            if coefficient in ("viscous", "coulomb"):
                share = 100 * change.value * first.span / getattr(laws[joint], coefficient)
                shares.setdefault(joint, []).append(f"{share:+.2g}")
        each = ", ".join(f"{joint} {' and '.join(both)} %" for joint, both in shares.items())
        log, unit, course = "", "", "with its temperature, from the lowest to the highest"
        if first.constant is not None:
            log, unit = first.recording.path.name, "s"
            course = f"as it warms up, T = {first.constant:.3g} s, from the beginning to the end"
        text = (
            f"friction changes {course}; viscous and Coulomb friction by these shares of their "
            f"described values: {each}. The model has the mean friction"
        )
        return (
            Correction(kind="temperature", log=log, value=first.constant, unit=unit, text=text),
        )

    @property
    def _changing(self) -> list[int]:
        """Numbers of viscous and Coulomb friction among the robot's parameters."""
        parameters = enumerate(self.dynamics.layout.parameters)
        return [k for k, entry in parameters if (entry.kind, entry.symbol) in _CHANGING]

    @property
    def _entries(self) -> Bool[np.ndarray, " entries"]:
        return np.isin(self.dynamics.regressor_pattern[1], self._changing)


def changing_friction(setup: Setup, progress: Progress) -> Setup:
    """Stage for friction that changes along recordings beyond chance, with a recorded temperature,
    else with one time constant; it replaces its earlier result, which another friction law may
    explain."""
    bare = setup.without(Warmth)
    rows = rows_for_friction(bare, progress, "changes with time")
    return setup if rows is None else bare.changed(additions=(*bare.additions, *_changes(rows)))


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def _changes(rows: FrictionRows) -> list[Warmth]:
    changes = list[Warmth]()
    motions = {point.trace.recording: point.motion for point in rows.points}
    known = {
        recording: temperature(recording, w) for recording, w in motions.items()
        if recording.log.columns.temperature is not None
    }  # fmt: skip
    if known:
        together = np.concatenate(list(known.values()))
        mean, span = float(np.mean(together)), float(np.ptp(together))
        courses = tuple(Course(recording, 0.0, None, mean, span) for recording in known)
        if span > 0 and _best(rows, motions, [courses]) is not None:
            changes.append(Warmth(rows.dynamics, courses, len(known) < len(motions)))
    for recording, w in motions.items():
        if recording not in known and len(w.time):
            course = _warming(rows, motions, recording)
            if course is not None:
                changes.append(Warmth(rows.dynamics, (course,), len(motions) > 1))
    return changes


def _best(
    rows: FrictionRows,
    motions: dict[PreparedRecording, SampleBlock],
    tried: Sequence[tuple[Course, ...]],
) -> int | None:
    """Number of the courses by which friction as a whole changes most; None if that is chance.

    A course is slow compared with the filter, so it may multiply filtered columns.
    """
    columns = []
    for courses in tried:
        g = {recording: np.zeros(len(w.time)) for recording, w in motions.items()}
        g |= {course.recording: course.values(motions[course.recording]) for course in courses}
        columns.append(rows.drive_rows.stack(rows.friction * np.concatenate(list(g.values()))))
    bare = rows.span.without(np.stack(columns, axis=1))
    visible = np.linalg.norm(bare, axis=0) > FAINT * np.sqrt(len(bare))
    if not visible.any():
        return None
    directions = np.where(visible, bare / lengths(bare), 0.0)
    best = int(np.argmax((directions.T @ rows.residual) ** 2))
    judged = rows.judged(directions[:, [best]], rows.residual, constants=min(len(tried) - 1, 1))
    return best if judged.surprise > SURPRISING and judged.is_large else None


def _warming(
    rows: FrictionRows, motions: dict[PreparedRecording, SampleBlock], recording: PreparedRecording
) -> Course | None:
    """The time constant with which a recording's friction changes; None if it does not."""
    start, length = recording.log.clock.first, recording.log.samples / recording.log.rate
    shares, course = _CONSTANTS, None
    for spacing in (*_FINER, 1.0):
        courses = list[Course]()
        for share in shares.tolist():
            end = float(np.exp(-1 / share))
            courses.append(Course(recording, start, share * length, share * (1 - end), end - 1))
        best = _best(rows, motions, [(course,) for course in courses])
        if best is None:
            return None
        course, shares = courses[best], shares[best] * np.geomspace(1 / spacing, spacing, num=9)
    return course


def temperature(recording: PreparedRecording, w: SampleBlock) -> Float[np.ndarray, " samples"]:
    columns = recording.log.columns
    channel = columns.temperature
    assert channel is not None
    return channel.scale * (w.extra[:, columns.extra_index(channel.column)] - channel.zero)
