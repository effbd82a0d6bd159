"""What a user may say about a robot that runs, and what holds where nothing is said."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from deltaid.errors import DeltaidError
from deltaid.online.contact import threshold

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
            where it is not known: how large residuals are is learnt then, from some seconds on.
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
                if not 0 < value < 1e9:
                    raise DeltaidError(f"must be a positive number, and is {value:g}", where=name)
        if not 0 <= self.friction_range < 1:
            raise DeltaidError(
                f"must lie between 0 and 1, and is {self.friction_range:g}", where="friction_range"
            )
        if not 0 <= self.grip_time <= LONGEST_GRIP:
            raise DeltaidError(
                f"must lie between 0 and {LONGEST_GRIP:g} s, and is {self.grip_time:g}",
                where="grip_time",
            )
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

    def contact_threshold(self, dof: int) -> float:
        """How large a residual must be for a contact, in deviations (`online.contact`)."""
        return threshold(self.false_alarms, self.corner, dof)

    def at_rate(self, rate: float) -> "OnlineSettings":
        """The same at another rate, with a filter that is no faster than a fifth of it."""
        return replace(self, rate=rate, corner=min(self.corner, rate / _CYCLES))

    @property
    def period(self) -> float:
        """Seconds that a cycle takes."""
        return 1 / self.rate
