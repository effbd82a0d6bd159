"""Opens recordings: reads and checks every row before anything is computed from it."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import chain

import numpy as np

from deltaid.errors import Doubt, RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.parallel import ordered
from deltaid.recording.address import find, listing
from deltaid.recording.columns import Columns, Rows
from deltaid.recording.contents import proposal_for
from deltaid.recording.log import Excerpt, Log, keep_batches
from deltaid.recording.mapped_columns import TIMES
from deltaid.recording.mapping import FOUND, ColumnMapping, as_words
from deltaid.recording.masks.masks import require_rest, runs_of
from deltaid.recording.masks.search import timed
from deltaid.recording.memory import Recording, RecordingLike, as_source
from deltaid.recording.resolution import extra_drives, resolve_columns
from deltaid.recording.source import LogTable
from deltaid.recording.spectrum import spectrum_of
from deltaid.recording.survey import Survey
from deltaid.recording.survey_checks import STRETCH, UNEVEN, require_rate
from deltaid.recording.table import open_table, read_batches
from deltaid.recording.time.clock import Clock
from deltaid.recording.time.counts import doubts_about_rounds, in_seconds, unwrappers
from deltaid.recording.time.signals import longest_hole, segments
from deltaid.recording.time.study import study
from deltaid.recording.units import si_factor, time_unit
from deltaid.robot.sensors import channels_of

# Cause and fix of a stated rate that a time column contradicts.
OTHER_RATE = "the rate is that of another recording, or only some of its rows were logged"
NO_RATE = "leave `rate` out of the mapping, so that the column is the time, unless that is wrong"
# Cause and fix of columns of more drives than the robot has.
OTHER_ROBOT = "the log is of another robot, or of an axis beside it as well"
ITS_ROBOT = (
    "give the robot that was recorded; an axis beside it does no harm, and a mapping of the "
    "robot's own columns says so"
)


def open_log(
    source: RecordingLike,
    kinematics: Kinematics,
    mapping: ColumnMapping | None = None,
    *,
    need_torque: bool = True,
    keep_all: bool = False,
    need_rest: bool = True,
) -> Log:
    """Survey a recording: read and check every row once, before anything is computed from it.

    Args:
        source: a file of any kind in `FORMATS`, or a recording in memory.
        kinematics: kinematics of the recorded robot.
        mapping: names and units of the columns, if they are not the default ones.
        need_torque: whether torques are needed; if not, the log may be a planned motion, and its
            torques are not read.
        keep_all: whether no rows are excluded (`masks`).
        need_rest: whether to refuse a log of which hardly any rows remain.

    Raises:
        RecordingError: a column is missing; a value is missing or not finite; a column is no time;
            a torque is constant; angles look like degrees; velocities are not the derivatives of
            positions; a sample is out of reach.
    """
    table, columns, mapping = resolved_table(source, kinematics, mapping)
    columns = _needed(table, columns, need_torque)
    survey = Survey(table, columns, kinematics)
    survey.warnings += table.warnings
    if other_rate := _contradicted_rate(table, columns):
        survey.warnings.append(Doubt(other_rate, cause=OTHER_RATE, cure=NO_RATE, key="clock"))
    if extra := extra_drives(table, columns, mapping, kinematics.dof):
        survey.warnings.append(Doubt(extra, cause=OTHER_ROBOT, cure=ITS_ROBOT, key="drive-count"))
    kept = list[Rows]()
    with ThreadPoolExecutor(1) as thread:
        digest = thread.submit(table.checksum, [channel.column for channel in columns.recorded])
        clock = _checked(survey, kept)
    excluded = [*(survey.search.runs() if survey.search else ()), *survey.loads.runs(clock.rate)]
    masks = () if keep_all else timed(excluded, clock)
    if need_rest:
        require_rest(masks, survey.clock.samples, kinematics.robot.drives, str(table.path))
    log = Log(
        table=table,
        columns=columns,
        sha256=digest.result(),
        samples=survey.clock.samples,
        clock=clock,
        torque_max=np.maximum(-survey.low, survey.high)[columns.torque_places],
        position_noise=survey.spectrum.noise,
        reach=np.array([survey.reach.nearest, survey.reach.farthest]),
        motion_cutoff=survey.spectrum.cutoff(clock.rate),
        bandwidth=survey.spectrum.bandwidth(clock.rate),
        masks=masks,
        keep_all=keep_all,
        warnings=tuple(survey.warnings),
        sample=survey.sample,
        other_rate=other_rate,
        kept=Excerpt(columns, tuple(kept), whole=True) if kept else None,
    )
    return _with_cutoff_between_stops(log)


def _needed(table: LogTable, columns: Columns, need_torque: bool) -> Columns:
    """Columns without torques and sensors for a planned motion; refuses others without torques."""
    if not need_torque:
        states = columns.extra[len(columns.extra) - columns.states :]
        return replace(columns, torque=(), extra=states, sensors=())
    if columns.torque:
        return columns
    raise RecordingError(
        f"has no torque columns; its columns are {listing(table.fields)}",
        where=table.header_place,
        cure=table.cure_without_torque,
    )


def _checked(survey: Survey, kept: list[Rows]) -> Clock:
    """Clock of a log whose rows the survey checks, and which are added to `kept`."""
    table, unwrapping = survey.table, unwrappers(survey.columns)
    batches = read_batches(table, survey.columns, unwrapping)
    for batch in ordered(survey.look, keep_batches(batches, kept, table.first_row)):
        survey.add(batch)
    survey.warnings += doubts_about_rounds(unwrapping, table)
    clock = _clock(survey)
    survey.finish(clock)
    return clock


def _contradicted_rate(table: LogTable, columns: Columns) -> str:
    """How a time column contradicts the rate that a mapping states in its place; empty if it does
    not, or if its unit is unknown.

    Raises:
        RecordingError: the recording cannot be read.
    """
    names = (name for name in TIMES if name in table.header and columns.time.is_absent)
    name, place = next(names, ""), columns.position[0].column
    field = find(table.fields, name)
    if field is None or field[0].holds:
        return ""
    rows = next(in_seconds(table.rows([name, place])), None)
    start = np.asarray(rows.numbers[0] if rows else (), dtype=float)
    if not (unit := time_unit(start)):
        return ""
    steps = np.diff(start[np.isfinite(start)]) * si_factor(unit, "s", where=name)
    usual, period = float(np.median(steps[steps > 0])), columns.time.scale
    if any(abs(step / period - 1) < UNEVEN for step in (usual, float(steps.mean()))):
        return ""
    return (
        f"column {name} makes a rate of {1 / usual:.4g} Hz, but the mapping states "
        f"{1 / period:.4g} Hz in its place"
    )


def resolved_table(
    source: RecordingLike, kinematics: Kinematics, mapping: ColumnMapping | None
) -> tuple[LogTable, Columns, ColumnMapping]:
    """Table of a recording, its columns by quantity, and the mapping that determines them.

    Without a mapping and without default names, a proposal that is certain is used, which the
    table's warnings report.

    Raises:
        RecordingError: the recording cannot be read, or a column is missing.
    """
    is_given, mapping, source = mapping is not None, mapping or ColumnMapping(), as_source(source)
    if isinstance(source, Recording):
        if source.drives not in (None, kinematics.dof):
            raise RecordingError(
                f"q has {source.drives} columns, but the robot has {kinematics.dof} drives",
                where=str(source),
                cure="give arrays of shape (samples, drives), drives in order of q",
            )
        table = source.table
    else:
        table = open_table(source, mapping)
    robot = kinematics.robot
    linear = robot.linear_drives
    channels = {name: channels_of(robot, name, sensor) for name, sensor in robot.sensors.items()}
    try:
        columns = resolve_columns(table, linear, mapping, channels)
    except RecordingError as error:
        named = all(any(find(table.fields, n) for n in names) for names in mapping.needed)
        if is_given or (named and not find(table.fields, "q0")):  # q1 may be the second drive
            raise
        table, mapping = _proposed(table, linear, error)
        columns = resolve_columns(table, linear, mapping, channels)
    return table, columns, mapping


def _proposed(
    table: LogTable, linear: tuple[bool, ...], error: RecordingError
) -> tuple[LogTable, ColumnMapping]:
    """Table with a warning, and its proposed mapping, which is certain.

    Raises:
        RecordingError: the proposal lacks columns or has doubts.
    """
    proposal = proposal_for(table, linear)
    if proposal.doubts or {*proposal.missing} - {"torque"}:
        ask = f"; `deltaid columns {table.path} ROBOT` proposes which is which, and writes it"
        ask *= "position" not in proposal.missing
        raise RecordingError(error.what, where=error.where, cure=error.cure + ask) from None
    mapping = proposal.mapping.known_as(FOUND)
    doubt = Doubt(
        f"has no default names; {as_words(mapping)}",
        cause="no mapping is given, and names, units and numbers leave no other",
        cure="`deltaid columns` says why and writes the mapping",
    )
    return replace(table, warnings=(*table.warnings, doubt)), mapping


def _with_cutoff_between_stops(log: Log) -> Log:
    """Log with cut-off, bandwidth and noise from between emergency stops, whose jerk is no part of
    the motion."""
    stops = tuple(mask for mask in log.masks if mask.reason == "emergency stop")
    if not stops:
        return log
    q = slice(1, 1 + len(log.columns.position))
    spectrum = spectrum_of(np.zeros((0, len(log.columns.position))))
    for rows in chain.from_iterable(replace(log, masks=stops).segments(None)):
        for first, last in runs_of(rows[:, -1] > 0):
            spectrum += spectrum_of(rows[first : last + 1, q])
    cutoff = spectrum.cutoff(log.rate)
    if cutoff is None:
        return log
    return replace(
        log,
        motion_cutoff=cutoff,
        bandwidth=spectrum.bandwidth(log.rate),
        position_noise=spectrum.noise,
    )


def _clock(survey: Survey) -> Clock:
    """Clock of a surveyed log; if rows are not steady, checks of neighbouring rows are repeated
    segment by segment."""
    survey.clock.require_time()
    if survey.clock.steady:
        return survey.clock.clock
    table, columns, dof = survey.table, survey.columns, survey.kinematics.dof

    # Refuse a wrong rate before it places rows.
    usual = 1 / survey.clock.step if survey.clock.step > 0 else 0.0
    require_rate(table, columns.time, usual, differentiated=False)
    clock = study(read_batches(table, columns), dof)
    require_rate(table, columns.time, clock.rate, differentiated=False)
    survey.begin_again()
    longest = longest_hole(clock.rate, 1 / STRETCH)  # the cut-off is not known yet
    for segment in segments(read_batches(table, columns), clock, longest, columns):
        survey.add_even(segment)
    return clock
