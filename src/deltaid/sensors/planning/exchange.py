"""Changes of p that may stay unseen, with words for them: what bodies could give to one another.

A mass μ at a point r of a body adds μ [1, r, r² E − r rᵀ] to its ten parameters. Where every
instance of a body A shares a point with some instance of B, mass may leave A there and turn up in
B; along a shared axis first and second moments may as well. Bodies that share parameters, such as
the struts, all change alike, so what B gets is shared among its instances, and whether the exchange
stays unseen is for the rows to say (`sensors.planning.null_space`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import ParameterLayout
from deltaid.robot.body import body_in_words
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, RigidBody, inertia_parameters
from deltaid.robot.platform import I4Platform, Par4Platform, RigidPlatform
from deltaid.sensors.planning.shared_points import Instance, Shared, move_alike, shared, turn_alike

Partner = Callable[[Instance, Instance], Shared | None]
Ten = Float[np.ndarray, " 10"]

_PLATFORM = ("P", "SB", "MP", "HP")


@dataclass(frozen=True, eq=False)
class Exchange:
    """Attributes:
    words: what passes from where to where.
    direction: how p changes.
    """

    words: str
    direction: Float[np.ndarray, " parameters"]


def exchanges(
    robot: RobotDescription, layout: ParameterLayout, found: Sequence[Instance]
) -> tuple[Exchange, ...]:
    """All that could pass between bodies, that next to the base first.

    Args:
        found: the bodies along a generic motion, the base last.
    """
    by_name = {name: [body for body in found if body.name == name] for name in robot.body_names}
    pairs = [(by_name[a], by_name[b]) for a, b in combinations(robot.body_names, 2)]
    proposed = [exchange for a, b in pairs for exchange in _between(layout, a, b)]
    proposed += [exchange for a, b in pairs for exchange in _alike(layout, a, b)]
    resting = {name: _resting(layout, bodies, found[-1]) for name, bodies in by_name.items()}
    for a, b in combinations([name for name, moments in resting.items() if moments], 2):
        # Mass at rest may pass from one body to another wherever the base carries both.
        words = f"mass at rest in the base {_passes(a, b)}"
        proposed.append(Exchange(words, resting[a][0][1] - resting[b][0][1]))
    for name, moments in resting.items():
        what = f"{body_in_words(name)}'s" if moments else ""
        for kind, direction in moments:
            proposed.append(Exchange(f"the {what} {kind} at rest in the base", direction))
    moving = [exchange for a, b in pairs for exchange in _between(layout, a, b, move_alike)]
    return (*proposed, *moving, *_rotors(robot, layout), *_geared(robot, layout))


def point_mass(r: Float[np.ndarray, " 3"]) -> Ten:
    """The ten parameters of 1 kg at a point."""
    return RigidBody.point(1.0, r).p


def _between(
    layout: ParameterLayout,
    bodies: Sequence[Instance],
    others: Sequence[Instance],
    partner: Partner = shared,
) -> Iterator[Exchange]:
    """Exchanges of two bodies at the points that they share, or that move alike."""
    if len(bodies) < len(others):
        bodies, others = others, bodies
    pairs = [_partner(body, others, partner) for body in bodies]
    met = [pair for pair in pairs if pair is not None]
    if len(met) < len(pairs):
        return
    points = [pair.a for pair in met]
    if any(len(pair.along) != len(met[0].along) for pair in met) or (
        np.ptp(points, axis=0).max() > 1e-7
    ):
        return
    a, b = bodies[0].name, others[0].name
    moments = _moments([pair.a for pair in met], [pair.along for pair in met])
    counter = _moments([pair.b for pair in met], [pair.along_b for pair in met])
    counts = np.array([body.count for body in bodies], dtype=float)
    all_b = sum(body.count for body in others)
    first, second = sorted((a, b), key=layout.bodies.index)
    place = _place(first, second) if partner is shared else "by points that move together"
    for (what, gives), (_, takes) in zip(moments, counter, strict=True):
        direction = np.zeros(len(layout.parameters))
        direction[layout.body(a)] += gives[0]
        direction[layout.body(b)] -= counts @ takes / all_b
        yield Exchange(f"{what} {place} {_passes(first, second)}", direction)


def _partner(body: Instance, others: Sequence[Instance], partner: Partner) -> Shared | None:
    found = (partner(body, other) for other in others)
    return next((point for point in found if point is not None), None)


def _moments(
    points: Sequence[np.ndarray], directions: Sequence[np.ndarray]
) -> list[tuple[str, Float[np.ndarray, "instances 10"]]]:
    """What may leave all instances at their points and along their directions, in words: moments
    are derivatives of a point mass along a direction."""
    here = np.stack([point_mass(r) for r in points])
    found = [("mass", here)]
    for k in range(len(directions[0])):
        plus, minus = (
            np.stack([point_mass(r + sign * e[k]) for r, e in zip(points, directions, strict=True)])
            for sign in (1, -1)
        )
        found.append(("first moment", 0.5 * (plus - minus)))
        found.append(("second moment", 0.5 * (plus + minus) - here))
    return found


def _alike(
    layout: ParameterLayout, bodies: Sequence[Instance], others: Sequence[Instance]
) -> Iterator[Exchange]:
    """Second moments of bodies that turn alike."""
    a, b = bodies[0], others[0]
    R = turn_alike(a, b) if len(bodies) == len(others) == 1 else None
    if R is None:
        return
    for name, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
        if 3 in (i, j):
            continue
        S, T = np.zeros((4, 4)), np.zeros((4, 4))
        S[i, j] = S[j, i] = 1.0
        T[:3, :3] = R @ S[:3, :3] @ R.T
        direction = np.zeros(len(layout.parameters))
        direction[layout.body(a.name)] += inertia_parameters(S)
        direction[layout.body(b.name)] -= inertia_parameters(T) * a.count / b.count
        yield Exchange(f"the second moment {name} {_passes(a.name, b.name)}", direction)


def _resting(
    layout: ParameterLayout, some: Sequence[Instance], base: Instance
) -> list[tuple[str, np.ndarray]]:
    """What of a body is at rest: mass and moments at points that never move, per kg of them."""
    found = [shared(body, base) for body in some]
    met = [point for point in found if point is not None]
    if len(met) < len(found) or np.ptp([point.a for point in met], axis=0).max() > 1e-7:
        return []
    total, result = sum(body.count for body in some), []
    for what, ten in _moments([met[0].a], [met[0].along]):
        direction = np.zeros(len(layout.parameters))
        direction[layout.body(some[0].name)] = ten[0] / total
        result.append((what, direction))
    return result


def _of_entries(layout: ParameterLayout, changes: dict[str, float]) -> np.ndarray:
    """The direction of p that changes some entries, by name."""
    direction = np.zeros(len(layout.names))
    for name, value in changes.items():
        direction[layout.names.index(name)] = value
    return direction


def _rotors(robot: RobotDescription, layout: ParameterLayout) -> Iterator[Exchange]:
    """A rotor against the inertia that it turns: of all limbs that share an arm, or of the tool."""
    by_arm: dict[str, dict[str, float]] = {}
    for i, limb in enumerate(robot.limb_geometry):
        drive, arm = f"drive{i + 1}", robot.limb_bodies(i)[0]
        if drive in robot.rotor_drives:
            entry = f"{arm}.Iyy" if limb.drive == "rotary" else f"{arm}.m"
            by_arm.setdefault(entry, {entry: 1.0})[f"rotor.{drive}"] = -1.0
    for entry, changes in by_arm.items():
        words = f"inertia may pass between rotors and {entry}"
        yield Exchange(words, _of_entries(layout, changes))
    for drive in robot.rotor_drives if "EE.Izz" in layout.names else ():
        words = f"inertia may pass between the rotor of {drive} and the tool"
        yield Exchange(words, _of_entries(layout, {"EE.Izz": 1.0, f"rotor.{drive}": -1.0}))


def _geared(robot: RobotDescription, layout: ParameterLayout) -> Iterator[Exchange]:
    """The tool against the parts of the platform that its angle ψ is geared to.

    Parts that turn by θ = ψ/k: ½ Σ Izz θ̇² = ½ Izz k² θ̇². Parts that slide by ±½ s = ±½ ψ/k have
    their middle where the tool is: 2 · ½ m (|ṙ|² + ¼ ṡ²) = ½ (2 m) |ṙ|² + ½ (m / 2k²) ψ̇².
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
    """Where two bodies meet, in words."""
    first, second = a.rstrip("0123456789"), b.rstrip("0123456789")
    match first, second:
        case ("U" | "C", "S"):
            return "at the elbow's ball joints" if first == "U" else "at the carriage's ball joints"
        case "S", _ if second in _PLATFORM:
            return "at the platform's ball joints"
        case _, "TL" | "TU":
            return f"at the {'lower' if second == 'TL' else 'upper'} universal joint"
        case "TL", "EE":
            return "at the lower universal joint"
        case "TU", "EE":
            return "at the upper universal joint"
        case _, "EE":
            return "on the tool's axis"
        case "MP", "R":
            return "at the rods' ends"
        case "SB", "MB":
            return "at the middle bar's ends"
        case _:
            return f"where {a} and {b} meet"
