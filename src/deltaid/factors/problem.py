"""A fit from factor files alone."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.factors.columns import GatheredColumns, LagsByName, plain
from deltaid.factors.file import FactorFile
from deltaid.factors.merged import Merging, geometric, merged
from deltaid.identification.additions import Addition
from deltaid.identification.balance import balanced
from deltaid.identification.fit import FittedProblem, fit_to, widened
from deltaid.identification.friction_curves import LawConstants
from deltaid.identification.geometry import shifted
from deltaid.identification.load_columns import LoadColumns
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
    dynamics = compiled(robot)
    additions = _additions(files, robot)
    merging = Merging(columns_of(files, robot), dynamics, additions)
    facts = weighings(robot)
    gathered = balanced(merged(merging, files), facts)
    problem = fit_to(gathered, dynamics, settings, additions)
    drives = np.sqrt(problem.information.drive_weights)
    rows = [geometric(merging, one, drives) for one in files if one.condensed.geometry is not None]
    if rows:
        found = shifted(rows, problem.base, problem.information, additions)
        estimate = problem.estimate.with_shifts(found.shifts)
        problem = replace(problem, estimate=estimate, geometry=found)
    return widened(problem)


def columns_of(files: Sequence[FactorFile], robot: RobotDescription) -> GatheredColumns:
    """The columns that files were gathered with, loads of all of them."""
    simple = plain(robot)
    dynamics = compiled(simple)
    own = GatheredColumns.of(robot, prior_parameters(simple), _loads(files, robot))
    return replace(own, additions=(*own.additions, LagsByName(dynamics)))


def _additions(files: Sequence[FactorFile], robot: RobotDescription) -> tuple[Addition, ...]:
    """Loads, and changes of the laws' constants."""
    constants = LawConstants(compiled(robot))
    return (*_loads(files, robot), *([constants] if constants.parameters else []))


def _loads(files: Sequence[FactorFile], robot: RobotDescription) -> tuple[LoadColumns, ...]:
    """One of each name."""
    found: dict[str, LoadColumns] = {}
    for one in files:
        for load in one.record.loads:
            spread = one.record.model.settings.prior_spread
            taken = np.array(load.taken)
            found.setdefault(load.load.name, LoadColumns(compiled(robot), load.load, spread, taken))
    return tuple(found.values())
