"""Bodies that are not as symmetric as `free` says: entries that it leaves out."""

from typing import get_args

import numpy as np

from deltaid.effects.point import Point
from deltaid.effects.unknown import SIZE, Deviations, Unknown
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.estimation.information import active_columns
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.model.corrections import Correction
from deltaid.robot.body import Entry
from deltaid.robot.description import RobotDescription


class Structure(Unknown):
    """First moments and products of bodies that a description takes to be zero [kg m, kg m²].

    A centre that is off by a share of a body's length, or an axis that is turned by as much, makes
    this share of m ℓ and m ℓ².
    """

    name = "structure"
    is_fitted = True

    def columns(self, point: Point) -> ColumnsOfDrives:
        reduction, left_out = _left_out(point)
        Y = point.trace.regressor()
        active = active_columns(point.dynamics)
        return Y @ reduction.A[active][:, left_out]

    def deviations(self, point: Point, columns: ColumnsOfDrives) -> Deviations:
        reduction, left_out = _left_out(point)
        return SIZE * reduction.scale[left_out]

    def names(self, point: Point) -> tuple[str, ...]:
        """Of the entries, such as U.mcy."""
        reduction, left_out = _left_out(point)
        return tuple(reduction.names[k] for k in left_out)

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        text = (
            "bodies are less symmetric than their descriptions say: entries that `free` leaves out "
            "are estimated too"
        )
        return (Correction(kind="structure", text=text),)


def opened(robot: RobotDescription) -> RobotDescription:
    """With all ten entries free of each body that is not known."""
    bodies = {
        name: body.model_copy(update={"free": get_args(Entry)}) if body.free else body
        for name, body in robot.bodies.items()
    }
    return robot.model_copy(update={"bodies": bodies})


def _left_out(point: Point) -> tuple[Reduction, np.ndarray]:
    """The reduction of a robot with all entries, and which of them are zero in the description."""
    active, robot = active_columns(point.dynamics), point.dynamics.robot
    full, own = build_reduction(opened(robot), active), build_reduction(robot, active)
    off_diagonal = ("mc", "Sxy", "Syz", "Sxz")
    return full, np.array(
        [
            k for k, variable in enumerate(full.variables)
            if variable.name not in own.names and variable.symbol.startswith(off_diagonal)
        ],
        dtype=int,
    )  # fmt: skip
