"""The recordings of a robot together, and the fit to them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC

import numpy as np

from deltaid.estimation.information import Information
from deltaid.fleets import store
from deltaid.fleets.block import ENDING, FORMAT, RecordingBlock, block_bytes, block_of, halved
from deltaid.fleets.factor_file import (
    FactorFile,
    digest,
    require_alike,
    require_mechanism,
    require_together,
)
from deltaid.fleets.factor_record import RecordingBrief
from deltaid.fleets.gather_plan import GatherResult
from deltaid.fleets.merged import Merging, merging_of, ordered, with_laws
from deltaid.fleets.place import Place
from deltaid.fleets.step import DamagedFactorsError, FleetJob
from deltaid.identification.fit import FittedProblem, fit_to
from deltaid.identification.gathering import Gathered, balanced
from deltaid.identification.geometric_rows import shifted
from deltaid.identification.widening import widened
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription
from deltaid.sensors.weighings import weighings

# Of so many recordings at most the groups are their stretches of time; of more, recordings.
FEW = 10
# Smaller blocks are kept only as long as each night needs them.
_LASTING = 8
# Of a key: those of the recording's checksum.
_BITS = 64


@dataclass(frozen=True, eq=False)
class RobotRecordings:
    """Recordings of a robot, merged for its fit.

    Attributes:
        merging: by which they were; with the friction laws that are to be fitted.
        block: all of them.
        stretches: of each, where there are few.
    """

    merging: Merging
    block: RecordingBlock
    stretches: tuple[tuple[Information, ...], ...] = ()

    @property
    def briefs(self) -> tuple[RecordingBrief, ...]:
        return self.block.briefs

    @property
    def gathered(self) -> Gathered:
        """What they say of the fit's columns."""
        merging, block = self.merging, self.block
        groups = block.information(merging, block.groups)
        (whole,) = block.information(merging, block.whole)
        parts = self.stretches or tuple((group,) for group in groups)
        return Gathered(parts, block.by_place(merging), whole)


def merged_files(
    files: Sequence[FactorFile], robot: RobotDescription, settings: Settings
) -> RobotRecordings:
    """Factor files of a robot together, with its friction laws or those that they ask for.

    Raises:
        RecordingError: they do not go together, or not with the robot.
    """
    require_alike(files, robot)
    each = {int.from_bytes(file.record.sha256.encode()): file for file in files}
    keys, briefs = sorted(each), ordered([file.brief for file in files])
    merging = merging_of(briefs, with_laws(robot, briefs, settings), settings)
    return merged_as(merging, [each[key] for key in keys], keys)


def merged_as(
    merging: Merging, files: Sequence[FactorFile], keys: Sequence[int]
) -> RobotRecordings:
    """Factor files together; keys, ascending, decide in which order."""
    parts = [merging.part(file) for file in files]
    block = _merged(keys, lambda k: RecordingBlock.of_file(merging, files[k], parts[k], keys[k]))
    few = len(files) <= FEW
    return RobotRecordings(merging, block, tuple(part.stretches for part in parts) if few else ())


# The first and the last of some recordings that follow each other, by their numbers, the last + 1.
_Span = tuple[int, int]


def _merged(
    keys: Sequence[int],
    leaf: Callable[[int], RecordingBlock],
    known: Mapping[_Span, RecordingBlock] | None = None,
    keep: Callable[[_Span, RecordingBlock], None] = lambda *_: None,
    first: int = 0,
) -> RecordingBlock:
    """The block of all keys, of halves of halves.

    Args:
        leaf: that of the number of a key.
        known: blocks that need not be made.
        keep: what is done with those that are made.
        first: number of the first key.
    """
    span, middle = (first, first + len(keys)), halved(keys)
    if known and span in known:
        return known[span]
    if len(keys) == 1:
        block = leaf(first)
    else:
        before = _merged(keys[:middle], leaf, known, keep, first)
        block = before.joined(_merged(keys[middle:], leaf, known, keep, first + middle))
    keep(span, block)
    return block


def fitted(
    recordings: RobotRecordings, robot: RobotDescription, settings: Settings
) -> FittedProblem:
    """The fit of a robot, that of the merging or one with other priors or measured values, to its
    recordings, by the settings of method, regulariser, γ and prior's spread.

    Raises:
        IdentificationError: the fit cannot be posed, or its solver did not reach its end.
    """
    merging = recordings.merging
    dynamics, additions = merging.dynamics, merging.additions
    if robot is not dynamics.robot:
        other = merging_of(recordings.briefs, robot, settings)
        dynamics, additions = other.dynamics, other.additions
    problem = fit_to(balanced(recordings.gathered, weighings(robot)), dynamics, settings, additions)
    rows = recordings.block.geometric_rows(merging, np.sqrt(problem.information.weights))
    if rows is not None:
        geometry = shifted([rows], problem.base, problem.information, additions)
        estimate = problem.estimate.with_shifts(geometry.shifts)
        problem = replace(problem, estimate=estimate, geometry=geometry)
    return widened(problem)


def merged_recordings(job: FleetJob, place: Place) -> RobotRecordings:
    """The recordings of a job, in halves of halves whose blocks are kept: a call reads a block for
    each half without news, and the factor files of what is new.

    A block is named by a checksum of its recordings and of all that its numbers follow from. So
    one that is missing, damaged or of other recordings is made again, calls at the same time write
    the same bytes, and a recording that is excluded changes the halves that it was in. Numbers do
    not depend on which blocks there are.

    Raises:
        DamagedFactorsError: factor files cannot be read.
        RecordingError: they do not go together, or not with the robot.
    """
    if job.files not in place.kept:
        place.kept[job.files] = _of_blocks(job, place)
    return place.kept[job.files]


def _of_blocks(job: FleetJob, place: Place) -> RobotRecordings:
    leaves = sorted(job.recordings, key=_key)
    keys = tuple(map(_key, leaves))
    if len(keys) <= FEW:
        files = [*_read(job, place, leaves, range(len(keys))).values()]
        return merged_as(_merging(job, [file.brief for file in files]), files, keys)
    names, kept = dict[_Span, str](), set[str]()
    for span, is_kept in _spans(keys, len(keys)):
        own = [(leaf.sha256, leaf.file) for leaf in leaves[slice(*span)]]
        names[span] = f"{job.blocks}/{digest([FORMAT, job.common, own])[:32]}{ENDING}"
        kept |= {names[span]} if is_kept else set()
    there, blocks = place.listing(job.blocks), dict[_Span, RecordingBlock]()
    reached, missing = 0, list[int]()
    for (first, last), name in names.items():
        if first < reached:
            continue
        if name in there and (block := block_of(place.read(name))) is not None:
            blocks[first, last], reached = block, last
        elif last == first + 1:
            missing.append(first)
            reached = last
    files = _read(job, place, leaves, missing)
    briefs = [brief for block in blocks.values() for brief in block.briefs]
    merging = _merging(job, [*briefs, *(file.brief for file in files.values())])
    for span in [x for x, block in blocks.items() if block.fingerprint != merging.fingerprint]:
        del blocks[span]
        files |= _read(job, place, leaves, range(*span))

    def leaf(k: int) -> RecordingBlock:
        file = files.pop(k)
        return RecordingBlock.of_file(merging, file, merging.part(file), keys[k])

    def keep(span: _Span, block: RecordingBlock) -> None:
        if names[span] in kept:
            place.write(names[span], block_bytes(block))

    whole = _merged(keys, leaf, blocks, keep)
    for name in there.keys() - kept:
        store.remove(place.path_to(name))
    return RobotRecordings(merging, whole)


def _key(leaf: GatherResult) -> int:
    """By time, to the microsecond, then by checksum."""
    time = leaf.recorded.time
    since = time.replace(tzinfo=time.tzinfo or UTC).timestamp()
    return (round(since * 1e6) << _BITS) | int(leaf.sha256[: _BITS // 4], 16)


def _spans(
    keys: Sequence[int], count: int, first: int = 0, *, of_newest: bool = True
) -> Iterator[tuple[_Span, bool]]:
    """All halves of halves, each before its own, and whether its block is kept."""
    size, is_newest = len(keys), first + len(keys) == count
    yield (first, first + size), size == 1 if is_newest else size >= _LASTING or of_newest
    if size > 1:
        middle = halved(keys)
        yield from _spans(keys[:middle], count, first, of_newest=is_newest)
        yield from _spans(keys[middle:], count, first + middle, of_newest=is_newest)


def _read(
    job: FleetJob, place: Place, leaves: Sequence[GatherResult], numbers: Sequence[int]
) -> dict[int, FactorFile]:
    files, damaged = dict[int, FactorFile](), list[str]()
    for k in numbers:
        file = place.factors(leaves[k].file)
        if file is None:
            damaged.append(leaves[k].file)
        else:
            files[k] = file
    if damaged:
        raise DamagedFactorsError(damaged)
    for file in files.values():
        require_mechanism(file, job.description)
    return files


def _merging(job: FleetJob, briefs: Sequence[RecordingBrief]) -> Merging:
    require_together(ordered(briefs))
    return merging_of(briefs, with_laws(job.description, briefs, job.settings), job.settings)
