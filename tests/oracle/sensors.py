"""What sensors of a composed robot show, from MuJoCo.

base wrench    forces and moments that the world exerts on the roots of the cut tree; the forces
               that close its loops are inside the robot. Rotors are bodies of their own on the
               base, balanced and without weight, that turn with their drives by a gear.
strut          forces of `oracle.forces`; in the middle, less what a part of the strut, welded to
               the rest, takes from there on.
joint torque   inverse dynamics without friction and rotors of drives.
"""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Self

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from oracle.composed import ComposedOracle
from oracle.forces import ForceOracle
from oracle.limb import LimbShape
from oracle.tree import EY, EZ, HINGE, Array, Body, attached

_WEIGHTLESS = 1e-13


@dataclass(frozen=True, eq=False)
class SensorOracle(ComposedOracle):
    """A robot on a base with sensors.

    Attributes:
        turns: of each motor, in radians for one radian of its drive or for one metre of a rail;
            zero leaves its rotor out.
        outer: by the strut's body, what of it lies beyond the gauge in its middle.
    """

    turns: Array = field(default_factory=lambda: np.zeros(0))
    outer: dict[str, Body] = field(default_factory=dict)

    @classmethod
    def with_sensors(cls, oracle: ComposedOracle, **more: Any) -> Self:
        """The same robot."""
        return cls(**{f.name: getattr(oracle, f.name) for f in fields(oracle)}, **more)

    @property
    def _wheels(self) -> tuple[str, ...]:
        return tuple(f"rotor{i}" for i, n in enumerate(self.turns) if n)

    @cached_property
    def _couplings(self) -> tuple[dict[str, float], ...]:
        rotors = zip(self._actuators, self.turns, strict=False)
        rows = [{f"rotor{i}": 1.0, q: -n} for i, (q, n) in enumerate(rotors) if n]
        return (*super()._couplings, *rows)

    def _add(self, parent: Any, name: str, body: str, count: float = 1, **pose: Any) -> Any:
        part = self._mounted(name, body)
        beyond = self.outer.get(body)
        if beyond is not None:
            part = Body(part.m - beyond.m, part.mc - beyond.mc, part.inertia - beyond.inertia)
        child = attached(parent, name, part, count, **pose)
        if beyond is not None:
            attached(child, f"outer_{name}", beyond, count)
        return child

    def _add_limb(self, world: Any, i: int, limb: LimbShape, part: Any) -> None:
        super()._add_limb(world, i, limb, part)
        self._add_rotor(world, i, limb.axes @ EY if limb.arm else limb.rail)

    def _add_telescope(self, world: Any, platform: Any, top: Array, bottom: Array) -> None:
        super()._add_telescope(world, platform, top, bottom)
        self._add_rotor(world, 3, EZ)

    def _add_rotor(self, world: Any, i: int, axis: Array) -> None:
        if not len(self.turns) or not self.turns[i]:
            return
        inertia = self.rotor_inertia[i] / self.turns[i] ** 2
        wheel = world.add_body(name=f"rotor{i}", pos=[0.3, -0.2, 0.1])
        wheel.explicitinertial, wheel.mass = True, _WEIGHTLESS
        wheel.ipos, wheel.inertia = np.zeros(3), inertia * np.array([0.5, 0.5, 1.0])
        wheel.iquat = np.zeros(4)
        mujoco.mju_quatZ2Vec(wheel.iquat, axis)
        wheel.add_joint(name=f"rotor{i}", type=HINGE, axis=axis)

    def base_wrench(
        self, pose: ArrayLike, qd: ArrayLike, qdd: ArrayLike, origin: Array, axes: Array
    ) -> Array:
        """Force and moment on the robot about a point, along the columns of `axes`."""
        model, data = self._model, self._data
        self._needed(pose, qd, qdd)
        mujoco.mj_rnePostConstraint(model, data)
        force, moment = np.zeros(3), np.zeros(3)
        for body in range(1, model.nbody):
            if model.body_parentid[body] == 0:
                wrench = data.cfrc_int[body]
                lever = data.subtree_com[model.body_rootid[body]] - origin
                force += wrench[3:]
                moment += wrench[:3] + np.cross(lever, wrench[3:])
        return np.concatenate([axes.T @ force, axes.T @ moment])

    def strut_sums(self, pose: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> dict[str, float]:
        """Forces along all struts of each limb together; how they share them may be open."""
        model, data, needed = self._model, self._data, self._needed(pose, qd, qdd)
        mujoco.mj_rnePostConstraint(model, data)
        rest = [k for k in range(model.nv) if model.joint(k).name not in self._actuators]
        multipliers, *_ = np.linalg.lstsq(self._closure()[:, rest].T, needed[rest])
        found: dict[str, float] = {}
        for k, tie in enumerate(self._ties):
            cut = next(iter(tie))
            if cut in ("cut_bar", "rod", "tool"):
                continue
            strut = f"strut{cut.removeprefix('cut')}"
            along = data.body(strut).xmat.reshape(3, 3)[:, 0]
            platform = along @ multipliers[3 * k : 3 * k + 3]
            ends = {"platform": platform, "elbow": platform - along @ self._force_on(strut)}
            if self.outer:
                ends["middle"] = platform - along @ self._force_on(f"outer_{strut}")
            for end, value in ends.items():
                name = f"strut{int(cut[3]) + 1}.{end}"
                found[name] = found.get(name, 0.0) + float(value)
        return found

    def _force_on(self, body: str) -> Array:
        return np.array(self._data.cfrc_int[self._model.body(body).id][3:])

    def joint_torques(self, pose: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """What the gears pass on to arms, carriages and the telescope."""
        drives = np.arange(len(self._lossy)) < self.dof
        without = replace(
            self,
            viscous=np.where(drives, 0.0, self.viscous),
            coulomb=np.where(drives, 0.0, self.coulomb),
            rotor_inertia=np.zeros(self.dof),
            turns=np.zeros(0),
        )
        return without.inverse_dynamics(pose, qd, qdd)


@dataclass(frozen=True, eq=False)
class StrutOracle(SensorOracle, ForceOracle):
    """The same for forces along single struts; of a rigid or an H4 platform."""

    def _limb_forces(self, i: int) -> dict[str, float]:
        found = super()._limb_forces(i)
        for letter, side in (("a", 1.0), ("b", -1.0)):
            name, strut = f"strut{i + 1}{letter}", f"strut{i}{side:+.0f}"
            along = self._data.body(strut).xmat.reshape(3, 3)[:, 0]
            if self.outer:
                taken = along @ self._from_parent(f"outer_{strut}")[0]
                found[f"{name}.middle.x"] = found[f"{name}.platform.x"] - float(taken)
        return found
