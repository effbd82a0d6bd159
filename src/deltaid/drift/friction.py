"""Friction of each recording, with the rigid bodies of the robot's model held.

Bodies do not change from day to day, so what a day's recording has to tell is friction alone:

    τ_i − Y_i,rigid p ≈ H_i c_i + (what is held),

with H_i the columns of the drive's friction law. Held things that nobody told of, a new tool or
another gripper, act like a mass at the platform, so that mass is unknown in every recording: its
change does not pass for friction. Noise is not white, so standard deviations come from the scatter
between the recording's stretches of time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from deltaid.errors import DeltaidError
from deltaid.estimation.information import Information
from deltaid.estimation.problem import LinearProblem
from deltaid.factors.file import FactorFile
from deltaid.factors.keys import require_alike
from deltaid.factors.merged import Merging, merging_of
from deltaid.identification.load_columns import LoadColumns
from deltaid.model.record import IdentifiedModel

# What is held beside what was told: so many times what the carrier weighs, this far off its axis
# [m], as a standard deviation.
_HELD, _ARM = 0.3, 0.03
# Loads that were told are known to this share before a recording.
_TOLD = 0.3
_HELD_SYMBOLS = ("m", "mcx", "mcy", "Izz")


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What one recording is asked for.

    Attributes:
        names: friction coefficients of drives, then what is held.
        drives: of which drive's friction each is, as a number; −1 of what is held.
        at: places of the coefficients among columns of the fit, in the order of `names`.
        mean, precision: of what is known before; nothing of friction.
    """

    names: tuple[str, ...]
    drives: Int[np.ndarray, " unknowns"]
    at: Int[np.ndarray, " unknowns"]
    mean: Float[np.ndarray, " unknowns"]
    precision: Float[np.ndarray, " unknowns"]


@dataclass(frozen=True, eq=False)
class DayFriction:
    """What one recording says.

    Attributes:
        values: of the unknowns.
        covariance: of them.
        products: HᵀH of each drive's friction columns, by unknowns.
    """

    values: Float[np.ndarray, " unknowns"]
    covariance: Float[np.ndarray, "unknowns unknowns"]
    products: Float[np.ndarray, "unknowns unknowns"]


@dataclass(frozen=True, eq=False)
class FrictionSeries:
    """Friction of all recordings.

    Attributes:
        drives: names.
        unknowns: what was asked for.
        days: what each recording says.
        weights: for each drive how much each coefficient adds to its mean friction.
    """

    drives: tuple[str, ...]
    unknowns: Unknowns
    days: tuple[DayFriction, ...]
    weights: Float[np.ndarray, "drives unknowns"]

    def first(self, count: int) -> "FrictionSeries":
        """What the first recordings say alone."""
        days = self.days[:count]
        weights = _weights(self.unknowns, days, len(self.drives))
        return replace(self, days=days, weights=weights)

    @property
    def mean(self) -> Float[np.ndarray, "drives n"]:
        """Mean friction of each drive at the speeds of all recordings together [N m or N]."""
        return np.stack([self.weights @ day.values for day in self.days], axis=1)

    @property
    def std(self) -> Float[np.ndarray, "drives n"]:
        """Its standard deviation within a recording."""
        W = self.weights
        each = [np.einsum("du,uv,dv->d", W, day.covariance, W) for day in self.days]
        return np.sqrt(np.stack(each, axis=1))

    @property
    def held(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Mass beside what was told, with its standard deviation [kg]; NaN where none shows."""
        at = [k for k, name in enumerate(self.unknowns.names) if name == "held.m"]
        if not at:
            none = np.full(len(self.days), np.nan)
            return none, none
        k = at[0]
        return (
            np.array([day.values[k] for day in self.days]),
            np.sqrt([day.covariance[k, k] for day in self.days]),
        )


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
    days = tuple(_day(merging, unknowns, model, one) for one in files)
    return FrictionSeries(robot.drives, unknowns, days, _weights(unknowns, days, len(robot.drives)))


def _unknowns(merging: Merging, model: IdentifiedModel) -> Unknowns:
    robot, layout = model.robot, merging.dynamics.layout
    active = merging.active.tolist()
    rows = list[tuple[str, int, int, float, float]]()
    for term in robot.friction_terms:
        place = layout.names.index(term.name)
        if term.joint in robot.drives and place in active:
            rows.append((term.name, robot.drives.index(term.joint), active.index(place), 0.0, 0.0))
    carrier = "EE" if "EE" in layout.bodies else "P"
    if carrier in layout.bodies:
        mass = _HELD * abs(model.value(f"{carrier}.m")) + 1e-3
        sizes = mass * np.array([1.0, _ARM, _ARM, _ARM**2])
        for symbol, size in zip(_HELD_SYMBOLS, sizes.tolist(), strict=True):
            place = layout.names.index(f"{carrier}.{symbol}")
            if place in active:
                rows.append((f"held.{symbol}", -1, active.index(place), 0.0, size**-2))
    first = len(layout.names)
    for one in merging.additions:
        if isinstance(one, LoadColumns):
            known = {held.name: held for held in model.loads}.get(one.load.name)
            for k, own in enumerate(one.parameters):
                if first + k in active:
                    value = own.prior if known is None else (
                        known.parameters[k].value - float(one.taken[k]))  # fmt: skip
                    size = _TOLD * own.scale / _WIDE
                    rows.append((own.name, -1, active.index(first + k), value, size**-2))
        first += len(one.parameters)
    names, drives, at, mean, precision = zip(*rows, strict=True)
    return Unknowns(names, np.array(drives), np.array(at), np.array(mean), np.array(precision))


# By how much scales of loads' parameters are wider than the load.
_WIDE = 20.0


def _day(
    merging: Merging, unknowns: Unknowns, model: IdentifiedModel, one: FactorFile
) -> DayFriction:
    part, dof = merging.part(one), merging.dynamics.dof
    known = np.zeros(len(merging.active))
    own = merging.active < len(model.p)
    known[own] = model.p[merging.active[own]]
    bodies = unknowns.precision > 0
    held = [name.startswith("held.") for name in unknowns.names]
    known[unknowns.at[~(bodies & held)]] = 0.0
    noise = np.maximum(np.array(one.record.noise), 1e-12)
    count = np.maximum(part.information.samples[:dof], 1.0)
    seen = (unknowns.drives == np.arange(dof)[:, None]) | (unknowns.drives < 0)

    def rows(given: Information) -> tuple[np.ndarray, np.ndarray]:
        """Rows of one stretch over the unknowns, and what is left of its torques."""
        F = given.factors / noise[:, None, None]
        X = F[:, :, unknowns.at] * seen[:, None, :]
        left = F[:, :, -1] - F[:, :, :-1] @ known
        return X.reshape(-1, X.shape[2]), left.ravel()

    stretches = [rows(stretch) for stretch in part.stretches]
    groups = np.repeat(np.arange(len(stretches)), [len(b) for _, b in stretches])
    measured = LinearProblem(
        np.vstack([A for A, _ in stretches]),
        np.concatenate([b for _, b in stretches]),
        groups,
        values=float(part.information.samples.sum()),
    )
    size = np.sqrt(unknowns.precision[bodies])
    D = np.eye(len(bodies))[bodies] * size[:, None]
    problem = measured.with_known(D, size * unknowns.mean[bodies])
    own = part.information.factors[:, :, unknowns.at] * (seen & ~bodies)[:, None, :]
    products = np.einsum("inu,inv,i->uv", own, own, 1.0 / count)
    # What has one stretch only tells nothing of its noise.
    covariance = problem.covariance() if len(stretches) > 1 else np.full(D.shape[1:] * 2, np.nan)
    return DayFriction(problem.x, covariance, products)


def _weights(
    unknowns: Unknowns, days: Sequence[DayFriction], drives: int
) -> Float[np.ndarray, "drives unknowns"]:
    """How coefficients make up a drive's mean friction, mean of sign(v) φ(v) over all samples."""
    G = np.sum([day.products for day in days], axis=0)
    W = np.zeros((drives, len(unknowns.at)))
    for i in range(drives):
        sign = np.array(
            [unknowns.drives[k] == i and name.startswith(("coulomb.", "coulomb_back."))
             for k, name in enumerate(unknowns.names)]
        ).astype(float)  # fmt: skip
        size = sign @ G @ sign
        if size > 0:
            W[i] = np.where(unknowns.drives == i, G @ sign, 0.0) / size
    return W
