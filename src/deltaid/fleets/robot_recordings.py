"""Recordings of a robot, merged in saved blocks, and the fit to them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC

import numpy as np

from deltaid.estimation.information import Information
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

# Number of recordings up to which groups are their stretches of time; beyond, groups are
# recordings. Blocks of fewer recordings are saved only beside the newest ones, for the next call.
FEW = 10
# Bits of the recording's checksum in a key.
_BITS = 64


@dataclass(frozen=True, eq=False)
class RobotRecordings:
    """Recordings of a robot, merged for its fit.

    Attributes:
        merging: of the recordings, with the friction laws to fit.
        block: of all recordings.
        stretches: of each recording, if they are few.
    """

    merging: Merging
    block: RecordingBlock
    stretches: tuple[tuple[Information, ...], ...] = ()

    @property
    def gathered(self) -> Gathered:
        """Information of the fit's columns."""
        merging, block = self.merging, self.block
        groups = block.information(merging, block.groups)
        (whole,) = block.information(merging, block.whole)
        return Gathered(
            self.stretches or tuple((group,) for group in groups), block.by_place(merging), whole
        )


def merged_files(
    files: Sequence[FactorFile], robot: RobotDescription, settings: Settings
) -> RobotRecordings:
    """Factor files of a robot, merged with its friction laws or those that they choose.

    Raises:
        RecordingError: they do not match each other or the robot.
    """
    require_alike(files, robot)
    each = {int.from_bytes(file.record.sha256.encode()): file for file in files}
    keys, briefs = sorted(each), ordered([file.brief for file in files])
    merging = merging_of(briefs, with_laws(robot, briefs, settings), settings)
    return merged_as(merging, {k: each[key] for k, key in enumerate(keys)}, keys)


# Consecutive recordings: index of the first, and index after the last.
_Span = tuple[int, int]


def merged_as(
    merging: Merging,
    files: dict[int, FactorFile],
    keys: Sequence[int],
    known: Mapping[_Span, RecordingBlock] | None = None,
    keep: Callable[[_Span, RecordingBlock], None] = lambda *_: None,
) -> RobotRecordings:
    """Recordings merged in the order of their ascending keys.

    Args:
        files: by the index of their keys, of recordings without a known block; each is removed as
            it is merged.
        known: existing blocks.
        keep: called with new blocks.
    """
    stretches = list[tuple[Information, ...]]()

    def leaf(k: int) -> RecordingBlock:
        part = merging.part(files.pop(k))
        if len(keys) <= FEW:
            stretches.append(part.stretches)
        return RecordingBlock.of_part(merging, part, keys[k])

    block = _merged(keys, leaf, known or {}, keep)
    return RobotRecordings(merging, block, tuple(stretches))


def _merged(
    keys: Sequence[int],
    leaf: Callable[[int], RecordingBlock],
    known: Mapping[_Span, RecordingBlock],
    keep: Callable[[_Span, RecordingBlock], None],
    first: int = 0,
) -> RecordingBlock:
    """The block of all keys, merged by recursive halves.

    Args:
        leaf: makes the block of one key from its index.
        known, keep: as in `merged_as`.
        first: index of the first key.
    """
    span, middle = (first, first + len(keys)), halved(keys)
    if span in known:
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
    """Fit a robot: the one of the merging, or one with other priors or measured values.

    Args:
        settings: method, regulariser, γ and prior's spread.

    Raises:
        IdentificationError: the fit cannot be posed, or its solver did not converge.
    """
    merging = recordings.merging
    dynamics, additions = merging.dynamics, merging.additions
    if robot is not dynamics.robot:
        other = merging_of(recordings.block.briefs, robot, settings)
        dynamics, additions = other.dynamics, other.additions
    problem = fit_to(balanced(recordings.gathered, weighings(robot)), dynamics, settings, additions)
    rows = recordings.block.geometric_rows(merging, np.sqrt(problem.information.weights))
    if rows is not None:
        geometry = shifted([rows], problem.base, problem.information, additions)
        problem = replace(problem, geometry=geometry)
    return widened(problem)


def merged_recordings(job: FleetJob, place: Place) -> RobotRecordings:
    """The recordings of a job, merged by recursive halves whose blocks are saved: a call reads
    blocks of unchanged halves, and the factor files of new recordings.

    A block is named by a checksum of its recordings and of all other inputs. So a missing, damaged
    or outdated block is made again, simultaneous calls write the same bytes, and an excluded
    recording changes the halves that contained it. Results do not depend on existing blocks.

    Raises:
        DamagedFactorsError: factor files cannot be read.
        RecordingError: they do not match each other or the robot.
    """
    if job.files not in place.kept:
        place.kept[job.files] = _of_blocks(job, place)
    return place.kept[job.files]


def _of_blocks(job: FleetJob, place: Place) -> RobotRecordings:
    leaves = sorted(job.recordings, key=_key)
    keys = tuple(map(_key, leaves))
    if len(keys) <= FEW:
        files = _read(job, place, leaves, range(len(keys)))
        return merged_as(_merging(job, [file.brief for file in files.values()]), files, keys)
    members, spans = [(leaf.sha256, leaf.file) for leaf in leaves], dict(_spans(keys, len(keys)))
    names = {
        span: f"{job.blocks}/{digest([FORMAT, job.common, members[slice(*span)]])[:32]}{ENDING}"
        for span in spans
    }
    kept = {names[span] for span, is_kept in spans.items() if is_kept}
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

    def keep(span: _Span, block: RecordingBlock) -> None:
        if names[span] in kept:
            place.write(names[span], block_bytes(block))

    recordings = merged_as(merging, files, keys, blocks, keep)
    place.remove(there.keys() - kept)
    return recordings


def _key(leaf: GatherResult) -> int:
    """Sort key: time in microseconds, then checksum."""
    time = leaf.recorded.time
    since = time.replace(tzinfo=time.tzinfo or UTC).timestamp()
    return (round(since * 1e6) << _BITS) | int(leaf.sha256[: _BITS // 4], 16)


def _spans(
    keys: Sequence[int], count: int, first: int = 0, *, of_newest: bool = True
) -> Iterator[tuple[_Span, bool]]:
    """Yield all recursive halves, each before its parts, and whether its block is saved."""
    size, is_newest = len(keys), first + len(keys) == count
    yield (first, first + size), size == 1 if is_newest else size >= FEW or of_newest
    if size > 1:
        middle = halved(keys)
        yield from _spans(keys[:middle], count, first, of_newest=is_newest)
        yield from _spans(keys[middle:], count, first + middle, of_newest=is_newest)


def _read(
    job: FleetJob, place: Place, leaves: Sequence[GatherResult], numbers: Sequence[int]
) -> dict[int, FactorFile]:
    found = {k: place.factors(leaves[k].file) for k in numbers}
    files = {k: file for k, file in found.items() if file is not None}
    if len(files) < len(found):
        raise DamagedFactorsError([leaves[k].file for k in found if k not in files])
    for file in files.values():
        require_mechanism(file, job.description)
    return files


def _merging(job: FleetJob, briefs: Sequence[RecordingBrief]) -> Merging:
    require_together(ordered(briefs))
    return merging_of(briefs, with_laws(job.description, briefs, job.settings), job.settings)
