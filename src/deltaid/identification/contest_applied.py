"""The outcome of the contest of causes, applied: readings, robot, extra columns and corrections."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.all import UNKNOWNS
from deltaid.effects.along_motion import AlongMotion
from deltaid.effects.at_drives import DriveSpring, with_offsets
from deltaid.effects.geometry import reshaped
from deltaid.effects.lag_columns import TimingColumns
from deltaid.effects.point import Added, UnknownEffect
from deltaid.effects.unexplained import FreeTorque
from deltaid.effects.windings import motors_of
from deltaid.estimation.scatter import NORMAL
from deltaid.identification.contest import Contest
from deltaid.identification.setup import WIND_UP, ContestOutcome, Setup
from deltaid.model.corrections import Correction, Kind
from deltaid.recording.columns import Readings

# Effects that stay columns of the fit.
_ADDED = (AlongMotion, FreeTorque)


def without_contest(setup: Setup) -> Setup:
    """Without the corrections of an earlier contest."""
    robot = setup.robot
    if setup.outcome is not None:
        described = setup.outcome.described
        robot = robot.model_copy(
            update={"limbs": described.limbs, "gravity": described.gravity,
                    "tolerances": described.tolerances, "bodies": described.bodies}
        )  # fmt: skip
    kinds: list[Kind] = [u.corrected_as for u in UNKNOWNS if u.corrected_as is not None]
    bare = setup.without(*_ADDED).changed(outcome=None).with_robot(robot).reported((), *kinds)
    return bare.all_repaired(readings=None, drift=None, turns=())


def with_readings(bare: Setup, outcome: ContestOutcome, p: Parameters) -> Setup:
    """The setup with readings of the recordings corrected by an outcome."""
    largest = np.max([recording.log.torque_max for recording in bare.recordings], axis=0)
    pairs = np.reshape(outcome.coefficients("torque-constant"), (-1, 2)).tolist()
    falling = tuple((a, b) for a, b in pairs)
    readings = Readings(
        zero=outcome.coefficients("zero"),
        ratio=outcome.coefficients("gear-ratio"),
        falling=falling,
        largest=tuple(largest.tolist()) if falling else (),
    )
    setup, wound = bare, outcome.coefficients(WIND_UP)
    drifts = np.reshape(outcome.coefficients("torque-drift"), (len(outcome.recordings), -1, 3))
    drifting = dict(zip(outcome.recordings, drifts.tolist(), strict=True)) if drifts.size else {}
    for recording in bare.recordings:
        gears = None
        if any(wound) and recording.low_pass is not None:
            cutoff, rate = recording.low_pass.cutoff, recording.log.rate
            gears = motors_of(bare.robot, p, cutoff, rate, wound)
        drift = drifting.get(recording.log.sha256)
        setup = setup.repaired(
            recording,
            readings=None if readings.are_right else readings,
            drift=drift and recording.drifting(drift),
            gears=gears,
        )
    return setup


def with_effects(now: Setup, outcome: ContestOutcome, last: Contest) -> Setup:
    """The setup with the robot corrected, effects that stay columns, and new studies."""
    shapes = [outcome.coefficients(name) for name in ("length", "mounting", "tilt")]
    if any(shapes):
        robot = reshaped(outcome.described, *shapes)
        now = now.with_robot(
            now.robot.model_copy(update={"limbs": robot.limbs, "gravity": robot.gravity})
        )
    for unknown in UNKNOWNS:
        if unknown.is_fitted and unknown.name in outcome.kept:
            now = now.with_robot(unknown.opened(now.robot))
    if DriveSpring.name in outcome.kept:
        now = now.with_robot(with_offsets(now.robot))
    additions = list(now.without(TimingColumns).additions)
    for name in outcome.kept:
        unknown = last.unknown(name)
        if isinstance(unknown, Added):
            group = last.group(name)
            alpha = last.shrunk.alpha[last.shrunk.groups.index(group)]
            if isinstance(unknown.addition, FreeTorque):
                alpha = max(alpha, 1.0)  # bodies had wider priors and may have absorbed a part
            scale = alpha * group.deviation
            assert isinstance(unknown.addition, _ADDED)
            addition = replace(unknown.addition, deviation=tuple(scale.tolist()))
            additions.append(addition.on(now.dynamics))
    corrections = [
        correction
        for unknown in UNKNOWNS
        if unknown.name in outcome.kept
        for correction in _corrections(unknown, outcome, last)
    ]
    now = now.changed(additions=tuple(additions), outcome=outcome).reported(
        corrections, "compliance"
    )
    return now.studied()


def _corrections(
    unknown: UnknownEffect, outcome: ContestOutcome, last: Contest
) -> Iterator[Correction]:
    """Corrections of an effect, per recording where each has its own coefficients."""
    points = last.points if unknown.is_own else last.points[:1]
    known = [outcome.values.get(unknown.name), outcome.deviations.get(unknown.name)]
    if unknown.is_fitted:
        group = last.group(unknown.name)
        known = [last.shrunk.x[group.columns], last.shrunk.deviation(group)]
    sizes = [np.split(np.zeros(0) if x is None else x, len(points)) for x in known]
    for point, values, deviations in zip(points, *sizes, strict=True):
        log = point.trace.recording.path.name if unknown.is_own else ""
        for correction in unknown.corrections(outcome.described, values, NORMAL * deviations):
            yield correction.changed(log=log) if log else correction
