"""Proposals refitted: lines of files are proposed only where they explain rows that were held back.

All that verdicts on a recording propose is tried together, then without each: what changes nothing
for the better is dropped. A verdict stays without its lines, and says that no change of the files
explains it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from deltaid.check.evidence import Evidence, evidence
from deltaid.check.held_out import HeldOut, held_out
from deltaid.check.mended import changes, mended, written_out
from deltaid.errors import DeltaidError
from deltaid.model.verdict import Grade, Verdict
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import described_in, parse, yaml_text

# Whether the first of two errors speaks for what it was made with; None where there is none.
_Judge = Callable[[HeldOut | None, HeldOut | None], bool]
_NO_CHANGE = (
    "no change of the files explains this: with the lines that would correct it, errors of torques "
    "that were held out do not fall"
)


def proved(record: Evidence, verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """Verdicts on a recording, with those proposals that explain it better than the files do."""
    return _with_useful(record, verdicts, _helps)


def unharmed(record: Evidence, verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """Verdicts on a description, with those proposals that do not explain a recording worse."""
    return _with_useful(record, verdicts, lambda proposed, files: not _harms(proposed, files))


def _with_useful(
    record: Evidence, verdicts: Sequence[Verdict], helps: _Judge
) -> tuple[Verdict, ...]:
    proposing = [verdict for verdict in verdicts if verdict.proposals]
    kept = _useful(record, proposing, helps) if proposing else []
    return tuple(
        _to_write(verdict) if not verdict.proposals or verdict in kept else _without(verdict)
        for verdict in verdicts
    )


def _to_write(verdict: Verdict) -> Verdict:
    """A verdict with the proposals that are to be written."""
    written = tuple(proposal for proposal in verdict.proposals if proposal.is_written)
    return verdict if written == verdict.proposals else replace(verdict, proposals=written)


def _useful(record: Evidence, proposing: Sequence[Verdict], helps: _Judge) -> list[Verdict]:
    """Those whose proposals help beside those of all others that do."""
    kept, files = list(proposing), _error(record, ())
    best = _error(record, kept)
    while len(kept) > 1:
        # Of two proposals that exclude each other, the first stays.
        fewer = ((_error(record, [v for v in kept if v is not last]), last) for last in kept[::-1])
        spare = next((trial for trial in fewer if not helps(best, trial[0])), None)
        if spare is None:
            break
        best, dropped = spare
        kept.remove(dropped)
    return kept if helps(best, files) else []


def _helps(proposed: HeldOut | None, files: HeldOut | None) -> bool:
    """Whether a proposal explains more, or rows cannot judge it."""
    if proposed is None or files is None:
        return proposed is not None or files is None
    return proposed.same(files) or proposed.better(files)


def _harms(proposed: HeldOut | None, files: HeldOut | None) -> bool:
    """Whether a proposal explains less."""
    if proposed is None or files is None:
        return files is not None
    return proposed.worse(files)


def _error(record: Evidence, verdicts: Sequence[Verdict]) -> HeldOut | None:
    """Of a recording with all that verdicts propose; None where it cannot be read so."""
    try:
        if not verdicts:
            return held_out(record)
        robot, mapping = proposed_robot(record.robot, verdicts), proposed_mapping(record, verdicts)
        return held_out(evidence(robot, record.source, mapping, record.settings))
    except DeltaidError:
        return None


def proposed_robot(robot: RobotDescription, verdicts: Sequence[Verdict]) -> RobotDescription:
    """A description with all that verdicts propose for it.

    Raises:
        DescriptionError: what is proposed does not fit.
    """
    if not (proposed := changes(verdicts, "robot")):
        return robot
    data = robot.model_dump(mode="json", exclude_none=True)
    return described_in(yaml_text(mended(data, proposed)), "proposed robot")


def proposed_mapping(record: Evidence, verdicts: Sequence[Verdict]) -> ColumnMapping | None:
    """The mapping of a recording with all that verdicts propose for it.

    Raises:
        RecordingError: what is proposed does not fit.
    """
    if not (proposed := changes(verdicts, "mapping")):
        return record.mapping
    linear = tuple(record.robot.is_linear(drive) for drive in record.robot.drives)
    data = mended(written_out(record.mapping, record.table, record.columns, linear), proposed)
    return parse(yaml_text(data), ColumnMapping, where="proposed mapping").of("proposed mapping")


def _without(verdict: Verdict) -> Verdict:
    """A verdict whose proposals do not help: doubtful, for what it says explains nothing."""
    return replace(
        verdict,
        grade=min(verdict.grade, Grade.DOUBTFUL, key=list(Grade).index),
        cause="",
        cure=_NO_CHANGE,
        proposals=(),
    )
