"""What all oracles share: bodies, and inverse dynamics of a tree whose loops were cut.

MuJoCo sees a spanning tree. The loops are closed by ties, sums of sites' positions that never
change, and couplings, sums of joint rates that are zero. Their Jacobians, and these' time
derivatives, give tree velocities and accelerations without differences; MuJoCo's recursive
Newton-Euler torques are then projected onto the actuators.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Axes, and MuJoCo's joints about or along one.
EX, EY, EZ = np.eye(3)
HINGE, SLIDE = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in its link frame: mass > 0 (kg), first moment (kg m), inertia (kg m^2).

    `inertia` is the tensor about the frame's origin: off the diagonal minus the integral of x*y.
    """

    m: float
    mc: Array
    inertia: Array

    def principal(self) -> tuple[Array, Array, Array]:
        """Centre of mass (m), quaternion of the principal axes, principal moments (kg m^2)."""
        c = np.asarray(self.mc, float) / self.m
        about_com = np.asarray(self.inertia, float) - self.m * (c @ c * np.eye(3) - np.outer(c, c))
        moments, axes = np.linalg.eigh(0.5 * (about_com + about_com.T))
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.ravel())
        return c, quat, moments


def random_body(
    rng: np.random.Generator, mass: float, size: float, centre: ArrayLike = (0, 0, 0)
) -> Body:
    """A body of eight random point masses: ten generic, physically consistent parameters."""
    points = np.asarray(centre, float) + size * rng.uniform(-1, 1, (8, 3))
    masses = mass * rng.dirichlet(np.full(8, 3.0))
    second = np.einsum("k,ki,kj->ij", masses, points, points)
    return Body(float(masses.sum()), masses @ points, np.trace(second) * np.eye(3) - second)


def rot_z(angle: float) -> Array:
    """Rotation about the third axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def add_joints(body: Any, kind: Any, names: tuple[str, str, str]) -> None:
    """Let a body turn about, or slide along, its three axes, one after the other."""
    for name, axis in zip(names, np.eye(3), strict=True):
        body.add_joint(name=name, type=kind, axis=axis)


class TreeOracle(ABC):
    """Dynamics of a robot from its cut tree; what describes the robot is up to the subclass.

    A pose is what `_tree_positions` takes: actuator or task coordinates.

    Attributes:
        bodies: by name.
        gravity: in the world (m/s^2).
        viscous, coulomb: of the joints in `_lossy` (N m s/rad, N m; N s/m, N).
        rotor_inertia: of the actuators (kg m^2, or kg for a linear one).
    """

    bodies: dict[str, Body]
    gravity: Array
    viscous: Array
    coulomb: Array
    rotor_inertia: Array

    @property
    @abstractmethod
    def _actuators(self) -> tuple[str, ...]:
        """The tree's actuated joints."""

    @property
    @abstractmethod
    def _lossy(self) -> tuple[str, ...]:
        """The tree's joints with friction."""

    @property
    @abstractmethod
    def _ties(self) -> tuple[dict[str, float], ...]:
        """Sites and their weights: the sum of weighted positions never changes."""

    @property
    @abstractmethod
    def _couplings(self) -> tuple[dict[str, float], ...]:
        """Joints and their weights: the sum of weighted rates is zero."""

    @property
    @abstractmethod
    def _model(self) -> Any:
        """MuJoCo's model of the tree."""

    @abstractmethod
    def _tree_positions(self, pose: Array) -> Array:
        """All joint coordinates of the tree at one pose."""

    @property
    def dof(self) -> int:
        """Number of actuators."""
        return len(self._actuators)

    def _fill(self, name: str, size: int) -> None:
        """Give an omitted list its zeros; refuse one of another length."""
        value = np.asarray(getattr(self, name), float)
        value = np.zeros(size) if value.size == 0 else value
        if value.shape != (size,):
            raise ValueError(f"{name} needs {size} entries, has {value.shape}")
        object.__setattr__(self, name, value)

    def _new_spec(self) -> Any:
        """An empty model: inertia as given, no constraints of MuJoCo's own."""
        spec = mujoco.MjSpec()
        spec.compiler.balanceinertia = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        spec.option.gravity = self.gravity
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        return spec

    def _add(self, parent: Any, name: str, body: str, count: float = 1, **pose: Any) -> Any:
        """Child body with the inertia of `count` copies of `bodies[body]`."""
        return attached(parent, name, self._mounted(name, body), count, **pose)

    def _mounted(self, name: str, body: str) -> Body:
        """A body in the axes that it is added in."""
        del name
        return self.bodies[body]

    @cached_property
    def _data(self) -> Any:
        return mujoco.MjData(self._model)

    @cached_property
    def _index(self) -> dict[str, int]:
        """Joint name to its place in the tree's coordinates and rates; all joints are scalar."""
        return {self._model.joint(j).name: j for j in range(self._model.njnt)}

    def _closure(self, rate: bool = False) -> Array:
        """Loop-closure matrix J with J v = 0, or its time derivative."""
        model, data, ties = self._model, self._data, self._ties
        rows = np.zeros((3 * len(ties) + len(self._couplings), model.nv))
        for k, tie in enumerate(ties):
            for name, weight in tie.items():
                site, jac = model.site(name).id, np.zeros((3, model.nv))
                if rate:
                    point, body = data.site_xpos[site], model.site_bodyid[site]
                    mujoco.mj_jacDot(model, data, jac, None, point, body)
                else:
                    mujoco.mj_jacSite(model, data, jac, None, site)
                rows[3 * k : 3 * k + 3] += weight * jac
        if not rate:
            for k, coupling in enumerate(self._couplings, 3 * len(ties)):
                for joint, weight in coupling.items():
                    rows[k, self._index[joint]] = weight
        return rows

    def _set(self, pose: Array, qd: Array) -> tuple[Array, Array]:
        """Bring the tree to a state; its rates are proj qd, its accelerations proj qdd + bias.

        Redundant closure equations agree with one another, so least squares solves all of them.
        """
        model, data = self._model, self._data
        data.qpos = self._tree_positions(pose)
        mujoco.mj_fwdPosition(model, data)
        closure = self._closure()
        free = [self._index[name] for name in self._actuators]
        rest = [k for k in range(model.nv) if k not in free]
        undo = np.linalg.pinv(closure[:, rest])
        proj = np.zeros((model.nv, self.dof))
        proj[free] = np.eye(self.dof)
        proj[rest] = -undo @ closure[:, free]
        data.qvel = proj @ qd
        mujoco.mj_fwdVelocity(model, data)
        bias = np.zeros(model.nv)
        bias[rest] = -undo @ (self._closure(rate=True) @ data.qvel)
        return proj, bias

    def _joint_forces(self, proj: Array, qd: Array) -> Array:
        """Torques on the actuators from the joints: each one's force times its partial rates."""
        rates = proj[[self._index[name] for name in self._lossy]]
        v = rates @ qd
        return rates.T @ (self.viscous * v + self.coulomb * np.sign(v))

    def inverse_dynamics(self, pose: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """Actuator torques (N m) at one state (dof,) or at many (n, dof)."""
        pose, qd, qdd = (np.asarray(a, float) for a in (pose, qd, qdd))
        if pose.ndim > 1:
            states = zip(pose, qd, qdd, strict=True)
            return np.array([self.inverse_dynamics(*state) for state in states])
        proj, bias = self._set(pose, qd)
        self._data.qacc = proj @ qdd + bias
        mujoco.mj_inverse(self._model, self._data)
        tau = proj.T @ self._data.qfrc_inverse
        return tau + self._joint_forces(proj, qd) + self.rotor_inertia * qdd

    def mass_matrix(self, pose: ArrayLike) -> Array:
        """Generalised mass matrix (kg m^2) in actuator coordinates at one pose, with rotors."""
        proj, _ = self._set(np.asarray(pose, float), np.zeros(self.dof))
        momenta = np.zeros(proj.T.shape)
        for row, rates in zip(momenta, proj.T.copy(), strict=True):
            mujoco.mj_mulM(self._model, self._data, row, rates)
        return momenta @ proj + np.diag(self.rotor_inertia)

    def kinetic_energy(self, pose: ArrayLike, qd: ArrayLike) -> float:
        """Kinetic energy (J) of bodies and rotors at one state."""
        qd = np.asarray(qd, float)
        return 0.5 * float(qd @ self.mass_matrix(pose) @ qd)

    def potential_energy(self, pose: ArrayLike) -> float:
        """Potential energy (J), zero with every centre of mass at the world's origin."""
        self._set(np.asarray(pose, float), np.zeros(self.dof))
        return -float(self._model.body_mass @ (self._data.xipos @ self.gravity))

    def body_poses(self, pose: ArrayLike) -> dict[str, tuple[Array, Array]]:
        """Rotation and origin of every body in the world at one pose, by its name in the tree."""
        self._set(np.asarray(pose, float), np.zeros(self.dof))
        model, data = self._model, self._data
        return {
            model.body(k).name: (data.xmat[k].reshape(3, 3).copy(), data.xpos[k].copy())
            for k in range(1, model.nbody)
        }

    def well_posed(self, pose: ArrayLike) -> float:
        """Least singular value of the closure for the passive joints: 0 where loops let go."""
        self._set(np.asarray(pose, float), np.zeros(self.dof))
        free = [self._index[name] for name in self._actuators]
        closure = self._closure()
        rest = [k for k in range(self._model.nv) if k not in free]
        return float(np.linalg.svd(closure[:, rest], compute_uv=False)[-1])


def attached(parent: Any, name: str, body: Body, count: float, **pose: Any) -> Any:
    """Child body with the inertia of so many copies of a body."""
    com, quat, moments = body.principal()
    child = parent.add_body(name=name, **pose)
    child.explicitinertial = True
    child.mass = count * body.m
    child.ipos, child.iquat, child.inertia = com, quat, count * moments
    return child
