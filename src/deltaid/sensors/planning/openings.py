"""What stays open, by what there is: torques, what is described, each use, all that is bought."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deltaid.dynamics.dynamics import Dynamics
from deltaid.mechanism.platform import with_turned_half
from deltaid.sensors.planning.exchange import exchanges
from deltaid.sensors.planning.joints import instances
from deltaid.sensors.planning.motion import PlannedMotion
from deltaid.sensors.planning.null_space import NullSpace, null_space, whole_null_space
from deltaid.sensors.planning.rows import Extended
from deltaid.sensors.planning.uses import Use

# Poses that tell which points bodies share.
_POSES = 40

TORQUES, DESCRIBED, PLAN = "torques", "described", "plan"


@dataclass(frozen=True, eq=False)
class Opening:
    """What some rows leave open.

    Attributes:
        name: 'torques', 'described', of a use, 'plan'.
        title: in words.
        null: what they do not tell.
        parted: for each of its directions the uses after which it is told, each by itself.
    """

    name: str
    title: str
    null: NullSpace
    parted: tuple[tuple[str, ...], ...]


def openings(
    dynamics: Dynamics,
    motion: PlannedMotion,
    torque: Extended,
    described: Extended,
    uses: Sequence[Use],
    bought: Sequence[Use],
) -> tuple[Opening, ...]:
    """For torques alone, with what is described, with each use besides, and with all bought."""
    layout = dynamics.layout
    n = len(layout.parameters)
    mechanism = with_turned_half(dynamics.kinematics.mechanism)
    step = max(1, len(motion.z) // _POSES)
    proposed = exchanges(dynamics.robot, layout, instances(mechanism, motion.z[::step]))
    known = np.vstack([torque, described])
    wholes = {
        one.name: whole_null_space(np.vstack([known, one.sure])[:, :n], layout) for one in uses
    }

    def of(name: str, title: str, rows: Extended) -> Opening:
        null = null_space(rows[:, :n], layout, proposed)
        parted = tuple(
            tuple(key for key, basis in wholes.items() if not one.stays(null, basis))
            for one in null.directions
        )
        return Opening(name, title, null, parted)

    found = [of(TORQUES, "torques alone", torque)]
    if len(described):
        found.append(of(DESCRIBED, "with what the description has", known))
    found += [of(one.name, one.title, np.vstack([known, one.sure])) for one in uses]
    if bought:
        every = np.vstack([known, *(one.sure for one in bought)])
        found.append(of(PLAN, "with all that is bought", every))
    return tuple(found)
