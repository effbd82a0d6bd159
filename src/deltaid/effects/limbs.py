"""Limbs whose bodies differ, though the description says that all share theirs."""

import numpy as np

from deltaid.effects.point import SIZE, Deviations, TracePoint, UnknownEffect
from deltaid.estimation.drive_rows import ColumnsOfDrives, from_mean, of_own_drives
from deltaid.estimation.information import active_columns
from deltaid.estimation.posterior_draws import with_own_limbs
from deltaid.estimation.reduction import Reduction, build_reduction
from deltaid.model.corrections import Correction
from deltaid.robot.description import RobotDescription


class UnlikeLimbs(UnknownEffect):
    """Deviations d_i of limb i's arm or carriage from the mean of all limbs [kg, kg m, kg m²].

    Its torque acts on its own drive alone, so of the columns Y_b of the shared body b limb i has
    the rows Y_b,i of its drive:

        τ_i = Y_i p + Y_b,i d_i,   Σ_i d_i = 0.

    A heavier strut changes torques nearly as a mass at the end of the arm does.
    """

    name = corrected_as = "limb"
    is_of_parts = False  # a hose or a valve on one arm is no error of manufacture
    is_fitted = True

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        reduction, driven = _driven(point)
        if not driven:
            return np.zeros((*point.model.shape, 0))
        shared = point.regressor @ reduction.A[active_columns(point.dynamics)][:, driven]
        limbs = len(point.dynamics.robot.identical_drives)
        own = of_own_drives(shared)[:, :, : limbs * len(driven)]
        return own @ np.kron(from_mean(limbs), np.eye(len(driven)))

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        reduction, driven = _driven(point)
        differences = columns.shape[2] // len(driven)
        return SIZE * np.tile(reduction.scale[driven], differences)

    def opened(self, robot: RobotDescription) -> RobotDescription:
        return with_own_limbs(robot).changed(measured=robot.measured, sensors=robot.sensors)

    def corrections(
        self, robot: RobotDescription, values: Deviations, half: Deviations
    ) -> tuple[Correction, ...]:
        limbs = len(robot.identical_drives)
        deviations = from_mean(limbs) @ values.reshape(limbs - 1, -1)
        shares = (deviations**2 / np.sum(deviations**2, axis=0)).sum(axis=1)
        most = f"limb {int(np.argmax(shares)) + 1}"
        text = (
            "it differs most from the others, as with a hose or valve on one arm, or a wrong part; "
            "each limb has its own bodies now"
        )
        return (Correction(kind="limb", subject=most, text=text),)


def _driven(point: TracePoint) -> tuple[Reduction, list[int]]:
    """The reduction, and numbers of the free entries of the driven body that limbs share; none
    where it was weighed, for that holds for all limbs."""
    robot = point.dynamics.robot
    reduction = build_reduction(robot, active_columns(point.dynamics))
    if len(robot.identical_drives) < 2:
        return reduction, []
    shared = robot.limb_bodies(0)
    together = {placed.body for measured in robot.measured for placed in measured.placed}
    if any(robot.bodies[name].measured or name in together for name in shared):
        return reduction, []
    variables = enumerate(reduction.variables)
    return reduction, [k for k, variable in variables if variable.owner == shared[0]]
