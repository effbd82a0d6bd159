"""Friction of each recording, with the rigid bodies of the robot's model held.

Bodies do not change from day to day, so a day's recording determines friction alone:

    τ_i − Y_i,rigid p ≈ H_i c_i + (what is held),

with H_i the columns of the drive's friction law. Undeclared loads, a new tool or another gripper,
act like a mass at the platform, so that mass is unknown in every recording and its change is not
taken for friction. Noise is not white, so standard deviations come from the scatter between the
recording's stretches of time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from deltaid.effects.load_columns import LoadColumns
from deltaid.errors import DeltaidError
from deltaid.estimation.problem import LinearProblem
from deltaid.fleets.factor_file import FactorFile, require_alike
from deltaid.fleets.merged import Merging, merging_of
from deltaid.model.record import IdentifiedModel

# Undeclared load, as a standard deviation: share of the carrier's mass, distance off its axis [m].
_HELD, _ARM = 0.3, 0.03
_HELD_SYMBOLS = {"m": 1.0, "mcx": _ARM, "mcy": _ARM, "Izz": _ARM**2}
# Prior spread of declared loads as a share; by how much scales of their parameters are wider.
_TOLD, _WIDE = 0.3, 20.0


@dataclass(frozen=True, eq=False)
class FrictionUnknowns:
    """Unknowns of one recording.

    Attributes:
        names: friction coefficients of drives, then what is held.
        drives: of which drive's friction each is, as a number; −1 of what is held.
        at: places of the coefficients among columns of the fit, in the order of `names`.
        mean, precision: of the prior; none of friction.
    """

    names: tuple[str, ...]
    drives: Int[np.ndarray, " unknowns"]
    at: Int[np.ndarray, " unknowns"]
    mean: Float[np.ndarray, " unknowns"]
    precision: Float[np.ndarray, " unknowns"]


@dataclass(frozen=True, eq=False)
class FrictionSeries:
    """Friction of all recordings.

    Attributes:
        drives: names.
        values, covariance: of the unknowns in each recording.
        products: HᵀH of each drive's friction columns.
    """

    drives: tuple[str, ...]
    unknowns: FrictionUnknowns
    values: Float[np.ndarray, "n unknowns"]
    covariance: Float[np.ndarray, "n unknowns unknowns"]
    products: Float[np.ndarray, "n unknowns unknowns"]

    @cached_property
    def weights(self) -> Float[np.ndarray, "drives unknowns"]:
        """How much each coefficient adds to a drive's mean friction, the mean of sign(v) φ(v) over
        all samples."""
        own = self.unknowns.drives == np.arange(len(self.drives))[:, None]
        names = self.unknowns.names
        sign = own & [name.startswith(("coulomb.", "coulomb_back.")) for name in names]
        products = sign @ self.products.sum(axis=0)
        size = np.sum(products * sign, axis=1, keepdims=True)
        return np.where(own & (size > 0), products, 0.0) / np.where(size > 0, size, 1.0)

    @property
    def mean(self) -> Float[np.ndarray, "drives n"]:
        """Mean friction of each drive at the speeds of all recordings together [N m or N]."""
        return self.weights @ self.values.T

    @property
    def std(self) -> Float[np.ndarray, "drives n"]:
        """Its standard deviation within a recording."""
        return np.sqrt(np.einsum("du,nuv,dv->dn", self.weights, self.covariance, self.weights))

    @property
    def held(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Undeclared mass with its standard deviation [kg]; NaN if unobservable."""
        if "held.m" not in self.unknowns.names:
            none = np.full(len(self.values), np.nan)
            return none, none
        k = self.unknowns.names.index("held.m")
        return self.values[:, k], np.sqrt(self.covariance[:, k, k])


def friction_series(files: Sequence[FactorFile], model: IdentifiedModel) -> FrictionSeries:
    """Friction of each recording.

    Args:
        files: of one robot, each recording once.
        model: of the robot by all of them, or by those that it is compared with.

    Raises:
        RecordingError: files do not go together, or not with the model.
        DeltaidError: the robot has no friction in its drives.
    """
    robot = model.robot
    require_alike(files, robot)
    if not any(drive in robot.friction for drive in robot.drives):
        raise DeltaidError(
            "has no friction in its drives, so none of it can change",
            where=robot.name,
            cure="describe friction of the drives",
        )
    merging = merging_of(files, robot, model.settings)
    unknowns = _unknowns(merging, model)
    estimates = (_friction(merging, unknowns, model, file) for file in files)
    arrays = (np.stack(array) for array in zip(*estimates, strict=True))
    return FrictionSeries(robot.drives, unknowns, *arrays)


def _unknowns(merging: Merging, model: IdentifiedModel) -> FrictionUnknowns:
    robot, layout = model.robot, merging.dynamics.layout
    place = {k: column for column, k in enumerate(merging.active.tolist())}
    rows = list[tuple[str, int, int, float, float]]()
    for term in robot.friction_terms:
        k = layout.names.index(term.name)
        if term.joint in robot.drives and k in place:
            rows.append((term.name, robot.drives.index(term.joint), place[k], 0.0, 0.0))
    carrier = "EE" if "EE" in layout.bodies else "P"
    if carrier in layout.bodies:
        mass = _HELD * abs(model.value(f"{carrier}.m")) + 1e-3
        for symbol, arm in _HELD_SYMBOLS.items():
            k = layout.names.index(f"{carrier}.{symbol}")
            if k in place:
                rows.append((f"held.{symbol}", -1, place[k], 0.0, (mass * arm) ** -2))
    first, loads = len(layout.names), {load.name: load.parameters for load in model.loads}
    for held_load in merging.additions:
        if isinstance(held_load, LoadColumns):
            known = loads.get(held_load.load.name)
            for k, entry in enumerate(held_load.parameters):
                if first + k in place:
                    mean = known[k].value - float(held_load.taken[k]) if known else entry.prior
                    size = _TOLD * entry.scale / _WIDE
                    rows.append((entry.name, -1, place[first + k], mean, size**-2))
        first += len(held_load.parameters)
    names, drives, at, mean, precision = zip(*rows, strict=True)
    return FrictionUnknowns(
        names, np.array(drives), np.array(at), np.array(mean), np.array(precision)
    )


def _friction(
    merging: Merging, unknowns: FrictionUnknowns, model: IdentifiedModel, file: FactorFile
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, covariance and products of one recording."""
    part, dof, at = merging.part(file), merging.dynamics.dof, unknowns.at
    fixed = np.zeros(len(merging.active))
    of_robot = merging.active < len(model.p)
    fixed[of_robot] = model.p[merging.active[of_robot]]
    is_more = np.array([name.startswith("held.") for name in unknowns.names])
    fixed[at[~is_more]] = 0.0
    noise = np.maximum(np.array(file.record.noise), 1e-12)[:, None, None]
    is_friction = unknowns.drives == np.arange(dof)[:, None]
    visible = (is_friction | (unknowns.drives < 0))[:, None, :]
    stretches = part.stretches
    F = np.stack([stretch.factors for stretch in stretches]) / noise
    b = (F[..., -1] - F[..., :-1] @ fixed).reshape(len(F), -1)
    A = (F[..., at] * visible).reshape(b.size, -1)
    groups = np.repeat(np.arange(len(F)), b.shape[1])
    values = float(sum(stretch.samples.sum() for stretch in stretches))
    measured = LinearProblem(A, b.ravel(), groups, values=values)
    bodies = unknowns.precision > 0
    size = np.sqrt(unknowns.precision[bodies])
    estimate = measured.with_known(
        np.diag(np.sqrt(unknowns.precision))[bodies], size * unknowns.mean[bodies]
    )
    H = part.information.factors[:, :, at] * is_friction[:, None, :]
    count = np.maximum(part.information.samples[:dof], 1.0)
    # A single stretch does not determine its noise.
    several = len(stretches) > 1
    covariance = estimate.covariance() if several else np.full((len(at), len(at)), np.nan)
    return estimate.x, covariance, np.einsum("inu,inv,i->uv", H, H, 1.0 / count)
