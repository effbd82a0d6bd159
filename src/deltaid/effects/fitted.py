"""Effects that take torques beside the robot, with the coefficients of a fit."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.effects.at_drives import AtDrives, DriveSpring, RippleColumns
from deltaid.effects.at_platform import FORCES, AtPlatform
from deltaid.estimation.additions import Addition, of_each, torques_of
from deltaid.model.effect_record import FittedEffect
from deltaid.model.parameter_record import Parameter as Judged

InTask = Float[np.ndarray, "samples dof"]


@dataclass(frozen=True, eq=False)
class Fitted:
    """An effect with its coefficients; a `recording.burden.Pull`."""

    addition: AtPlatform | AtDrives
    values: tuple[float, ...]

    def torques(self, z: InTask, qd: InTask) -> InTask:
        entries = self.addition.of_motion(z, qd)
        return torques_of(self.addition.pattern, qd.shape[1], entries, np.array(self.values)).T

    @property
    def record(self) -> FittedEffect:
        addition = self.addition
        if isinstance(addition, AtPlatform):
            return FittedEffect(name=addition.name, values=self.values, fastest=addition.fastest)
        names = addition.dynamics.robot.drives
        orders = addition.orders if isinstance(addition, RippleColumns) else ()
        drives = tuple(names[i] for i in addition.drives)
        return FittedEffect(name=addition.name, values=self.values, drives=drives, orders=orders)


def fitted_effects(additions: Iterable[Addition], judged: Sequence[Judged]) -> tuple[Fitted, ...]:
    """Those among the additions of a fit, by what it judged of all their parameters."""
    return tuple(
        Fitted(addition, tuple(entry.value for entry in own))
        for addition, own in of_each(tuple(additions), judged)
        if isinstance(addition, AtPlatform | AtDrives)
    )


def as_fitted(dynamics: Dynamics, record: FittedEffect) -> Fitted:
    """An effect of a model file."""
    names, deviation = dynamics.robot.drives, (1.0,) * len(record.values)
    drives = tuple(names.index(drive) for drive in record.drives)
    if record.name == RippleColumns.name:
        return Fitted(RippleColumns(dynamics, drives, deviation, record.orders), record.values)
    if record.name == DriveSpring.name:
        return Fitted(DriveSpring(dynamics, drives, deviation), record.values)
    force = next(force for force in FORCES if force.name == record.name)
    return Fitted(force(dynamics, deviation, record.fastest), record.values)
