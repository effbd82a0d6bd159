"""The recordings of a robot together, and the fit to them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
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
        """Of each recording."""
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
    keys = sorted(each)
    briefs = ordered([file.brief for file in files])
    merging = merging_of(briefs, with_laws(robot, briefs, settings), settings)
    return merged_as(merging, [each[key] for key in keys], keys)


def merged_as(
    merging: Merging, files: Sequence[FactorFile], keys: Sequence[int]
) -> RobotRecordings:
    """Factor files together; keys, ascending, decide in which order."""
    parts = [merging.part(file) for file in files]

    def leaf(k: int) -> RecordingBlock:
        return RecordingBlock.of_file(merging, files[k], parts[k], keys[k])

    block = merged_in_halves(keys, leaf)
    few = len(files) <= FEW
    return RobotRecordings(merging, block, tuple(part.stretches for part in parts) if few else ())


def merged_in_halves(
    keys: Sequence[int], leaf: Callable[[int], RecordingBlock], first: int = 0
) -> RecordingBlock:
    """The block of all keys, of halves of halves; `leaf` of the number of a key."""
    if len(keys) == 1:
        return leaf(first)
    middle = halved(keys)
    before = merged_in_halves(keys[:middle], leaf, first)
    return before.joined(merged_in_halves(keys[middle:], leaf, first + middle))


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
    gathered = balanced(recordings.gathered, weighings(robot))
    problem = fit_to(gathered, dynamics, settings, additions)
    weights = np.sqrt(problem.information.weights)
    rows = recordings.block.geometric_rows(merging, weights)
    if rows is not None:
        geometry = shifted([rows], problem.base, problem.information, additions)
        estimate = problem.estimate.with_shifts(geometry.shifts)
        problem = replace(problem, estimate=estimate, geometry=geometry)
    return widened(problem)


# Smaller blocks are kept only as long as each night needs them.
_LASTING = 8
_BITS = 64


def merged_recordings(job: FleetJob, place: Place) -> RobotRecordings:
    """The recordings of a job.

    Raises:
        DamagedFactorsError: factor files cannot be read.
        RecordingError: they do not go together, or not with the robot.
    """
    if job.files not in place.kept:
        place.kept[job.files] = _BlockTree.of_job(job, place).recordings()
    return place.kept[job.files]


def _key(leaf: GatherResult) -> int:
    """By time, to the microsecond, then by checksum."""
    time = leaf.recorded.time
    since = time.replace(tzinfo=time.tzinfo or UTC).timestamp()
    return (round(since * 1e6) << _BITS) | int(leaf.sha256[: _BITS // 4], 16)


@dataclass(frozen=True)
class _Half:
    """Recordings `first` … `last` − 1 of all, the file of their block, and whether it is kept."""

    first: int
    last: int
    file: str
    is_kept: bool

    def __len__(self) -> int:
        return self.last - self.first


@dataclass(frozen=True, eq=False)
class _BlockTree:
    """Halves of halves of a robot's recordings; the last recording is the newest."""

    place: Place
    job: FleetJob
    leaves: tuple[GatherResult, ...]
    keys: tuple[int, ...]

    @classmethod
    def of_job(cls, job: FleetJob, place: Place) -> "_BlockTree":
        leaves = tuple(sorted(job.recordings, key=_key))
        return cls(place, job, leaves, tuple(map(_key, leaves)))

    def recordings(self) -> RobotRecordings:
        """Read, merged, and kept."""
        count = len(self.leaves)
        if count <= FEW:
            files = self._read(range(count))
            merging = self._merging([file.brief for file in files.values()])
            return merged_as(merging, [files[k] for k in range(count)], self.keys)
        halves, there = list(self._halves(0, count)), self.place.listing(self.job.blocks)
        blocks, files = dict[_Half, RecordingBlock](), dict[int, FactorFile]()
        reached, missing = 0, list[int]()
        for half in halves:
            if half.first < reached:
                continue
            block = block_of(self.place.read(half.file)) if half.file in there else None
            if block is not None:
                blocks[half], reached = block, half.last
            elif len(half) == 1:
                missing.append(half.first)
                reached = half.last
        files |= self._read(missing)
        briefs = [brief for block in blocks.values() for brief in block.briefs]
        merging = self._merging([*briefs, *(file.brief for file in files.values())])
        for half in [half for half in blocks if blocks[half].fingerprint != merging.fingerprint]:
            del blocks[half]
            files |= self._read(range(half.first, half.last))
        whole = self._merged(iter(halves), merging, blocks, files)
        for file in there.keys() - {half.file for half in halves if half.is_kept}:
            store.remove(self.place.path_to(file))
        return RobotRecordings(merging, whole)

    def _halves(self, first: int, last: int, *, of_newest: bool = True) -> Iterator[_Half]:
        """All halves, each before its own."""
        size, count = last - first, len(self.leaves)
        is_kept = size == 1 if last == count else size >= _LASTING or of_newest
        own = [(leaf.sha256, leaf.file) for leaf in self.leaves[first:last]]
        name = f"{self.job.blocks}/{digest([FORMAT, self.job.common, own])[:32]}{ENDING}"
        yield _Half(first, last, name, is_kept)
        if size > 1:
            middle = first + halved(self.keys[first:last])
            yield from self._halves(first, middle, of_newest=last == count)
            yield from self._halves(middle, last, of_newest=last == count)

    def _merged(
        self,
        halves: Iterator[_Half],
        merging: Merging,
        blocks: dict[_Half, RecordingBlock],
        files: dict[int, FactorFile],
    ) -> RecordingBlock:
        """The block of the next half; those that are made now are written."""
        half = next(halves)
        if half in blocks:
            for _ in range(2 * len(half) - 2):  # halves of its own
                next(halves)
            return blocks[half]
        if len(half) == 1:
            file = files.pop(half.first)
            part = merging.part(file)
            block = RecordingBlock.of_file(merging, file, part, self.keys[half.first])
        else:
            before = self._merged(halves, merging, blocks, files)
            block = before.joined(self._merged(halves, merging, blocks, files))
        if half.is_kept:
            self.place.write(half.file, block_bytes(block))
        return block

    def _read(self, numbers: Iterable[int]) -> dict[int, FactorFile]:
        """Factor files of some recordings."""
        files = {k: self.place.factors(self.leaves[k].file) for k in numbers}
        if damaged := [self.leaves[k].file for k, file in files.items() if file is None]:
            raise DamagedFactorsError(damaged)
        whole = {k: file for k, file in files.items() if file is not None}
        for file in whole.values():
            require_mechanism(file, self.job.description)
        return whole

    def _merging(self, briefs: Sequence[RecordingBrief]) -> Merging:
        require_together(sorted(briefs, key=lambda brief: brief.sha256))
        robot = with_laws(self.job.description, briefs, self.job.settings)
        return merging_of(briefs, robot, self.job.settings)
