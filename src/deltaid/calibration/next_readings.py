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
from deltaid.calibration.fit import FAR, UsedReadings, own_columns, tools_of
from deltaid.calibration.outlook import drawn
from deltaid.calibration.readings import KINDS, Instrument
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
    """Readings of one instrument of the list, the most valuable first.

    Attributes:
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
    found: Calibration, count: int = 6, *, offers: Offers | None = None, budget: float | None = None
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
    plans = [
        _plan(found, name, offer, offers.hourly, count)
        for name, offer in offers.offers.items()
        if offer.reads
    ]
    plans = [plan for plan in plans if budget is None or plan.cost <= budget]
    if not plans:
        raise DescriptionError(
            "the list has no instrument that measures poses at this price",
            where="--sensors, --budget",
            cure="raise --budget, or give offers with reads, as deltaid sensors --list shows",
        )
    return tuple(sorted(plans, key=lambda plan: plan.cost / plan.gain))


def _plan(found: Calibration, name: str, offer: Offer, hourly: float, count: int) -> NextReadings:
    assert offer.reads is not None
    fit, reads, F = found.fit, offer.reads, found.places.moved @ found.known.G
    kind, knowledge, n, instruments = reads.kind, fit.knowledge, len(fit.u), fit.instruments
    alike = [k for k, past in enumerate(instruments) if past.kind == kind]
    used = next((k for k in alike if _is_offered(instruments[k], reads)), None)
    past = next(iter(alike), None) if used is None and kind == "probe" else used  # on the same bed
    ends, blocks = _candidates(found, reads)
    q = fit.loops.inverse(ends.reshape(-1, 3)).reshape(*ends.shape[:2], -1)
    values = np.zeros((len(q), 3 if kind == "points" else 1))
    instrument = KINDS[kind]("", q, values, reads.noise, np.arange(len(q)))
    x, by_u = tools_of(fit.loops, found.known, instrument, fit.u)
    if past is None:  # a new instrument's unknowns
        if kind == "points":
            instrument = replace(instrument, values=x[:, 0])
        state, new = instrument.start(x), len(instrument.unknowns)
        own = len(knowledge.root) + np.arange(new)
        root = np.pad(knowledge.root, (0, new))
        root[own, own] = 1 / FAR
        knowledge = Knowledge(root)
    else:
        state, own = fit.readings[past].state, own_columns(n, instruments)[past]
    offered = UsedReadings(instrument, np.ones(len(q), dtype=bool), state, reads.noise)
    A = offered.rows(x, by_u, own, len(knowledge.root)).slopes
    F = np.linalg.qr(np.pad(F, ((0, 0), (0, len(knowledge.root) - n)))).R
    F /= np.sqrt(len(found.places.x))
    goal = Goal("positions", F, 1.0, _ENOUGH)
    before, chosen = goal.left(knowledge), list[int]()
    for _ in range(count):
        half = A @ knowledge.inverse
        S = np.eye(half.shape[1]) + half @ half.swapaxes(1, 2)
        moved = half @ (F @ knowledge.inverse).T
        worth = np.sum(np.linalg.solve(S, moved) * moved, axis=(1, 2))
        chosen.append(int(np.argmax(worth)))
        knowledge = knowledge.and_rows(A[chosen[-1]])
    return NextReadings(
        name, offer.title, kind, ends[chosen], blocks[chosen],
        position=float(np.linalg.norm(knowledge.std_of(F))),
        size=found.places.size(found.known.G @ knowledge.inverse[:n]),
        gain=max(before - goal.left(knowledge), np.finfo(float).tiny),
        cost=offer.hours * hourly + (offer.price if used is None else 0.0),
    )  # fmt: skip


def _is_offered(past: Instrument, reads: PoseReadings) -> bool:
    """Whether an instrument of a calibration is that of an offer."""
    stood = past.values if past.kind == "probe" else np.zeros((1, 1))
    on = [np.abs(stood - block).min() < _SAME_BLOCK for block in reads.blocks]
    return 1 / _ALIKE <= past.noise / reads.noise <= _ALIKE and all(on)


def _candidates(
    found: Calibration, reads: PoseReadings
) -> tuple[Float[np.ndarray, "readings ends 3"], Float[np.ndarray, " readings"]]:
    """Commanded points of readings that could be taken, and the blocks under them."""
    loops, rng = found.fit.loops, np.random.default_rng(_SEED)
    x = loops.start(drawn(loops.kinematics, loops.limbs, _PLACES, _SEED))[:, :3]
    if reads.kind == "points":
        return x[:, None], np.zeros(len(x))
    beds = [part.state[0] for part in found.fit.readings if part.instrument.kind == "probe"]
    blocks, on = np.repeat(reads.blocks, len(x)), np.tile(x, (len(reads.blocks), 1))
    on[:, 2] = (beds[0] if beds else x[:, 2].min()) + blocks
    inside = found.described.workspace.contains(on)
    on, blocks = on[inside], blocks[inside]
    if reads.kind == "probe":
        return on[:, None], blocks
    pairs = rng.integers(len(on), size=(4 * _PLACES, 2))
    pairs = pairs[np.linalg.norm(on[pairs[:, 0]] - on[pairs[:, 1]], axis=1) > 0]
    return on[pairs], np.zeros(len(pairs))
