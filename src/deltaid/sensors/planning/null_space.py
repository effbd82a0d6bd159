"""What no row sees: every direction of p along which nothing that is shown changes, by name.

Directions that mean something are proposed: mass that passes from one body to another at a point
that both share (with what follows along a shared axis), second moments that pass between bodies
that turn alike, a rotor against what it turns. Those of them in the null space of the rows are
named; what is left of it is named by its entries. `openings` asks this of torques, of what is
described, of each use, and of all that is bought.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import ParameterLayout
from deltaid.estimation.problem import DEPENDENT
from deltaid.mechanism.platform import with_turned_half
from deltaid.sensors.planning.exchange import Exchange, eliminate, exchanges, instances
from deltaid.sensors.planning.rows import Extended, PlannedMotion
from deltaid.sensors.planning.uses import Use

# A direction that rows see by less than this share of what they see of its entries is not seen.
_UNSEEN = 1e-8
# A direction is another one than those before if so much of it is not along them.
_NEW = 1e-6
# Entries below this share of the largest one of a direction are not named.
_SMALL = 1e-6

# A direction that is off a null space by less than this share of itself is of it.
_STAYS = 1e-4

Direction = Float[np.ndarray, " parameters"]


@dataclass(frozen=True, eq=False)
class Open:
    """One direction that rows do not see.

    Attributes:
        words: what may change: 'mass at the elbow's joints may pass between upper arm and strut'.
        entries: which parameters it changes, by name.
        direction: of p; of entries that rows see at all.
    """

    words: str
    entries: tuple[str, ...]
    direction: Direction = field(repr=False)

    def stays(self, null: "NullSpace", other: "NullSpace") -> bool:
        """Whether it is open to other rows as well, whatever else may change with it.

        Args:
            null: that it is of; of entries that its rows do not see all may change.
        """
        basis, d = other.basis[null.seen], (self.direction / null.scale)[null.seen]
        rest = d - basis @ np.linalg.lstsq(basis, d, rcond=_UNSEEN)[0]
        return bool(np.linalg.norm(rest) < _STAYS * np.linalg.norm(d))


@dataclass(frozen=True, eq=False)
class NullSpace:
    """Attributes:
    rank: how many combinations of the parameters that rows see they tell.
    directions: a basis of what they do not, visible less rank of them.
    invisible: parameters that they do not see at all.
    seen: which parameters they see.
    scale: sizes of all parameters.
    basis: of all that they do not see, whether by sums or at all, in units of the scales.
    """

    rank: int
    directions: tuple[Open, ...]
    invisible: tuple[str, ...]
    seen: Bool[np.ndarray, " parameters"] = field(repr=False)
    scale: Float[np.ndarray, " parameters"] = field(repr=False)
    basis: Float[np.ndarray, "parameters dimension"] = field(repr=False)

    @property
    def visible(self) -> int:
        """How many parameters the rows see, alone or in sums."""
        return int(self.seen.sum())


def null_space(
    rows: Float[np.ndarray, "rows parameters"],
    layout: ParameterLayout,
    exchanges: Sequence[Exchange],
) -> NullSpace:
    """All that rows over p do not tell of the parameters that they see."""
    scale = np.array([parameter.scale for parameter in layout.parameters])
    norms = np.linalg.norm(rows * scale, axis=0)
    seen = norms > DEPENDENT * norms.max(initial=0.0)
    to_p = scale[seen] / norms[seen]
    unit = rows[:, seen] * to_p
    _, S, Vt = np.linalg.svd(unit)
    rank = int(np.sum(DEPENDENT * S[0] < S))
    chosen, basis = list[Open](), np.zeros((len(to_p), 0))
    for exchange in (*exchanges, *_together(unit, to_p, seen, exchanges)):
        d = exchange.direction[seen] / to_p
        length = np.linalg.norm(d)
        if length == 0 or np.linalg.norm(unit @ d) > _UNSEEN * length:
            continue
        rest = d / length
        for _ in range(2):  # orthogonal to rounding
            rest = rest - basis @ (basis.T @ rest)
        if np.linalg.norm(rest) > _NEW:
            basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
            chosen.append(_open(exchange.words, exchange.direction, seen, layout))
    named = [free.direction[seen] / to_p for free in chosen]
    for d in _left(Vt[rank:], np.array(named).reshape(-1, len(to_p))):
        direction = np.zeros(len(scale))
        direction[seen] = d * to_p
        chosen.append(_open("", direction, seen, layout))
    whole = np.zeros((len(scale), len(scale) - rank))
    whole[seen, : len(to_p) - rank] = Vt[rank:].T / norms[seen, None]
    whole[~seen, len(to_p) - rank :] = np.eye(int(np.sum(~seen)))
    invisible = tuple(np.array(layout.names)[~seen].tolist())
    return NullSpace(rank, tuple(chosen), invisible, seen, scale, whole)


def _together(
    unit: Float[np.ndarray, "rows seen"],
    to_p: Float[np.ndarray, " seen"],
    seen: Bool[np.ndarray, " parameters"],
    exchanges: Sequence[Exchange],
) -> Iterator[Exchange]:
    """Two exchanges that rows see one by one, in the proportion in which they do not see them."""
    open_ = list[tuple[Exchange, np.ndarray, float]]()
    for exchange in exchanges:
        d = exchange.direction[seen] / to_p
        length = float(np.linalg.norm(d))
        if length > 0 and np.linalg.norm(unit @ d) > _UNSEEN * length:
            open_.append((exchange, unit @ d / length, length))
    for (exchange, a, long), (other, b, wide) in combinations(open_, 2):
        share = float(a @ b) / float(b @ b)
        if np.linalg.norm(a - share * b) > _UNSEEN * np.linalg.norm(a):
            continue
        direction = exchange.direction / long - share * other.direction / wide
        yield Exchange(f"{exchange.words} together with: {other.words}", direction)


def _open(
    words: str, direction: Direction, seen: Bool[np.ndarray, " parameters"], layout: ParameterLayout
) -> Open:
    d = np.where(seen, direction, 0.0)
    share = np.abs(d) / np.array([parameter.scale for parameter in layout.parameters])
    names = tuple(layout.names[k] for k in np.flatnonzero(share > _SMALL * share.max()))
    return Open(words or f"a combination of {', '.join(names)}", names, d)


def _left(
    null: Float[np.ndarray, "dimension seen"], named: Float[np.ndarray, "named seen"]
) -> Iterator[np.ndarray]:
    """A basis with few entries of what a null space has beside named directions of it.

    Reduced echelon form of both, so that what is left has none of the pivots of the named ones.
    """
    count = len(null) - len(named)
    if count <= 0:
        return
    basis = np.linalg.qr(named.T)[0]
    _, _, Vt = np.linalg.svd(null - (null @ basis) @ basis.T, full_matrices=False)
    rows, pivots = np.vstack([named, Vt[:count]]), list[int]()
    for k in range(len(rows)):
        free = np.ones(rows.shape[1], dtype=bool)
        free[pivots] = False
        pivot = int(np.argmax(np.abs(rows[k]) * free))
        eliminate(rows, k, pivot)
        pivots.append(pivot)
    yield from np.where(np.abs(rows[-count:]) > DEPENDENT, rows[-count:], 0.0)


# Poses that tell which points bodies share.
_POSES = 40

TORQUES, DESCRIBED, PLAN = "torques", "described", "plan"


@dataclass(frozen=True, eq=False)
class Opening:
    """What some rows leave open.

    Attributes:
        name: 'torques', 'described', of a use, 'plan'.
        title: in words.
        null: what they do not tell.
        parted: for each of its directions the uses after which it is told, each by itself.
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
    """For torques alone, with what is described, with each use besides, and with all bought."""
    layout, mechanism = dynamics.layout, with_turned_half(dynamics.kinematics.mechanism)
    step = max(1, len(motion.z) // _POSES)
    proposed = exchanges(dynamics.robot, layout, instances(mechanism, motion.z[::step]))
    known, titles = np.vstack([torque, described]), {use.name: use.title for use in uses}

    def null(*rows: Extended) -> NullSpace:
        return null_space(np.vstack(rows)[:, : len(layout.parameters)], layout, proposed)

    of_uses = {use.name: null(known, use.sure) for use in uses}
    nulls = {TORQUES: ("torques alone", null(torque))}
    if len(described):
        nulls[DESCRIBED] = "with what the description has", null(known)
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
