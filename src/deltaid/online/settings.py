"""What a user may say about a robot that runs, and what holds where nothing is said; and what a
model knows of itself, in the few directions that matter while the robot runs.

What may be off, and by how much: coefficients of the drives' friction, each by itself, because they
change; and of all else the few directions of p that make most of the torque's uncertainty along the
robot's motions. With p's covariance R Rᵀ and torques Y p along a typical motion, weighed by the
noise, these are the leading singular vectors of Y R; and the mass of what carries the load, a tare.
So a model's error is a constant that is estimated beside the load, and does not average out as
noise would.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import stated_spreads
from deltaid.errors import DeltaidError, positive, within
from deltaid.estimation.posterior_density import density
from deltaid.model.model import Model
from deltaid.motion.random_motion import random_motion
from deltaid.online.entries import LoadEntries, load_entries

# From the gripper's signal to the load [s], at most.
LONGEST_GRIP = 10.0
# Cycles in the time constant of the filter, at least, where it is chosen by the rate.
_CYCLES = 5.0


@dataclass(frozen=True)
class OnlineSettings:
    """How a robot is watched while it runs.

    Attributes:
        rate: cycles a second [Hz].
        corner: K of the filter of torques [1/s].
        speed: 'measured' where each cycle has a velocity of the same instant; 'differenced' where
            it comes from two positions: everything is then taken half a cycle earlier, between
            them, where the difference has no lag.
        torque: 'sampled' where it is measured together with the position, 'held' where it is the
            command that holds from this cycle to the next.
        largest_mass: of a load [kg]; None for three times the body that carries it.
        extent: how far a load reaches from the frame of the body that carries it [m].
        least_mass: attach and release of less are not looked for [kg]; None for 1 % of the largest.
        body: what carries loads; EE, or P where there is no EE, if None.
        grip_time: how long after the gripper's signal a load is not yet held, or still [s].
        noise: standard deviation of one cycle's torque, drive by drive, on the joint's side
            [N m or N]; None for what the identification left, 2 % of a drive's torque without one.
        unmodelled: standard deviation of torques that the model does not have and that stay for
            some hundredths of a second, drive by drive, while it moves: what it begins with, and
            how large they are is learnt; None for what the identification left.
        rest_speed: speed [rad/s or m/s] below which the direction of friction is not known.
        friction_range: share by which friction may be off or may change.
        friction_time: over which friction may change by that much [s].
        false_alarms: of contact that are accepted in an hour.
        speed_noise: standard deviation of one cycle's speed, drive by drive [rad/s or m/s]; None
            where it is not known: it is learnt then while the drives move (`online.cycle`).
        alarm: how many standard deviations make a change of load.
        delay: by how much torques are reported later than their motion, drive by drive or one for
            all [s], negative where they are early; None for what the identification found, 0 for
            none. All that is known is as late as the largest.
        torque_ends: size of the torque, drive by drive and as the drives report it, at which the
            channel ends, so that it may be more; None for no such end [N m or N].
    """

    rate: float = 1000.0
    corner: float = 150.0
    speed: Literal["measured", "differenced"] = "measured"
    torque: Literal["sampled", "held"] = "sampled"
    largest_mass: float | None = None
    extent: float = 0.15
    least_mass: float | None = None
    body: str | None = None
    grip_time: float = 0.0
    noise: tuple[float, ...] | None = None
    unmodelled: tuple[float, ...] | None = None
    rest_speed: float = 0.02
    friction_range: float = 0.3
    friction_time: float = 10.0
    alarm: float = 3.0
    false_alarms: float = 1.0
    speed_noise: tuple[float, ...] | None = None
    delay: float | tuple[float, ...] | None = None
    torque_ends: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in (
            "rate", "corner", "extent", "rest_speed", "friction_time", "alarm",
            "largest_mass", "least_mass", "noise", "unmodelled",
        ):  # fmt: skip
            given = getattr(self, name)
            for value in np.atleast_1d(() if given is None else given):
                positive(name, float(value), (0.0, 1e9))
        within("friction_range", self.friction_range, (0.0, 1.0))
        within("grip_time", self.grip_time, (0.0, LONGEST_GRIP))
        if self.corner > self.rate:
            raise DeltaidError(
                f"of {self.corner:g} 1/s is faster than the cycle of {self.rate:g} Hz",
                where="corner",
                cure="take at most a fifth of the rate",
            )
        for name, first, second in (
            ("torque", "sampled", "held"),
            ("speed", "measured", "differenced"),
        ):
            value = getattr(self, name)
            if value not in (first, second):
                raise DeltaidError(f"must be '{first}' or '{second}', not {value!r}", where=name)

    def at_rate(self, rate: float) -> "OnlineSettings":
        """The same at another rate, with a filter that is no faster than a fifth of it."""
        return replace(self, rate=rate, corner=min(self.corner, rate / _CYCLES))

    @property
    def period(self) -> float:
        """Seconds that a cycle takes."""
        return 1 / self.rate


# Directions beside friction, at most, and how large their torque must be, as a share of the noise.
_DIRECTIONS, _SMALLEST = 3, 0.1
# Torque noise and unmodelled torque where nothing is known of them, as shares of a drive's largest.
_NOISE, _UNMODELLED = 0.02, 0.01
# Torques that a model has not, as a share of what the fit left; and of slow drives also as a share
# of their dry friction, slow as a share of their largest speed.
_OF_FIT, _OF_FRICTION, _SLOW = 1.0, 0.25, 0.05
# Friction that is followed.
_FOLLOWED = ("viscous", "coulomb", "viscous_back", "coulomb_back", "offset")
# Typical motion: seconds and samples.
_PERIOD, _SAMPLES = 8.0, 800
# Largest load where nothing is said of it, in masses of what carries it.
_LOAD_SHARE = 3.0
# What carries a load may be heavier or lighter than identified, beside what the intervals say, by
# this share of the largest load: nothing that a model lacks is wholly without a mean.
_TARE = 0.01


@dataclass(frozen=True, eq=False)
class OnlineKnowledge:
    """Numbers that a cycle is made with.

    Attributes:
        entries: what torques show of a load, with
        load_scales: the sizes of its entries for the largest mass, and
        least_mass: the least that is looked for [kg].
        directions: of p beside friction, by which the model may be off; columns, one deviation.
        followed: places in p of the friction that is followed.
        friction_std: of each.
        noise: of one cycle's torque, drive by drive.
        unmodelled: torques that the model has not, drive by drive, and
        unmodelled_slow: further ones of drives that are slow, that is near or below
        slow_speed: of each drive [rad/s or m/s].
        largest: torque along a typical motion, drive by drive.
    """

    entries: LoadEntries
    load_scales: tuple[float, ...]
    least_mass: float
    directions: Float[np.ndarray, "parameters directions"]
    followed: tuple[int, ...]
    friction_std: tuple[float, ...]
    noise: Float[np.ndarray, " drives"]
    unmodelled: Float[np.ndarray, " drives"]
    unmodelled_slow: Float[np.ndarray, " drives"]
    slow_speed: Float[np.ndarray, " drives"]
    largest: Float[np.ndarray, " drives"]


def knowledge(model: Model, settings: OnlineSettings) -> OnlineKnowledge:
    """What is known of a model.

    Raises:
        DescriptionError: no such body to carry a load.
        DeltaidError: noise is not given for each drive.
    """
    dynamics, layout, found = model.dynamics, model.layout, model.identified
    entries, root = load_entries(dynamics, settings.body), _root(model)
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0), period=_PERIOD)
    pose = motion.evaluate(np.linspace(0, _PERIOD, _SAMPLES, endpoint=False))
    q, qd, qdd = dynamics.kinematics.drive_motion(*pose)
    Y = dynamics.regressor(q, qd, qdd, np.zeros_like(q))
    largest = np.abs(Y @ model.p).max(axis=0)
    noise, unmodelled = largest * _NOISE, largest * _UNMODELLED
    if found is not None:
        noise = np.array(found.fit.rms_unfiltered) * model.gains
        unmodelled = _OF_FIT * np.array(found.fit.rms) * model.gains
    noise = _each(settings.noise, "noise", model, noise)
    unmodelled = _each(settings.unmodelled, "unmodelled", model, unmodelled)
    followed = tuple(
        k
        for k, parameter in enumerate(layout.parameters)
        if parameter.kind == "friction"
        and parameter.symbol in _FOLLOWED
        and parameter.owner in model.robot.drives
    )
    places, rest = list(followed), root.copy()
    rest[places] = 0.0
    std = np.sqrt(np.sum(root[places] ** 2, axis=1))
    std = np.maximum(std, settings.friction_range / 2 * np.abs(model.p[places]))
    seen = (Y @ rest) / noise[:, None] / np.sqrt(_SAMPLES)
    _, sizes, V = np.linalg.svd(seen.reshape(-1, rest.shape[1]), full_matrices=False)
    count = min(_DIRECTIONS, int(np.sum(sizes > _SMALLEST)))
    left_out = np.sqrt(np.mean(np.sum((Y @ (rest @ V[count:].T)) ** 2, axis=2), axis=0))
    mass = settings.largest_mass or _LOAD_SHARE * float(model.body(entries.body)[0])
    tare = np.zeros((len(model.p), 1))
    tare[layout.body(entries.body).start] = _TARE * mass
    return OnlineKnowledge(
        entries=entries,
        load_scales=entries.scales(mass, settings.extent),
        least_mass=settings.least_mass or 0.01 * mass,
        directions=np.hstack([rest @ V[:count].T, tare]),
        followed=followed,
        friction_std=tuple(std.tolist()),
        noise=noise,
        unmodelled=unmodelled if settings.unmodelled else np.hypot(unmodelled, left_out),
        unmodelled_slow=np.maximum(_OF_FRICTION * _dry(model), 1e-9),
        slow_speed=_SLOW * np.abs(qd).max(axis=0),
        largest=largest,
    )


def _dry(model: Model) -> Float[np.ndarray, " drives"]:
    found = dict.fromkeys(model.robot.drives, 0.0)
    for k, term in enumerate(model.robot.friction_terms, start=model.layout.friction.start):
        if term.joint in found and not term.continuous and not term.of_load:
            found[term.joint] += abs(float(model.p[k]))
    return np.array([*found.values()])


def _each(
    given: tuple[float, ...] | None, name: str, model: Model, else_: Float[np.ndarray, " drives"]
) -> Float[np.ndarray, " drives"]:
    """What was given for each drive, or what holds else.

    Raises:
        DeltaidError: it has another number than there are drives.
    """
    if given is None:
        return np.maximum(else_, 1e-9)
    if len(given) != len(model.robot.drives):
        raise DeltaidError(
            f"has {len(given)} numbers, and the robot has {len(model.robot.drives)} drives",
            where=name,
            cure="give one for each drive",
        )
    return np.array(given)


def _root(model: Model) -> Float[np.ndarray, "parameters n"]:
    """R with p's covariance R Rᵀ: of the posterior, else of the priors, each by itself."""
    found, spreads = model.identified, stated_spreads(model.robot)
    if found is not None and found.posterior is not None:
        posterior = density(found, model.source)
        return posterior.reduction.A @ posterior.root
    if found is not None:
        return np.diag([parameter.std for parameter in found.parameters])
    parameters = model.layout.parameters
    return np.diag([spreads.get(x.name, model.prior_spread) * x.scale for x in parameters])
