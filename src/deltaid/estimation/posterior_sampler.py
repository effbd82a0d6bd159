"""Elliptical slice sampling of a normal distribution on cones, many chains at once.

From a point y inside, another one ν ~ N(0, 1) is drawn, and an angle on the ellipse
y cos θ + ν sin θ until the point there lies inside (Murray, Adams and MacKay 2010): an interval of
angles shrinks towards y, so that an end is always found, and the distribution stays as it is
exactly. On the ellipse all entries of the blocks are combinations of those of y and ν, so a trial
costs no product of matrices.

Where data would like a body to be one that cannot exist, the distribution is a thin layer at an
edge, and no ellipse across it is long; most directions meet no edge at all. So axes are turned to
those of the curvature of −Σ log det M_b. Steps along each axis that soon meets an edge, in some of
those chosen at random, in all that meet none, and in what is not alone take turns.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Float, Int

from deltaid.errors import IdentificationError
from deltaid.estimation.posterior_density import Density

# An axis has steps of its own above the first curvature, and is next to free below the second one.
_ALONE, _FREE = 0.3, 0.05
# All others take steps together in so many parts, chosen anew each time.
_PARTS = 4
# After so many steps entries are computed anew, before rounding adds up.
_ANEW = 50
# Trials on an ellipse; an interval shrinks by half in each.
_TRIALS = 200
# Chains begin where a ray from the model, so many times longer than the distribution is wide, ends
# or meets the edge.
_WIDER = 2.0

Points = Float[np.ndarray, "n chains"]
Each = Float[np.ndarray, " chains"]
Some = Int[np.ndarray, " some"]


class Chains:
    """So many chains that walk over a posterior."""

    def __init__(self, density: Density, count: int, rng: np.random.Generator) -> None:
        self.density, self.count, self.rng = density, count, rng
        self._turn, self._steps = np.eye(density.reduction.size), 0
        self._y = self._starts()
        self.turn()

    def turn(self) -> None:
        """Choose axes anew, by the middle of where chains are; before draws that count."""
        y = self.y.T
        values, vectors = np.linalg.eigh(self.density.cones.curvature(y.mean(axis=1)))
        self._turn, curvature = vectors[:, ::-1], values[::-1]
        self._near, self._middle = (int(np.sum(curvature > edge)) for edge in (_ALONE, _FREE))
        self._cones = self.density.cones.turned(self._turn)
        self._y = self._turn.T @ y
        self._entries = self._cones.slopes @ self._y
        self._log = self._factor(self._y)

    @property
    def y(self) -> Float[np.ndarray, "chains n"]:
        return (self._turn @ self._y).T

    def walk(self, rounds: int) -> None:
        n = len(self._y)
        for _ in range(rounds):
            for k in range(self._near):
                self._step(np.array([k]))
            for part in np.array_split(self.rng.permutation(self._middle), _PARTS):
                self._step(part)
            self._step(np.arange(self._middle, n))
            self._step(np.arange(self._near, n))

    def _step(self, axes: Some) -> None:
        if not axes.size:
            return
        self._steps += 1
        if self._steps % _ANEW == 0:
            self._entries = self._cones.slopes @ self._y
        old = self._y[axes]
        new = self.rng.standard_normal(old.shape)
        slopes = self._cones.slopes[:, axes]
        current, target = slopes @ old, slopes @ new
        stays = self._cones.constant[:, None] + self._entries - current
        threshold = self._log + np.log(self.rng.random(self.count))

        def accepted(angle: Each, k: Some) -> Bool[np.ndarray, " some"]:
            """Which of the chains k may go to these angles."""
            cos, sin = np.cos(angle), np.sin(angle)
            good = self._cones.hold(stays[:, k] + current[:, k] * cos + target[:, k] * sin)
            if self.density.rest is not None:
                y = self._y[:, k[good]]
                y[axes] = (old[:, k] * cos + new[:, k] * sin)[:, good]
                good[good] = self._factor(y) > threshold[k[good]]
            return good

        angle = self._angle(accepted)
        cos, sin = np.cos(angle), np.sin(angle)
        self._y[axes] = old * cos + new * sin
        self._entries += current * (cos - 1) + target * sin
        if self.density.rest is not None:
            self._log = self._factor(self._y)

    def _angle(self, accepted: Callable[[Each, Some], np.ndarray]) -> Each:
        angle = self.rng.uniform(0, 2 * np.pi, self.count)
        low, high = angle - 2 * np.pi, angle.copy()
        active = np.arange(self.count)
        for _ in range(_TRIALS):
            active = active[~accepted(angle[active], active)]
            if not active.size:
                return angle
            back = angle[active] < 0
            low[active] = np.where(back, angle[active], low[active])
            high[active] = np.where(back, high[active], angle[active])
            angle[active] = self.rng.uniform(low[active], high[active])
        angle[active] = 0.0  # rounding at the very edge: these stay where they are
        return angle

    def _factor(self, y: Points) -> Each:
        return self.density.log_factor((self._turn @ y).T)

    def _starts(self) -> Points:
        """Points inside that lie farther apart than the distribution does, about the model."""
        cones, centre = self.density.cones, _inner(self.density)
        rays = _WIDER * self.rng.standard_normal((len(centre), self.count))
        entries, along = cones.constant + cones.slopes @ centre, cones.slopes @ rays
        length = np.ones(self.count)
        for _ in range(_TRIALS):
            outside = ~cones.hold(entries[:, None] + along * length)
            if not outside.any():
                break
            length[outside] *= 0.7 * self.rng.random(outside.sum()) + 0.3
        return centre[:, None] + rays * length


def _inner(density: Density) -> Float[np.ndarray, " n"]:
    """The model, a little way towards its prior where it touches the edge."""
    cones = density.cones
    for share in (0.0, *np.geomspace(1e-9, 1.0, 19)):
        y = density.fitted + share * (density.prior - density.fitted)
        if cones.hold((cones.constant + cones.slopes @ y)[:, None])[0]:
            return y
    raise IdentificationError(
        "the model lies outside of what its own description allows",
        where="posterior",
        cure="take back what was changed in the model file by hand, or identify it again",
    )
