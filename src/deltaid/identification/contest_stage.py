"""Effects that win the contest of causes, corrected in recordings and robot or fitted as columns."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from deltaid.effects.at_drives import AtDrives, DriveSpring
from deltaid.effects.at_platform import AtPlatform, platform_forces
from deltaid.effects.beside import BESIDE
from deltaid.effects.falling_gain import Saturation
from deltaid.effects.gain import Ratios as Gains
from deltaid.effects.geometry import Lengths, Ratios, Tilt, Zeros, reshaped
from deltaid.effects.point import Point
from deltaid.effects.unknown import Added, Unknown
from deltaid.estimation.additions import Addition
from deltaid.estimation.trace_rows import TraceRows
from deltaid.estimation.traces import Trace
from deltaid.identification.contest import Contest, contest, start
from deltaid.identification.lag_stage import traced, without_lags
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.study import Study, studied
from deltaid.model.corrections import Kind
from deltaid.recording.readings import Readings
from deltaid.robot.description import RobotDescription

# Sweeps at most, and the step of what is applied, in standard deviations, below which they end.
_SWEEPS, _SETTLED = 5, 0.2
# Windows of a recording at least that are used.
_WINDOWS = 8
# Half a 95 % interval in standard deviations.
_HALF = 1.96

ZEROS, RATIOS, TILT, LENGTHS, SATURATION, GAINS = (
    Zeros(), Ratios(), Tilt(), Lengths(), Saturation(), Gains()
)  # fmt: skip
_EXACT: tuple[Unknown, ...] = (ZEROS, RATIOS, TILT, LENGTHS, SATURATION)
_KINDS: tuple[Kind, ...] = ("zero", "gear-ratio", "tilt", "length", "torque-constant")

Coefficients = Float[np.ndarray, " coefficients"]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What won a contest.

    Attributes:
        described: the robot as it is described.
        kept: names of effects.
        values, deviations: of those that are applied exactly.
    """

    described: RobotDescription
    kept: tuple[str, ...] = ()
    values: dict[str, Coefficients] = field(default_factory=dict[str, Coefficients])
    deviations: dict[str, Coefficients] = field(default_factory=dict[str, Coefficients])

    def of(self, unknown: Unknown) -> tuple[float, ...]:
        return tuple(self.values.get(unknown.name, np.zeros(0)).tolist())


def contested(setup: Setup, progress: Progress) -> Setup:
    """Effects that rows need beside all others; earlier results are decided anew."""
    progress("weighing causes against each other")
    bare = _bare(setup)
    traces = _traces(bare)
    if not traces:
        return setup
    largest = np.max([recording.log.torque_max for recording in bare.recordings], axis=0)
    now, before, p = bare, Outcome(bare.robot), None
    for _ in range(_SWEEPS):
        rows = TraceRows.of(now.dynamics, without_lags(bare.additions), bare.settings.prior_spread)
        p = start(rows, traces) if p is None else p
        points = [Point(trace, p) for trace in traces]
        full = contest(rows, points, _unknowns(points[0]), before.values).with_ripples()
        last, p = full.reduced(), full.p
        after = _outcome(before, last)
        now = _applied(bare, after, largest)
        if _is_settled(before, after):
            break
        before, p, traces = after, last.p, _traces(now)
    return _finished(now, after, last) if after.kept else bare


def _bare(setup: Setup) -> Setup:
    """Without what an earlier contest has decided."""
    robot = setup.robot
    if setup.outcome is not None:
        described = setup.outcome.described
        same = {"limbs": described.limbs, "gravity": described.gravity,
                "tolerances": described.tolerances}  # fmt: skip
        robot = robot.model_copy(update=same)
    kept = tuple(a for a in setup.additions if not isinstance(a, AtPlatform | AtDrives))
    bare = setup.changed(additions=kept, outcome=None).with_robot(robot).reported((), *_KINDS)
    for recording in bare.recordings:
        bare = bare.repaired(recording, readings=None)
    return bare


def _traces(setup: Setup) -> list[Trace]:
    """Of recordings that no undeclared load disturbs."""
    recordings = [r for k, r in enumerate(setup.recordings) if not setup.is_disturbed(k)]
    traces = (traced(setup, recording, recording.cutoff, _WINDOWS) for recording in recordings)
    return [trace for trace in traces if trace is not None]


def _unknowns(point: Point) -> tuple[Unknown, ...]:
    dynamics, every = point.dynamics, tuple(range(point.dof))
    fastest = float(np.linalg.norm(point.platform, axis=1).max(initial=1e-9))
    spring = DriveSpring(dynamics, every, (1.0,) * point.dof)
    forces = (Added(force.name, force) for force in platform_forces(dynamics, fastest))
    return (*BESIDE, GAINS, *_EXACT, Added("drive-spring", spring), *forces)


def _outcome(before: Outcome, last: Contest) -> Outcome:
    """What is kept, with what had been applied before."""
    kept, values, deviations = last.shrunk.candidates, dict(before.values), {}
    for unknown in _EXACT:
        if unknown.name not in kept:
            values.pop(unknown.name, None)
            continue
        group = last.group(unknown.name)
        values[unknown.name] = last.shrunk.x[group.columns] - group.mean
        deviations[unknown.name] = last.shrunk.deviation(group)
    return Outcome(before.described, kept, values, deviations)


def _is_settled(before: Outcome, after: Outcome) -> bool:
    return before.kept == after.kept and all(
        np.all(np.abs(values - before.values[name]) <= _SETTLED * after.deviations[name])
        for name, values in after.values.items()
    )


def _applied(bare: Setup, outcome: Outcome, largest: Coefficients) -> Setup:
    """The robot as it is and recordings as drives moved, by exact corrections."""
    robot = reshaped(outcome.described, outcome.of(LENGTHS), outcome.of(TILT))
    same = {"limbs": robot.limbs, "gravity": robot.gravity}
    setup = bare.with_robot(bare.robot.model_copy(update=same))
    pairs = np.reshape(outcome.of(SATURATION), (-1, 2)).tolist()
    readings = Readings(
        zero=outcome.of(ZEROS),
        ratio=outcome.of(RATIOS),
        falling=tuple((a, b) for a, b in pairs),
        largest=tuple(largest.tolist()),
    )
    if any(unknown.name in outcome.values for unknown in (ZEROS, RATIOS, SATURATION)):
        for recording in setup.recordings:
            setup = setup.repaired(recording, readings=readings)
    return setup


def _finished(now: Setup, outcome: Outcome, last: Contest) -> Setup:
    """With columns of the fit, reports, and studies of what is left."""
    additions = list(now.additions)
    for name in outcome.kept:
        unknown = last.unknown(name)
        if isinstance(unknown, Added):
            group = last.group(name)
            scale = last.shrunk.alpha[last.shrunk.groups.index(group)] * group.deviation
            assert isinstance(unknown.addition, AtPlatform | AtDrives)
            additions.append(replace(unknown.addition, deviation=tuple(scale.tolist())))
    corrections = [
        correction
        for unknown in _EXACT
        if unknown.name in outcome.kept
        for correction in unknown.corrections(
            outcome.described,
            outcome.values[unknown.name],
            _HALF * outcome.deviations[unknown.name],
        )
    ]
    now = now.changed(additions=tuple(additions), outcome=outcome).reported(corrections)
    return now.changed(studies=_studies(now, additions))


def _studies(setup: Setup, additions: Sequence[Addition]) -> tuple[Study | None, ...]:
    """Of recordings as corrected."""
    beside = [addition for addition in additions if isinstance(addition, AtPlatform | AtDrives)]
    return tuple(
        studied(setup.dynamics, recording, beside=beside) for recording in setup.recordings
    )
