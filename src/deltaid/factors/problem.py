"""A fit from factor files alone."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.additions import Addition
from deltaid.factors.columns import GatheredColumns, plain
from deltaid.factors.file import FactorFile
from deltaid.factors.merged import Merging, merged
from deltaid.identification.balance import balanced
from deltaid.identification.fit import FittedProblem, fit_to, widened
from deltaid.identification.friction_curves import LawConstants
from deltaid.identification.geometry import shifted
from deltaid.identification.load_columns import LoadColumns
from deltaid.identification.loads import Held, joined
from deltaid.model.record import Settings
from deltaid.robot.description import RobotDescription
from deltaid.sensors.weighings import weighings


def fitted(
    files: Sequence[FactorFile], robot: RobotDescription, settings: Settings
) -> FittedProblem:
    """The fit of a robot to recordings by their factors.

    Args:
        files: of recordings of the same robot.
        robot: with the friction laws that are to be fitted.
        settings: method, regulariser, γ, prior's spread.

    Raises:
        IdentificationError: the fit cannot be posed, or its solver did not reach its end.
    """
    merging = merging_of(files, robot, settings)
    gathered = balanced(merged(merging, files), weighings(robot))
    problem = fit_to(gathered, merging.dynamics, settings, merging.additions)
    drives = np.sqrt(problem.information.drive_weights)
    rows = [merging.geometry(one, drives) for one in files if one.condensed.geometry is not None]
    if rows:
        found = shifted(rows, problem.base, problem.information, merging.additions)
        estimate = problem.estimate.with_shifts(found.shifts)
        problem = replace(problem, estimate=estimate, geometry=found)
    return widened(problem)


def merging_of(files: Sequence[FactorFile], robot: RobotDescription, settings: Settings) -> Merging:
    """How files become rows of a robot's fit, with loads of all of them and changes of the laws'
    constants."""
    dynamics, simple = compiled(robot), plain(robot)
    loads, constants = _loads(files, robot, settings), LawConstants(dynamics)
    columns = GatheredColumns.of(robot, prior_parameters(simple), loads)
    more: tuple[Addition, ...] = (constants,) if constants.parameters else ()
    return Merging(columns, dynamics, (*loads, *more))


def _loads(
    files: Sequence[FactorFile], robot: RobotDescription, settings: Settings
) -> tuple[LoadColumns, ...]:
    """One of each name."""
    ordered = sorted(files, key=lambda one: one.record.sha256)
    taken = {x.load.name: x.taken for one in reversed(ordered) for x in one.record.loads}
    dynamics, spread = compiled(robot), settings.prior_spread
    return tuple(
        LoadColumns(dynamics, load, spread, np.array(taken[load.name]))
        for load in joined(holding(ordered))
    )


def holding(files: Sequence[FactorFile]) -> Held:
    """What the recordings of files hold."""
    return [(one.record.log, [held.load for held in one.record.loads]) for one in files]
