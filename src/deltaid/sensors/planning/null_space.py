"""Null space of rows: every direction of p that no row determines, with a name.

Candidate directions have a physical meaning: mass that passes from one body to another at a shared
point (and moments along a shared axis), second moments that pass between bodies with the same
rotation, a rotor against the inertia that it turns. Candidates in the null space of the rows are
named; the remaining directions are named by their entries. `openings` does so for torques, for the
described measurements, for each use, and for all purchases.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import ParameterLayout
from deltaid.levels import FAINT, NEGLIGIBLE
from deltaid.sensors.planning.exchange import Exchange, eliminate, exchanges, instances
from deltaid.sensors.planning.rows import Extended, PlannedMotion
from deltaid.sensors.planning.uses import Use

Direction = Float[np.ndarray, " parameters"]


@dataclass(frozen=True, eq=False)
class Open:
    """One direction of p that rows do not determine.

    Attributes:
        words: its meaning: 'mass at the elbow's joints may pass between upper arm and strut'.
        entries: names of the parameters that it changes.
        direction: of p, zero at entries that no row depends on.
    """

    words: str
    entries: tuple[str, ...]
    direction: Direction = field(repr=False)

    def stays(self, null: "NullSpace", other: "NullSpace") -> bool:
        """Whether other rows do not determine it either, whatever else changes with it.

        Args:
            null: its null space; entries that its rows do not depend on may change.
        """
        basis, d = other.basis[null.is_visible], (self.direction / null.scale)[null.is_visible]
        rest = d - basis @ np.linalg.lstsq(basis, d, rcond=FAINT)[0]
        return bool(np.linalg.norm(rest) < FAINT * np.linalg.norm(d))


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Directions of p that rows do not determine, and their rank.

    Attributes:
        rank: number of determined combinations of parameters.
        directions: a basis of the undetermined ones among visible parameters, visible − rank of
            them.
        invisible: parameters that no row depends on.
        is_visible: which parameters are visible.
        scale: sizes of all parameters.
        basis: of the whole null space, invisible parameters included, in units of the scales.
    """

    rank: int
    directions: tuple[Open, ...]
    invisible: tuple[str, ...]
    is_visible: Bool[np.ndarray, " parameters"] = field(repr=False)
    scale: Float[np.ndarray, " parameters"] = field(repr=False)
    basis: Float[np.ndarray, "parameters dimension"] = field(repr=False)

    @property
    def visible(self) -> int:
        return int(self.is_visible.sum())


def null_space(
    rows: Float[np.ndarray, "rows parameters"],
    layout: ParameterLayout,
    exchanges: Sequence[Exchange],
) -> NullSpace:
    """Null space of rows over p, with names for its directions."""
    scale = np.array([parameter.scale for parameter in layout.parameters])
    norms = np.linalg.norm(rows * scale, axis=0)
    is_visible = norms > NEGLIGIBLE * norms.max(initial=0.0)
    to_p = scale[is_visible] / norms[is_visible]
    unit = rows[:, is_visible] * to_p
    _, S, Vt = np.linalg.svd(unit)
    rank = int(np.sum(NEGLIGIBLE * S[0] < S))
    chosen, basis = list[Open](), np.zeros((len(to_p), 0))
    for exchange in (*exchanges, *_together(unit, to_p, is_visible, exchanges)):
        d = exchange.direction[is_visible] / to_p
        length = np.linalg.norm(d)
        if length == 0 or np.linalg.norm(unit @ d) > FAINT * length:
            continue
        rest = d / length
        for _ in range(2):  # the second pass makes it orthogonal to rounding
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > FAINT:
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            chosen.append(_open(exchange.words, exchange.direction, is_visible, layout))
    named = [free.direction[is_visible] / to_p for free in chosen]
    left = _remaining(Vt[rank:], np.array(named).reshape(-1, len(to_p)))
    each = np.eye(len(scale))
    chosen += [_open("", each[:, is_visible] @ (d * to_p), is_visible, layout) for d in left]
    whole = np.hstack(
        [each[:, is_visible] @ (Vt[rank:].T / norms[is_visible, None]), each[:, ~is_visible]]
    )
    invisible = tuple(np.array(layout.names)[~is_visible].tolist())
    return NullSpace(rank, tuple(chosen), invisible, is_visible, scale, whole)


def _together(
    unit: Float[np.ndarray, "rows visible"],
    to_p: Float[np.ndarray, " visible"],
    is_visible: Bool[np.ndarray, " parameters"],
    exchanges: Sequence[Exchange],
) -> Iterator[Exchange]:
    """Pairs of determined exchanges in the ratio that makes their sum undetermined."""
    open_ = list[tuple[Exchange, np.ndarray, float]]()
    for exchange in exchanges:
        d = exchange.direction[is_visible] / to_p
        length = float(np.linalg.norm(d))
        if length > 0 and np.linalg.norm(unit @ d) > FAINT * length:
            open_.append((exchange, unit @ d / length, length))
    for (exchange, a, long), (other, b, wide) in combinations(open_, 2):
        share = float(a @ b) / float(b @ b)
        if np.linalg.norm(a - share * b) > FAINT * np.linalg.norm(a):
            continue
        direction = exchange.direction / long - share * other.direction / wide
        yield Exchange(f"{exchange.words} together with: {other.words}", direction)


def _open(
    words: str,
    direction: Direction,
    is_visible: Bool[np.ndarray, " parameters"],
    layout: ParameterLayout,
) -> Open:
    d = np.where(is_visible, direction, 0.0)
    share = np.abs(d) / np.array([parameter.scale for parameter in layout.parameters])
    names = tuple(layout.names[k] for k in np.flatnonzero(share > FAINT * share.max()))
    return Open(words or f"a combination of {', '.join(names)}", names, d)


def _remaining(
    null: Float[np.ndarray, "dimension visible"], named: Float[np.ndarray, "named visible"]
) -> Iterator[np.ndarray]:
    """A sparse basis of a null space without its named directions.

    Reduced echelon form of both, so that the remaining rows have none of the named ones' pivots.
    """
    count = len(null) - len(named)
    if count <= 0:
        return
    basis = np.linalg.qr(named.T)[0]
    _, _, Vt = np.linalg.svd(null - (null @ basis) @ basis.T, full_matrices=False)
    rows = np.vstack([named, Vt[:count]])
    for k in range(len(rows)):  # elimination leaves exact zeros at the pivots of earlier rows
        eliminate(rows, k, int(np.argmax(np.abs(rows[k]))))
    yield from np.where(np.abs(rows[-count:]) > NEGLIGIBLE, rows[-count:], 0.0)


TORQUES, DESCRIBED, PLAN = "torques", "described", "plan"
TITLES = {TORQUES: "torques alone", DESCRIBED: "with what the description has"}


@dataclass(frozen=True, eq=False)
class Opening:
    """Null space of some rows.

    Attributes:
        name: 'torques', 'described', of a use, 'plan'.
        title: in words.
        null: the null space.
        parted: for each of its directions the uses that determine it, each by itself.
    """

    name: str
    title: str
    null: NullSpace
    parted: tuple[tuple[str, ...], ...]


def openings(
    dynamics: Dynamics,
    motion: PlannedMotion,
    torque: Extended,
    described: Extended,
    uses: Sequence[Use],
    bought: Sequence[Use],
) -> tuple[Opening, ...]:
    """Null spaces of torques, then with the description's rows, each use, and all purchases."""
    layout, along = dynamics.layout, instances(dynamics.kinematics, motion.z[motion.few])
    proposed = exchanges(dynamics.robot, layout, along)
    known, titles = np.vstack([torque, described]), {use.name: use.title for use in uses}

    def null(*rows: Extended) -> NullSpace:
        return null_space(np.vstack(rows)[:, : len(layout.parameters)], layout, proposed)

    of_uses = {use.name: null(known, use.sure) for use in uses}
    nulls = {TORQUES: (TITLES[TORQUES], null(torque))}
    if len(described):
        nulls[DESCRIBED] = TITLES[DESCRIBED], null(known)
    nulls |= {name: (titles[name], space) for name, space in of_uses.items()}
    if bought:
        nulls[PLAN] = "with all that is bought", null(known, *(use.sure for use in bought))
    return tuple(
        Opening(
            name,
            title,
            space,
            tuple(
                tuple(key for key, other in of_uses.items() if not direction.stays(space, other))
                for direction in space.directions
            ),
        )
        for name, (title, space) in nulls.items()
    )
