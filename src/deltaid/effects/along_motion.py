"""Torques that a description lacks and that follow from the robot's motion alone.

They are columns of the fit, at single drives (`at_drives.py`) or of a force at the platform
(`at_platform.py`); a model keeps their coefficients.
"""

from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from deltaid.estimation.additions import Addition, Own, Values, split_by_addition, torques_of
from deltaid.model.corrections import Correction, FittedEffect, Kind
from deltaid.model.parameter_record import Parameter
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PRIOR_SPREAD, PriorParameter

WITHOUT = "the model excludes it"

InTask = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True, eq=False)
class AlongMotion(Addition):
    """Torques of a robot that are linear in their coefficients."""

    drives: tuple[int, ...]  # that they act on; empty for a force at the platform
    deviation: tuple[float, ...]  # prior standard deviation of each coefficient, drive by drive
    # of ripples, n of each drive [1/rad or 1/m]; see the effects that have others
    orders: tuple[float, ...] = ()
    fastest: float = 0.0  # largest speed of the platform [m/s]

    is_corrected = True
    looks_like_events: ClassVar[bool] = False  # as brief as a push
    kind: ClassVar[Kind]
    name: ClassVar[str]
    symbols: ClassVar[tuple[str, ...]]

    @property
    @abstractmethod
    def coefficients(self) -> Iterable[tuple[str, str, str, float]]:
        """Owner, symbol, unit and prior standard deviation of each; their means are zero."""

    @abstractmethod
    def of_motion(self, z: InTask, qd: InTask, qdd: InTask) -> Values:
        """Entries along a motion."""

    @property
    def owners(self) -> tuple[str, ...]:
        return tuple(self.dynamics.robot.drives[i] for i in self.drives)

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return tuple(
            PriorParameter("effect", owner, symbol, unit, -np.inf, np.inf, 0.0, size / PRIOR_SPREAD)
            for owner, symbol, unit, size in self.coefficients
        )

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        return self.of_motion(w.z, w.qd, w.qdd)

    def record(self, values: tuple[float, ...]) -> FittedEffect:
        return FittedEffect(name=self.name, values=values, drives=self.owners, orders=self.orders,
                            fastest=self.fastest)  # fmt: skip

    def correction(
        self, subject: str, value: float, judged: Iterable[Parameter], unit: str, text: str
    ) -> Correction:
        """A correction of this size, as wide as the widest interval of some coefficients."""
        half = widest(judged)
        return Correction(kind=self.kind, subject=subject, value=value, low=value - half,
                          high=value + half, unit=unit, text=f"{text}; {WITHOUT}")  # fmt: skip


@dataclass(frozen=True, eq=False)
class FittedTorques:
    """An effect with its coefficients; a `recording.repairs.Pull`."""

    addition: AlongMotion
    values: tuple[float, ...]

    def torques(self, z: InTask, qd: InTask, qdd: InTask) -> InTask:
        entries = self.addition.of_motion(z, qd, qdd)
        return torques_of(self.addition.pattern, qd.shape[1], entries, np.array(self.values)).T


def widest(judged: Iterable[Parameter]) -> float:
    """Half the width of the widest interval of some coefficients."""
    ends = [(x.low, x.high) for x in judged if x.low is not None and x.high is not None]
    return max(((high - low) / 2 for low, high in ends), default=0.0)


def fitted_effects(
    additions: Iterable[Addition], judged: Sequence[Parameter]
) -> tuple[FittedTorques, ...]:
    """Effects among the additions of a fit, with the values of its judged parameters."""
    return tuple(
        FittedTorques(addition, tuple(entry.value for entry in parameters))
        for addition, parameters in split_by_addition(tuple(additions), judged)
        if isinstance(addition, AlongMotion)
    )
