"""Fitting and judging friction laws on folds of a recording, from triangular factors alone."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from deltaid.dynamics.dynamics import Parameters, compiled
from deltaid.dynamics.friction_dictionary import FrictionDictionary
from deltaid.identification.base_parameters import base_parameters
from deltaid.identification.gathering import gather
from deltaid.identification.information import Information, merge, triangle
from deltaid.recording.recording import Recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction, FrictionTerm

FOLDS = 10

Laws = Mapping[str, Friction]
_Key = tuple[str, str, float, float]


@dataclass(frozen=True)
class Fold:
    """Factors of W^½ [Y_rigid, Y_friction, τ] without a stretch of the recordings, and of it."""

    train: Float[np.ndarray, "columns columns"]
    test: Float[np.ndarray, "columns columns"]


@dataclass(frozen=True)
class FrictionSearch:
    """Recordings prepared for trying friction laws.

    Columns of all factors: rigid-body representatives (free), then the friction columns, then τ.

    Attributes:
        folds: for cross-validation.
        whole: the factor of everything.
        rigid: number of rigid-body columns.
        place: where the column of each friction term stands among the friction columns.
        rows: number of torque values behind the whole.
    """

    folds: tuple[Fold, ...]
    whole: Float[np.ndarray, "columns columns"]
    rigid: int
    place: dict[_Key, int]
    rows: float

    def combination(self, laws: Laws, robot: RobotDescription) -> Float[np.ndarray, "columns k"]:
        """Friction columns as combinations of those here, one for each positive coefficient.

        An offset, which may have either sign, takes two; a law for each direction has the column
        for forward motion as difference of both ways and backwards.
        """
        terms = robot.changed(friction=dict(laws)).friction_terms
        columns = []
        for term in terms:
            column = np.zeros(len(self.place))
            column[self.place[term_key(term)]] = 1.0
            if term.one_sided:
                column[self.place[f"{term.kind}_back", term.joint, 1.0, 1.0]] = -1.0
            columns.append(column)
            if term.signed:
                columns.append(-column)
        return np.column_stack(columns)

    def fit(
        self, factor: Float[np.ndarray, "columns columns"], G: Float[np.ndarray, "friction k"]
    ) -> tuple[Float[np.ndarray, " columns"], float]:
        """The best [−p; 1] for a factor, and the squared error it leaves of the friction rows.

        min ‖R_ff G c − r_f‖ over c ≥ 0 (non-negative least squares) after the rigid-body columns
        have been projected out by the triangular form.
        """
        n = self.rigid
        A, b = factor[n:, n:-1] @ G, factor[n:, -1]
        norms = np.linalg.norm(A, axis=0)
        norms[norms == 0] = 1.0
        c, left = nnls(A / norms, b, maxiter=20 * A.shape[1])
        friction = G @ (c / norms)
        right = factor[:n, -1] - factor[:n, n:-1] @ friction
        rigid = solve_triangular(factor[:n, :n], right)
        return np.concatenate([-rigid, -friction, [1.0]]), float(left**2)

    def errors(
        self, options: Iterable[Float[np.ndarray, "friction k"]]
    ) -> Float[np.ndarray, " folds"]:
        """Squared error on each fold of the law that fits the rest best among some options."""
        options, result = tuple(options), []
        for fold in self.folds:
            fits = [self.fit(fold.train, G) for G in options]
            best, _ = min(fits, key=lambda one: one[1])
            result.append(float(np.sum((fold.test @ best) ** 2)))
        return np.array(result)

    def best(self, options: Sequence[Float[np.ndarray, "friction k"]]) -> int:
        """Which option fits everything best."""
        return int(np.argmin([self.fit(self.whole, G)[1] for G in options]))


def prepare(
    robot: RobotDescription,
    recordings: Sequence[Recording],
    terms: Sequence[FrictionTerm],
    load: Parameters,
) -> FrictionSearch:
    """One pass over recordings for a robot with viscous and Coulomb friction and further terms.

    Args:
        load: parameters of `robot` that predict the torques for terms that depend on load.

    Raises:
        IdentificationError: the motion does not determine the rigid-body parameters.
    """
    dynamics = compiled(robot)
    dictionary = FrictionDictionary(dynamics, tuple(terms))
    blocks = [block for one in recordings for block in gather(dictionary, one, load=load)]
    together = merge(blocks)
    layout, own = dynamics.layout, dictionary.own_columns
    base = base_parameters(_first_columns(together, own), layout)
    rigid = [
        g.representative
        for g in base.groups
        if not layout.friction.start <= g.representative < layout.friction.stop
    ]
    friction = [*range(layout.friction.start, layout.friction.stop)]
    friction += range(own, own + len(terms))
    at = [*(np.searchsorted(together.columns, rigid + friction)), len(together.columns)]
    weights = together.drive_weights
    factors = [triangle(block.weighted(weights)[:, at]) for block in blocks]
    size = len(at)

    def joined(parts: Iterable[int]) -> Float[np.ndarray, "columns columns"]:
        stacked = np.vstack([np.zeros((size, size)), *(factors[i] for i in parts)])
        return triangle(stacked)

    count = len(blocks)
    stretch = (
        np.arange(count) * min(FOLDS, count) // count
    )  # the fold that each block is left out of
    folds = tuple(
        Fold(
            train=joined(i for i in range(count) if stretch[i] != k),
            test=joined(i for i in range(count) if stretch[i] == k),
        )
        for k in range(min(FOLDS, count))
    )
    keys = [term_key(term) for term in (*robot.friction_terms, *terms)]
    return FrictionSearch(
        folds=folds,
        whole=joined(range(count)),
        rigid=len(rigid),
        place={key: k for k, key in enumerate(keys)},
        rows=together.rows,
    )


def first_look(
    robot: RobotDescription, recordings: Sequence[Recording]
) -> tuple[dict[str, float], Parameters]:
    """Speed of each friction joint [rad/s or m/s], and parameters that predict the torques.

    The speed is a root mean square weighted with ∂ϑ̇/∂q̇: the viscous column is the Coulomb column
    times |ϑ̇|, so their sizes tell.
    """
    dynamics = compiled(robot)
    information = merge([block for one in recordings for block in gather(dynamics, one)])
    factor = information.weighted(information.drive_weights)
    p = np.zeros(len(dynamics.layout.names))
    p[information.columns], *_ = np.linalg.lstsq(factor[:, :-1], factor[:, -1])
    norms = np.sqrt(np.sum(information.factors**2, axis=(0, 1)))
    viscous, coulomb = (
        norms[np.searchsorted(information.columns, range(len(p))[part])]
        for part in (dynamics.layout.viscous, dynamics.layout.coulomb)
    )
    speed = np.maximum(viscous / np.maximum(coulomb, 1e-300), 1e-6)
    speeds = dict(zip(robot.friction_joints, speed.tolist(), strict=True))
    return speeds, p


def _first_columns(information: Information, own: int) -> Information:
    """The same information about a robot's own columns only."""
    kept = np.flatnonzero(information.columns < own)
    return Information(
        columns=information.columns[kept],
        factors=np.stack([triangle(F[:, [*kept, -1]]) for F in information.factors]),
        samples=information.samples,
        torque_max=information.torque_max,
    )


def term_key(term: FrictionTerm) -> _Key:
    """What tells a term's column from all others."""
    return term.kind, term.joint, term.exponent, term.speed
