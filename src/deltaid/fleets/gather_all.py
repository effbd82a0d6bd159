"""All recordings of a fleet: what earlier calls have gathered or refused is not gathered again."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from deltaid.errors import DeltaidError
from deltaid.fleets.fleet import Recorded
from deltaid.fleets.gather_one import FACTORS, GatherJob, GatherResult, gather_recorded
from deltaid.fleets.step import Call
from deltaid.fleets.store import has_pattern


def gather_all(call: Call) -> tuple[list[GatherResult], int]:
    """What became of all recordings, in their order, and how many were gathered now."""
    listing = call.place.listing(FACTORS)
    outcomes, jobs = list[GatherResult](), list[GatherJob]()
    for recorded in call.fleet.recordings:
        try:
            job = GatherJob.for_recording(recorded, call.plan.how(recorded))
        except DeltaidError as error:
            outcomes.append(GatherResult(recorded, "", reason=str(error), is_new=False))
            continue
        known = call.known.gathered(recorded, job.key, listing)
        if known is None:
            jobs.append(job)
        else:
            outcomes.append(known)
    new = _gathered(call, jobs)
    outcomes += new + _gone(call, listing)
    return _once(outcomes), sum(outcome.is_new for outcome in new)


def gather_again(
    call: Call, outcomes: Sequence[GatherResult], files: Iterable[str]
) -> tuple[list[GatherResult], int]:
    """The same with some recordings gathered anew, whose factor files are damaged."""
    names, known = set(files), dict[Recorded, GatherResult]()
    for outcome in outcomes:
        if outcome.file in names:
            reason = f"{outcome.file} is damaged, and the recording is no longer there"
            known[outcome.recorded] = replace(outcome, key="", file="", reason=reason)
    jobs = [GatherJob.for_recording(log, call.plan.how(log)) for log in known if log.stamp]
    new = _gathered(call, jobs)
    known |= {outcome.recorded: outcome for outcome in new}
    return [known.get(outcome.recorded, outcome) for outcome in outcomes], len(new)


def how_digest(call: Call, recorded: Recorded) -> str:
    """The checksum of how a recording is gathered; empty where it cannot be."""
    try:
        return call.plan.how(recorded).digest
    except DeltaidError:
        return ""


def _gathered(call: Call, jobs: Sequence[GatherJob]) -> list[GatherResult]:
    words = ("gathered", "recordings")
    return list(call.done(words, gather_recorded, jobs, _failed))


def _failed(job: GatherJob, why: str) -> GatherResult:
    return GatherResult(job.recorded, "", reason=why)


def _gone(call: Call, listing: dict[str, int]) -> list[GatherResult]:
    """Recordings that the manifest still names and that have been thrown away once gathered.

    What they said has been kept, so they count.
    """
    from fsspec.utils import glob_translate

    named, patterns = set(call.fleet.entries), dict[str, list[re.Pattern[str]]]()
    for robot, pattern in call.fleet.entries:
        if has_pattern(pattern):
            patterns.setdefault(robot, []).append(re.compile(glob_translate(pattern)))
    here, gone = {recorded.path for recorded in call.fleet.recordings}, list[GatherResult]()
    for outcome, how in call.known.gone(here, listing):
        robot, path = outcome.recorded.robot, outcome.recorded.path
        matches = any(pattern.fullmatch(path) for pattern in patterns.get(robot, ()))
        if (matches or (robot, path) in named) and how_digest(call, outcome.recorded) == how:
            gone.append(outcome)
    return gone


def _once(outcomes: Iterable[GatherResult]) -> list[GatherResult]:
    """The same with every recording once: copies would narrow all intervals, telling nothing new.

    What is still there comes before what is not, and the first in order before others.
    """
    kept, first = list[GatherResult](), dict[str, Recorded]()
    for outcome in sorted(outcomes, key=lambda own: (not own.recorded.stamp, own.recorded)):
        log = outcome.recorded
        original = first.setdefault(outcome.sha256, log) if outcome.file else log
        if original == log:
            kept.append(outcome)
        elif log.stamp:
            reason = f"is a copy of {original.path} of {original.robot}\n"
            reason += "  → give each recording once"
            kept.append(replace(outcome, key="", file="", reason=reason))
    return sorted(kept, key=lambda outcome: outcome.recorded)
