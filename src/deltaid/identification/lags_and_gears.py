"""Stages that read torques by their lags, with remaining lags as columns of the fit, and that
compute positions of links behind gears that wind up, by estimated or stated compliances."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.compliance import compliances
from deltaid.effects.lag_columns import LagColumns, TimingColumns, UnknownFilter, UnknownLag
from deltaid.effects.lag_groups import SMALL, LagGroup, Timing, alone, chosen_groups, delays_of
from deltaid.effects.lags import estimate_lags
from deltaid.effects.timing import other_than_delays
from deltaid.effects.windings import BAND, Compliance, motors_of
from deltaid.errors import IdentificationError, RecordingError
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.traces import Trace, trace
from deltaid.identification.gains import gains
from deltaid.identification.passive_turns import usual_speeds
from deltaid.identification.setup import WIND_UP, Progress, Setup
from deltaid.identification.study import ADEQUATE, LOAD_CHANGE, Study, left_of_a_drive
from deltaid.model.corrections import Correction
from deltaid.recording.log import FEW_WINDOWS
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import WINDOW

# Length of a recording that is used [s]; more hardly helps.
_SECONDS = 12.0
# Repairs of a recording without lags.
_ON_TIME: dict[str, Any] = {"delay": (), "constants": (), "growth": None, "blur": ()}
# Least number of windows of a recording in which compliances are searched.
_OF_GEARS = 2


def lags_corrected(setup: Setup, progress: Progress) -> Setup:
    """Correct lags of all torques, with columns for remaining lags; replaces earlier ones."""
    lag = setup.settings.lag
    setup = setup.without(TimingColumns).reported((), "lag")
    if lag == "none":
        return setup
    if not isinstance(lag, str):
        return _fixed(setup, lag)
    progress("looking for lags")
    traces = list[tuple[PreparedRecording, Trace]]()
    for k, recording in enumerate(setup.recordings):
        as_it_came, record = recording.repaired(**_ON_TIME), None
        if not setup.disturbed[k]:
            record = traced(setup, as_it_came, recording.cutoff)
        if record is not None:
            traces.append((recording, record))
        else:  # an initial lag by other stages is no estimate
            setup = setup.with_recording(k, as_it_came)
    return _estimated(setup, traces) if traces else setup


def _estimated(setup: Setup, traces: Sequence[tuple[PreparedRecording, Trace]]) -> Setup:
    """Correct estimated lags, and filters and clocks where traces have these."""
    additions, spread = setup.additions, setup.settings.prior_spread
    every, several = tuple(range(setup.dynamics.dof)), len(setup.recordings) > 1
    lags = estimate_lags(
        [record for _, record in traces],
        additions,
        spread=spread,
        turning=[_of_motors(setup, record) for _, record in traces],
        start=np.array([recording.repairs.lag or np.zeros(len(every)) for recording, _ in traces]),
    )
    rows = TraceRows.for_dynamics(setup.dynamics, additions, spread)
    for k, (recording, record) in enumerate(traces):
        blurred = lags.blur[k] > 0
        timing, unsure = other_than_delays(
            rows, record, lags.values[k], lags.abrupt[k], blurred, lags.p
        )
        repairs, columns = _ON_TIME | {"blur": lags.blurred(k)}, list[Addition]()
        which = tuple(np.flatnonzero(unsure).tolist())
        blur = tuple(np.flatnonzero(blurred).tolist())
        common = (setup.dynamics, additions, lags.p, recording)
        if timing is not None:
            parts, columns = _timed(setup, recording, record, timing, additions)
            repairs |= parts | ({"blur": ()} if timing.rate else {})  # the clock has blurred them
        elif groups := lags.groups(k):
            repairs |= {"delay": delays_of(groups, len(every))}
            columns.append(LagColumns(*common, groups, several, which, blurred=blur))
            doubted = tuple(group for group in groups if set(group.drives) & set(which))
            if doubted and all(group.delay for group in doubted):  # intervals allow for filters
                columns.append(UnknownFilter(*common, doubted, several))
        elif lags.common(k).deviation[0] > SMALL:
            columns.append(UnknownLag(*common, (LagGroup(every, 0.0),), several, which))
        setup = setup.repaired(recording, **repairs)
        setup = setup.changed(additions=(*setup.additions, *columns))
    return setup


def _timed(
    setup: Setup,
    recording: PreparedRecording,
    record: Trace,
    timing: Timing,
    others: tuple[Addition, ...],
) -> tuple[dict[str, Any], list[Addition]]:
    """Repairs by filters and a clock, and columns for remaining lags, time constants and rate."""
    groups, several = chosen_groups(timing.lags, timing.of_lags), len(setup.recordings) > 1
    delay = np.array(delays_of(groups, setup.dynamics.dof))
    if timing.pure:
        timing = replace(timing, constants=np.where(timing.constants > 0, delay, 0.0), lags=delay)
    filtered = bool(np.any(timing.constants))
    repairs = {
        "delay": tuple((delay - timing.constants).tolist()),
        "constants": tuple(timing.constants.tolist()) if filtered else (),
        "growth": timing.growth(record),
    }
    common = (setup.dynamics, others, timing.p, recording, groups, several)
    return repairs, [LagColumns(*common, timing=timing)]


def traced(
    setup: Setup, recording: PreparedRecording, cutoff: float | None, least: int = FEW_WINDOWS
) -> Trace | None:
    """A trace of at least `least` windows; None where the recording cannot be differentiated."""
    windows = max(least, round(_SECONDS * recording.log.rate / WINDOW))
    load = prior_parameters(setup.robot)
    try:
        return trace(setup.dynamics, recording, load, cutoff=cutoff, windows=windows)
    except RecordingError:
        return None  # with recorded velocities and accelerations it can still be fitted


def _of_motors(setup: Setup, record: Trace) -> Trace:
    recording = record.recording
    if recording.repairs.gears is None:
        return record
    return traced(setup, recording.repaired(gears=None), recording.cutoff) or record


def _fixed(setup: Setup, lag: tuple[float, ...]) -> Setup:
    dof = setup.dynamics.dof
    if len(lag) not in (1, dof):
        raise IdentificationError(
            f"has {len(lag)} values, and the robot has {dof} drives",
            where="--lag",
            cure=f"give one value for all drives, or {dof}",
        )
    delay = lag * dof if len(lag) == 1 else lag
    groups = (LagGroup(tuple(range(dof)), delay[0]),) if len(set(delay)) == 1 else alone(dof)
    setup = setup.all_repaired(delay=delay if any(delay) else ())
    text = "torques are read so much later, as was asked for"
    return setup.reported([
        Correction(kind="lag", subject=name, value=value, unit="s", text=text)
        for group in groups
        for name in group.subjects(setup.dynamics)
        if (value := delay[group.drives[0]])
    ])  # fmt: skip


def gears_turned_back(setup: Setup, progress: Progress) -> Setup:
    """Replace positions of motors by those of links, where gears wind up.

    Compliances of a contest, which weighs them against all other effects, are not searched again.
    """
    turned = _turned_back(setup, progress)
    gears = [recording.repairs.gears for recording in (*setup.recordings, *turned.recordings)]
    return turned if any(gears) else setup  # with its lags


def estimated_anew(setup: Setup, progress: Progress) -> Setup:
    """Estimate gains, lags and gears again once other effects, which look like them, are known."""
    return gears_turned_back(lags_corrected(gains(setup, progress), progress), progress)


def _turned_back(setup: Setup, progress: Progress, *, search: bool = True) -> Setup:
    """With stated compliances and, if `search`, detected ones."""
    setup = setup.all_repaired(gears=None).reported((), "compliance")
    bare = setup.without(TimingColumns)  # `compliances` has columns of lags
    # Recordings with a filter.
    cutoffs = [(r, r.low_pass.cutoff) for r in bare.recordings if r.low_pass is not None]
    pairs = _in_both_bands(bare, cutoffs)
    stated = np.array([1 / setup.robot.stiffness(drive) for drive in setup.robot.drives])
    free = (stated == 0) & (search and setup.settings.compliance == "estimate")
    weighed, deviation = (np.where(free, sizes, 0.0) for sizes in _weighed(setup))
    searched = free & (setup.outcome is None)
    if not pairs or not (stated.any() or weighed.any() or searched.any()):
        return setup
    progress("looking for gears that wind up")
    rows = TraceRows.for_dynamics(bare.dynamics, bare.additions, bare.settings.prior_spread)
    sizes = np.where(searched, np.nan, stated + weighed)
    narrow, wide = zip(*pairs, strict=True)
    gears = compliances(narrow, wide, rows, sizes)
    is_explained = all(left_of_a_drive(study) <= ADEQUATE for study in setup.studies if study)
    if not is_explained and (turns := usual_turns(bare)):
        fast = [(recording.repaired(turns=turns), cutoff) for recording, cutoff in cutoffs]
        narrow, wide = zip(*(_in_both_bands(bare, fast) or pairs), strict=True)
        certain = compliances(narrow, wide, rows, sizes)
        gears = gears if certain.agrees(gears.values) else certain
    if not gears.values.any():
        return setup
    if weighed.any():
        gears = gears.estimated(deviation)
    for recording, cutoff in cutoffs:
        rate, compliance = recording.log.rate, gears.values.tolist()
        motors = motors_of(bare.robot, gears.p, cutoff, rate, compliance)
        bare = bare.repaired(recording, gears=motors)
    bare = bare.studied()
    empty = [r for r in bare.recordings if r.low_pass and not traced(bare, r, r.cutoff)]
    if free.any() and (empty or not _better_than_loads(setup, bare.studies)):
        return _turned_back(setup, progress, search=False)
    if empty:
        raise IdentificationError(
            "has no row whose links' motion is known behind gears that wind up: outliers are too "
            "close to each other for the low-pass",
            where=str(empty[0].path),
            cure="raise --cutoff, or leave gear_stiffness out of the robot file",
        )
    bare = bare.reported(gears.corrections(bare.robot))
    return lags_corrected(bare, progress)


def _in_both_bands(
    setup: Setup, cutoffs: Sequence[tuple[PreparedRecording, float]]
) -> list[tuple[Trace, Trace]]:
    """Traces in the band of the motion and in that of a fit."""
    pairs = [
        [traced(setup, recording, share * cutoff, _OF_GEARS) for share in (BAND, 1.0)]
        for recording, cutoff in cutoffs
    ]
    return [(a, b) for a, b in pairs if a is not None and b is not None]


def usual_turns(setup: Setup) -> tuple[float, ...]:
    """The usual speeds of passive joints with friction: behind compliant gears, slower ones may
    turn either way."""
    if not setup.dynamics.kinematics.passive_friction.names:
        return ()
    traces = [traced(setup, recording, recording.cutoff) for recording in setup.recordings]
    return usual_speeds(known) if (known := [trace for trace in traces if trace]) else ()


def _weighed(setup: Setup) -> tuple[Compliance, Compliance]:
    """Compliances by the contest of causes, and their standard deviations."""
    none, outcome = np.zeros(setup.dynamics.dof), setup.outcome
    if outcome is None or not outcome.winds_up:
        return none, none
    return outcome.values[WIND_UP], outcome.deviations.get(WIND_UP, none)


def _better_than_loads(setup: Setup, turned: Sequence[Study | None]) -> bool:
    """Whether compliant gears leave less residual than an undeclared load would, in each recording
    that seems to have one."""
    for before, after in zip(setup.studies, turned, strict=False):  # no studies: nothing seems so
        if before is None or after is None or not before.is_disturbed:
            continue
        parts, residual = before.account.detected, before.account.left
        of_loads = sum(part.gain for part in parts if part.candidate.kind == LOAD_CHANGE)
        total = float(residual @ residual) + sum(part.gain for part in parts)
        if np.mean((after.fit.rows.scale / before.fit.rows.scale) ** 2) > 1.0 - of_loads / total:
            return False
    return True
