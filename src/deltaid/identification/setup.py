"""What a fit is posed from: a robot, its recordings as far as they are corrected, and why; and what
a contest of causes came to, for the stages after it and for the model."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.effects.all import UNKNOWNS
from deltaid.estimation.additions import Addition
from deltaid.identification.study import Study, studied
from deltaid.model.corrections import Correction, Inseparable, Kind
from deltaid.model.parameter_record import FrictionChoice, JointTerm
from deltaid.model.record import Settings
from deltaid.progress import Progress
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.description import RobotDescription

WIND_UP = "compliance"

Coefficients = Float[np.ndarray, " _"]  # of each effect as many as it has
# Key of the doubt that no known effect explains what acts on the robot.
UNEXPLAINED = "unexplained"


@dataclass(frozen=True, eq=False)
class ContestOutcome:
    """What won a contest.

    Attributes:
        described: the robot as it is described.
        kept: names of effects.
        values, deviations: of those that are applied exactly.
        recordings: checksums of those that took part, in whose order values of each stand.
        moves: what parameters of the robot, by name, move by where these are off as they may be,
            or where another cause takes the place of one of them: one standard deviation each.
        inseparable: causes that rows do not separate.
        doubts: sentences, by effect, on what is beyond all that a description may be off by.
    """

    described: RobotDescription
    kept: tuple[str, ...] = ()
    values: dict[str, Coefficients] = field(default_factory=dict[str, Coefficients])
    deviations: dict[str, Coefficients] = field(default_factory=dict[str, Coefficients])
    recordings: tuple[str, ...] = ()
    moves: tuple[dict[str, float], ...] = ()
    inseparable: tuple[Inseparable, ...] = ()
    doubts: dict[str, str] = field(default_factory=dict[str, str])

    @property
    def read(self) -> dict[str, Coefficients]:
        """Those that recordings have been corrected by."""
        robot = [unknown.name for unknown in UNKNOWNS if unknown.corrects == "robot"]
        return {name: values for name, values in self.values.items() if name not in robot}

    def within_limits(self) -> "ContestOutcome":
        """Without effects that are beyond their limits, and with doubts in their place."""
        beyond = {
            unknown.name: unknown.doubt(self.values[unknown.name])
            for unknown in UNKNOWNS
            if unknown.name in self.values
            and np.linalg.norm(self.values[unknown.name]) > unknown.limit
        }
        values = {name: value for name, value in self.values.items() if name not in beyond}
        kept = tuple(name for name in self.kept if name not in beyond)
        return replace(self, kept=kept, values=values, doubts=self.doubts | beyond)

    @property
    def is_refuted(self) -> bool:
        return UNEXPLAINED in self.doubts

    @property
    def winds_up(self) -> bool:
        """Whether rows need gears that wind up beside all else."""
        return WIND_UP in self.values

    def coefficients(self, name: str) -> tuple[float, ...]:
        """Coefficients of an effect; none if it is not applied."""
        return tuple(self.values.get(name, np.zeros(0)).tolist())


@dataclass(frozen=True, eq=False)
class Setup:
    """A fit that is about to be posed."""

    robot: RobotDescription  # the description, with the friction laws that have been chosen so far
    recordings: tuple[
        PreparedRecording, ...
    ]  # each with its filter and what has been corrected in it
    settings: Settings
    additions: tuple[Addition, ...] = ()  # extra columns
    corrections: tuple[Correction, ...] = ()  # in the order in which they were made
    friction_choice: FrictionChoice | None = None
    # terms of friction and effects that are not chosen, for a fit has put them at zero
    barred: frozenset[JointTerm] = frozenset()
    barred_effects: frozenset[str] = frozenset()
    # whether every row of recordings is inspected for events; else excerpts are first
    closely: bool = False
    # numbers of the recordings of which nothing but an excerpt was inspected for events
    glanced: tuple[int, ...] = ()
    # what each recording looks like before anything in it is corrected that was not declared; none
    # before they have been studied
    studies: tuple[Study | None, ...] = ()
    # by the names of loads that no mapping declares, the studies that detected them
    detected: Mapping[str, Study] = field(default_factory=dict[str, Study])
    outcome: ContestOutcome | None = None  # of the contest of causes

    def is_disturbed(self, k: int) -> bool:
        """Whether an undeclared load comes and goes in the k-th recording."""
        study = self.studies[k] if self.studies else None
        return study is not None and study.is_disturbed

    def studied(self) -> "Setup":
        corrected = tuple(addition for addition in self.additions if addition.is_corrected)
        studies = (studied(self.dynamics, r, beside=corrected) for r in self.recordings)
        return self.changed(studies=tuple(studies))

    @property
    def dynamics(self) -> Dynamics:
        return compiled(self.robot)

    def changed(self, **values: Any) -> "Setup":
        return replace(self, **values)

    def without(self, *kinds: type[Addition]) -> "Setup":
        kept = tuple(addition for addition in self.additions if not isinstance(addition, kinds))
        return self.changed(additions=kept)

    def with_robot(self, robot: RobotDescription) -> "Setup":
        """The same for a description with other friction laws, additions beside its columns."""
        additions = tuple(addition.on(compiled(robot)) for addition in self.additions)
        return self.changed(robot=robot, additions=additions)

    def repaired(self, recording: PreparedRecording, **repairs: Any) -> "Setup":
        """The same with one more thing corrected in a recording, by fields of `Repairs`."""
        k = next(k for k, other in enumerate(self.recordings) if other is recording)
        return self.with_recording(k, recording.repaired(**repairs))

    def all_repaired(self, **repairs: Any) -> "Setup":
        return self.changed(recordings=tuple(r.repaired(**repairs) for r in self.recordings))

    def with_recording(self, k: int, recording: PreparedRecording) -> "Setup":
        before, after = self.recordings[:k], self.recordings[k + 1 :]
        return self.changed(recordings=(*before, recording, *after))

    def reported(self, corrections: Sequence[Correction], *instead_of: Kind) -> "Setup":
        """The same with more corrections, in the place of all earlier ones of some kinds."""
        kept = (correction for correction in self.corrections if correction.kind not in instead_of)
        return self.changed(corrections=(*kept, *corrections))


# One step towards a fit: what it detects, it corrects and reports.
Stage = Callable[[Setup, Progress], Setup]
