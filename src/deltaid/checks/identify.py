"""An identification with all checks about it: wrong input is refused first, and doubts become
warnings (`identify`)."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from deltaid.checks.check import named_verdicts, of_robot, reading_warnings
from deltaid.checks.closed_loop import checked_feedback
from deltaid.checks.evidence import Evidence, evidence, forget, with_fit
from deltaid.checks.information import checked_information, judged_information
from deltaid.checks.proposals import confirmed, not_refuted
from deltaid.checks.residual import checked_residual, detected_load, load_held_throughout
from deltaid.checks.sensing.sensors import checked_sensors
from deltaid.checks.signal import checked_signals
from deltaid.checks.verdicts import KEYS, Verdicts
from deltaid.checks.wiring.wiring import checked_wirings
from deltaid.checks.wiring.zeros import Shifts
from deltaid.dynamics.parameters import parameter_layout
from deltaid.errors import DescriptionError, RecordingError
from deltaid.estimation.additions import extended
from deltaid.estimation.information import active_columns
from deltaid.estimation.posterior_draws import with_posterior_intervals
from deltaid.estimation.problem import Span
from deltaid.identification.assembly import doubts_of_fit
from deltaid.identification.fit import FittedProblem
from deltaid.identification.geometric_rows import geometric_rows
from deltaid.identification.identify import Identification
from deltaid.identification.identify import identify as fitted
from deltaid.identification.whole_loads import ExcessMass
from deltaid.levels import CERTAIN
from deltaid.model.settings import Settings, settings_of
from deltaid.model.verdict import Grade, Verdict, worst
from deltaid.progress import Watch, watched
from deltaid.recording.mapping import ColumnMappings, mapping_each
from deltaid.recording.memory import RecordingLike, as_sources
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import RobotLike, load_robot
from deltaid.robot.tolerances import BY_EYE, Tolerances

# Verdicts on some excluded rows, whose spans the table of masks reports.
_MASKED = {"standing", "saturation", "frozen-torque"}

# Verdicts that explain why a fit contradicts the recording or the prior.
_EXPLAIN_A_FIT = {
    *KEYS["units and wiring"], *KEYS["the fit"], "torque-lag", "prior-scale", "length-unit",
}  # fmt: skip


@dataclass(frozen=True, repr=False)
class Judged(Identification):
    """An identification with the verdicts before and after it: those of `deltaid check` without the
    workspace, good ones included."""

    verdicts: Verdicts = field(default_factory=Verdicts)


def identify(
    robot: RobotLike,
    logs: RecordingLike | Sequence[RecordingLike],
    *,
    columns: ColumnMappings = None,
    settings: Settings | Mapping[str, Any] | None = None,
    force: bool = False,
    progress: Watch = None,
    **options: Any,
) -> Judged:
    """Identify a robot's dynamic parameters from recordings of the same machine.

    Checks of `deltaid.check` come first: a wrong description, wrong units or wrong wiring are
    refused with the message of their verdict. Signals, information and the residual of the fit are
    judged after it. Verdicts that are not good come first in `model.warnings`.

    Args:
        robot: the description with geometry, priors and reductions; or a catalogue name, a file of
            a robot or of a model.
        logs: one recording or a sequence of them: a log file, a table of polars or pandas, or
            `PreparedRecording.from_arrays`.
        columns: names and units of their columns, if not the default ones, and held loads: one
            mapping for all recordings, or a sequence with one for each (None for default names).
            Arrays with their own units keep these.
        settings: method, regulariser, γ, filter, friction laws; by value or as a dictionary.
        force: continue despite wrong verdicts, which then become warnings of the model.
        progress: called with a sentence before each stage; or whether to show these sentences,
            None for only in a notebook or at a prompt.
        options: single settings by name, such as `lag="none"`.

    Raises:
        DescriptionError: the description is wrong.
        RecordingError: a log cannot be used, or is wrong.
        IdentificationError: the fit cannot be posed or did not converge.
    """
    description, settings = load_robot(robot), settings_of(settings, options)
    with watched(progress, "identify") as say:
        judged = of_robot(description, quick=True, recorded=True)
        _refuse(judged, description, force)
        sources, before_fit = as_sources(logs), list[tuple[Verdict, ...]]()
        mappings = mapping_each(columns, len(sources))
        places = zip(sources, mappings, strict=True)
        opened = [evidence(description, *place, settings) for place in places]
        say(f"judging {', '.join(str(source) for source in sources)}")
        common, on_columns = checked_wirings(opened)
        for record in opened:
            common = not_refuted(record, common)
        if common:
            _refuse(common, opened[0], force)
        for record, wiring in zip(opened, on_columns, strict=True):
            first = _first(record, wiring, force)
            if record.columns.sensors:  # which need a survey, made again for the fit
                first += _first(record, checked_sensors(record), force)
            before_fit.append(first)
            if len(opened) > 1:
                forget(record)
        result = fitted(description, sources, columns=mappings, settings=settings, progress=say)
        say("judging the result")
        after_fit = _after_fit(result, opened, before_fit, description)
        verdicts = Verdicts((*judged, *common, *after_fit), description, sources, mappings)
        poor = (verdict.sentence for verdict in verdicts if verdict.grade is not Grade.GOOD)
        model = result.model.changed(warnings=(*poor, *_warnings(result, verdicts)))
        model = verdicts.noted(model)
        if settings.intervals == "posterior":
            say("drawing models")
            model = with_posterior_intervals(model)
        return Judged(
            model, result.problem, result.recordings, result.studies, result.detected, verdicts
        )


def _first(record: Evidence, judged: tuple[Verdict, ...], force: bool) -> tuple[Verdict, ...]:
    """Verdicts before the fit; a wrong one refuses the recording, if its proposal explains it
    better."""
    if worst(judged) is Grade.WRONG:
        judged = confirmed(record, judged)
        _refuse(judged, record, force)
    return judged


def _refuse(verdicts: Iterable[Verdict], subject: RobotDescription | Evidence, force: bool) -> None:
    """Raise the first wrong verdict as an error with the lines that it proposes, unless `force`."""
    for verdict in () if force else verdicts:
        if verdict.grade is not Grade.WRONG:
            continue
        if isinstance(subject, RobotDescription):
            kind, where, wrong = DescriptionError, subject.name, Verdicts([verdict], subject)
        else:
            kind, where = RecordingError, str(subject.table.path)
            wrong = Verdicts([verdict], subject.robot, [subject.source], [subject.mapping])
        writes = " and --write writes what it proposes" if verdict.proposals else ""
        raise kind(
            verdict.finding,
            where=where,
            cure=f"{verdict.cure}; `deltaid check` shows more{writes}, --force continues anyway"
            f"\n{wrong.cures}".rstrip(),
        )


def _after_fit(
    result: Identification,
    opened: Sequence[Evidence],
    before: Sequence[Sequence[Verdict]],
    described: RobotDescription,
) -> Iterator[Verdict]:
    problem, several = result.problem, len(opened) > 1
    for record, verdicts, recording in zip(opened, before, result.recordings, strict=True):
        kept = [
            v for verdict in verdicts if (v := _unresolved(verdict, recording, result, described))
        ]
        yield from named_verdicts(record, confirmed(record, kept), several=several)
    if several:  # together they may determine what none does alone
        strokes = [record.moved for record in opened]
        yield from judged_information(problem.dynamics, problem.information, strokes)
    studies = result.studies or (None,) * len(opened)
    for record, recording, study in zip(opened, result.recordings, studies, strict=True):
        fitted = with_fit(record, problem, recording, study)
        names = [load.name for load in recording.log.columns.loads if load.name in result.detected]
        detected = [result.detected[name] for name in names]
        throughout = {name for name in names if result.detected[name] is None}
        judged = (
            *checked_signals(fitted),
            *(() if several else checked_information(fitted)),
            *checked_residual(fitted),
            *checked_feedback(fitted),
            *(detected_load(before) for before in detected if before is not None),
            *(
                load_held_throughout(ExcessMass(load.body, load.parameters[0].value))
                for load in result.model.loads
                if load.name in throughout
            ),
        )
        if not (fitted.settings.keep_all or fitted.stands):
            judged = tuple(verdict for verdict in judged if verdict.key not in _MASKED)
        yield from named_verdicts(record, confirmed(record, judged), several=several)


def _unresolved(
    verdict: Verdict,
    recording: PreparedRecording,
    result: Identification,
    described: RobotDescription,
) -> Verdict | None:
    """A verdict on a recording's columns after the fit; None where the fit resolved it."""
    fixes = result.model.corrections
    if verdict.key == "sensor-gain" and any(fix.kind == "gain" for fix in fixes):
        return None  # the drives were off, not the sensor, and have been corrected
    if verdict.grade is not Grade.DOUBTFUL:
        return verdict
    if verdict.key == "homing-or-tilt":
        return verdict if _is_zero_significant(result.problem, recording, described) else None
    logs = [fix.log for fix in fixes if fix.kind == "velocity"]
    if verdict.key != "velocity" or recording.path.name not in logs:
        return verdict
    fixed = "which has been corrected: they are excluded, and positions differentiated"
    seen = f"{verdict.seen}, {fixed}"
    return replace(verdict, grade=Grade.GOOD, seen=seen, cause="", cure="")


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def _is_zero_significant(
    problem: FittedProblem, recording: PreparedRecording, described: RobotDescription
) -> bool:
    """Whether a zero or a tilt explains the residual of a fit, or as much as its additions.

    A zero or a tilt of a usual size is accepted unless the additions certainly explain more, by
    twice a log likelihood ratio: a squared deviation, which coloured noise raises several times.
    """
    fitted = _shifts_after(problem, recording)
    if fitted.is_significant:
        return True
    names = {entry.name for entry in parameter_layout(described).parameters}
    added = {entry.name for entry in problem.dynamics.layout.parameters} - names
    gains = {entry.name for entry in problem.layout.parameters if entry.kind == "gain"}
    repairs = replace(recording.repairs, gears=None, gain=())
    bare = _shifts_after(problem, replace(recording, repairs=repairs), without=added | gains)
    if not bare.is_significant:
        return False
    likeliest = max(bare.causes, key=bare.gain)
    value, _ = bare.estimate(likeliest)
    instead = bare.squares * (1.0 - bare.gain(likeliest))
    chance = bare.rows * np.log(max(instead, 1e-300) / max(fitted.squares, 1e-300))
    return bool(np.linalg.norm(value) < BY_EYE and chance < CERTAIN**2)


def _shifts_after(
    problem: FittedProblem, recording: PreparedRecording, without: Collection[str] = ()
) -> Shifts:
    """Errors of zeros and gravity with the columns of a fit, some of them excluded; unobservable
    zeros and tilts have columns of zeros."""
    dynamics, regressor = problem.dynamics, extended(problem.dynamics, problem.additions)
    weights = np.sqrt(problem.information.weights)
    step = Tolerances().mounting  # of all columns, divided out below
    tolerances = Tolerances(lengths=0.0, homing=step, mounting=step)
    rows = next(geometric_rows(regressor, dynamics, recording, problem.values, weights, tolerances))
    tilts = [name for name in rows.names if name.startswith("tilt")]
    zeros = [f"zero of {drive}" for drive in dynamics.robot.drives]
    names = [problem.layout.parameters[k].name for k in active_columns(regressor)]
    span = Span.of_columns(rows.Y[:, [name not in without for name in names]])
    D = rows.over((*zeros, *tilts)) / step
    return Shifts.from_rows(span, D, rows.tau, len(zeros), len(tilts))


def _warnings(result: Identification, verdicts: Sequence[Verdict]) -> tuple[str, ...]:
    """Warnings of survey and fit whose cause no verdict reports: contradictions of the fit follow
    from poor units, wiring and priors."""
    doubts = [(recording.path, recording.log.warnings) for recording in result.recordings]
    count = sum(len(of_recording) for _, of_recording in doubts)
    poor = {v.key for v in verdicts if v.grade in (Grade.DOUBTFUL, Grade.WRONG)}
    explained = doubts_of_fit(result.problem) if poor & _EXPLAIN_A_FIT else ()
    of_fit = (text for text in result.model.warnings[count:] if text not in explained)
    return (*reading_warnings(doubts, verdicts), *of_fit)
