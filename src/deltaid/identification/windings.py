"""Recordings in memory whose gears wind up: what they carry, and the links' motion behind them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.traces import Trace
from deltaid.recording.filter import HIGHEST, LowPass
from deltaid.recording.gears import Gears, convolved
from deltaid.recording.windows import Samples
from deltaid.robot.description import RobotDescription

# The low-pass over what gears carry, as a multiple of that over rows.
_WIDER = 2.5
# What a gear carries counts as known from this share of what its motor takes by itself.
_LOADED = 0.2

Compliance = Float[np.ndarray, " dof"]


def motors_of(robot: RobotDescription, p: Parameters, cutoff: float, rate: float) -> Gears:
    """Stiff gears between links and motors with the friction and rotors of p.

    Args:
        cutoff: of the low-pass over rows [Hz], which that over what gears carry must not bend.
        rate: samples per second.
    """
    layout = parameter_layout(robot)
    named = dict(zip((one.name for one in layout.parameters), p.tolist(), strict=True))

    def of(kind: str) -> tuple[float, ...]:
        return tuple(named.get(f"{kind}.{drive}", 0.0) for drive in robot.drives)

    stiff = (0.0,) * len(robot.drives)
    widest = min(_WIDER * cutoff, HIGHEST * rate)
    return Gears(stiff, of("viscous"), of("coulomb"), of("rotor"), widest)


@dataclass(frozen=True, eq=False)
class Windings:
    """A trace of the motors' motion, and what gears carry along it: τ_g, its rate, and the next.

    Attributes:
        trace: without the ends for which τ_g is not known.
        motors: with their friction and rotors.
        carried: for each stretch (3, samples, drives).
    """

    trace: Trace
    motors: Gears
    carried: tuple[Float[np.ndarray, "3 _ dof"], ...]

    def by_model(self, p: Parameters) -> "Windings":
        """The same with what gears carry by the torques of p along this motion."""
        dynamics = self.trace.dynamics

        def torque(w: Samples) -> np.ndarray:
            return dynamics.carried(w.z, w.qd, w.qdd, p) + w.carried

        return _along(self.trace, self.motors, torque)

    def inner(self, low_pass: LowPass) -> "Windings":
        """The same without the ends that a filter takes."""
        lost, stretches, carried = low_pass.margin, list[Samples](), list[np.ndarray]()
        for w, along in zip(self.trace.stretches, self.carried, strict=True):
            if len(w.time) > 2 * lost:
                kept = slice(lost, len(w.time) - lost)
                stretches.append(w.part(kept))
                carried.append(along[:, kept])
        trace = replace(self.trace, stretches=tuple(stretches))
        return Windings(trace, self.motors, tuple(carried))

    @property
    def loaded(self) -> np.ndarray:
        """Whose gears carry a good share of what their motors take by themselves; of others, how
        much is carried is hardly known."""
        carried = np.concatenate([x[0] for x in self.carried])
        own = [self.motors.of_motor(w.qd, w.qdd) for w in self.trace.stretches]
        return carried.std(axis=0) > _LOADED * np.concatenate(own).std(axis=0)

    def turned(self, compliance: Compliance) -> Trace:
        """The links' motion."""
        kinematics = self.trace.dynamics.kinematics

        def back(w: Samples, carried: np.ndarray) -> Samples:
            by = compliance * carried
            z, _ = kinematics.forward_unchecked(kinematics.inverse(w.z) - by[0])
            tau = w.tau - self.motors.less(w.qd, w.qdd, by[1], by[2])
            return replace(w, z=z, qd=w.qd - by[1], qdd=w.qdd - by[2], tau=tau)

        parts = zip(self.trace.stretches, self.carried, strict=True)
        return replace(self.trace, stretches=tuple(back(w, x) for w, x in parts))


def wound(one: Trace, motors: Gears) -> Windings:
    """What gears carry along a trace, by its measured torques."""

    def torque(w: Samples) -> np.ndarray:
        return w.tau + w.carried - motors.of_motor(w.qd, w.qdd)

    return _along(one, motors, torque)


def _along(
    one: Trace, motors: Gears, torque: Callable[[Samples], Float[np.ndarray, "samples dof"]]
) -> Windings:
    """A torque that gears carry and its derivatives; the filter's length is lost at both ends."""
    low_pass = motors.low_pass(one.low_pass.rate)
    stretches, carried = list[Samples](), list[np.ndarray]()
    for w in one.stretches:
        along, lost = torque(w), low_pass.margin
        taps = (low_pass.level, low_pass.first, low_pass.second)
        parts = np.array([convolved(each, along) for each in taps])
        if parts.shape[1] > 0:
            stretches.append(w.part(slice(lost, lost + parts.shape[1])))
            carried.append(parts)
    return Windings(replace(one, stretches=tuple(stretches)), motors, tuple(carried))
