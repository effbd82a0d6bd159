"""The recordings of a robot together, and the fit to them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from deltaid.estimation.information import Information
from deltaid.fleets.block import RecordingBlock, halved
from deltaid.fleets.factor_file import FactorFile, require_alike
from deltaid.fleets.friction_laws import with_laws
from deltaid.fleets.merged import Merging, merging_of, ordered
from deltaid.fleets.recording_brief import RecordingBrief
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
