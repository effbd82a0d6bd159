"""Motion of a machine during its recording, and the torques of its motors.

The platform always moves as planned: a stiff controller is assumed, so contact, load and friction
affect only torques. From the link to the motor:

    τ_l = bodies + passive friction + load − Jᵀ F + springs  torque that the gear carries
    q_m = q + τ_l / s ± ½ backlash                           by the sign of τ_l
    τ   = τ_l + rotor q̈_m + friction(q̇_m, τ_l)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.ndimage import gaussian_filter1d

from drives.pulls import Balancer, BallJoints, Cable, Hose
from drives.robots import Machine
from oracle.tree import Array
from plants import Pace, Truth, paced

Span = tuple[float, float]
# Time of a motor to cross backlash (s); standard deviation of the smoothing of windup (s), because
# links follow steps of friction with a delay; torque, as a share of the largest, within which gears
# change sides.
_THROUGH, _SMOOTH, _SIDE = 6e-3, 6e-3, 0.02
# Durations of an emergency stop and of a normal start (s).
_STOP, _START = 0.15, 0.4
# Time before the end at which a motion stops; time of holding after brakes open (s).
_END, _HELD = 0.45, 0.1


@dataclass(frozen=True, eq=False)
class Law:
    """Friction of the drives; numbers are scalars or (drives,).

    τ = (1 + d s)(viscous v + coulomb s) + stribeck coulomb exp(−(v/knee)²) s + load |τ_l| s
        + bias coulomb
    times 1 + warm exp(−t / constant), s = sign(v); at rest, a random share of Coulomb's. Where
    contacts yield over a distance before they slip, coulomb s is coulomb z by Dahl's law.
    """

    viscous: Array
    coulomb: Array
    stribeck: float = 0.0
    knee: Array | float = 1.0
    direction: Array | float = 0.0
    bias: Array | float = 0.0
    load: float = 0.0
    warm: float = 0.0
    constant: float = 1.0
    distance: Array | float = 0.0

    def yielding(self, q: Array, v: Array) -> Array:
        """coulomb (z − s) along a motion (samples, drives), from relaxed contacts on."""
        z, moves = np.zeros_like(q), np.diff(q, axis=0)
        for k, move in enumerate(moves):
            s = np.sign(move)
            z[k + 1] = s + (z[k] - s) * np.exp(-np.abs(move) / self.distance)
        return self.coulomb * (z - np.sign(v))

    def curve(self, v: Array, link: Array | float = 0.0) -> Array:
        """Friction at speeds (samples, drives) with torques `link` that the gears carry."""
        s = np.sign(v)
        base = (1 + self.direction * s) * (self.viscous * v + self.coulomb * s)
        near = self.stribeck * self.coulomb * np.exp(-((v / self.knee) ** 2)) * s
        return base + near + self.load * np.abs(link) * s + self.bias * self.coulomb


@dataclass(frozen=True, eq=False)
class Load:
    """A load at the tool: mass (kg), centre (m) in the tool's frame, inertia Izz about it."""

    mass: float
    centre: Array = field(default_factory=lambda: np.zeros(3))
    gyration: float = 0.04

    def torque(self, truth: Truth, gravity: Array) -> Array:
        """Torque of the load at the drives; a tool that does not turn has the base's axes."""
        zd, zdd, z = truth.zd, truth.zdd, truth.z
        turns = zdd.shape[1] == 4
        psi = z[:, 3] if turns else np.zeros(len(zdd))
        rate, rise = (x[:, 3] if turns else np.zeros(len(zdd)) for x in (zd, zdd))
        c, s = np.cos(psi), np.sin(psi)
        x, y, h = self.centre
        arm = np.column_stack([c * x - s * y, s * x + c * y, np.full(len(c), h)])
        across = np.column_stack([-arm[:, 1], arm[:, 0], np.zeros(len(c))])
        flat = arm * [1, 1, 0]
        force = self.mass * (zdd[:, :3] + rise[:, None] * across - (rate**2)[:, None] * flat
                             - gravity)  # fmt: skip
        wrench = force
        if turns:
            about = self.mass * self.gyration**2 * rise
            moment = about + arm[:, 0] * force[:, 1] - arm[:, 1] * force[:, 0]
            wrench = np.column_stack([force, moment])
        return np.einsum("szd,sz->sd", truth.hand, wrench)


@dataclass(frozen=True)
class Contact:
    """A push at the platform: a half sine of force (N, world) from `start` on for `length` (s).

    Its `size` is the force scaled to a robot of the IRB 360 class (N).
    """

    start: float
    length: float
    force: tuple[float, ...]
    size: float

    def torque(self, truth: Truth) -> Array:
        """−Jᵀ F: torque that the motors must add."""
        share = (truth.time - self.start) / self.length
        push = np.where((share > 0) & (share < 1), np.sin(np.pi * np.clip(share, 0, 1)), 0.0)
        return -np.einsum("szd,z,s->sd", truth.hand[:, :3], np.array(self.force), push)


@dataclass(frozen=True, eq=False)
class Happening:
    """A machine during its recording.

    Attributes:
        machine: the robot and its path.
        duration: of the recording (s).
        seed: of friction at rest.
        law: friction of the drives; that of the machine's p if None.
        standing: spans of rest under control, between ramps.
        braked: spans with drives off and brakes closed; outside of a span of rest this begins with
            an emergency stop.
        contacts: pushes.
        load, held: load at the tool, and spans in which it is held.
        pulls: permanent forces of hoses, cables, balancers and ball joints.
        stiffness, backlash: of the gears (N m/rad, rad; N/m, m).
        hard: whether backlash changes sides with the sign of τ_l; else with its tanh.
        rhythm: pace of a motion with varying speed.
    """

    machine: Machine
    duration: float
    seed: int
    law: Law | None = None
    standing: Sequence[Span] = ()
    braked: Sequence[Span] = ()
    contacts: Sequence[Contact] = ()
    load: Load | None = None
    held: Sequence[Span] = ()
    pulls: Sequence[Hose | Cable | Balancer | BallJoints] = ()
    stiffness: Array | float = np.inf
    backlash: Array | float = 0.0
    hard: bool = False
    rhythm: Callable[[Array], Pace] | None = None

    @property
    def friction(self) -> Law:
        """Friction law of the drives."""
        return self.law or Law(self.machine.viscous, self.machine.coulomb)

    @cached_property
    def time(self) -> Array:
        """Times of the samples (s)."""
        rate = self.machine.rate
        return np.arange(round(self.duration * rate)) / rate

    def pace(self, time: Array) -> Pace:
        """Pace along the path from rest to rest, with all stops."""
        if self.rhythm is not None:
            return self.rhythm(time)
        edges = [(-10.0, -1, _START), (0.0, 1, _START), (self.duration - _END, -1, _START)]
        for start, end in self.standing:
            edges += [(start - _START, -1, _START), (end, 1, _START)]
        for start, end in self.braked:
            if any(first <= start < last for first, last in self.standing):
                continue
            edges += [(start, -1, _STOP), (end + _HELD, 1, _START)]
        return paced(time, self.machine.period, edges)

    def truth_at(self, time: Array) -> Truth:
        """Motion and torques of rigid bodies at other times (ascending), without the drives'
        friction."""
        return self.machine.plant.move(self.pace(time), np.random.default_rng([self.seed, 1]))

    @cached_property
    def truth(self) -> Truth:
        """Angles and torques of the motors at the samples."""
        return self.moved(self.time)

    def moved(self, time: Array) -> Truth:
        """Angles and torques of the motors at given times (ascending)."""
        truth, dof = self.truth_at(time), self.machine.dof
        rotor, link = self.machine.plant.oracle.rotor_inertia, self.link(truth)
        q, qd, qdd = self._motor(truth, link)
        law, rng = self.friction, np.random.default_rng([self.seed, 3])
        rest = rng.uniform(-0.8, 0.8, dof) * self.machine.coulomb
        friction = np.where(truth.qd == 0, rest, law.curve(qd, link))
        if np.any(law.distance):
            friction += np.where(truth.qd == 0, 0.0, law.yielding(q, qd))
        friction *= 1 + law.warm * np.exp(-time / law.constant)[:, None]
        tau = link + rotor * qdd + friction
        tau[within(time, self.braked)] = 0.0
        return replace(truth, q=q, qd=qd, qdd=qdd, tau=tau)

    @cached_property
    def carried(self) -> Array:
        """Mean absolute torque that each gear carries, (drives,)."""
        return np.abs(self.link(self.truth_at(self.time))).mean(axis=0)

    def link(self, truth: Truth) -> Array:
        """τ_l: torque that each gear carries, (samples, drives)."""
        plant = self.machine.plant
        rotor, time = plant.oracle.rotor_inertia, truth.time
        link = truth.tau - rotor * truth.qdd
        if self.load is not None:
            link = link + within(time, self.held)[:, None] * self.load.torque(
                truth, plant.oracle.gravity)  # fmt: skip
        for force in (*self.contacts, *self.pulls):
            link = link + force.torque(truth)
        return link

    def _motor(self, truth: Truth, link: Array) -> tuple[Array, ...]:
        """q, q̇ and q̈ on the motor's side of the gears."""
        if np.all(np.isinf(self.stiffness)) and not np.any(self.backlash):
            return truth.q, truth.qd, truth.qdd
        step = truth.time[1] - truth.time[0]
        wound = gaussian_filter1d(link, _SMOOTH / step, axis=0) / self.stiffness
        share = link / (_SIDE * np.abs(link).max(axis=0))
        side = np.sign(share) if self.hard else np.tanh(share)
        wound += 0.5 * self.backlash * gaussian_filter1d(side, 0.25 * _THROUGH / step, axis=0)
        rate = np.gradient(wound, step, axis=0)
        return truth.q + wound, truth.qd + rate, truth.qdd + np.gradient(rate, step, axis=0)


def within(time: Array, spans: Sequence[Span]) -> Array:
    """Whether each time is in one of the spans."""
    inside = np.zeros(len(time), bool)
    for start, end in spans:
        inside |= (time >= start) & (time < end)
    return inside
