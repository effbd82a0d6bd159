"""What takes part in the contest of causes: effects with unknown coefficients, among them those
that stages of their own correct, so that in the contest nothing else explains them."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from deltaid.effects.point import TracePoint
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.model.corrections import Correction, Kind
from deltaid.robot.description import RobotDescription

# What nobody described makes some such share of a drive's torque, before any recording [rms].
SIZE = 0.05

Deviations = Float[np.ndarray, " coefficients"]


class UnknownEffect(ABC):
    """An effect in the contest."""

    name: str  # of the effect
    # standard deviation of each coefficient before any recording, where it is the same for all; 0
    # if not
    deviation: ClassVar[float] = 0.0
    # kind, unit, text: of the corrections of each subject, whose unit is that of the drive's
    # coordinate if not given; no text where other stages say what was corrected
    kind: ClassVar[Kind]
    unit: ClassVar[str] = ""
    text: ClassVar[str] = ""
    # whether it is named and corrected where rows need it; else it only keeps others from
    # explaining what it may be, and stages of their own correct it
    is_candidate: ClassVar[bool] = True
    is_positive: ClassVar[bool] = False  # whether its coefficients are at least zero by physics
    # whether parts are made and mounted within a few times its deviation
    is_of_parts: ClassVar[bool] = True
    is_own: ClassVar[bool] = False  # whether each recording has its own
    # what its coefficients are applied to exactly: readings of the drives, the robot, or nothing
    # where they stay columns of a fit or stages of their own estimate them
    corrects: ClassVar[Literal["readings", "robot", ""]] = ""
    # whether the fit estimates it anew, as parameters of the robot
    is_fitted: ClassVar[bool] = False
    # size of all coefficients together above which the description is wrong, or something else
    # looks like it: that is said and not corrected
    limit: ClassVar[float] = np.inf

    @abstractmethod
    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        """Slopes of the torques by its coefficients."""

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        """Standard deviations of its coefficients before any recording; where nothing is known
        those that make `SIZE` of the drives' largest torques."""
        if self.deviation:
            return np.full(columns.shape[2], self.deviation)
        own = np.sqrt(np.mean((columns / point.largest[:, None, None]) ** 2, axis=(0, 1)))
        return SIZE / np.maximum(own, np.finfo(float).tiny ** 0.5)

    def stated(self, robot: RobotDescription) -> Deviations:
        """Standard deviations that parts may have besides, as a description states them; one zero
        where it has none."""
        return np.zeros(1)

    def is_possible(self, values: Deviations) -> bool:
        """Whether physics allows such coefficients; others stand for another cause."""
        return True

    def possible(self, values: Deviations) -> Deviations:
        return np.maximum(values, 0.0) if self.is_positive else values

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        """What was corrected, for coefficients and half widths of their 95 % intervals."""
        if not self.text:
            return ()
        scale = 100.0 if self.unit == "%" else 1.0
        sizes = (scale * np.stack([values, half], axis=1)).tolist()
        return tuple(
            Correction(kind=self.kind, subject=subject, value=value, low=value - wide,
                       high=value + wide, unit=self.unit or robot.units(subject).coordinate,
                       text=self.text)
            for subject, (value, wide) in zip(self.subjects(robot), sizes, strict=True)
        )  # fmt: skip

    def subjects(self, robot: RobotDescription) -> Sequence[str]:
        """Whose coefficients these are: the drives', if not said otherwise."""
        return robot.drives

    def doubt(self, values: Deviations) -> str:
        """A sentence on what is beyond the limit: what torques look like, the likeliest cause, and
        what to do."""
        return ""


class Beside(UnknownEffect):
    """An effect that stages of their own correct; in the contest it keeps others from explaining
    what it may be."""

    is_candidate = False


class Added(UnknownEffect):
    """An effect whose columns are an addition to the fit."""

    def __init__(self, name: str, addition: Addition) -> None:
        self.name, self.addition = name, addition

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        return point.added(self.addition)
