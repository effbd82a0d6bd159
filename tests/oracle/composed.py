"""Inverse dynamics of composed robots from MuJoCo: drive x platform (x telescope), any limbs.

The tree has the robot's real joints, and what keeps a platform's parts parallel to the base is
what does so in the machine. Each limb of two struts is a parallelogram whose struts are cut from
the platform one by one, so the part it holds could turn in the tree if the struts let it; a limb
of one strut holds nothing, and its part is kept from turning by a coupling.

rigid   one body P.
h4      side bars SB, hinged about z to the ends of a middle bar MB.
par4    main parts MP and two rods R, hinged about z at all four corners: a loop of its own, cut
        between the second rod and the second part. Rod k lies at corners[k] from the parts' points.
i4      half platforms HP on a slide along e.
The tool EE turns in a place that moves with the middle bar's centre, the first rod's centre, or
half-way between the half platforms (a pinion that rolls on a rack of each); a gear, belt or rack
gives it the rate k times that of the hinge or slide.

Frames, in metres and radians (body frames are the link frames in which `Body` is written):
world    z up
U, C, S  of the limbs, see `oracle.limb`
P, SB, MP, HP   at the part's point, parallel to the world
MB, R    at the middle between the parts' points (rod: and its corner), turned by theta about z
TU, TL   R = Rz(psi) Rx(a) Ry(b), z from platform to base; origins at the two universal joints
EE       at the platform point + tool, turned by psi about z

The parts' points are r + half u and r - half u; u = (cos theta, sin theta, 0) and half fixed, or
for i4 u = e fixed and half = s / 2. A pose is z = (r, psi), psi = k theta or k s.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from oracle.limb import LimbShape
from oracle.tree import EX, EY, EZ, HINGE, SLIDE, Array, Body, TreeOracle, add_joints, rot_z

Kind = Literal["rigid", "h4", "par4", "i4"]

# Half the distance of the two struts of a limb (m). No torque depends on it.
_APART = 0.3
# Platforms of two equal parts.
_HALVES = ("SB", "MP", "HP")


@dataclass(frozen=True, eq=False)
class ComposedOracle(TreeOracle):
    """A robot of limbs and a platform; see the module's text.

    Friction and springs list the actuators, then theta or s, or the telescope's slide. `first`
    names the limbs (0, 1, ...) that hold the first part. `direction` is the angle of e (rad).
    """

    limbs: tuple[LimbShape, ...]
    kind: Kind
    bodies: dict[str, Body]
    struts_per_limb: int = 2
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    first: tuple[int, ...] = ()
    half: float = 0.0
    ratio: float = 1.0
    direction: float = 0.0
    tool: Array = field(default_factory=lambda: np.zeros(3))
    corners: Array = field(default_factory=lambda: np.array([[0.01, 0.05, 0.02], [0, -0.06, 0.03]]))
    telescope: tuple[Array, Array] | None = None
    viscous: Array = field(default_factory=lambda: np.zeros(0))
    coulomb: Array = field(default_factory=lambda: np.zeros(0))
    stiffness: Array = field(default_factory=lambda: np.zeros(0))
    rest: Array = field(default_factory=lambda: np.zeros(0))
    rotor_inertia: Array = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        """Give what was left out its zeros."""
        for name in ("viscous", "coulomb", "stiffness", "rest"):
            self._fill(name, len(self._lossy))
        self._fill("rotor_inertia", self.dof)

    # --- geometry -----------------------------------------------------------------------------

    def joint(self, z: Array) -> float:
        """Coordinate of the platform's own joint, theta (rad) or s (m)."""
        return z[3] / self.ratio

    def parts(self, z: Array) -> tuple[Array, Array]:
        """Points of the first and the second part in the world; the same for one body."""
        if self.kind == "rigid":
            return z[:3], z[:3]
        if self.kind == "i4":
            way = 0.5 * self.joint(z) * rot_z(self.direction)[:, 0]
        else:
            way = self.half * rot_z(self.joint(z))[:, 0]
        return z[:3] + way, z[:3] - way

    def held(self, z: Array) -> Array:
        """The middle of each limb's strut joints on the platform, one a row."""
        parts = self.parts(z)
        return np.array([parts[i not in self.first] + l.seat for i, l in enumerate(self.limbs)])

    def positions(self, z: ArrayLike) -> Array:
        """Actuator coordinates (dof,) of one pose or of many; NaN out of reach."""
        z = np.asarray(z, float)
        if z.ndim > 1:
            return np.array([self.positions(row) for row in z])
        q = [l.position(point) for l, point in zip(self.limbs, self.held(z), strict=True)]
        return np.array([*q, z[3]] if self.telescope else q)

    def jacobian(self, z: Array) -> Array:
        """Derivatives of the actuators' coordinates by a pose (dof, dof), or by many poses."""
        steps = 1e-6 * np.eye(z.shape[-1])
        slopes = [(self.positions(z + h) - self.positions(z - h)) / 2e-6 for h in steps]
        return np.stack(slopes, axis=-1)

    def gaps(self, z: ArrayLike, q: ArrayLike) -> Array:
        """Distance of arm tip or carriage to the held point, less the strut's length (m)."""
        rows = []
        for pose, drives in zip(np.asarray(z), np.asarray(q), strict=True):
            ways = zip(self.limbs, self.held(pose), drives, strict=False)
            rows.append([np.linalg.norm(p - l.tip(d)) - l.strut for l, p, d in ways])
        return np.array(rows)

    # --- tree ---------------------------------------------------------------------------------

    @property
    def _own_joint(self) -> tuple[str, ...]:
        if self.telescope:
            return ("length",)
        return {"rigid": (), "i4": ("s",)}.get(self.kind, ("theta",))

    @property
    def _wheels(self) -> tuple[str, ...]:
        """Joints whose angle moves nothing, such as those of rotors."""
        return ()

    @property
    def _actuators(self) -> tuple[str, ...]:
        names = tuple(f"q{i}" for i in range(len(self.limbs)))
        return (*names, "psi") if self.telescope else names

    @property
    def _lossy(self) -> tuple[str, ...]:
        return (*self._actuators, *self._own_joint)

    @property
    def _sides(self) -> tuple[float, ...]:
        return (0.0,) if self.struts_per_limb == 1 else (-1.0, 1.0)

    @cached_property
    def _ties(self) -> tuple[dict[str, float], ...]:
        """Struts, then what a platform adds."""
        names = [f"{i}{side:+.0f}" for i in range(len(self.limbs)) for side in self._sides]
        ties = [{f"cut{name}": 1.0, f"seat{name}": -1.0} for name in names]
        ties += [{"cut_bar": 1.0, "seat_bar": -1.0}] if self.telescope else []
        ties += [{"rod": 1.0, "corner": -1.0}] if self.kind == "par4" else []
        if self.kind != "rigid":
            place = ("point0", "point1") if self.kind == "i4" else ("middle",)
            ties += [{"tool": 1.0} | {name: -1.0 / len(place) for name in place}]
        return tuple(ties)

    @cached_property
    def _couplings(self) -> tuple[dict[str, float], ...]:
        """The tool's gear, and what single struts leave free."""
        rows: list[dict[str, float]] = []
        if self.telescope:
            rows.append({"ee": 1.0, "psi": -1.0})
        elif self.kind != "rigid":
            rows.append({"ee": 1.0, self._own_joint[0]: -self.ratio})
        if self.struts_per_limb == 1:
            rows += [{name: 1.0} for name in ("rx", "ry", "rz")]
            rows += [{"back": 1.0, "theta": 1.0}] if self.kind == "h4" else []
        return tuple(rows)

    @cached_property
    def _model(self) -> Any:
        spec = self._new_spec()
        parts = self._add_platform(spec.worldbody)
        for i, limb in enumerate(self.limbs):
            self._add_limb(spec.worldbody, i, limb, parts[bool(self.first) and i not in self.first])
        if self.telescope:
            self._add_telescope(spec.worldbody, parts[0], *self.telescope)
        return spec.compile()

    def _add_limb(self, world: Any, i: int, limb: LimbShape, part: Any) -> None:
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, limb.axes.ravel())
        driven = self._add(world, f"driven{i}", limb.driven, pos=limb.base, quat=quat)
        if limb.arm is None:
            driven.add_joint(name=f"q{i}", type=SLIDE, axis=limb.axes.T @ limb.rail)
        else:
            driven.add_joint(name=f"q{i}", type=HINGE, axis=EY)
        for side in self._sides:
            name, aside = f"{i}{side:+.0f}", side * _APART * EY
            strut = self._add(
                driven, f"strut{name}", limb.strut_body, pos=aside + (limb.arm or 0.0) * EX
            )
            strut.add_joint(name=f"alpha{name}", type=HINGE, axis=EY)
            strut.add_joint(name=f"beta{name}", type=HINGE, axis=EZ)
            strut.add_site(name=f"cut{name}", pos=limb.strut * EX)
            part.add_site(name=f"seat{name}", pos=limb.seat + limb.axes @ aside)

    def _mounted(self, name: str, body: str) -> Body:
        """The second half of a platform of two equal parts is turned by 180 degrees about z."""
        part, R = super()._mounted(name, body), rot_z(np.pi)
        if name != "part1" or body not in _HALVES:
            return part
        return Body(part.m, R @ part.mc, R @ part.inertia @ R.T)

    def _add_platform(self, world: Any) -> tuple[Any, Any]:
        """The platform's bodies in the pose z = 0; returns what the limbs hold."""
        name = {"rigid": "P", "h4": "SB", "par4": "MP", "i4": "HP"}[self.kind]
        first = self._add(world, "part0", name)
        add_joints(first, SLIDE, ("px", "py", "pz"))
        add_joints(first, HINGE, ("rx", "ry", "rz"))
        first.add_site(name="point0", pos=[0, 0, 0])
        if self.kind == "rigid":
            return first, first
        second = self._add_second(first, name)
        second.add_site(name="point1", pos=[0, 0, 0])
        tool = self._add(world, "EE", "EE")
        add_joints(tool, SLIDE, ("tx", "ty", "tz"))
        tool.add_site(name="tool", pos=[0, 0, 0])
        tool.add_joint(name="ee", type=HINGE, axis=EZ)
        return first, second

    def _add_second(self, first: Any, name: str) -> Any:
        """The second part on what joins it to the first."""
        if self.kind == "i4":
            second = self._add(first, "part1", name)
            second.add_joint(name="s", type=SLIDE, axis=-rot_z(self.direction)[:, 0])
            return second
        arm = self.half * EX
        if self.kind == "h4":
            middle = self._add(first, "bar", "MB", pos=-arm)
            middle.add_joint(name="theta", type=HINGE, axis=EZ, pos=arm)
            middle.add_site(name="middle", pos=[0, 0, 0])
            second = self._add(middle, "part1", name, pos=-arm)
            second.add_joint(name="back", type=HINGE, axis=EZ)
            return second
        corners = np.asarray(self.corners, float)
        rods = []
        for k, joint in enumerate(("theta", "theta1")):
            rods.append(self._add(first, f"rod{k}", "R", pos=corners[k] - arm))
            rods[k].add_joint(name=joint, type=HINGE, axis=EZ, pos=arm)
        rods[0].add_site(name="middle", pos=[0, 0, 0])
        rods[1].add_site(name="rod", pos=-arm)
        second = self._add(rods[0], "part1", name, pos=-arm - corners[0])
        second.add_joint(name="back", type=HINGE, axis=EZ, pos=corners[0])
        second.add_site(name="corner", pos=corners[1])
        return second

    def _add_telescope(self, world: Any, platform: Any, top: Array, bottom: Array) -> None:
        bar = self._add(world, "TU", "TU", pos=top)
        for joint, axis in (("psi", EZ), ("a", EX), ("b", EY)):
            bar.add_joint(name=joint, type=HINGE, axis=axis)
        lower = self._add(bar, "TL", "TL")
        lower.add_joint(name="length", type=SLIDE, axis=-EZ)
        lower.add_site(name="cut_bar", pos=[0, 0, 0])
        platform.add_site(name="seat_bar", pos=bottom)
        self._add(platform, "EE", "EE").add_joint(name="ee", type=HINGE, axis=EZ)

    def _tree_positions(self, pose: Array) -> Array:
        first, held = self.parts(pose)[0], self.held(pose)
        joints: dict[str, Any] = dict(zip(("px", "py", "pz"), first, strict=True))
        joints |= dict.fromkeys(("rx", "ry", "rz", *self._wheels), 0.0)
        for i, (limb, q) in enumerate(zip(self.limbs, self.positions(pose), strict=False)):
            x, y, z = limb.axes.T @ (held[i] - limb.tip(q)) / limb.strut
            alpha = np.arctan2(-z, x) - (0.0 if limb.arm is None else q)
            joints[f"q{i}"] = q
            for side in self._sides:
                joints |= {f"alpha{i}{side:+.0f}": alpha, f"beta{i}{side:+.0f}": np.arcsin(y)}
        if self.telescope:
            joints |= self._bar_positions(pose, *self.telescope)
        elif self.kind != "rigid":
            joints |= dict(zip(("tx", "ty", "tz"), pose[:3] + self.tool, strict=True))
            theta = self.joint(pose)
            joints |= {"ee": pose[3], "theta": theta, "theta1": theta, "back": -theta, "s": theta}
        return np.array([joints[name] for name in self._index])

    @staticmethod
    def _bar_positions(pose: Array, top: Array, bottom: Array) -> dict[str, Any]:
        bar = rot_z(pose[3]).T @ (top - pose[:3] - bottom)
        length = np.linalg.norm(bar)
        x, y, z = bar / length
        a, b = np.arctan2(-y, z), np.arcsin(x)
        return {"psi": pose[3], "a": a, "b": b, "length": length, "ee": pose[3]}

    # --- states and answers -------------------------------------------------------------------

    def _joint_forces(self, proj: Array, qd: Array) -> Array:
        places = [self._index[name] for name in self._lossy]
        away = self._data.qpos[places] - self.rest
        return super()._joint_forces(proj, qd) + proj[places].T @ (self.stiffness * away)

    def _needed(self, pose: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """Forces of all joints of the tree in a motion, at whose state it is left."""
        qd = np.asarray(qd, float)
        proj, bias = self._set(np.asarray(pose, float), qd)
        self._data.qacc = proj @ np.asarray(qdd, float) + bias
        mujoco.mj_inverse(self._model, self._data)
        return self._data.qfrc_inverse + self._passive(proj @ qd)

    def _passive(self, rates: Array) -> Array:
        """What friction and springs of joints that no drive moves take."""
        forces = np.zeros(self._model.nv)
        for k, name in enumerate(self._lossy):
            if name not in self._actuators:
                at = self._index[name]
                v, away = rates[at], self._data.qpos[at] - self.rest[k]
                forces[at] = self.viscous[k] * v + self.coulomb[k] * np.sign(v)
                forces[at] += self.stiffness[k] * away
        return forces

    def gain(self, z: Array) -> float:
        """Largest speed of the first part for a drive speed of one: large near singularities."""
        proj, _ = self._set(z, np.zeros(self.dof))
        return float(np.abs(proj[[self._index[name] for name in ("px", "py", "pz")]]).max())
