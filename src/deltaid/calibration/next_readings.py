"""What to measure next, and with what: the readings that make positions most certain, by price.

Of readings with rows a (slopes over noise) that could be taken next, the one is taken that lowers
the variance of positions over the workspace most,

    tr E C Eᵀ − tr E C′ Eᵀ = ‖E C aᵀ (1 + a C aᵀ)^-½‖²,    E the positions' slopes by u, Cov u = C

then the next, up to so many. Nothing is measured for it. What so many readings of an instrument are
worth is by how much ½ log det(I + E C Eᵀ/ε²) falls, as `deltaid sensors` counts it [nats].
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.calibration.calibrate import Calibration
from deltaid.calibration.gauss_newton import FAR, UsedReadings, own_columns, tools_of
from deltaid.calibration.instruments import KINDS
from deltaid.calibration.outlook import drawn
from deltaid.errors import DescriptionError
from deltaid.sensors.planning.knowledge import Knowledge
from deltaid.sensors.planning.offers import Offer, Offers, PoseKind, PoseReadings, shipped_offers
from deltaid.sensors.planning.shopping import Goal

# Places that are tried for each reading, and the seed that draws them.
_PLACES, _SEED = 60, 2
# Positions that are known to this are known well enough: what a good probe reads to [m].
_ENOUGH = 1e-5
# Noise of what was used already is that of an offer within this factor, blocks within this [m].
_ALIKE, _SAME_BLOCK = 2.0, 1e-2


@dataclass(frozen=True, eq=False)
class NextReadings:
    """Readings of one instrument, the most valuable first.

    Attributes:
        name, title: of the instrument in the list.
        kind: of its readings.
        poses: commanded platform points of each reading's ends, in the described robot's frame [m].
        blocks: height of the block under each touch of a probe [m].
        position: standard deviation of positions after all of them, rms [m].
        size: the same of sizes across, as a share.
        gain: what is learnt of positions [nats].
        cost: of instrument and work; of an instrument that was used already the work alone.
    """

    name: str
    title: str
    kind: PoseKind
    poses: Float[np.ndarray, "readings ends 3"]
    blocks: Float[np.ndarray, " readings"]
    position: float
    size: float
    gain: float
    cost: float


def next_readings(
    found: Calibration,
    count: int = 6,
    *,
    offers: Offers | None = None,
    budget: float | None = None,
) -> tuple[NextReadings, ...]:
    """The best next readings of each instrument of a list, that which gains most per price first.

    Args:
        found: what is known so far; its instruments' frames and planes stay where they are.
        count: readings of each instrument.
        offers: instruments with their prices; the list of `deltaid sensors` without.
        budget: most that one may cost; None for no bound.

    Raises:
        DescriptionError: the list has no instrument for that money.
    """
    offers = offers or shipped_offers()
    sold = [(name, offer) for name, offer in offers.offers.items() if offer.reads]
    plans = [_plan(found, name, offer, offers.hourly, count) for name, offer in sold]
    plans = [plan for plan in plans if budget is None or plan.cost <= budget]
    if not plans:
        raise DescriptionError(
            "the list has no instrument that measures poses at this price",
            where="--sensors, --budget",
            cure="raise --budget, or give offers with reads, as deltaid sensors --list shows",
        )
    return tuple(sorted(plans, key=lambda plan: plan.cost / plan.gain))


def _used(found: Calibration, reads: PoseReadings) -> int | None:
    """Which instrument of a calibration is that of an offer."""
    for k, past in enumerate(found.fit.instruments):
        stood = past.values if past.kind == "probe" else np.zeros((1, 1))
        stated = past.noise / reads.noise
        on = [np.abs(stood - block).min() < _SAME_BLOCK for block in reads.blocks]
        if past.kind == reads.kind and 1 / _ALIKE <= stated <= _ALIKE and all(on):
            return k
    return None


def _plan(found: Calibration, name: str, offer: Offer, hourly: float, count: int) -> NextReadings:
    assert offer.reads is not None
    loops, n, reads = found.fit.loops, len(found.fit.u), offer.reads
    kind, past = reads.kind, _used(found, reads)
    cost = offer.hours * hourly + (offer.price if past is None else 0.0)
    if past is None and kind == "probe":  # another probe on the same bed
        past = next((k for k, x in enumerate(found.fit.instruments) if x.kind == kind), None)
    ends, blocks = _candidates(found, reads)
    rows, knowledge = len(ends), found.fit.knowledge
    instrument = KINDS[kind](
        "", loops.inverse(ends.reshape(-1, 3)).reshape(*ends.shape[:2], -1),
        np.zeros((rows, 3 if kind == "points" else 1)), reads.noise, np.arange(rows),
    )  # fmt: skip
    x, by_u = tools_of(loops, found.known, instrument, found.fit.u)
    if past is None:  # a new instrument's unknowns
        if kind == "points":
            instrument = replace(instrument, values=x[:, 0])
        state, new = instrument.start(x), len(instrument.unknowns)
        own = len(knowledge.root) + np.arange(new)
        root = np.pad(knowledge.root, (0, new))
        root[own, own] = 1 / FAR
        knowledge = Knowledge(root)
    else:
        state = found.fit.readings[past].state
        own = own_columns(n, found.fit.instruments)[past]
    offered = UsedReadings(instrument, np.ones(rows, dtype=bool), state, reads.noise)
    A = offered.rows(x, by_u, own, len(knowledge.root)).slopes
    E = np.zeros((found.places.moved.shape[0], len(knowledge.root)))
    E[:, :n] = found.places.moved @ found.known.G
    F = np.linalg.qr(E).R / np.sqrt(len(found.places.x))
    goal = Goal("positions", F, 1.0, _ENOUGH)
    before, chosen = goal.left(knowledge), list[int]()
    for _ in range(count):
        half = A @ knowledge.inverse
        S = np.eye(half.shape[1]) + half @ half.swapaxes(1, 2)
        moved = half @ (F @ knowledge.inverse).T
        worth = np.sum(np.linalg.solve(S, moved) * moved, axis=(1, 2))
        chosen.append(int(np.argmax(worth)))
        knowledge = knowledge.and_rows(A[chosen[-1]])
    position = float(np.linalg.norm(knowledge.std_of(F)))
    size = found.places.size(found.known.G @ knowledge.inverse[:n])
    gain = max(before - goal.left(knowledge), np.finfo(float).tiny)
    return NextReadings(
        name, offer.title, kind, ends[chosen], blocks[chosen], position, size, gain, cost
    )


def _candidates(
    found: Calibration, reads: PoseReadings
) -> tuple[Float[np.ndarray, "readings ends 3"], Float[np.ndarray, " readings"]]:
    """Commanded points of readings that could be taken, and the blocks under them."""
    loops, rng = found.fit.loops, np.random.default_rng(_SEED)
    x = loops.start(drawn(loops.kinematics, loops.limbs, _PLACES, _SEED))[:, :3]
    if reads.kind == "points":
        return x[:, None], np.zeros(len(x))
    probes = [k for k, other in enumerate(found.fit.instruments) if other.kind == "probe"]
    plane = found.fit.readings[probes[0]].state[0] if probes else x[:, 2].min()
    blocks = np.repeat(reads.blocks, len(x))
    on = np.tile(x, (len(blocks) // len(x), 1))
    on[:, 2] = plane + blocks
    inside = found.described.workspace.contains(on)
    on, blocks = on[inside], blocks[inside]
    if reads.kind == "probe":
        return on[:, None], blocks
    pairs = rng.integers(len(on), size=(4 * _PLACES, 2))
    pairs = pairs[np.linalg.norm(on[pairs[:, 0]] - on[pairs[:, 1]], axis=1) > 0]
    return on[pairs], np.zeros(len(pairs))
