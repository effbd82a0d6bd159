"""What to measure next: the readings of each instrument that make positions most certain.

Of readings with rows a (slopes over noise) that could be taken next, the one is taken that lowers
the variance of positions over the workspace most,

    tr E C Eᵀ − tr E C′ Eᵀ = ‖E C aᵀ (1 + a C aᵀ)^-½‖²,    E the positions' slopes by u, Cov u = C

then the next, up to so many. Nothing is measured for it.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.calibration.calibrate import Calibration
from deltaid.calibration.gauss_newton import FAR
from deltaid.calibration.instruments import KINDS, Instrument, Kind
from deltaid.calibration.outlook import drawn
from deltaid.calibration.readings import USUAL
from deltaid.sensors.planning.knowledge import Knowledge

# Places that are tried for each reading, and heights of gauge blocks on the plane [m].
_PLACES, _BLOCKS = 60, (0.0, 0.05, 0.1)
_SEED = 2


@dataclass(frozen=True, eq=False)
class NextReadings:
    """Readings of one instrument, the most valuable first.

    Attributes:
        kind: of the instrument.
        poses: commanded platform points of each reading's ends, in the described robot's frame [m].
        blocks: height of the block under each touch of a probe [m].
        position: standard deviation of positions after all of them, rms [m].
    """

    kind: Kind
    poses: Float[np.ndarray, "readings ends 3"]
    blocks: Float[np.ndarray, " readings"]
    position: float


def next_readings(found: Calibration, count: int = 6) -> tuple[NextReadings, ...]:
    """The best next readings of each kind of instrument, the most useful instrument first.

    Args:
        found: what is known so far; its instruments' frames and planes stay where they are.
        count: readings of each instrument.
    """
    plans = [_plan(found, kind, count) for kind in KINDS]
    return tuple(sorted(plans, key=lambda plan: plan.position))


def _plan(found: Calibration, kind: Kind, count: int) -> NextReadings:
    loops, n = found.fit.loops, len(found.fit.u)
    past = [k for k, instrument in enumerate(found.fit.instruments) if instrument.kind == kind]
    x, blocks = _candidates(found, kind)
    q = loops.inverse(x.reshape(-1, 3))
    tools = loops.points(q, found.values, loops.start(q))
    ends = x.shape[1]
    noise = found.fit.instruments[past[0]].noise if past else USUAL[kind]
    instrument: Instrument = KINDS[kind](
        "", q.reshape(len(x), ends, -1), np.zeros((len(x), 3 if kind == "points" else 1)), noise,
        np.arange(len(x)),
    )  # fmt: skip
    places = [tools.x.reshape(-1, ends, 3)[:, end] for end in range(ends)]
    if kind == "points":
        instrument = replace(instrument, values=places[0])
    state = found.fit.states[past[0]] if past else instrument.start(places)
    at = instrument.slopes(places, state)
    by_u = (tools.slopes @ found.known.G).reshape(len(x), ends, 3, n)
    own = sum(len(other.unknowns) for other in found.fit.instruments[: past[0] if past else None])
    knowledge = found.fit.knowledge
    if not past:  # a new instrument's unknowns
        new = len(instrument.unknowns)
        root = np.pad(knowledge.root, (0, new))
        root[len(root) - new :, len(root) - new :] = np.eye(new) / FAR
        knowledge = Knowledge(root)
    A = np.zeros((*at.error.shape, len(knowledge.root)))
    A[:, :, :n] = sum(tool @ by_u[:, end] for end, tool in enumerate(at.tools))
    A[:, :, n + own : n + own + at.own.shape[2]] = at.own
    A /= noise
    E = np.zeros((found.places.moved.shape[0], len(knowledge.root)))
    E[:, :n] = found.places.moved @ found.known.G
    F = np.linalg.qr(E).R
    chosen: list[int] = []
    for _ in range(count):
        half = A @ knowledge.inverse
        S = np.eye(half.shape[1]) + half @ half.swapaxes(1, 2)
        moved = F @ knowledge.inverse @ half.swapaxes(1, 2)
        moved = moved.swapaxes(1, 2)
        worth = np.sum(np.linalg.solve(S, moved) * moved, axis=(1, 2))
        chosen.append(int(np.argmax(worth)))
        knowledge = knowledge.and_rows(A[chosen[-1]])
    position = float(np.linalg.norm(knowledge.std_of(F)) / np.sqrt(len(found.places.x)))
    return NextReadings(kind, x[chosen], blocks[chosen], position)


def _candidates(
    found: Calibration, kind: Kind
) -> tuple[Float[np.ndarray, "readings ends 3"], Float[np.ndarray, " readings"]]:
    """Commanded points of readings that could be taken, and the blocks under them."""
    loops, rng = found.fit.loops, np.random.default_rng(_SEED)
    q = drawn(loops.kinematics, loops.limbs, _PLACES, _SEED)
    x = loops.start(q)[:, :3]
    if kind == "points":
        return x[:, None], np.zeros(len(x))
    probes = [k for k, other in enumerate(found.fit.instruments) if other.kind == "probe"]
    plane = found.fit.states[probes[0]][0] if probes else x[:, 2].min()
    blocks = np.repeat(_BLOCKS if kind == "probe" else (0.0,), len(x))
    on = np.tile(x, (len(blocks) // len(x), 1))
    on[:, 2] = plane + blocks
    inside = found.described.workspace.contains(on)
    on, blocks = on[inside], blocks[inside]
    if kind == "probe":
        return on[:, None], blocks
    pairs = rng.integers(len(on), size=(4 * _PLACES, 2))
    pairs = pairs[np.linalg.norm(on[pairs[:, 0]] - on[pairs[:, 1]], axis=1) > 0]
    return on[pairs], np.zeros(len(pairs))
