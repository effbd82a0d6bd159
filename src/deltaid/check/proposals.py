"""Proposals refitted: lines of files are proposed only where they explain rows that were held back.

All that verdicts on a recording propose is tried together, then without each: what changes nothing
for the better is dropped. A verdict stays without its lines, and says that no change of the files
explains it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from deltaid.check.evidence import Evidence, evidence
from deltaid.check.held_out import HeldOut, held_out
from deltaid.check.mended import cured_mapping, cured_robot, files_of
from deltaid.errors import DeltaidError
from deltaid.model.verdict import Grade, Verdict

# Whether the first of two errors speaks for what it was made with.
_Judge = Callable[[HeldOut, HeldOut], bool]
_NO_CHANGE = (
    "no change of the files explains this: with the lines that would correct it, errors of torques "
    "that were held out do not fall"
)


def proved(record: Evidence, verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """Verdicts on a recording, with those proposals that explain it better than the files do, or
    that its rows cannot judge."""
    return _with_useful(record, verdicts, lambda new, old: new.same(old) or new.better(old))


def unharmed(record: Evidence, verdicts: Sequence[Verdict]) -> tuple[Verdict, ...]:
    """Verdicts on a description, with those proposals that do not explain a recording worse."""
    return _with_useful(record, verdicts, HeldOut.as_good)


def _with_useful(
    record: Evidence, verdicts: Sequence[Verdict], judge: _Judge
) -> tuple[Verdict, ...]:
    """Verdicts that keep what helps of the proposals that are to be written."""
    kept, judged = _useful(record, [v for v in verdicts if v.proposals], judge), list[Verdict]()
    for verdict in verdicts:
        written = tuple(proposal for proposal in verdict.proposals if proposal.is_written)
        if verdict.proposals and verdict not in kept:  # what it says explains nothing
            grade = min(verdict.grade, Grade.DOUBTFUL, key=list(Grade).index)
            verdict = replace(verdict, grade=grade, cause="", cure=_NO_CHANGE, proposals=())
        elif written != verdict.proposals:
            verdict = replace(verdict, proposals=written)
        judged.append(verdict)
    return tuple(judged)


def _useful(record: Evidence, proposing: Sequence[Verdict], judge: _Judge) -> list[Verdict]:
    """Those whose proposals help beside those of all others that do."""
    if not proposing:
        return []
    kept, files, best = list(proposing), _error(record, ()), _error(record, proposing)
    while len(kept) > 1:
        # Of two proposals that exclude each other, the first stays.
        fewer = ((_error(record, [v for v in kept if v is not last]), last) for last in kept[::-1])
        spare = next((trial for trial in fewer if not _helps(best, trial[0], judge)), None)
        if spare is None:
            break
        best, dropped = spare
        kept.remove(dropped)
    return kept if _helps(best, files, judge) else []


def _helps(proposed: HeldOut | None, files: HeldOut | None, judge: _Judge) -> bool:
    """Whether a proposal is to be kept; where there is an error of one side only, it decides."""
    if proposed is None or files is None:
        return proposed is not None or files is None
    return judge(proposed, files)


def _error(record: Evidence, verdicts: Sequence[Verdict]) -> HeldOut | None:
    """Of a recording with all that verdicts propose; None where it cannot be read so."""
    try:
        if not verdicts:
            return held_out(record)
        robot, mapping = cured_robot(record.robot, verdicts), record.mapping
        if "mapping" in files_of(verdicts):
            mapping = cured_mapping(record, verdicts)
        return held_out(evidence(robot, record.source, mapping, record.settings))
    except DeltaidError:
        return None
