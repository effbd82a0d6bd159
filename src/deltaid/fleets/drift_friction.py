"""Friction of each recording, with fixed rigid bodies of the robot's model.

Bodies do not change from day to day, so a recording only has to determine friction:

    τ_i − Y_i,rigid p ≈ H_i c_i + (loads),

with H_i the columns of the drive's friction law. Undeclared loads, such as a new tool or gripper,
act like a mass at the platform, so this mass is unknown in every recording and its change is not
mistaken for friction. Noise is not white, so standard deviations come from the scatter between the
recording's stretches of time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, reduce

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.effects.load_columns import WIDE, LoadColumns
from deltaid.errors import DeltaidError
from deltaid.estimation.information import triangle
from deltaid.estimation.problem import LinearProblem, Span
from deltaid.fleets.factor_file import FactorFile, require_alike
from deltaid.fleets.merged import MergedPart, Merging, merging_of
from deltaid.model.record import IdentifiedModel
from deltaid.robot.parameter import PriorParameter

# Standard deviation of an undeclared load: share of the carrier's mass, distance off its axis [m].
_HELD, _ARM = 0.3, 0.03
_HELD_SYMBOLS = {"m": 1.0, "mcx": _ARM, "mcy": _ARM, "Izz": _ARM**2}
# Relative prior spread of declared loads.
_DECLARED = 0.3

# Prior mean and precision.
Prior = tuple[float, float]


@dataclass(frozen=True, eq=False)
class FrictionUnknowns:
    """Unknowns of one recording.

    Attributes:
        names: friction coefficients of drives, then entries of loads.
        drives: index of each coefficient's drive; −1 for loads.
        units: of friction coefficients; empty for loads.
        at: indices of the unknowns among columns of the fit, in the order of `names`.
    """

    names: tuple[str, ...]
    drives: Int[np.ndarray, " unknowns"]
    units: tuple[str, ...]
    at: Int[np.ndarray, " unknowns"]

    @cached_property
    def is_carrier(self) -> Bool[np.ndarray, " unknowns"]:
        """Mask of unknowns that change the body at the platform, whose parameters are fixed."""
        return np.array([name.startswith("held.") for name in self.names])


@dataclass(frozen=True, eq=False)
class FrictionSums:
    """Sums of recordings that give friction for any rigid bodies, as rows of unit noise.

    With bodies c over independent columns, a recording's unknowns x have the rows
    R x = b − F (c − c₀), with c₀ the recording's own fit.

    Attributes:
        root, cross, offset, reference: R, F, b, c₀.
        scores: sums over stretches of g gᵀ, g = Aᵀe by columns A of the unknowns and residual e.
        level: variance of white noise from the residual; NaN for a single stretch, which does not
            determine its noise.
        scale: variance of each drive's noise over its number of samples.
    """

    root: Float[np.ndarray, "n unknowns unknowns"]
    cross: Float[np.ndarray, "n unknowns columns"]
    offset: Float[np.ndarray, "n unknowns"]
    reference: Float[np.ndarray, "n columns"]
    scores: Float[np.ndarray, "n unknowns unknowns"]
    level: Float[np.ndarray, " n"]
    scale: Float[np.ndarray, "n drives"]

    def joined(self, other: "FrictionSums") -> "FrictionSums":
        pairs = ([getattr(sums, entry.name) for sums in (self, other)] for entry in fields(self))
        return FrictionSums(*map(np.concatenate, pairs))

    def only(self, places: Int[np.ndarray, " some"]) -> "FrictionSums":
        return FrictionSums(*(getattr(self, entry.name)[places] for entry in fields(self)))


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
        """Weight of each coefficient in a drive's mean friction, the mean of sign(v) φ(v) over all
        samples."""
        of_drive = self.unknowns.drives == np.arange(len(self.drives))[:, None]
        names = self.unknowns.names
        sign = of_drive & [name.startswith(("coulomb.", "coulomb_back.")) for name in names]
        products = sign @ self.products.sum(axis=0)
        size = np.sum(products * sign, axis=1, keepdims=True)
        return np.where(of_drive & (size > 0), products, 0.0) / np.where(size > 0, size, 1.0)

    @property
    def mean(self) -> Float[np.ndarray, "drives n"]:
        """Mean friction of each drive at the speeds of all recordings together [N m or N]."""
        return self.weights @ self.values.T

    @property
    def std(self) -> Float[np.ndarray, "drives n"]:
        """Standard deviation of `mean` within a recording [N m or N]."""
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
        model: of the robot from all of them, or from the recordings to compare with.

    Raises:
        RecordingError: files do not match each other or the model.
        DeltaidError: the robot has no friction in its drives.
    """
    require_alike(files, model.robot)
    merging = merging_of([file.brief for file in files], model.robot, model.settings)
    each = (friction_sums(merging, merging.part(file)) for file in files)
    return series_of(reduce(FrictionSums.joined, each), merging, model)


def series_of(sums: FrictionSums, merging: Merging, model: IdentifiedModel) -> FrictionSeries:
    """Friction of each recording with the bodies of a model, by the merging's friction laws.

    Raises:
        DeltaidError: the robot has no friction in its drives.
    """
    robot = model.robot
    if not any(drive in robot.friction for drive in robot.drives):
        raise DeltaidError(
            "has no friction in its drives, so none of it can change",
            where=robot.name,
            cure="describe friction of the drives",
        )
    unknowns, active = unknowns_of(merging), merging.active
    mean, precision = _prior(merging, unknowns, model)
    fixed = np.zeros(len(active))
    of_robot = active < len(model.p)
    fixed[of_robot] = model.p[active[of_robot]]
    fixed[unknowns.at[~unknowns.is_carrier]] = 0.0
    c = merging.independent.combinations @ fixed
    b = sums.offset - np.einsum("nuc,nc->nu", sums.cross.astype(float), c - sums.reference)
    D = np.diag(np.sqrt(precision))[precision > 0]
    measured = np.zeros(sums.root.shape[1], dtype=int)
    problems = [
        LinearProblem(R, right, measured).with_known(D, D @ mean)
        for R, right in zip(sums.root, b, strict=True)
    ]
    x = np.stack([problem.x for problem in problems])
    W = np.stack([problem.inverse @ problem.inverse.T for problem in problems])
    products = sums.root.swapaxes(1, 2) @ sums.root
    covariance = W @ sums.scores.astype(float) @ W
    white = np.einsum("nuv,nvw,nwu->nu", W, products, W) * sums.level[:, None]
    variance = np.einsum("nuu->nu", covariance)
    grown = np.sqrt(np.maximum(white / np.maximum(variance, 1e-300), 1.0))
    covariance = covariance * grown[:, :, None] * grown[:, None, :] + W @ np.diag(precision) @ W
    same = (unknowns.drives[:, None] == unknowns.drives) & (unknowns.drives >= 0)
    scale = np.where(unknowns.drives >= 0, sums.scale[:, unknowns.drives], 0.0)
    return FrictionSeries(
        robot.drives, unknowns, x, covariance, np.where(same, products * scale[:, None], 0.0)
    )


def unknowns_of(merging: Merging) -> FrictionUnknowns:
    """Unknowns of a recording: friction of drives, the carrier's change, and loads."""
    robot, layout = merging.dynamics.robot, merging.dynamics.layout
    place = {k: column for column, k in enumerate(merging.active.tolist())}
    every = [
        (term.name, robot.drives.index(term.joint), term.unit, layout.names.index(term.name))
        for term in robot.friction_terms
        if term.joint in robot.drives
    ]
    every += [
        (f"held.{symbol}", -1, "", layout.names.index(f"{robot.load_carrier}.{symbol}"))
        for symbol in (_HELD_SYMBOLS if robot.load_carrier else ())
    ]
    every += [(entry.name, -1, "", k) for *_, k, entry in _of_loads(merging)]
    rows = [(*row, place[k]) for *row, k in every if k in place]
    names, drives, units, at = zip(*rows, strict=True) if rows else ((), (), (), ())
    return FrictionUnknowns(names, np.array(drives, dtype=int), units, np.array(at, dtype=int))


def _of_loads(merging: Merging) -> Iterator[tuple[LoadColumns, int, int, PriorParameter]]:
    """Parameters of loads, with their indices in the load and in the layout."""
    first = len(merging.dynamics.layout.names)
    for added in merging.additions:
        if isinstance(added, LoadColumns):
            yield from ((added, k, first + k, entry) for k, entry in enumerate(added.parameters))
        first += len(added.parameters)


def _prior(
    merging: Merging, unknowns: FrictionUnknowns, model: IdentifiedModel
) -> tuple[Float[np.ndarray, " unknowns"], Float[np.ndarray, " unknowns"]]:
    """Prior mean and precision of loads; zero precision for friction."""
    known, priors = {load.name: load.parameters for load in model.loads}, dict[str, Prior]()
    if carrier := merging.dynamics.robot.load_carrier:
        mass = _HELD * abs(model.value(f"{carrier}.m")) + 1e-3
        priors |= {
            f"held.{symbol}": (0.0, (mass * arm) ** -2) for symbol, arm in _HELD_SYMBOLS.items()
        }
    for load, k, _, entry in _of_loads(merging):
        identified = known.get(load.load.name)
        mean = identified[k].value - float(load.taken[k]) if identified else entry.prior
        priors[entry.name] = (mean, (_DECLARED * entry.scale / WIDE) ** -2)
    mean, precision = zip(*(priors.get(name, (0.0, 0.0)) for name in unknowns.names), strict=True)
    return np.array(mean), np.array(precision)


def friction_sums(merging: Merging, part: MergedPart) -> FrictionSums:
    """Sums of one recording, from its part of a fit."""
    unknowns, independent = unknowns_of(merging), merging.independent.at
    noise = np.maximum(np.array(part.file.record.noise), 1e-12)
    is_friction = unknowns.drives == np.arange(len(noise))[:, None]
    visible = (is_friction | (unknowns.drives < 0))[:, None, :]
    count = len(unknowns.at)

    def columns(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Columns of unknowns, independent ones, and torques, of all drives together."""
        F = rows / noise[:, None, None]
        A = (F[..., unknowns.at] * visible).reshape(*F.shape[:-3], -1, count)
        shape = (*F.shape[:-3], A.shape[-2])
        return A, F[..., independent].reshape(*shape, -1), F[..., -1].reshape(shape)

    A, F, b = columns(part.information.factors)
    fitted = Span.of_columns(F)
    c = fitted.coefficients(b)
    is_fixed = np.isin(independent, unknowns.at[~unknowns.is_carrier], invert=True)
    reference = np.where(is_fixed, c, 0.0)
    R = triangle(np.pad(np.column_stack([A, F, b]), ((0, count), (0, 0))))[:count]
    root, cross = R[:, :count], R[:, count:-1]
    groups = part.file.groups.named("time")
    A_g, F_g, b_g = columns(part.rows(groups))
    e = b_g - F_g @ c
    g, several = np.einsum("gru,gr->gu", A_g, e), len(groups) > 1
    freedom = max(float(groups.samples.sum()) - fitted.rank, 1.0)
    arrays = (
        root,
        cross.astype(np.float32),
        R[:, -1] - cross @ reference,
        reference,
        (g.T @ g * (len(g) / max(len(g) - 1, 1))).astype(np.float32),
        np.array(float(np.sum(e**2)) / freedom if several else np.nan),
        noise**2 / np.maximum(part.information.samples[: len(noise)], 1.0),
    )
    return FrictionSums(*(array[None] for array in arrays))
