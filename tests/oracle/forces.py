"""Constraint forces from MuJoCo: Lagrange multipliers of the cut tree, then forces in its joints.

The tree of `oracle.composed` with every strut a body of its own. Two things differ, because they
change no torque but do change forces: the telescope's lower end is a universal joint with a cross
(its axes along x of EE and y of the bar) in place of a gear between EE and drive, and the tool of
an H4 turns in the middle bar, geared to the first side bar, in place of a carriage of its own.

With all joints' coordinates free and the loops cut, recursive Newton-Euler gives the generalised
forces that the motion takes. What drives do not give, the cuts do: Jᵀ λ on the other joints.
"""

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from oracle.composed import ComposedOracle
from oracle.tree import EZ, HINGE, SLIDE, Array, add_joints


@dataclass(frozen=True, eq=False)
class ForceOracle(ComposedOracle):
    """A robot of two struts a limb with a rigid or H4 platform. H4: `tool` on the bar's axis."""

    @classmethod
    def like(cls, oracle: ComposedOracle) -> "ForceOracle":
        """The same robot."""
        return cls(**{f.name: getattr(oracle, f.name) for f in fields(oracle)})

    @cached_property
    def _ties(self) -> tuple[dict[str, float], ...]:
        return tuple(tie for tie in super()._ties if "tool" not in tie)

    @cached_property
    def _couplings(self) -> tuple[dict[str, float], ...]:
        return ({"ee": 1.0, "theta": 1.0 - self.ratio},) if self.kind == "h4" else ()

    def _add_platform(self, world: Any) -> tuple[Any, Any]:
        if self.kind == "rigid":
            return super()._add_platform(world)
        first = self._add(world, "part0", "SB")
        add_joints(first, SLIDE, ("px", "py", "pz"))
        add_joints(first, HINGE, ("rx", "ry", "rz"))
        second = self._add_second(first, "SB")
        tool = self._add(second.parent, "EE", "EE", pos=self.tool)
        tool.add_joint(name="ee", type=HINGE, axis=EZ)
        return first, second

    def _tree_positions(self, pose: Array) -> Array:
        joints = super()._tree_positions(pose)
        if self.kind == "h4":
            joints[self._index["ee"]] -= self.joint(pose)
        return joints

    def _closure(self, rate: bool = False) -> Array:
        """Those of the ties and couplings; with a telescope, of its lower joint's cross as well."""
        rows = super()._closure(rate)
        if not self.telescope:
            return rows
        model, data = self._model, self._data
        bar, tool = model.body("TL").id, model.body("EE").id
        x, y = data.xmat[tool].reshape(3, 3)[:, 0], data.xmat[bar].reshape(3, 3)[:, 1]
        turn = {body: np.zeros((3, model.nv)) for body in (bar, tool)}
        for body, jac in turn.items():
            mujoco.mj_jac(model, data, None, jac, data.xpos[body], body)
        apart = turn[bar] - turn[tool]
        row = np.cross(x, y) @ apart
        if rate:
            w_bar, w_tool = turn[bar] @ data.qvel, turn[tool] @ data.qvel
            n_rate = np.cross(np.cross(w_tool, x), y) + np.cross(x, np.cross(w_bar, y))
            row = n_rate @ apart
            for body, sign in ((bar, 1.0), (tool, -1.0)):
                jac = np.zeros((3, model.nv))
                mujoco.mj_jacDot(model, data, None, jac, data.xpos[body], body)
                row = row + sign * np.cross(x, y) @ jac
        return np.vstack([rows, row])

    def forces(self, pose: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> dict[str, float]:
        """All constraint forces at one state, under the package's names."""
        model, data, needed = self._model, self._data, self._needed(pose, qd, qdd)
        closure = self._closure()
        rest = [k for k in range(model.nv) if model.joint(k).name not in self._actuators]
        multipliers = np.linalg.solve(closure[:, rest].T, needed[rest])
        self._apply(multipliers)
        mujoco.mj_rnePostConstraint(model, data)
        found = {}
        for i in range(len(self.limbs)):
            found |= self._limb_forces(i)
        if self.telescope:
            found |= self._bar_forces(multipliers)
        data.xfrc_applied[:] = 0.0
        return found

    def _apply(self, multipliers: Array) -> None:
        """The cuts' forces as forces from outside."""
        model, data = self._model, self._data
        for k, tie in enumerate(self._ties):
            for name, weight in tie.items():
                site = model.site(name).id
                force = weight * multipliers[3 * k : 3 * k + 3]
                body = model.site_bodyid[site]
                lever = data.site_xpos[site] - data.xipos[body]
                data.xfrc_applied[body] += np.hstack([force, np.cross(lever, force)])
        if self.telescope:
            torque = multipliers[-1] * self._cross_axis()
            for name, sign in (("TL", 1.0), ("EE", -1.0)):
                data.xfrc_applied[model.body(name).id, 3:] += sign * torque

    def _cross_axis(self) -> Array:
        data = self._data
        x = data.body("EE").xmat.reshape(3, 3)[:, 0]
        return np.cross(x, data.body("TL").xmat.reshape(3, 3)[:, 1])

    def _from_parent(self, name: str) -> tuple[Array, Array]:
        """Force and moment about its own origin that a body takes from its parent, world."""
        model, data = self._model, self._data
        body = model.body(name).id
        wrench = data.cfrc_int[body]
        lever = data.subtree_com[model.body_rootid[body]] - data.xpos[body]
        return wrench[3:], wrench[:3] + np.cross(lever, wrench[3:])

    def _limb_forces(self, i: int) -> dict[str, float]:
        limb, found = self.limbs[i], {}
        for letter, side in (("a", 1.0), ("b", -1.0)):
            key, name = f"{i}{side:+.0f}", f"strut{i + 1}{letter}"
            R = self._data.body(f"strut{key}").xmat.reshape(3, 3)
            g, moment = self._from_parent(f"strut{key}")
            body = self._model.body(f"strut{key}").id
            end = self._data.site(f"cut{key}").xpos - self._data.xipos[body]
            f = self._data.xfrc_applied[body, :3]
            assert np.allclose(np.cross(end, f), self._data.xfrc_applied[body, 3:])
            axis = np.cross(limb.axes[:, 1], R[:, 2])
            assert np.allclose(np.cross(axis / np.linalg.norm(axis), moment), 0, atol=1e-9)
            found |= _named(f"{name}.platform", R.T @ f) | _named(f"{name}.elbow", -R.T @ g)
            found[f"{name}.elbow.moment"] = float(axis @ moment)
            outwards = side * limb.axes[:, 1]
            found[f"{name}.platform.out"] = float(outwards @ f)
            found[f"{name}.elbow.out"] = float(outwards @ g)
        force, moment = self._from_parent(f"driven{i}")
        R = limb.axes
        if limb.arm is None:
            R = np.column_stack(
                [np.cross(limb.axes[:, 1], -limb.rail), limb.axes[:, 1], -limb.rail]
            )
        force, moment = R.T @ force, R.T @ moment
        found |= _named(f"motor{i + 1}.force", force) | _named(f"motor{i + 1}.moment", moment)
        found[f"motor{i + 1}.drive"] = float(moment[1] if limb.arm else -force[2])
        return found

    def _bar_forces(self, multipliers: Array) -> dict[str, float]:
        R = self._data.body("TU").xmat.reshape(3, 3)
        force, moment = self._from_parent("TU")
        lower = multipliers[3 * (len(self._ties) - 1) : 3 * len(self._ties)]
        return {
            **_named("telescope.base", R.T @ force),
            "telescope.base.torque": float(self._cross_axis() @ moment),
            **_named("telescope.platform", R.T @ lower),
            "telescope.platform.torque": float(multipliers[-1]),
            "telescope.drive": float(moment[2]),
        }


def _named(name: str, v: Array) -> dict[str, float]:
    return {f"{name}.{axis}": float(value) for axis, value in zip("xyz", v, strict=True)}
