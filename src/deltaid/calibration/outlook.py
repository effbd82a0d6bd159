"""Remaining uncertainty of positions and sizes over the workspace, the combinations of dimensions
that stay undetermined, and the best next measurements.

With slopes J of tool points by the numbers, P the projection that removes rigid motions (the pose
of the base is no geometric error) and Cov u = L Lᵀ, positions have the covariance root E = P J G L.
Its singular vectors are the uncertain deformations of the workspace. Each belongs to one
combination of numbers, which readings determine in part and the description for the rest.

The next reading, with rows a (slopes over noise), is the one that lowers the variance of positions
over the workspace most,

    tr E C Eᵀ − tr E C′ Eᵀ = ‖E C aᵀ (1 + a C aᵀ)^-½‖²,    E the positions' slopes by u, Cov u = C

and so on greedily. The gain of an instrument's readings is the decrease of
½ log det(I + E C Eᵀ/ε²), as in `deltaid sensors` [nats].
"""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deltaid.calibration.fit import (
    LITTLE,
    GeometryFit,
    UsedReadings,
    instrument_columns,
    tool_slopes,
)
from deltaid.calibration.loops import Loops
from deltaid.calibration.readings import KINDS, Instrument, ProbeReadings
from deltaid.calibration.rows import FAR
from deltaid.calibration.unknowns import WORDS, Unknowns
from deltaid.errors import DescriptionError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.verdict import FEW
from deltaid.sensors.planning.knowledge import Knowledge
from deltaid.sensors.planning.offers import Offer, Offers, PoseKind, PoseReadings, shipped_offers

if TYPE_CHECKING:
    from deltaid.calibration.calibrate import Calibration

# A combination that matters is undetermined where readings decide less than half of it, or where it
# moves positions by more than this many times the noise.
_WEAK = 5.0
# Factor and unit that numbers are shown in, by their SI unit.
_SHOWN = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "": (100, "%")}


@dataclass(frozen=True)
class Direction:
    """An undetermined combination of numbers, at one standard deviation: in words, with the
    position error that it causes, root mean square [m], and the error of size in the plane, as a
    share."""

    words: str
    error: float
    size: float
    numbers: dict[str, float] = field(repr=False)


@dataclass(frozen=True)
class PoseUncertainty:
    """Standard deviations of positions over the workspace, root mean square and largest [m], and of
    sizes in the plane, as a share."""

    position: float
    worst: float
    size: float


@dataclass(frozen=True, eq=False)
class Places:
    """Tool points over a workspace [m], and their slopes by each number, without rigid motions."""

    x: Float[np.ndarray, "places 3"]
    moved: Float[np.ndarray, "entries numbers"]

    def uncertainty(self, root: Float[np.ndarray, "numbers _"]) -> PoseUncertainty:
        """Uncertainty of positions and sizes, for L with Cov θ = L Lᵀ."""
        errors = self.errors(root)
        return PoseUncertainty(
            float(np.sqrt(np.mean(errors**2))), float(errors.max()), self.size(root)
        )

    def errors(self, root: Float[np.ndarray, "numbers _"]) -> Float[np.ndarray, " places"]:
        """Standard deviation of positions at each place [m], for L with Cov θ = L Lᵀ."""
        return np.linalg.norm((self.moved @ root).reshape(len(self.x), -1), axis=1)

    def size(self, root: Float[np.ndarray, "numbers _"]) -> float:
        """Standard deviation of sizes in the plane, as a share."""
        return float(np.linalg.norm(_across(self.x) @ self.moved @ root))


def _across(x: Float[np.ndarray, "places 3"]) -> Float[np.ndarray, " entries"]:
    """Row vector that maps displacements to the growth in x and y, as a share."""
    f = x - x.mean(axis=0)
    f[:, 2] = 0.0
    return f.ravel() / np.sum(f**2)


def places(loops: Loops, known: Unknowns, theta: Float[np.ndarray, " numbers"]) -> Places:
    """Tool points over the described workspace within reach."""
    x, slopes = loops.points(drawn(loops.kinematics, loops.limbs), theta)
    J, arms = slopes.reshape(-1, len(known.numbers)), x - x.mean(axis=0)
    turns = [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    Q = np.linalg.qr(np.column_stack([*np.tile(np.eye(3), (len(x), 1)).T, *turns]))[0]
    return Places(x, J - Q @ (Q.T @ J))


def drawn(
    kinematics: Kinematics, limbs: int, count: int = 200, seed: int = 1
) -> Float[np.ndarray, "places drives"]:
    """Drive coordinates of random poses of the workspace, away from singularities."""
    rng, robot = np.random.default_rng(seed), kinematics.robot
    low, high = robot.workspace.bounding_box
    # a hemisphere fills a quarter of its box, and edges may be out of reach
    x = rng.uniform(low, high, (20 * count, 3))
    x = x[robot.workspace.contains(x)]
    z = np.tile(kinematics.home, (len(x), 1))
    z[:, :3] = x
    if robot.platform_turns:
        z[:, 3] = rng.uniform(robot.turn.low, robot.turn.high, len(z))
    good = kinematics.regularity(z).condition < robot.largest_condition
    return kinematics.inverse(z[good][:count])[:, :limbs]


def open_directions(fit: GeometryFit, over: Places) -> tuple[Direction, ...]:
    """Combinations that matter and that measurements do not determine, the worst first."""
    known, C = fit.known, fit.root @ fit.root.T
    L = np.linalg.cholesky(C + 1e-14 * np.trace(C) * np.eye(len(C)))
    _, s, Vt = np.linalg.svd(over.moved @ known.G @ L, full_matrices=False)
    noise = max(readings.noise for readings in fit.readings)
    reach = float(np.sqrt(np.mean(np.sum((over.x - over.x.mean(axis=0))[:, :2] ** 2, axis=1))))
    directions = []
    for size, u in zip(s, (L @ Vt.T).T, strict=True):
        # with the posterior's metric uᵀC⁻¹u = 1 = |u|² (the description's share) + data's
        error = float(size / np.sqrt(len(over.x)))
        if size < LITTLE * np.linalg.norm(s) or (u @ u < 0.5 and error < _WEAK * noise):
            continue
        theta = known.G @ u
        grows = float(_across(over.x) @ over.moved @ theta)
        theta, grows = theta * (np.sign(grows) or 1.0), abs(grows)
        what = "shape stays uncertain"
        if grows * reach > np.sqrt(0.5) * error:
            what = f"sizes stay uncertain by {100 * grows:.2g} %"
        directions.append(
            Direction(
                words=f"{what}, positions by {1e3 * error:.2g} mm: {_in_words(known, theta)}",
                error=error,
                size=grows,
                numbers=dict(zip(known.names, theta.tolist(), strict=True)),
            )
        )
    return tuple(directions)


def _in_words(known: Unknowns, theta: Float[np.ndarray, " numbers"]) -> str:
    """Such as 'strut +2.7 mm, zero -0.3 mrad (limb 2 most)'."""
    named = []
    for kind in known.kinds:
        at = known.of_kind(kind)
        own, mean, number = theta[at], float(np.mean(theta[at])), known.numbers[at[0]]
        largest = int(np.argmax(np.abs(own)))
        # common to all limbs where their mean makes most of it
        alike = abs(mean) * np.sqrt(len(at)) > np.sqrt(0.5) * np.linalg.norm(own)
        peak, most = (mean, "") if alike else (float(own[largest]), f" (limb {largest + 1} most)")
        factor, unit = _SHOWN[number.unit]
        text = f"{WORDS[kind]} {factor * peak:+.2g} {unit}{most}"
        named.append((abs(peak) / (number.spread or np.inf), text))
    named.sort(key=lambda entry: -entry[0])
    return ", ".join([text for share, text in named if share > LITTLE * named[0][0]][:FEW])


# Candidate poses of each reading, and the seed that draws them.
_TRIED, _TRIED_SEED = 60, 2
# An instrument in use matches an offer whose noise is within this factor, and blocks within this
# distance [m].
_ALIKE, _SAME_BLOCK = 2.0, 1e-2


@dataclass(frozen=True, eq=False)
class NextReadings:
    """Readings of one instrument of the list, the most valuable first.

    Attributes:
        poses, blocks: commanded platform points of each reading's ends, in the described robot's
            frame, and height of the block under each touch of a probe [m].
        position, size: standard deviation of positions after all of them, rms [m], and of sizes.
        gain: information gained on positions [nats].
        cost: of instrument and work; of the work alone for an instrument that was used already.
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
    found: "Calibration", count: int = 6, *, offers: Offers | None = None,
    budget: float | None = None,
) -> tuple[NextReadings, ...]:  # fmt: skip
    """Best next readings of each instrument of a list, the least cost per gain first.

    Args:
        found: the calibration so far; its instruments' frames and planes stay where they are.
        count: number of readings of each instrument.
        offers: instruments with their prices; None for the list of `deltaid sensors`.
        budget: largest cost of an instrument; None for no limit.

    Raises:
        DescriptionError: no instrument of the list is within the budget.
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


def _plan(
    calibration: "Calibration", name: str, offer: Offer, hourly: float, count: int
) -> NextReadings:
    assert offer.reads is not None
    fit, reads, F = calibration.fit, offer.reads, calibration.places.moved @ calibration.known.G
    kind, knowledge, n = reads.kind, fit.knowledge, len(fit.u)
    instruments = [part.instrument for part in fit.readings]
    alike = [k for k, past in enumerate(instruments) if past.kind == kind]
    used = next((k for k in alike if _is_like(instruments[k], reads)), None)
    past = next(iter(alike), None) if used is None and kind == "probe" else used  # on the same bed
    ends, blocks = _candidates(calibration, reads)
    q = fit.loops.inverse(ends.reshape(-1, 3)).reshape(*ends.shape[:2], -1)
    values = np.zeros((len(q), 3 if kind == "points" else 1))
    instrument = KINDS[kind]("", q, values, reads.noise, np.arange(len(q)))
    x, _ = tool_slopes(fit.loops, calibration.known, instrument, fit.u)
    if past is None:  # a new instrument's unknowns
        if kind == "points":
            instrument = replace(instrument, values=x[:, 0])
        state, new = instrument.start(x), len(instrument.unknowns)
        own = len(knowledge.root) + np.arange(new)
        root = np.pad(knowledge.root, (0, new))
        root[own, own] = 1 / FAR
        knowledge = Knowledge(root)
    else:
        state, own = fit.readings[past].state, instrument_columns(n, instruments)[past]
    offered = UsedReadings.begun(instrument, np.ones(len(q), dtype=bool), state)
    A = offered.weighted(fit.loops, calibration.known, fit.u, own, len(knowledge.root)).slopes
    F = np.linalg.qr(np.pad(F, ((0, 0), (0, len(knowledge.root) - n)))).R
    F /= np.sqrt(len(calibration.places.x))
    G = 1.0 / ProbeReadings.usual * F
    before, chosen = knowledge.log_det(G), list[int]()
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
        size=calibration.places.size(calibration.known.G @ knowledge.inverse[:n]),
        gain=max(before - knowledge.log_det(G), np.finfo(float).tiny),
        cost=offer.hours * hourly + (offer.price if used is None else 0.0),
    )  # fmt: skip


def _is_like(instrument: Instrument, reads: PoseReadings) -> bool:
    """Whether an instrument in use reads as well as an offer, on blocks of the same heights."""
    stood = instrument.values if instrument.kind == "probe" else np.zeros((1, 1))
    return 1 / _ALIKE <= instrument.noise / reads.noise <= _ALIKE and all(
        np.abs(stood - block).min() < _SAME_BLOCK for block in reads.blocks
    )


def _candidates(
    calibration: "Calibration", reads: PoseReadings
) -> tuple[Float[np.ndarray, "readings ends 3"], Float[np.ndarray, " readings"]]:
    """Commanded points of possible readings, and heights of the blocks under them."""
    loops, rng = calibration.fit.loops, np.random.default_rng(_TRIED_SEED)
    x = loops.start(drawn(loops.kinematics, loops.limbs, _TRIED, _TRIED_SEED))[:, :3]
    if reads.kind == "points":
        return x[:, None], np.zeros(len(x))
    beds = [part.state[0] for part in calibration.fit.readings if part.instrument.kind == "probe"]
    blocks, on = np.repeat(reads.blocks, len(x)), np.tile(x, (len(reads.blocks), 1))
    on[:, 2] = (beds[0] if beds else x[:, 2].min()) + blocks
    inside = calibration.described.workspace.contains(on)
    on, blocks = on[inside], blocks[inside]
    if reads.kind == "probe":
        return on[:, None], blocks
    pairs = rng.integers(len(on), size=(4 * _TRIED, 2))
    pairs = pairs[np.linalg.norm(on[pairs[:, 0]] - on[pairs[:, 1]], axis=1) > 0]
    return on[pairs], np.zeros(len(pairs))
