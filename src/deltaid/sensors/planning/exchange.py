"""Exchanges: changes of p that rows may not determine, such as mass that passes between bodies.

A mass μ at a point r of a body adds μ [1, r, r² E − r rᵀ] to its ten parameters. Where every
instance of a body A shares a point with some instance of B, mass may pass from A to B there; along
a shared axis first and second moments may pass too. Bodies that share parameters, such as the
struts, change together, so B's share is divided among its instances. Whether rows determine the
exchange is decided in `sensors.planning.null_space`.

Shared points follow from poses along a motion alone. A point r_A of A coincides with r_B of B if
R_A r_A + o_A = R_B r_B + o_B at all samples. This is linear in both, so the solutions are a point
(a ball joint), a line (an axis) or all of space (one part). The base is a body that never moves.
This works for any kind of robot.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.grouping import grouped
from deltaid.levels import FAINT
from deltaid.mechanism.kinematics import Kinematics
from deltaid.robot.body import body_in_words
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, RigidBody
from deltaid.robot.platform import I4Platform, Par4Platform, RigidPlatform

# Distances [m] below this are zero.
_APART = 1e-8

Points = Float[np.ndarray, "samples 3"]
Turns = Float[np.ndarray, "samples 3 3"]


@dataclass(frozen=True, eq=False)
class Instance:
    """One moving body along a motion.

    Attributes:
        name: of the body, '' for the base.
        count: number of bodies that move identically.
        R, o: pose of the link frame in the world.
    """

    name: str
    count: int
    R: Turns
    o: Points


@dataclass(frozen=True, eq=False)
class Shared:
    """Points that two bodies share: r_a + directions · λ of one, r_b + … of the other.

    Attributes:
        a, b: the point in both link frames; on a line the one nearest to the origin of a.
        along, along_b: directions in a and b, one a row; none for a single point.
    """

    a: Float[np.ndarray, " 3"]
    b: Float[np.ndarray, " 3"]
    along: Float[np.ndarray, "free 3"]
    along_b: Float[np.ndarray, "free 3"]


def instances(kinematics: Kinematics, z: Float[np.ndarray, "samples dof"]) -> tuple[Instance, ...]:
    """All bodies along a motion, the base last."""
    moving = [
        Instance(body.name, body.count, pose.R_WB, pose.r_WB)
        for body, pose in zip(kinematics.mechanism.bodies, kinematics.poses(z), strict=True)
    ]
    still = np.broadcast_to(np.eye(3), (len(z), 3, 3)), np.zeros((len(z), 3))
    return (*moving, Instance("", 1, *still))


def shared(a: Instance, b: Instance) -> Shared | None:
    """The points that two bodies share; None if there is none."""
    M = np.concatenate([a.R, -b.R], axis=2).reshape(-1, 6) / np.sqrt(len(a.o))
    apart = (b.o - a.o).ravel() / np.sqrt(len(a.o))
    U, S, Vt = np.linalg.svd(M, full_matrices=False)
    rank = int(np.sum(FAINT * S[0] < S))
    r = Vt[:rank].T @ ((U.T @ apart)[:rank] / S[:rank])
    if np.abs(M @ r - apart).max() > _APART:
        return None
    # As few directions as there are, along the axes of a where these will do.
    along = _upright(Vt[rank:])
    if len(along):
        r = r + along.T @ np.linalg.lstsq(along[:, :3].T, -r[:3], rcond=None)[0]
    r[np.abs(r) < _APART] = 0.0
    return Shared(r[:3], r[3:], along[:, :3], along[:, 3:])


def move_alike(a: Instance, b: Instance) -> Shared | None:
    """Points of two bodies with a constant difference; None if there are none.

    For a body that only translates this is its origin.
    """
    turning = [bool(np.abs(body.R - body.R[0]).max() > _APART) for body in (a, b)]
    still = np.broadcast_to(np.eye(3), (len(a.o), 3, 3))
    M = np.concatenate([a.R] * turning[0] + [-b.R] * turning[1] + [-still], axis=2)
    M, apart = M.reshape(3 * len(a.o), -1), (b.o - a.o).ravel()
    r, *_ = np.linalg.lstsq(M, apart, rcond=FAINT)
    if np.abs(M @ r - apart).max() > _APART:
        return None
    points = iter(np.split(r, sum(turning) + 1))
    r_a, r_b = (next(points) if turns else np.zeros(3) for turns in turning)
    return Shared(r_a, r_b, np.zeros((0, 3)), np.zeros((0, 3)))


def turn_alike(a: Instance, b: Instance) -> Float[np.ndarray, "3 3"] | None:
    """The constant R_BA of two bodies that rotate together; None if there is none."""
    R = b.R.swapaxes(1, 2) @ a.R
    constant = np.abs(R - R[0]).max() < _APART
    return R[0] if constant and np.abs(a.R - a.R[0]).max() > _APART else None


def _upright(free: Float[np.ndarray, "free 6"]) -> Float[np.ndarray, "free 6"]:
    """A basis of the same directions in reduced echelon form: unit vectors of a where possible."""
    rows, done = free.copy(), 0
    for column in range(3):
        if done == len(rows):
            break
        pivot = done + int(np.argmax(np.abs(rows[done:, column])))
        if abs(rows[pivot, column]) < FAINT:
            continue
        rows[[done, pivot]] = rows[[pivot, done]]
        eliminate(rows, done, column)
        done += 1
    return rows


def eliminate(rows: Float[np.ndarray, "rows columns"], k: int, column: int) -> None:
    """Make, in place, a column 1 in row k and 0 in all others, by multiples of that row."""
    rows[k] /= rows[k, column]
    others = np.arange(len(rows)) != k
    rows[others] -= np.outer(rows[others, column], rows[k])


Partner = Callable[[Instance, Instance], Shared | None]
Ten = Float[np.ndarray, " 10"]

# Where two bodies meet, by their kinds without a number; '*' are all.
_PLACES = (
    ("U", "S", "at the elbow's ball joints"),
    ("C", "S", "at the carriage's ball joints"),
    ("S", "P SB MP HP", "at the platform's ball joints"),
    ("*", "TL", "at the lower universal joint"),
    ("*", "TU", "at the upper universal joint"),
    ("TL", "EE", "at the lower universal joint"),
    ("TU", "EE", "at the upper universal joint"),
    ("*", "EE", "on the tool's axis"),
    ("MP", "R", "at the rods' ends"),
    ("SB", "MB", "at the middle bar's ends"),
)


@dataclass(frozen=True, eq=False)
class Exchange:
    """A change of p that rows may not determine.

    Attributes:
        words: what may pass between which bodies.
        direction: change of p.
    """

    words: str
    direction: Float[np.ndarray, " parameters"]


def exchanges(
    robot: RobotDescription, layout: ParameterLayout, instances: Sequence[Instance]
) -> tuple[Exchange, ...]:
    """All candidate exchanges, those next to the base first.

    Args:
        instances: bodies along a generic motion, the base last.
    """
    by_name = {name: [body for body in instances if body.name == name] for name in robot.body_names}
    pairs = [(by_name[a], by_name[b]) for a, b in combinations(robot.body_names, 2)]
    proposed = [exchange for a, b in pairs for exchange in _between(layout, a, b)]
    proposed += [exchange for a, b in pairs for exchange in _alike(layout, a, b)]
    resting = {name: _resting(layout, bodies, instances[-1]) for name, bodies in by_name.items()}
    proposed += [  # mass at rest may pass from one body to another wherever the base carries both
        Exchange(f"mass at rest in the base {_passes(a, b)}", resting[a][0][1] - resting[b][0][1])
        for a, b in combinations([name for name, moments in resting.items() if moments], 2)
    ]
    proposed += [
        Exchange(f"the {body_in_words(name)}'s {kind} at rest in the base", direction)
        for name, moments in resting.items()
        for kind, direction in moments
    ]
    proposed += [exchange for a, b in pairs for exchange in _between(layout, a, b, move_alike)]
    return (*proposed, *_rotors(robot, layout), *_geared(robot, layout))


def _between(
    layout: ParameterLayout,
    bodies: Sequence[Instance],
    others: Sequence[Instance],
    partner: Partner = shared,
) -> Iterator[Exchange]:
    if len(bodies) < len(others):
        bodies, others = others, bodies
    pairs = [
        next(filter(None, (partner(body, other) for other in others)), None) for body in bodies
    ]
    met = [pair for pair in pairs if pair is not None]
    if len(met) < len(pairs) or any(len(pair.along) != len(met[0].along) for pair in met):
        return
    if np.ptp([pair.a for pair in met], axis=0).max() > FAINT:
        return
    a, b = bodies[0].name, others[0].name
    counter = _moments([pair.b for pair in met], [pair.along_b for pair in met])
    counts = np.array([body.count for body in bodies]) / sum(body.count for body in others)
    first, second = sorted((a, b), key=layout.bodies.index)
    place = _place(first, second) if partner is shared else "by points that move together"
    for (what, gives), (_, takes) in zip(
        _moments([met[0].a], [met[0].along]), counter, strict=True
    ):
        direction = np.zeros(len(layout.parameters))
        direction[layout.body(a)] += gives[0]
        direction[layout.body(b)] -= counts @ takes
        yield Exchange(f"{what} {place} {_passes(first, second)}", direction)


def _moments(
    points: Sequence[np.ndarray], directions: Sequence[np.ndarray]
) -> list[tuple[str, Float[np.ndarray, "instances 10"]]]:
    """Mass and moments at a point of each instance, with words: moments are derivatives of a point
    mass along a direction."""

    def masses(k: int, step: float) -> np.ndarray:
        moved = (r + step * e[k] if step else r for r, e in zip(points, directions, strict=True))
        return np.stack([RigidBody.point(1.0, r).p for r in moved])

    here = masses(0, 0.0)
    moments = [("mass", here)]
    for k in range(len(directions[0])):
        plus, minus = masses(k, 1.0), masses(k, -1.0)
        moments.append(("first moment", 0.5 * (plus - minus)))
        moments.append(("second moment", 0.5 * (plus + minus) - here))
    return moments


def _alike(
    layout: ParameterLayout, bodies: Sequence[Instance], others: Sequence[Instance]
) -> Iterator[Exchange]:
    """Second moments of bodies that rotate together."""
    a, b = bodies[0], others[0]
    R = turn_alike(a, b) if len(bodies) == len(others) == 1 else None
    if R is None:
        return
    for name, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
        if 3 in (i, j):
            continue
        S, direction = np.zeros((3, 3)), np.zeros(len(layout.parameters))
        S[i, j] = S[j, i] = 1.0
        of_a, of_b = (RigidBody.of_moments(0.0, np.zeros(3), x).p for x in (S, R @ S @ R.T))
        direction[layout.body(a.name)] += of_a
        direction[layout.body(b.name)] -= of_b * a.count / b.count
        yield Exchange(f"the second moment {name} {_passes(a.name, b.name)}", direction)


def _resting(
    layout: ParameterLayout, bodies: Sequence[Instance], base: Instance
) -> list[tuple[str, np.ndarray]]:
    """Mass and moments of a body at points that never move, per kg of its instances."""
    met = [point for body in bodies if (point := shared(body, base)) is not None]
    if len(met) < len(bodies) or np.ptp([point.a for point in met], axis=0).max() > FAINT:
        return []
    per_kg = np.zeros((len(layout.parameters), 10))
    per_kg[layout.body(bodies[0].name)] = np.eye(10) / sum(body.count for body in bodies)
    return [(what, per_kg @ ten[0]) for what, ten in _moments([met[0].a], [met[0].along])]


def _of_entries(layout: ParameterLayout, changes: dict[str, float]) -> np.ndarray:
    return np.array([changes.get(name, 0.0) for name in layout.names])


def _rotors(robot: RobotDescription, layout: ParameterLayout) -> Iterator[Exchange]:
    """Rotors against the inertia that they turn: that of an arm, or of the tool."""
    by_arm = grouped(
        (f"{robot.limb_bodies(i)[0]}.{'Iyy' if limb.drive == 'rotary' else 'm'}", f"drive{i + 1}")
        for i, limb in enumerate(robot.limb_geometry)
        if f"drive{i + 1}" in robot.rotor_drives
    )
    passing = {
        f"rotors and {entry}": {entry: 1.0} | {f"rotor.{drive}": -1.0 for drive in drives}
        for entry, drives in by_arm.items()
    }
    passing |= {
        f"the rotor of {drive} and the tool": {"EE.Izz": 1.0, f"rotor.{drive}": -1.0}
        for drive in (robot.rotor_drives if "EE.Izz" in layout.names else ())
    }
    for pair, changes in passing.items():
        yield Exchange(f"inertia may pass between {pair}", _of_entries(layout, changes))


def _geared(robot: RobotDescription, layout: ParameterLayout) -> Iterator[Exchange]:
    """The tool against platform parts that are geared to its angle ψ.

    Parts that turn by θ = ψ/k: ½ Σ Izz θ̇² = ½ Izz k² θ̇². Parts that slide by ±½ s = ±½ ψ/k have
    the tool at their centre: 2 · ½ m (|ṙ|² + ¼ ṡ²) = ½ (2 m) |ṙ|² + ½ (m / 2k²) ψ̇².
    """
    platform = robot.platform
    if robot.mechanism is not None or isinstance(platform, RigidPlatform):
        return

    def changing(entries: dict[str, float], what: str, body: str) -> Exchange:
        return Exchange(f"{what} {_passes(body, 'EE')}", _of_entries(layout, entries))

    if isinstance(platform, I4Platform):
        k, angle = platform.ratio, np.deg2rad(platform.direction_deg)
        mass = {"HP.m": -1.0, "EE.m": 2.0, "EE.Izz": 0.5 / k**2}
        # At rest the halves' first moments cancel; on their way they balance the tool's turn.
        mass |= {"HP.mcx": -0.5 / k * np.sin(angle), "HP.mcy": 0.5 / k * np.cos(angle)}
        yield changing(mass, "mass where rack and pinion meet", "HP")
        yield changing({"HP.mcz": -1.0, "EE.mcz": 2.0}, "first moment along z", "HP")
        return
    name, count = ("R", 2) if isinstance(platform, Par4Platform) else ("MB", 1)
    yield changing({f"{name}.Izz": platform.ratio**2 / count, "EE.Izz": -1.0}, "inertia", name)


def _passes(a: str, b: str) -> str:
    return f"may pass between {body_in_words(a)} and {body_in_words(b)}"


def _place(a: str, b: str) -> str:
    first, second = a.rstrip("0123456789"), b.rstrip("0123456789")
    places = (place for x, y, place in _PLACES if x in ("*", first) and second in y.split())
    return next(places, f"where {a} and {b} meet")
