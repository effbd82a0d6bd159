"""What is known of positions and sizes over the workspace, and which numbers are not known.

Slopes J of tool points by the numbers, less rigid motions (where a robot stands is no error of
its geometry), make of the covariance of u that of positions: E = P J G L with Cov u = L Lᵀ. Its
singular vectors are the motions of the workspace that remain uncertain; each comes from one
combination of numbers, which readings decide in part and the description for the rest.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from deltaid.calibration.fit import GeometryFit
from deltaid.calibration.loops import Loops
from deltaid.calibration.unknowns import WORDS, Unknowns
from deltaid.mechanism.kinematics import Kinematics

# Places over the workspace that stand for all of it, and the seed that draws them.
PLACES, _SEED = 200, 1
# A combination counts where it makes this share of the whole remaining error, or more ...
_MATTERS = 0.2
# ... and is not known from readings where these decide less than half of it, or where it makes
# more of positions than this many times their noise.
_HALF, _WEAK = 0.5, 5.0
# Numbers are named that move at least this share of their spread before, against the largest.
_NAMED = 0.3
# Most kinds of numbers that a sentence names, and what they are shown in.
_LISTED, _SHOWN = 3, {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "": (100, "%")}


@dataclass(frozen=True)
class Direction:
    """A combination of numbers that measurements do not know: what it does, in words and of
    positions, root mean square [m], and sizes across, as a share; one standard deviation of it."""

    words: str
    error: float
    size: float
    numbers: dict[str, float] = field(repr=False)


@dataclass(frozen=True)
class Knows:
    """Standard deviations of positions over the workspace, root mean square and where it is largest
    [m], and of sizes across, as a share."""

    position: float
    worst: float
    size: float


@dataclass(frozen=True, eq=False)
class Places:
    """Tool points over a workspace [m], and what a unit of each number moves them by, less rigid
    motions."""

    x: Float[np.ndarray, "places 3"]
    moved: Float[np.ndarray, "entries numbers"]

    def knows(self, root: Float[np.ndarray, "numbers _"]) -> Knows:
        """What is known of positions and sizes."""
        errors = self.errors(root)
        return Knows(float(np.sqrt(np.mean(errors**2))), float(errors.max()), self.size(root))

    def errors(self, root: Float[np.ndarray, "numbers _"]) -> Float[np.ndarray, " places"]:
        """Standard deviation of positions at each place [m], for L with Cov θ = L Lᵀ."""
        return np.linalg.norm((self.moved @ root).reshape(len(self.x), -1), axis=1)

    def size(self, root: Float[np.ndarray, "numbers _"]) -> float:
        """Standard deviation of sizes across, as a share."""
        return float(np.linalg.norm(_across(self.x) @ self.moved @ root))


def _across(x: Float[np.ndarray, "places 3"]) -> Float[np.ndarray, " entries"]:
    """Takes displacements to the share by which they grow in x and y."""
    f = x - x.mean(axis=0)
    f[:, 2] = 0.0
    return f.ravel() / np.sum(f**2)


def places(loops: Loops, known: Unknowns, theta: Float[np.ndarray, " numbers"]) -> Places:
    """Places over the described workspace that the robot reaches."""
    x, slopes = loops.points(drawn(loops.kinematics, loops.limbs), theta)
    J, arms = slopes.reshape(-1, len(known.numbers)), x - x.mean(axis=0)
    turns = [np.cross(axis, arms).ravel() for axis in np.eye(3)]
    Q = np.linalg.qr(np.column_stack([*np.tile(np.eye(3), (len(x), 1)).T, *turns]))[0]
    return Places(x, J - Q @ (Q.T @ J))


def drawn(
    kinematics: Kinematics, limbs: int, count: int = PLACES, seed: int = _SEED
) -> Float[np.ndarray, "places drives"]:
    """Drive coordinates at random places of the workspace, away from singularities."""
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


def open_directions(found: GeometryFit, over: Places) -> tuple[Direction, ...]:
    """Combinations that matter and that measurements do not know, the worst first."""
    known, C = found.known, found.root @ found.root.T
    L = np.linalg.cholesky(C + 1e-14 * np.trace(C) * np.eye(len(C)))
    _, s, Vt = np.linalg.svd(over.moved @ known.G @ L, full_matrices=False)
    noise = max(readings.noise for readings in found.readings)
    reach = float(np.sqrt(np.mean(np.sum((over.x - over.x.mean(axis=0))[:, :2] ** 2, axis=1))))
    directions = []
    for size, u in zip(s, (L @ Vt.T).T, strict=True):
        # with the posterior's metric uᵀC⁻¹u = 1 = |u|² (the description's share) + data's
        error = float(size / np.sqrt(len(over.x)))
        if size < _MATTERS * np.linalg.norm(s) or (u @ u < _HALF and error < _WEAK * noise):
            continue
        theta = known.G @ u
        grows = float(_across(over.x) @ over.moved @ theta)
        theta, grows = theta * (np.sign(grows) or 1.0), abs(grows)
        what = "shape stays uncertain"
        if grows * reach > np.sqrt(_HALF) * error:
            what = f"sizes stay uncertain by {100 * grows:.2g} %"
        words = f"{what}, positions by {1e3 * error:.2g} mm: {_named(known, theta)}"
        numbers = dict(zip(known.names, theta.tolist(), strict=True))
        directions.append(Direction(words, error, grows, numbers))
    return tuple(directions)


def _named(known: Unknowns, theta: Float[np.ndarray, " numbers"]) -> str:
    """Such as 'strut +2.7 mm, zero -0.3 mrad (limb 2 most)'."""
    named = []
    for kind in known.kinds:
        at = known.of_kind(kind)
        own, mean, number = theta[at], float(np.mean(theta[at])), known.numbers[at[0]]
        largest = int(np.argmax(np.abs(own)))
        # alike in all limbs where their mean makes most of it
        alike = abs(mean) * np.sqrt(len(at)) > np.sqrt(_HALF) * np.linalg.norm(own)
        peak, most = (mean, "") if alike else (float(own[largest]), f" (limb {largest + 1} most)")
        factor, unit = _SHOWN[number.unit]
        text = f"{WORDS[kind]} {factor * peak:+.2g} {unit}{most}"
        named.append((abs(peak) / (number.spread or np.inf), text))
    named.sort(key=lambda entry: -entry[0])
    return ", ".join([text for share, text in named if share > _NAMED * named[0][0]][:_LISTED])
