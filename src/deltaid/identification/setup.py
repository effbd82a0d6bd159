"""`Setup`, the value that stages take and return until a fit is posed, and `ContestOutcome`, the
result of the contest of causes in it."""

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

Coefficients = Float[np.ndarray, " _"]  # of one effect
# Key of the doubt that no known effect explains what acts on the robot, so nothing is corrected.
REFUTED = "refuted"


@dataclass(frozen=True, eq=False)
class ContestOutcome:
    """The result of a contest.

    Attributes:
        described: the robot as described.
        kept: names of the effects that the rows need.
        values, deviations: coefficients of effects that are applied exactly.
        recordings: checksums of the recordings that took part, in the order of the coefficients
            that each recording has of its own.
        moves: changes of the robot's parameters, by name, by one standard deviation of an effect,
            or by a rival in its place.
        inseparable: pairs of causes that the rows do not separate.
        doubts: sentences, by effect, about coefficients beyond their limits.
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
        """Coefficients by which readings of the recordings have been corrected."""
        robot = [unknown.name for unknown in UNKNOWNS if unknown.corrects == "robot"]
        return {name: values for name, values in self.values.items() if name not in robot}

    def within_limits(self) -> "ContestOutcome":
        """With doubts in place of effects beyond their limits."""
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
        return REFUTED in self.doubts

    @property
    def winds_up(self) -> bool:
        """Whether the rows need compliant gears beside all other effects."""
        return WIND_UP in self.values

    def coefficients(self, name: str) -> tuple[float, ...]:
        """Coefficients of an effect; none if it is not applied."""
        return tuple(self.values.get(name, np.zeros(0)).tolist())


@dataclass(frozen=True, eq=False)
class Setup:
    """A fit that is about to be posed.

    Attributes:
        robot: the description, with the friction laws chosen so far.
        recordings: each with its filter and its corrections.
        additions: extra columns of the fit.
        corrections: in the order in which they were made.
        undetected: changes of parameters, by name, by a constant that drives may share.
        barred, barred_effects: friction terms and effects that a fit has put at zero; they are not
            chosen again.
        studies: of each recording before undeclared causes are corrected; empty at first.
        detected: studies that detected undeclared loads, by the loads' names; None for loads of
            whole recordings, which no study of one recording shows.
        outcome: of the contest of causes.
    """

    robot: RobotDescription
    recordings: tuple[PreparedRecording, ...]
    settings: Settings
    additions: tuple[Addition, ...] = ()
    corrections: tuple[Correction, ...] = ()
    friction_choice: FrictionChoice | None = None
    undetected: Mapping[str, float] = field(default_factory=dict[str, float])
    barred: frozenset[JointTerm] = frozenset()
    barred_effects: frozenset[str] = frozenset()
    studies: tuple[Study | None, ...] = ()
    detected: Mapping[str, Study | None] = field(default_factory=dict[str, Study | None])
    outcome: ContestOutcome | None = None

    @property
    def disturbed(self) -> tuple[bool, ...]:
        """In which recordings an undeclared load comes and goes."""
        studies = self.studies or (None,) * len(self.recordings)
        return tuple(study is not None and study.is_disturbed for study in studies)

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
        """With another description; additions are rebuilt for its columns."""
        additions = tuple(addition.on(compiled(robot)) for addition in self.additions)
        return self.changed(robot=robot, additions=additions)

    def repaired(self, recording: PreparedRecording, **repairs: Any) -> "Setup":
        """With one more correction of a recording, by fields of `Repairs`."""
        k = next(k for k, other in enumerate(self.recordings) if other is recording)
        return self.with_recording(k, recording.repaired(**repairs))

    def all_repaired(self, **repairs: Any) -> "Setup":
        return self.changed(recordings=tuple(r.repaired(**repairs) for r in self.recordings))

    def with_recording(self, k: int, recording: PreparedRecording) -> "Setup":
        before, after = self.recordings[:k], self.recordings[k + 1 :]
        return self.changed(recordings=(*before, recording, *after))

    def reported(self, corrections: Sequence[Correction], *instead_of: Kind) -> "Setup":
        """With more corrections, which replace earlier ones of the kinds `instead_of`."""
        kept = (correction for correction in self.corrections if correction.kind not in instead_of)
        return self.changed(corrections=(*kept, *corrections))


# A step towards a fit: it detects, corrects and reports one kind of cause.
Stage = Callable[[Setup, Progress], Setup]
