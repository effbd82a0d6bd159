"""The steps of a call: recordings, fits, studies of robots; each does what is left."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from deltaid.errors import DeltaidError
from deltaid.fleets.drift_settings import DriftSettings
from deltaid.fleets.fit_step import (
    ALL,
    MODELS,
    PARAMETERS,
    FitJob,
    Fitted,
    fit_jobs,
    fit_period,
    model_file,
)
from deltaid.fleets.fleet import Recorded
from deltaid.fleets.gather_one import FACTORS, Job, Outcome, gather_recorded
from deltaid.fleets.known import Named
from deltaid.fleets.step import Call
from deltaid.fleets.store import has_pattern
from deltaid.fleets.study_step import MEMBERS, TABLES, Studied, StudyJob, study_jobs, study_robot
from deltaid.fleets.type_step import FOLDER as TYPES
from deltaid.fleets.type_step import TABLES as TYPE_TABLES
from deltaid.fleets.type_step import Typed, TypeJob, fit_type, type_jobs


def gather_all(call: Call) -> tuple[list[Outcome], int]:
    """What became of all recordings, in their order, and how many were looked at now."""
    listing = _listing(call, FACTORS)
    outcomes, jobs = list[Outcome](), list[Job]()
    for one in call.fleet.recordings:
        try:
            call.ways.require(one)
            job = Job.of(one, call.ways.how(one))
        except DeltaidError as error:
            outcomes.append(Outcome(one, "", reason=str(error), is_new=False))
            continue
        there = call.known.gathered(one, job.key, listing)
        if there is not None:
            outcomes.append(there)
        else:
            jobs.append(job)
    new = _gathered(call, jobs)
    outcomes += new + _gone(call, listing)
    return _once(outcomes), sum(one.is_new for one in new)


def gather_again(
    call: Call, outcomes: Sequence[Outcome], files: Iterable[str]
) -> tuple[list[Outcome], int]:
    """The same with some recordings gathered anew, whose factor files are damaged."""
    names = set(files)
    lost = {one.recorded: one for one in outcomes if one.file in names}
    new = _gathered(call, [Job.of(one, call.ways.how(one)) for one in lost if one.stamp])
    known = {
        one.recorded: replace(
            one, key="", file="",
            reason=f"{one.file} is damaged, and the recording is no longer there",
        )
        for one in lost.values()
    } | {one.recorded: one for one in new}  # fmt: skip
    return [known.get(one.recorded, one) for one in outcomes], len(new)


def fit_all(call: Call, outcomes: Sequence[Outcome]) -> tuple[list[Fitted], int]:
    """All fits, in the order of robots and periods, and how many were made now."""
    jobs = fit_jobs(outcomes, call.fleet.period, dict(call.ways.robots), call.ways.settings)
    there, models = call.known.keys(PARAMETERS), _listing(call, MODELS)
    found = dict[FitJob, Fitted]()
    for job in jobs:
        if job.key in there and (ALL not in job.periods or model_file(job.robot) in models):
            found[job] = Fitted(job)
        elif job.key in call.known.refused:
            found[job] = Fitted(job, reason=call.known.refused[job.key])
    left = [job for job in jobs if job not in found]
    for one in call.done(
        ("fitted", "periods"), fit_period, left, lambda job, why: Fitted(job, {}, why, False)
    ):
        found[one.job] = one
    return [found[job] for job in jobs], len(left)


def study_all(
    call: Call, fits: Sequence[Fitted], outcomes: Sequence[Outcome], drift: DriftSettings
) -> tuple[list[Studied], int]:
    """Drift of each robot and what it tells of its type, and of how many that was found now."""
    jobs, members = study_jobs(fits, outcomes, drift), _listing(call, MEMBERS)
    there = [call.known.keys(name) for name in TABLES]
    found = dict[StudyJob, Studied]()
    for job in jobs:
        has_drift = all(job.key in own for own in there)
        if has_drift and job.member_file in members:
            found[job] = Studied(job)
        elif job.key in call.known.refused:
            missing = {"drift": not has_drift, "type": job.member_file not in members}
            reason = call.known.refused[job.key]
            found[job] = Studied(job, reasons={k: reason for k, no in missing.items() if no})
    left = [job for job in jobs if job not in found]
    for one in call.done(
        ("studied", "robots"),
        study_robot,
        left,
        lambda job, why: Studied(job, {}, {"drift": why, "type": why}, lasting=False),
    ):
        found[one.job] = one
    return [found[job] for job in jobs], len(left)


def type_all(call: Call, studies: Sequence[Studied]) -> tuple[list[Typed], int]:
    """What robots of each type say together, and how many types were fitted now."""
    jobs, there = type_jobs(studies), [call.known.keys(name) for name in TYPE_TABLES]
    files = _listing(call, TYPES)
    found = dict[TypeJob, Typed]()
    for job in jobs:
        if all(job.key in own for own in there) and job.file in files:
            found[job] = Typed(job)
        elif job.key in call.known.refused:
            found[job] = Typed(job, reason=call.known.refused[job.key])
    left = [job for job in jobs if job not in found]
    for one in call.done(
        ("compared", "types"), fit_type, left, lambda job, why: Typed(job, {}, why, lasting=False)
    ):
        found[one.job] = one
    return [found[job] for job in jobs], len(left)


def how_digest(call: Call, one: Recorded) -> str:
    """The checksum of how a recording is gathered; empty where it cannot be."""
    try:
        call.ways.require(one)
        return call.ways.how(one).digest
    except DeltaidError:
        return ""


def _gathered(call: Call, jobs: Sequence[Job]) -> list[Outcome]:
    return list(
        call.done(
            ("gathered", "recordings"),
            gather_recorded,
            jobs,
            lambda job, why: Outcome(job.recorded, "", reason=why),
        )
    )


def _listing(call: Call, folder: str) -> dict[str, int]:
    """Sizes of files in a part of the fleet's folder, by their names seen from that."""
    found = call.place.store.listing(call.place.at(folder))
    return {f"{folder}/{name}": size for name, size in found.items()}


def _gone(call: Call, listing: dict[str, int]) -> list[Outcome]:
    """Recordings that have been gathered, and thrown away since."""
    from fsspec.utils import glob_translate

    patterns = dict[str, list[str]]()
    for robot, pattern in call.fleet.entries:
        patterns.setdefault(robot, []).append(pattern)
    named = {
        robot: Named(
            frozenset(one for one in own if not has_pattern(one)),
            tuple(re.compile(glob_translate(one)) for one in own if has_pattern(one)),
        )
        for robot, own in patterns.items()
    }
    return [
        outcome
        for recorded, outcome, how in call.known.gone(call.fleet.recordings, named, listing)
        if how_digest(call, recorded) == how
    ]


def _once(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """The same with every recording once: copies would narrow all intervals, telling nothing new.

    What is still there comes before what is not, and the first in order before others.
    """
    found, first = list[Outcome](), dict[str, Recorded]()
    for one in sorted(outcomes, key=lambda one: (not one.recorded.stamp, one.recorded)):
        kept = first.setdefault(one.sha256, one.recorded) if one.file else one.recorded
        if kept == one.recorded:
            found.append(one)
        elif one.recorded.stamp:
            reason = f"is a copy of {kept.path} of {kept.robot}\n  → give each recording once"
            found.append(replace(one, key="", file="", reason=reason))
    return sorted(found, key=lambda one: one.recorded)
