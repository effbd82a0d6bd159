"""Base parameters (Sec. IV A): the combinations of parameters that torques determine.

The rank is that of the regressor's factor, its columns scaled to unit length. Representatives are
chosen in a fixed order (platform first), and each other column is written as a combination of them:
Y p = Y_B (p_B) with p_B = p_rep + K p_rest.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.errors import IdentificationError
from deltaid.estimation.information import Information
from deltaid.estimation.problem import Span
from deltaid.levels import NEGLIGIBLE, ROUNDING
from deltaid.robot.parameter import ADDED
from deltaid.shown import Shown

# Independent share of its length below which an addition's column is not identifiable.
_HARDLY = 1e-5
# Order in which bodies become representatives.
_PREFERENCE = ("P", "SB", "MP", "HP", "EE", "MB", "R", "U", "C", "TL", "TU", "S")


@dataclass(frozen=True)
class BaseGroup:
    """One base parameter: a representative plus multiples of other parameters."""

    representative: int
    members: dict[int, float]

    def formula(self, layout: ParameterLayout) -> str:
        """The group as a formula, equal coefficients factored: 'm_P + m_EE + 6·(m_S − …)'."""
        by_size: dict[float, list[tuple[str, bool]]] = {}
        for member, coefficient in self.members.items():
            size = abs(coefficient)
            key = next((k for k in by_size if np.isclose(k, size, rtol=1e-6)), size)
            label = layout.parameters[member].label
            by_size.setdefault(key, []).append((label, coefficient < 0))
        text = layout.parameters[self.representative].label
        for size, ((names, negative), *others) in by_size.items():
            for label, is_negative in others:
                names += f" {'+' if is_negative == negative else '−'} {label}"
            number = f"{size:.6g}"
            if others and (number != "1" or negative):
                names = f"({names})"
            times = "" if number == "1" else f"{number}·"
            text += f" {'−' if negative else '+'} {times}{names}"
        return text


@dataclass(frozen=True, repr=False)
class BaseParameters(Shown):
    """The identifiable combinations of a robot's parameters."""

    layout: ParameterLayout
    groups: tuple[BaseGroup, ...]  # one for each base parameter
    invisible: tuple[int, ...]  # parameters that no torque depends on
    condition: float  # of the base regressor, columns scaled to unit length

    @property
    def rank(self) -> int:
        return len(self.groups)

    @property
    def formulas(self) -> tuple[str, ...]:
        return tuple(group.formula(self.layout) for group in self.groups)

    def combination(self) -> Float[np.ndarray, "base parameters"]:
        """The matrix that takes p to the base parameters."""
        K = np.zeros((self.rank, len(self.layout.names)))
        for row, group in zip(K, self.groups, strict=True):
            row[group.representative] = 1.0
            row[list(group.members)] = list(group.members.values())
        return K

    @property
    def representatives(self) -> list[int]:
        return [group.representative for group in self.groups]

    def values(self, p: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " base"]:
        """The base parameters of p; zero where terms cancel up to rounding."""
        terms = self.combination() * p
        values, sizes = terms.sum(axis=1), np.abs(terms).sum(axis=1)
        return np.where(np.abs(values) > ROUNDING * sizes, values, 0.0)


def base_parameters(information: Information, layout: ParameterLayout) -> BaseParameters:
    """The base parameters that some motion determines.

    Raises:
        IdentificationError: the rank is not the number of representatives, for the motion hardly
            excites some parameter.
    """
    Y = information.weighted(np.ones(len(information.factors)))[:, :-1]
    if information.facts is not None:
        Y = np.vstack([Y, information.facts[:, :-1]])
    norms = np.linalg.norm(Y, axis=0)
    shown = norms > NEGLIGIBLE * norms.max()
    columns, norms, scaled = information.columns[shown], norms[shown], Y[:, shown] / norms[shown]
    is_robots = columns < len(layout.names) - layout.added
    rank = Span.of_columns(scaled[:, is_robots]).rank
    chosen = _representatives(scaled, columns, layout)
    of_robot = int(np.sum(is_robots[chosen]))
    if of_robot != rank:
        raise IdentificationError(
            f"the motion determines between {min(rank, of_robot)} and "
            f"{max(rank, of_robot)} parameters; it hardly excites some of them",
            cure="record a motion that uses all drives and more of the workspace",
        )
    others = np.setdiff1d(np.arange(len(columns)), chosen)
    K, *_ = np.linalg.lstsq(scaled[:, chosen], scaled[:, others], rcond=None)
    # A coefficient counts by its effect on torques, so in scaled columns.
    counts, K = np.abs(K) > NEGLIGIBLE, K * norms[others] / norms[chosen, None]
    order = np.argsort(chosen)
    groups = (
        BaseGroup(
            int(columns[chosen[k]]),
            dict(zip(columns[others[counted]].tolist(), row[counted].tolist(), strict=True)),
        )
        for k, counted, row in zip(order, counts[order], K[order], strict=True)
    )
    return BaseParameters(
        layout=layout,
        groups=tuple(groups),
        invisible=tuple(np.setdiff1d(np.arange(len(layout.names)), columns).tolist()),
        condition=float(np.linalg.cond(scaled[:, chosen])),
    )


def _representatives(
    scaled: Float[np.ndarray, "rows shown"], columns: np.ndarray, layout: ParameterLayout
) -> list[int]:
    """Columns, in the preferred order, that do not depend on those taken before."""
    parameters = [layout.parameters[column] for column in columns]

    def preference(k: int) -> tuple[int, bool, int]:
        parameter = parameters[k]
        if parameter.kind in ADDED:
            return len(_PREFERENCE) + 1, False, int(columns[k])
        body = parameter.owner.rstrip("0123456789")  # of limbs with inertia of their own
        known = parameter.kind == "inertia" and body in _PREFERENCE
        rank = _PREFERENCE.index(body) if known else len(_PREFERENCE)
        # Moments of inertia first: a strut's first moment then reads as mass at its ends.
        return rank, parameter.symbol in ("m", "mcx", "mcy", "mcz"), int(columns[k])

    basis, chosen = np.zeros((len(scaled), 0)), list[int]()
    for k in sorted(range(scaled.shape[1]), key=preference):
        rest = scaled[:, k]
        for _ in range(2):  # twice, so that rounding leaves it orthogonal
            rest = rest - basis @ (basis.T @ rest)
        length = np.linalg.norm(rest)
        if length > (_HARDLY if parameters[k].kind in ADDED else NEGLIGIBLE):
            basis = np.column_stack([basis, rest / length])
            chosen.append(k)
    return chosen
