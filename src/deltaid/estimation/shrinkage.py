"""Least squares over groups of columns, each shrunk by its prior as far as data does not need it.

    min Σ_i ‖A_i x − b_i‖²/σ_i² + ‖D x − d‖² + Σ_g ‖x_g / (α_g s_g)‖²

over blocks of rows i, such as those of a drive, and groups of columns g with prior standard
deviations s_g. σ_i and α_g maximise the evidence (MacKay, Neural Computation 4, 1992): with the
number γ_g of well-determined directions of a group, α_g² ← (‖x_g/s_g‖² + ε) / (γ_g + 1), so a group
that data does not need vanishes. The price of a group is the increase of the minimum without it.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import cho_solve, solve_triangular
from scipy.linalg.lapack import dtrtri

from deltaid.estimation.causes import CauseColumns, NoiseBlock, WeightedBlocks
from deltaid.estimation.problem import Columns, Rows, group_sums
from deltaid.estimation.scatter import scaled_cholesky, surprise
from deltaid.levels import FAINT, LEVEL, ROUNDS

# Columns of one of several groups, whose numbers differ.
OfGroup = Float[np.ndarray, "_ _"]

# Largest scale α of a prior; with a larger one, groups with similar columns would grow against each
# other.
_HIGH = 3.0
# ε, which keeps the scale of a group without effect above zero.
_PULL = 1e-2


@dataclass(frozen=True, eq=False)
class Shrunk:
    """The minimiser with its scales of priors and noise.

    Attributes:
        rows: blocks with their levels of noise, and the prior D.
        groups: columns that are shrunk; others have only the prior D.
        alpha: scale of each group's prior.
        free: columns whose coefficients are fitted.
        held: coefficients of the other columns, and zeros.
    """

    rows: WeightedBlocks
    groups: tuple[CauseColumns, ...]
    alpha: Float[np.ndarray, " groups"]
    free: Int[np.ndarray, " free"]
    held: Float[np.ndarray, " n"]

    @classmethod
    def fitted(
        cls, blocks: Sequence[NoiseBlock], D: Columns, d: Rows, groups: Sequence[CauseColumns]
    ) -> "Shrunk":
        """The maximum of evidence, starting from scales and noise of 1."""
        n, rows = D.shape[1], WeightedBlocks(tuple(blocks), D, d, np.ones(len(blocks)))
        start = cls(rows, tuple(groups), np.ones(len(groups)), np.arange(n), np.zeros(n))
        now = start._settled()
        bounded = tuple(group.held(now.x) for group in now.groups)
        if all(
            np.all(group.deviation == held.deviation)
            for group, held in zip(groups, bounded, strict=True)
        ):
            return now
        return replace(now, groups=bounded)._settled()

    @property
    def blocks(self) -> tuple[NoiseBlock, ...]:
        return self.rows.blocks

    @property
    def sigma(self) -> Float[np.ndarray, " blocks"]:
        return self.rows.sigma

    def _settled(self, *, noise: bool = True) -> "Shrunk":
        """With scales and, unless kept, noise at their fixed point."""
        now = self
        for _ in range(ROUNDS):
            rows = replace(now.rows, sigma=now._noise) if noise else now.rows
            after = replace(now, alpha=now._scales, rows=rows)
            change = np.abs(np.log(after.alpha / now.alpha)).max(initial=0.0)
            change = max(change, float(np.abs(np.log(after.sigma / now.sigma)).max()))
            now = after
            if change < LEVEL:
                break
        return now

    @property
    def _scales(self) -> Float[np.ndarray, " groups"]:
        alpha, variance = self.alpha.copy(), np.sum(self._root**2, axis=0)
        for k, group in enumerate(self.groups):
            u = (self.x[group.columns] - group.mean) / group.deviation
            left = variance[group.columns] / (self.alpha[k] * group.deviation) ** 2
            gamma = max(len(left) - float(left.sum()), 0.0)
            alpha[k] = np.sqrt((u @ u + _PULL) / (gamma + 1.0))
        return np.minimum(alpha, _HIGH)

    @property
    def _noise(self) -> Float[np.ndarray, " blocks"]:
        noise = [block.noise(self.residual(block)) for block in self.blocks]
        return np.maximum(noise, [FAINT * block.largest for block in self.blocks])

    @property
    def noise_spread(self) -> float:
        """Standard deviation of the logarithm of white noise's level by chance, 1/√(2n) of n
        independent rows."""
        rows = sum(block.independent * block.count for block in self.blocks)
        return float(1.0 / np.sqrt(2.0 * rows))

    def residual(self, block: NoiseBlock) -> Rows:
        return block.b - block.A @ self.x

    @cached_property
    def _factor(self) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
        """L and d with diag(d) L Lᵀ diag(d) = the precision of free coefficients."""
        K, _ = self._normal
        return scaled_cholesky(K if self._all_free else K[np.ix_(self.free, self.free)])

    @property
    def _all_free(self) -> bool:
        return len(self.free) == len(self.held)

    @cached_property
    def _root(self) -> Float[np.ndarray, "free n"]:
        """W with WᵀW = the covariance of x."""
        L, size = self._factor
        root = np.zeros((len(self.free), len(self.held)))
        root[:, self.free] = dtrtri(L, lower=1)[0] / size
        return root

    @cached_property
    def _normal(self) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
        return self._with_priors(self.groups)

    def _with_priors(
        self, groups: Sequence[CauseColumns]
    ) -> tuple[Float[np.ndarray, "n n"], Float[np.ndarray, " n"]]:
        """K, r with the priors of these groups."""
        K, r = (product.copy() for product in self.rows.products)
        for group, alpha in zip(self.groups, self.alpha, strict=True):
            if group in groups:
                precision = (alpha * group.deviation) ** -2.0
                K[group.columns, group.columns] += precision
                r[group.columns] += group.mean * precision
        return K, r

    @cached_property
    def x(self) -> Float[np.ndarray, " n"]:
        K, r = self._normal
        right = r if self._all_free else r - K @ self.held
        return self.held + self._root.T @ (self._root @ right)

    @cached_property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        return self._root.T @ self._root

    def deviation(self, group: CauseColumns) -> Float[np.ndarray, " k"]:
        """Standard deviations of a group's coefficients, by scatter where that is larger."""
        return np.sqrt(np.diag(self.covariance)[group.columns]) * np.sqrt(self.level(group))

    def price(self, group: CauseColumns) -> float:
        """Increase of the minimum without a group, x_gᵀ C_gg⁻¹ x_g."""
        own = self.covariance[np.ix_(group.columns, group.columns)]
        x = self.x[group.columns] - group.mean
        return float(x @ np.linalg.solve(own, x))

    def surprise(self, group: CauseColumns) -> float:
        """Surprise of a group's price by the scatter of its rows [decades]; coefficients whose
        columns are zero, as of a drive at rest, are no freedom."""
        shown = int(np.count_nonzero(np.diag(self.rows.products[0])[group.columns]))
        return surprise(self.price(group) / self.level(group), max(shown, 1))

    def is_beyond(self, group: CauseColumns, stated: Float[np.ndarray, " k"]) -> bool:
        """Whether a group exceeds the largest scale of its prior, and of `stated` deviations."""
        x = np.abs(self.x[group.columns] - group.mean)
        is_stated = np.sqrt(np.mean(x**2)) <= _HIGH * np.sqrt(np.mean(stated**2))
        return bool(self.alpha[self.groups.index(group)] >= _HIGH and not is_stated)

    def size(self, group: CauseColumns) -> float:
        """RMS of the part of a group that only it explains, as a share of the largest value."""
        shares = [s / block.largest for s, block in zip(self.sigma, self.blocks, strict=True)]
        rows = sum(block.count for block in self.blocks)
        return float(np.sqrt(self.price(group) / rows * np.mean(np.square(shares))))

    def level(self, group: CauseColumns) -> float:
        """Variance of the noise along a group's columns by scatter between stretches, over that of
        white noise; at least 1."""
        scatter = white = 0.0
        for block, sigma in zip(self.blocks, self.sigma, strict=True):
            influence = block.A @ self.covariance[:, group.columns] / sigma
            e = self.residual(block) / sigma
            sums = group_sums(influence * e[:, None], block.stretches)
            size = np.sqrt(np.diag(self.covariance)[group.columns])
            scatter += float(np.sum((sums / size) ** 2)) * len(sums) / max(len(sums) - 1, 1)
            white += float(np.sum((influence / size) ** 2))
        return max(scatter / max(white, 1e-300), 1.0)

    def rows_of(
        self, group: CauseColumns, count: int
    ) -> tuple[Float[np.ndarray, "rows count"], Float[np.ndarray, " rows"]]:
        """Rows A x = b, in units of noise, on the first coefficients of a group, with all other
        columns projected out.

        The noise is by scatter, or by residuals if larger. The prior of the first coefficients does
        not count, that of the group's others does as stated.
        """
        own, rest = group.columns[:count], group.columns[count:]
        K, r = self._with_priors([other for other in self.groups if other is not group])
        K[rest, rest] += group.deviation[count:] ** -2.0
        r, others = r - K @ self.held, np.setdiff1d(self.free, own)
        L, size = scaled_cholesky(K[np.ix_(others, others)])
        half = solve_triangular(L, K[np.ix_(others, own)] / size[:, None], lower=True)
        right = solve_triangular(L, r[others] / size, lower=True)
        # in units of the prior, without eigenvalues below rounding
        unit = group.deviation[:count]
        S = (K[np.ix_(own, own)] - half.T @ half) * np.outer(unit, unit)
        w, V = np.linalg.eigh(S)
        w, V = w[w > FAINT], V[:, w > FAINT]
        level = max(self.level(group), self._unfitted)
        s = V.T @ ((r[own] - half.T @ right) * unit)
        return np.sqrt(w / level)[:, None] * V.T / unit, s / np.sqrt(w * level)

    @property
    def _unfitted(self) -> float:
        """Variance of the noise by residuals, Σ e² / (independent rows − degrees of freedom of the
        fit), over the assumed one."""
        square = free = 0.0
        for block, sigma in zip(self.blocks, self.sigma, strict=True):
            taken = np.sum((self._root @ block.A.T) ** 2) / sigma**2
            square += float(np.sum(self.residual(block) ** 2)) / sigma**2
            free += block.independent * block.count - float(taken)
        return square / max(free, 1.0)

    def without(self, names: Collection[str]) -> "Shrunk":
        """The same with the coefficients of some groups fixed at the means of their priors."""
        kept = [k for k, group in enumerate(self.groups) if group.name not in names]
        dropped = [group for group in self.groups if group.name in names]
        if not dropped:
            return self
        held = self.held.copy()
        for group in dropped:
            held[group.columns] = group.mean
        free = np.setdiff1d(self.free, np.concatenate([group.columns for group in dropped]))
        groups = tuple(self.groups[k] for k in kept)
        return replace(self, groups=groups, alpha=self.alpha[kept], free=free, held=held)

    def with_groups(
        self, candidates: Sequence[tuple[str, Sequence[OfGroup], Float[np.ndarray, " _"]]]
    ) -> "Shrunk":
        """The same with more candidates: name, columns for each block, deviations."""
        groups, first = list(self.groups), len(self.held)
        for name, _, deviation in candidates:
            places = np.arange(first, first + len(deviation))
            groups.append(CauseColumns(name, places, deviation, np.zeros(len(deviation))))
            first += len(deviation)
        blocks = tuple(
            replace(block, A=np.hstack([block.A, *(columns[k] for _, columns, _ in candidates)]))
            for k, block in enumerate(self.blocks)
        )
        new = np.arange(len(self.held), first)
        rows = replace(self.rows, blocks=blocks, D=np.pad(self.rows.D, ((0, 0), (0, len(new)))))
        alpha = np.append(self.alpha, np.ones(len(candidates)))
        free, held = np.append(self.free, new), np.append(self.held, np.zeros(len(new)))
        return Shrunk(rows, tuple(groups), alpha, free, held)._settled()

    def explained(
        self, numbers: Sequence[int], sets: Sequence[Float[np.ndarray, "_ sets k"]], alike: float
    ) -> tuple[Float[np.ndarray, " sets"], Float[np.ndarray, "sets k"]]:
        """Sum of squares that each set of k additional columns alone would explain of some blocks,
        in units of these blocks' mean squared residuals; and its coefficients.

        Args:
            numbers: of the blocks.
            sets: columns of all sets, for each block.
            alike: least share of a column's square that counts as independent of all others.
        """
        width, size = sets[0].shape[1:]
        own, along = np.zeros((width, size, size)), np.zeros((width, size))
        mixed, unit = np.zeros((len(self.held), width * size)), list[float]()
        for number, columns in zip(numbers, sets, strict=True):
            block, sigma = self.blocks[number], self.sigma[number]
            e, scaled = self.residual(block) / sigma, columns / sigma
            own += np.einsum("nwi,nwj->wij", scaled, scaled)
            along += np.einsum("nwi,n->wi", scaled, e)
            mixed += block.A.T @ scaled.reshape(len(e), -1) / sigma
            unit.append(max(float(e @ e) / block.count, np.finfo(float).tiny))
        others = (self._root @ mixed).reshape(-1, width, size)
        alone = np.maximum(alike * np.einsum("wii->wi", own), np.finfo(float).tiny)
        left = own - np.einsum("nwi,nwj->wij", others, others) + alone[:, :, None] * np.eye(size)
        best = np.linalg.solve(left, along[:, :, None])[:, :, 0]
        return np.einsum("wi,wi->w", along, best) / float(np.mean(unit)), best

    @cached_property
    def evidence(self) -> float:
        """Logarithm of the probability of the rows, up to a constant."""
        cost = float(np.sum((self.rows.D @ self.x - self.rows.d) ** 2))
        L, size = self._factor
        volume = 2.0 * float(np.sum(np.log(np.diag(L) * size)))
        for block, sigma in zip(self.blocks, self.sigma, strict=True):
            cost += float(np.sum(self.residual(block) ** 2)) / sigma**2
        for group, alpha in zip(self.groups, self.alpha, strict=True):
            u = (self.x[group.columns] - group.mean) / (alpha * group.deviation)
            cost += float(u @ u)
            volume += 2.0 * float(np.sum(np.log(alpha * group.deviation)))
        return -0.5 * (cost + volume)

    @property
    def candidates(self) -> tuple[str, ...]:
        return tuple(group.name for group in self.groups if group.is_candidate)

    @property
    def droppable(self) -> tuple[CauseColumns, ...]:
        """Candidates that may be dropped."""
        return tuple(group for group in self.groups if group.is_candidate and group.may_be_dropped)

    def of_candidates(self, names: Collection[str]) -> "Shrunk":
        """The same with only these candidates, at the noise that all of them leave."""
        out = [name for name in self.candidates if name not in names]
        return self.without(out)._settled(noise=False)

    def follows(self, groups: Collection[CauseColumns]) -> Float[np.ndarray, "n k"]:
        """Changes of x by errors of some groups' coefficients: one column for a standard deviation
        of each independent error."""
        columns = np.concatenate([np.zeros(0, dtype=int), *(group.columns for group in groups)])
        half, size = scaled_cholesky(self.covariance[np.ix_(columns, columns)])
        by_scatter = np.concatenate([np.zeros(0), *(self.deviation(group) for group in groups)])
        moves = cho_solve((half, True), (self.covariance[:, columns] / size).T).T
        return moves @ (half * (by_scatter / size)[:, None])

    @property
    def least_surprising(self) -> float:
        return min((self.surprise(group) for group in self.droppable), default=np.inf)
