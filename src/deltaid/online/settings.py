"""Settings of online estimation, and a model's uncertainty in the few directions that matter.

Uncertain are the coefficients of the drives' friction, each by itself, because they change, and a
few directions of all other parameters p that make most of the torque's uncertainty. With p's
covariance R Rᵀ and torques Y p along a typical motion, weighted by the noise, these are the leading
singular vectors of Y R, and the mass of the body that carries the load, a tare. So a model's error
is a constant that is estimated together with the load, and does not average out like noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from numbers import Real
from types import NoneType
from typing import Literal

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.parameters import stated_spreads
from deltaid.errors import DeltaidError, positive, typed, within
from deltaid.estimation.posterior_density import density
from deltaid.levels import TORQUE_NOISE
from deltaid.model.model import Model
from deltaid.motion.random_motion import INSTANTS, random_motion
from deltaid.online.entries import LoadEntries, load_entries

# Fix for a model without intervals.
IDENTIFY_FIRST = "identify a model from a recording first, `deltaid identify`"
# Longest time from the gripper's signal to the load [s].
LONGEST_GRIP = 10.0
# Largest share of rows that repeat the previous one, and time [s] by which the mass is known after
# a load is taken, even if its signal is late.
MOST_STALE, SOON = 0.2, 0.2
# Least number of cycles in the filter's time constant if it follows from the rate.
_CYCLES = 5.0
# Settings with a number for each drive, and settings that are positive.
_OF_DRIVES = ("noise", "unmodelled", "speed_noise", "torque_ends")
_POSITIVE = (
    "rate", "corner", "extent", "rest_speed", "friction_time", "alarm", "largest_mass",
    "least_mass", "noise", "unmodelled",
)  # fmt: skip


@dataclass(frozen=True)
class OnlineSettings:
    """Settings of online estimation.

    Attributes:
        rate: cycles per second [Hz].
        corner: K of the torque filter [1/s].
        speed: 'measured' if each cycle has a velocity of the same instant; 'differenced' if it
            comes from two positions: estimates then refer to the middle between them, where the
            difference has no lag.
        torque: 'sampled' if it is measured together with the position, 'held' if it is the command
            that holds from this cycle to the next.
        largest_mass: of a load [kg]; None for three times the body that carries it.
        extent: reach of a load from the frame of the body that carries it [m].
        least_mass: least detected mass [kg]; None for 1 % of the largest.
        body: that carries loads; None for EE, or P where there is no EE.
        grip_time: from the gripper's signal until a load is held, or released [s].
        noise: standard deviation of one cycle's torque, drive by drive, on the joint's side
            [N m or N]; None for the identification's residual, else 2 % of a drive's torque.
        unmodelled: initial standard deviation of unmodelled torques that last some hundredths of a
            second, drive by drive, in motion [N m or N]; learnt from there. None for the
            identification's residual.
        rest_speed: speed [rad/s or m/s] below which the direction of friction is unknown.
        friction_range: relative uncertainty of friction.
        friction_time: in which friction may change by that much [s].
        false_alarms: accepted false alarms of contact per hour.
        speed_noise: standard deviation of one cycle's speed, drive by drive [rad/s or m/s]; None to
            learn it while the drives move (`online.cycle`).
        alarm: score of a change of load that is detected, in standard deviations.
        delay: lag of reported torques behind their motion, drive by drive or one for all [s],
            negative if early; None for the identification's, 0 for none. All estimates are
            delayed by the largest lag.
        torque_ends: reported torque, drive by drive, at which the channel saturates; None if it
            does not [N m or N].
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
        typed("body", self.body, (str, NoneType), "the name of a body")
        for entry in fields(self):
            name, given = entry.name, getattr(self, entry.name)
            if name in ("speed", "torque", "body") or given is entry.default is None:
                continue
            if name in _OF_DRIVES:
                typed(name, given, (Sequence, np.ndarray), "a number for each drive")
            elif name != "delay":
                typed(name, given, Real, "a number")
            for value in np.atleast_1d(given).tolist():
                typed(name, value, Real, "a number")
                if name in _POSITIVE:
                    positive(name, value, (0.0, 1e9))
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
        """The settings at another rate, with a corner of at most a fifth of it."""
        typed("rate", rate, Real, "a number")
        return replace(self, rate=rate, corner=min(self.corner, rate / _CYCLES))

    @property
    def period(self) -> float:
        """Duration of a cycle [s]."""
        return 1 / self.rate


# Largest number of directions in addition to friction, and least torque of one in units of the
# noise.
_DIRECTIONS, _SMALLEST = 3, 0.1
# Default unmodelled torque, as a share of a drive's largest torque.
_UNMODELLED = 0.01
# Unmodelled torque of slow drives in addition as a share of their dry friction; slow as a share of
# the largest speed.
_OF_FRICTION, _SLOW = 0.25, 0.05
# Symbols of the friction coefficients that are followed.
_FOLLOWED = ("viscous", "coulomb", "viscous_back", "coulomb_back", "offset")
# Default largest load, in masses of the body that carries it.
_LOAD_SHARE = 3.0
# Deviation of the carrying body's mass in addition to its interval, as a share of the largest load:
# unmodelled torques rarely have a mean of exactly zero.
_TARE = 0.01


@dataclass(frozen=True, eq=False)
class OnlineKnowledge:
    """Uncertainty and sizes of a model that a cycle uses.

    Attributes:
        entries: identifiable entries of a load.
        load_scales: sizes of the entries for the largest mass.
        least_mass: least detected mass [kg].
        directions: uncertain directions of p without friction, one deviation per column.
        followed: indices in p of the followed friction.
        friction_std: standard deviation of each.
        noise: of one cycle's torque, drive by drive.
        unmodelled: unmodelled torques, drive by drive.
        unmodelled_slow: additional ones of slow drives.
        slow_speed: below which a drive is slow [rad/s or m/s].
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
    """Uncertainty of a model for online estimation.

    Raises:
        DescriptionError: the body that carries loads does not exist.
        DeltaidError: noise is not given for each drive.
    """
    dynamics, layout, identified = model.dynamics, model.layout, model.identified
    entries, root = load_entries(dynamics, settings.body), _root(model)
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0))
    pose = motion.evaluate(np.linspace(0, motion.period, INSTANTS, endpoint=False))
    q, qd, qdd = dynamics.kinematics.drive_motion(*pose)
    Y = dynamics.regressor(q, qd, qdd, np.zeros_like(q))
    largest = np.abs(Y @ model.p).max(axis=0)
    noise, unmodelled = largest * TORQUE_NOISE, largest * _UNMODELLED
    if identified is not None:
        noise = np.array(identified.fit.rms_unfiltered) * model.gains
        unmodelled = np.array(identified.fit.rms) * model.gains
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
    seen = (Y @ rest) / noise[:, None] / np.sqrt(INSTANTS)
    _, sizes, V = np.linalg.svd(seen.reshape(-1, rest.shape[1]), full_matrices=False)
    count = min(_DIRECTIONS, int(np.sum(sizes > _SMALLEST)))
    dropped = np.sqrt(np.mean(np.sum((Y @ (rest @ V[count:].T)) ** 2, axis=2), axis=0))
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
        unmodelled=unmodelled if settings.unmodelled else np.hypot(unmodelled, dropped),
        unmodelled_slow=np.maximum(_OF_FRICTION * _dry(model), 1e-9),
        slow_speed=_SLOW * np.abs(qd).max(axis=0),
        largest=largest,
    )


def _dry(model: Model) -> Float[np.ndarray, " drives"]:
    friction = dict.fromkeys(model.robot.drives, 0.0)
    for k, term in enumerate(model.robot.friction_terms, start=model.layout.friction.start):
        if term.joint in friction and not term.continuous and not term.of_load:
            friction[term.joint] += abs(float(model.p[k]))
    return np.array([*friction.values()])


def _each(
    given: tuple[float, ...] | None, name: str, model: Model, else_: Float[np.ndarray, " drives"]
) -> Float[np.ndarray, " drives"]:
    """Given numbers of all drives, or default ones.

    Raises:
        DeltaidError: the number of values is not the number of drives.
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
    """R with p's covariance R Rᵀ, of the posterior or else of independent intervals or priors."""
    identified, spreads = model.identified, stated_spreads(model.robot)
    if identified is not None and identified.posterior is not None:
        posterior = density(identified, model.source)
        return posterior.reduction.A @ posterior.root
    if identified is not None:
        return np.diag([parameter.std for parameter in identified.parameters])
    parameters = model.layout.parameters
    return np.diag([spreads.get(x.name, model.prior_spread) * x.scale for x in parameters])
