"""Gather all recordings of a fleet; results and refusals of earlier calls are reused."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import polars as pl

from deltaid.errors import DeltaidError, RecordingError, counted
from deltaid.fleets.factor_file import FactorFile, write
from deltaid.fleets.factor_record import RecordingBrief
from deltaid.fleets.fleet import Fleet, Recorded
from deltaid.fleets.gather import gathered
from deltaid.fleets.gather_plan import FACTORS, GatherJob, GatherResult
from deltaid.fleets.place import RECORDINGS, Place
from deltaid.fleets.step import Call
from deltaid.fleets.store import StoreError, has_pattern, local_file
from deltaid.fleets.workers import ALONE
from deltaid.grouping import grouped
from deltaid.parallel import threads

# Columns of the table: fields of the recording and of its outcome.
_RECORDED = {
    **{"robot": pl.String, "type": pl.String, "time": pl.Datetime("us"), "path": pl.String},
    **{"columns": pl.String, "load": pl.Float64, "temperature": pl.Float64},
}
_OUTCOME = {
    **{"file": pl.String, "reason": pl.String, "samples": pl.Int64, "verdicts": pl.String},
    **{"sha256": pl.String, "bytes": pl.Int64, "key": pl.String, "how": pl.String},
}
RECORDINGS_SCHEMA = {**_RECORDED, **_OUTCOME, "there": pl.Boolean}
# Reasons why gathered factors cannot be used.
_WRONG = "whose description or mapping cannot be read"
_OTHERWISE = "that are gathered otherwise than asked, or by another version"
_AWAY = "that are not there, and were gathered otherwise than asked, or by another version"
_DAMAGED = "that are not there, and whose factor files are damaged or gone"
_UNNAMED = "that the manifest names no more"
# Grades of verdicts that the table lists.
_POOR = ("wrong", "doubtful")


def gather_all(call: Call) -> list[GatherResult]:
    """Outcomes of all recordings, in their order.

    Raises:
        DeltaidError: gathered factors of earlier calls would be lost without permission.
    """
    listing, before = call.place.listing(FACTORS), _gathered_before(call.tables[RECORDINGS])
    known = {outcome.key: outcome for outcome in before}
    hows = {outcome.recorded.path: outcome.how for outcome in before}
    outcomes, jobs, lost = list[GatherResult](), list[GatherJob](), Counter[str]()
    for recorded in call.fleet.recordings:
        how = hows.get(recorded.path)
        try:
            job = GatherJob(recorded, call.plan.how(recorded))
        except DeltaidError as error:
            lost[_WRONG] += how is not None
            outcomes.append(GatherResult(recorded, "", reason=str(error), is_new=False))
            continue
        outcome = known.get(job.key)
        if reason := call.refused.get(job.key):
            outcomes.append(replace(_failed(job, reason, job.key), is_new=False))
        elif outcome is not None and listing.get(outcome.file) == outcome.bytes:
            outcomes.append(replace(outcome, recorded=recorded))
        else:
            jobs.append(job)
            lost[_OTHERWISE] += how not in (None, job.how.digest)
    is_named, here = _naming(call.fleet), {recorded.path for recorded in call.fleet.recordings}
    for outcome in before:
        if outcome.recorded.path not in here:
            if why := _why_lost(call, outcome, listing) if is_named(outcome.recorded) else _UNNAMED:
                lost[why] += 1
            else:
                outcomes.append(outcome)
    _require_kept(call, lost)
    return _once(outcomes + _gathered(call, jobs))


def recordings_table(outcomes: Sequence[GatherResult]) -> pl.DataFrame:
    rows = [
        {key: getattr(outcome.recorded, key) for key in _RECORDED}
        | {key: getattr(outcome, key) for key in _OUTCOME}
        | {"there": bool(outcome.recorded.stamp)}
        for outcome in outcomes
    ]
    return pl.DataFrame(rows, schema=RECORDINGS_SCHEMA, orient="row")


def _gathered_before(table: pl.DataFrame) -> list[GatherResult]:
    """Outcomes of earlier calls that have factors; no recording has a stamp."""
    return [
        GatherResult(
            Recorded(**{key: row[key] for key in _RECORDED}),
            is_new=False,
            **{key: row[key] for key in _OUTCOME},
        )
        for row in table.filter(pl.col("file") != "").iter_rows(named=True)
    ]


def _require_kept(call: Call, lost: Counter[str]) -> None:
    """Refuse to lose gathered factors.

    Raises:
        DeltaidError: factors would be lost; the message counts the recordings concerned.
    """
    allowed = {_OTHERWISE: call.regather}
    kept = {why: n for why, n in (+lost).items() if not allowed.get(why, call.drop_absent)}
    if kept:
        raise DeltaidError(
            "would lose what was gathered of " + "; of ".join(
                f"{counted(n, 'recording')} {why}" for why, n in kept.items()
            ),
            where=call.place.root,
            cure="put back what is away, ask as before, or give another fleet a folder of its own"
            + "; --regather gathers anew" * (_OTHERWISE in kept)
            + "; --drop-absent forgets them" * (set(kept) != {_OTHERWISE}),
        )  # fmt: skip


def gather_again(
    call: Call, outcomes: Sequence[GatherResult], files: set[str]
) -> list[GatherResult]:
    """Gather recordings anew whose factor files are damaged; returns the outcomes of all.

    Raises:
        DeltaidError: some of these recordings are missing, and may not be dropped.
    """
    why = "is damaged, and the recording is no longer there"
    known = {
        outcome.recorded: replace(outcome, key="", file="", reason=f"{outcome.file} {why}")
        for outcome in outcomes
        if outcome.file in files
    }
    _require_kept(call, Counter({_DAMAGED: sum(not log.stamp for log in known)}))
    jobs = [GatherJob(log, call.plan.how(log)) for log in known if log.stamp]
    known |= {outcome.recorded: outcome for outcome in _gathered(call, jobs)}
    return [known.get(outcome.recorded, outcome) for outcome in outcomes]


def _gathered(call: Call, jobs: Sequence[GatherJob]) -> list[GatherResult]:
    return list(call.done(("gathered", "recordings"), gather_recorded, jobs, _failed))


def _failed(job: GatherJob, why: str, key: str = "") -> GatherResult:
    return GatherResult(job.recorded, key, reason=why, how=job.how.digest)


def _why_lost(call: Call, outcome: GatherResult, listing: Mapping[str, int]) -> str:
    """Why factors of a missing recording cannot be used; empty if they can."""
    try:
        if call.plan.how(outcome.recorded).digest != outcome.how:
            return _AWAY
    except DeltaidError:
        return _WRONG
    return "" if listing.get(outcome.file) == outcome.bytes else _DAMAGED


def _naming(fleet: Fleet) -> Callable[[Recorded], bool]:
    """A function that tests whether a manifest names a recording, even a missing one."""
    from fsspec.utils import glob_translate

    single = set(fleet.entries)
    patterns = grouped(
        (robot, re.compile(glob_translate(pattern)))
        for robot, pattern in fleet.entries
        if has_pattern(pattern)
    )
    return lambda log: (
        (log.robot, log.path) in single
        or any(pattern.fullmatch(log.path) for pattern in patterns.get(log.robot, ()))
    )


def _once(outcomes: Iterable[GatherResult]) -> list[GatherResult]:
    """The outcomes with each recording once: copies would narrow intervals without new information.

    Existing recordings have priority over missing ones, then the first in order.
    """
    kept, first = list[GatherResult](), dict[str, Recorded]()
    for outcome in sorted(
        outcomes, key=lambda outcome: (not outcome.recorded.stamp, outcome.recorded)
    ):
        log = outcome.recorded
        original = first.setdefault(outcome.sha256, log) if outcome.file else log
        if original == log:
            kept.append(outcome)
        elif log.stamp:
            kept.append(
                replace(
                    outcome,
                    key="",
                    file="",
                    reason=f"is a copy of {original.path} of {original.robot}\n"
                    "  → give each recording once",
                )
            )
    return sorted(kept, key=lambda outcome: outcome.recorded)


def gather_recorded(job: GatherJob, place: Place) -> GatherResult:
    """Gather a recording into a fleet's folder, unless it is there.

    A recording that cannot be used gives an outcome with its reason instead of an error.
    """
    with ALONE:
        try:
            file = known = place.factors(job.file, job.key)
            if file is None:
                file = _gathered_now(job)
                place.save_file(job.file, lambda path: write(file, path, job.key))
            size = place.size(job.file)
        except DeltaidError as error:
            return _failed(job, str(error), "" if isinstance(error, StoreError) else job.key)
    return GatherResult(
        job.recorded,
        job.key,
        file=job.file,
        is_new=known is None,
        bytes=size,
        sha256=file.record.sha256,
        samples=file.record.model.sources[0].samples,
        verdicts=poor([file.brief]),
        how=job.how.digest,
    )


def poor(recordings: Iterable[RecordingBrief]) -> str:
    """Names of doubtful and wrong verdicts, joined."""
    verdicts = (verdict for recording in recordings for verdict in recording.verdicts)
    return ", ".join(sorted({verdict.key for verdict in verdicts if verdict.grade in _POOR}))


def _gathered_now(job: GatherJob) -> FactorFile:
    recorded, how = job.recorded, job.how
    try:
        with local_file(recorded.path, recorded.stamp) as path, threads(1):
            try:
                return gathered(
                    how.robot, path, columns=how.mapping, settings=how.settings, force=how.force
                )
            except RecordingError as error:  # its place is the local copy, not the user's file
                raise RecordingError(
                    error.what, where=error.where.replace(str(path), recorded.path), cure=error.cure
                ) from None
    except FileNotFoundError:
        raise StoreError(
            "is no longer there", where=recorded.path, cure="check the manifest"
        ) from None
