"""Inverse dynamics of Delta robots from MuJoCo: a reference that shares no code with the package.

MuJoCo sees the spanning tree that is left when the loops are cut where struts and telescope meet
the platform. Its Jacobians at the cuts, and their time derivatives, give tree velocities and
accelerations without differences; its recursive Newton-Euler torques are then projected onto the
actuators.

Frames, in metres and radians (body frames are the link frames in which `Body` is written):
world    z up, origin at the base centre; limb i lies at azimuth phi_i, e_r outward, e_t = e_z x e_r
U        origin on the motor axis at base_radius e_r, x along the arm, y = e_t the motor axis;
         angle 0 is horizontal and outward, positive is down (rotation about +y)
S        origin at the elbow, x along the strut to the platform, z = unit(x cross y_U)
P        origin at the platform point, parallel to the world
TU, TL   R = Rz(psi) Rx(a) Ry(b), z from platform to base; origins at the base's universal joint
         and at the platform point
EE       origin at the platform point, R = Rz(psi)

Task coordinates z = (platform point, psi), actuator coordinates q = (arm angles, psi).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


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
    rng: np.random.Generator, mass: float = 1.0, size: float = 0.3, centre: ArrayLike = (0, 0, 0)
) -> Body:
    """A body of eight random point masses: ten generic, physically consistent parameters."""
    points = np.asarray(centre, float) + size * rng.uniform(-1, 1, (8, 3))
    masses = mass * rng.dirichlet(np.full(8, 3.0))
    second = np.einsum("k,ki,kj->ij", masses, points, points)
    return Body(float(masses.sum()), masses @ points, np.trace(second) * np.eye(3) - second)


def _rot_z(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True, eq=False)
class DeltaOracle:
    """Three-limb Delta, with a telescope 4-DOF (EE optional), without 3-DOF.

    Lengths in m, azimuths in rad, gravity in m/s^2 (world). `viscous` (N m s/rad) and `coulomb`
    (N m) list the actuators in order, then, with a telescope, its slide (N s/m and N);
    `rotor_inertia` (kg m^2) lists the actuators. All struts of a limb lie on its centre line.
    `telescope_base` (m) is the base's universal joint in the world.
    """

    base_radius: float
    platform_radius: float
    upper_arm: float
    strut: float
    bodies: dict[str, Body]
    has_telescope: bool
    azimuths: Array = field(default_factory=lambda: np.arange(3) * 2 * np.pi / 3)
    struts_per_limb: int = 2
    viscous: Array = field(default_factory=lambda: np.zeros(0))
    coulomb: Array = field(default_factory=lambda: np.zeros(0))
    rotor_inertia: Array = field(default_factory=lambda: np.zeros(0))
    gravity: Array = field(default_factory=lambda: np.array([0.0, 0.0, -9.81]))
    telescope_base: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        """Check the bodies' names and give omitted friction and rotors their zeros."""
        wanted = {"U", "S", "P"} | ({"TU", "TL"} if self.has_telescope else set())
        allowed = wanted | ({"EE"} if self.has_telescope else set())
        if not wanted <= set(self.bodies) <= allowed:
            raise ValueError(f"bodies must be {sorted(wanted)}, at most {sorted(allowed)}")
        joints = self.dof + self.has_telescope
        for name, size in (("viscous", joints), ("coulomb", joints), ("rotor_inertia", self.dof)):
            value = np.asarray(getattr(self, name), float)
            value = np.zeros(size) if value.size == 0 else value
            if value.shape != (size,):
                raise ValueError(f"{name} needs {size} entries, has {value.shape}")
            object.__setattr__(self, name, value)

    @classmethod
    def from_json(cls, robot: dict[str, Any], truth: dict[str, Any]) -> DeltaOracle:
        """From the robot.json and truth.json of the recordings; surplus friction is dropped."""
        telescope = robot["dof"] == 4
        joints = robot["dof"] + telescope
        bodies = {
            name: Body(b["m"], np.array(b["mc"]), np.array(b["inertia_about_link_frame"]))
            for name, b in truth["bodies"].items()
        }
        return cls(
            **{k: robot[k] for k in ("base_radius", "platform_radius", "upper_arm", "strut")},
            bodies=bodies,
            has_telescope=telescope,
            azimuths=np.deg2rad(robot["azimuth_deg"]),
            struts_per_limb=robot["struts_per_limb"],
            viscous=np.array(truth["viscous"][:joints]),
            coulomb=np.array(truth["coulomb"][:joints]),
            gravity=np.array(robot["gravity"], float),
        )

    @property
    def dof(self) -> int:
        """Number of actuators."""
        return 4 if self.has_telescope else 3

    def _add(self, parent: Any, name: str, body: str, count: int = 1, **pose: Any) -> Any:
        """Child body with the inertia of `count` copies of `bodies[body]`."""
        com, quat, moments = self.bodies[body].principal()
        child = parent.add_body(name=name, **pose)
        child.explicitinertial = True
        child.mass = count * self.bodies[body].m
        child.ipos, child.iquat, child.inertia = com, quat, count * moments
        return child

    @cached_property
    def _model(self) -> Any:
        """MuJoCo model of the tree; sites cut_i and seat_i coincide where loop i was cut."""
        spec = mujoco.MjSpec()
        spec.compiler.balanceinertia = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        spec.option.gravity = self.gravity
        spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
        ex, ey, ez = np.eye(3)
        world = spec.worldbody

        platform = self._add(world, "P", "P")
        for name, axis in (("px", ex), ("py", ey), ("pz", ez)):
            platform.add_joint(name=name, type=slide, axis=axis)
        for i, phi in enumerate(self.azimuths):
            e_r, quat = _rot_z(phi)[:, 0], [np.cos(phi / 2), 0, 0, np.sin(phi / 2)]
            upper = self._add(world, f"U{i}", "U", pos=self.base_radius * e_r, quat=quat)
            upper.add_joint(name=f"q{i}", type=hinge, axis=ey)
            arm_tip = [self.upper_arm, 0, 0]
            strut = self._add(upper, f"S{i}", "S", self.struts_per_limb, pos=arm_tip)
            strut.add_joint(name=f"alpha{i}", type=hinge, axis=ey)
            strut.add_joint(name=f"beta{i}", type=hinge, axis=ez)
            strut.add_site(name=f"cut_{i}", pos=[self.strut, 0, 0])
            platform.add_site(name=f"seat_{i}", pos=self.platform_radius * e_r)
        if self.has_telescope:
            bar = self._add(world, "TU", "TU", pos=self.telescope_base)
            for name, axis in (("psi", ez), ("a", ex), ("b", ey)):
                bar.add_joint(name=name, type=hinge, axis=axis)
            lower = self._add(bar, "TL", "TL")
            lower.add_joint(name="length", type=slide, axis=-ez)
            lower.add_site(name="cut_3", pos=[0, 0, 0])
            platform.add_site(name="seat_3", pos=[0, 0, 0])
        if "EE" in self.bodies:
            self._add(platform, "EE", "EE").add_joint(name="ee", type=hinge, axis=ez)
        return spec.compile()

    @cached_property
    def _data(self) -> Any:
        return mujoco.MjData(self._model)

    @cached_property
    def _index(self) -> dict[str, int]:
        """Joint name to its place in the tree's coordinates and rates; all joints are scalar."""
        return {self._model.joint(j).name: j for j in range(self._model.njnt)}

    def positions(self, z: ArrayLike) -> Array:
        """Actuator coordinates (n, dof) of task coordinates, elbows outward; NaN out of reach."""
        z = np.asarray(z, float)
        q = z.copy()
        for i, phi in enumerate(self.azimuths):
            local = z[..., :3] @ _rot_z(phi)
            x = local[..., 0] + self.platform_radius - self.base_radius
            y, down = local[..., 1], -local[..., 2]
            square = x**2 + y**2 + down**2 + self.upper_arm**2 - self.strut**2
            with np.errstate(invalid="ignore"):
                swing = np.arccos(square / (2 * self.upper_arm * np.hypot(x, down)))
            q[..., i] = np.arctan2(down, x) - swing
        return q

    def task(self, q: ArrayLike) -> Array:
        """Task coordinates of one q: the lower point where three strut spheres meet, or NaN."""
        q = np.asarray(q, float)
        centres = np.empty((3, 3))
        for i, phi in enumerate(self.azimuths):
            reach = self.base_radius - self.platform_radius + self.upper_arm * np.cos(q[i])
            centres[i] = _rot_z(phi) @ [reach, 0, -self.upper_arm * np.sin(q[i])]
        edges = centres[1:] - centres[0]
        normal = np.cross(edges[0], edges[1])
        rows = np.vstack([edges, normal])
        foot = np.linalg.solve(rows, [edges[0] @ edges[0] / 2, edges[1] @ edges[1] / 2, 0.0])
        with np.errstate(invalid="ignore"):
            height = np.sqrt(self.strut**2 - foot @ foot)
        side = -np.sign(normal[2]) * height / np.linalg.norm(normal)
        return np.concatenate([centres[0] + foot + side * normal, q[3:]])

    def _tree_positions(self, q: Array) -> Array:
        """All joint coordinates of the tree at one q."""
        point = self.task(q)[:3]
        joints: dict[str, Any] = {"px": point[0], "py": point[1], "pz": point[2]}
        for i, phi in enumerate(self.azimuths):
            arm = np.array([np.cos(q[i]), 0.0, -np.sin(q[i])])
            seat = _rot_z(phi).T @ point + [self.platform_radius - self.base_radius, 0, 0]
            x, y, z = (seat - self.upper_arm * arm) / self.strut
            joints |= {f"q{i}": q[i], f"alpha{i}": np.arctan2(-z, x) - q[i]}
            joints[f"beta{i}"] = np.arcsin(y)
        if self.has_telescope:
            bar = _rot_z(q[3]).T @ (self.telescope_base - point)
            length = np.linalg.norm(bar)
            x, y, z = bar / length
            a, b = np.arctan2(-y, z), np.arcsin(x)
            joints |= {"psi": q[3], "a": a, "b": b, "length": length, "ee": q[3]}
        return np.array([joints[name] for name in self._index])

    def _closure(self, rate: bool = False) -> Array:
        """Loop-closure matrix J with J v = 0, or its time derivative."""
        model, data = self._model, self._data
        rows = np.zeros((3 * self.dof + ("EE" in self.bodies), model.nv))
        for k in range(self.dof):  # the limbs, then the telescope
            for name, sign in (("cut", 1.0), ("seat", -1.0)):
                site, jac = model.site(f"{name}_{k}").id, np.zeros((3, model.nv))
                if rate:
                    point, body = data.site_xpos[site], model.site_bodyid[site]
                    mujoco.mj_jacDot(model, data, jac, None, point, body)
                else:
                    mujoco.mj_jacSite(model, data, jac, None, site)
                rows[3 * k : 3 * k + 3] += sign * jac
        if "EE" in self.bodies and not rate:
            rows[-1, [self._index["ee"], self._index["psi"]]] = 1.0, -1.0
        return rows

    def _set(self, q: Array, qd: Array) -> tuple[Array, Array]:
        """Bring the tree to a state; its rates are proj qd, its accelerations proj qdd + bias."""
        model, data = self._model, self._data
        data.qpos = self._tree_positions(q)
        mujoco.mj_fwdPosition(model, data)
        closure = self._closure()
        free = [self._index[name] for name in ("q0", "q1", "q2", "psi")[: self.dof]]
        rest = [k for k in range(model.nv) if k not in free]
        proj = np.zeros((model.nv, self.dof))
        proj[free] = np.eye(self.dof)
        proj[rest] = -np.linalg.solve(closure[:, rest], closure[:, free])
        data.qvel = proj @ qd
        mujoco.mj_fwdVelocity(model, data)
        bias = np.zeros(model.nv)
        bias[rest] = -np.linalg.solve(closure[:, rest], self._closure(rate=True) @ data.qvel)
        return proj, bias

    def _friction(self, proj: Array, qd: Array) -> Array:
        """Friction torques on the actuators, each joint's force times its partial rates."""
        rates = np.eye(self.dof)
        if self.has_telescope:
            rates = np.vstack([rates, proj[self._index["length"]]])
        v = rates @ qd
        return rates.T @ (self.viscous * v + self.coulomb * np.sign(v))

    def inverse_dynamics(self, q: ArrayLike, qd: ArrayLike, qdd: ArrayLike) -> Array:
        """Actuator torques (N m) at one state (dof,) or at many (n, dof)."""
        q, qd, qdd = (np.asarray(a, float) for a in (q, qd, qdd))
        if q.ndim > 1:
            return np.array([self.inverse_dynamics(*row) for row in zip(q, qd, qdd, strict=True)])
        proj, bias = self._set(q, qd)
        self._data.qacc = proj @ qdd + bias
        mujoco.mj_inverse(self._model, self._data)
        tau = proj.T @ self._data.qfrc_inverse
        return tau + self._friction(proj, qd) + self.rotor_inertia * qdd

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Generalised mass matrix (kg m^2) in actuator coordinates at one q, rotors included."""
        proj, _ = self._set(np.asarray(q, float), np.zeros(self.dof))
        momenta = np.zeros(proj.T.shape)
        for row, rates in zip(momenta, proj.T.copy(), strict=True):
            mujoco.mj_mulM(self._model, self._data, row, rates)
        return momenta @ proj + np.diag(self.rotor_inertia)

    def kinetic_energy(self, q: ArrayLike, qd: ArrayLike) -> float:
        """Kinetic energy (J) of bodies and rotors at one state."""
        qd = np.asarray(qd, float)
        return 0.5 * float(qd @ self.mass_matrix(q) @ qd)

    def potential_energy(self, q: ArrayLike) -> float:
        """Potential energy (J), zero with every centre of mass at the world's origin."""
        self._set(np.asarray(q, float), np.zeros(self.dof))
        return -float(self._model.body_mass @ (self._data.xipos @ self.gravity))

    def random_state(self, rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
        """Task coordinates z, q, qd (rad/s), qdd (rad/s^2) well inside the workspace."""
        qd, qdd = 2.0 * rng.standard_normal(self.dof), 10.0 * rng.standard_normal(self.dof)
        for _ in range(1000):
            q = np.concatenate([rng.uniform(-0.4, 0.9, 3), rng.uniform(-3, 3, self.dof - 3)])
            z = self.task(q)
            reachable = np.allclose(self.positions(z), q, rtol=0, atol=1e-9)
            if reachable and z[2] < -0.1 and np.abs(self._set(q, qd)[0]).max() < 4.0:
                return z, q, qd, qdd
        raise RuntimeError("no feasible state found for this geometry")


def random_oracle(
    rng: np.random.Generator, *, telescope: bool = True, friction: bool = True
) -> DeltaOracle:
    """A 1.6 m class robot with generic bodies, azimuths, rotors and (if wanted) friction."""
    dof = 3 + telescope
    centres = {"U": (0.2, 0, 0), "S": (0.5, 0, 0), "TU": (0, 0, -0.3), "TL": (0, 0, 0.3)}
    names = ["U", "S", "P"] + (["TU", "TL", "EE"] if telescope else [])
    lossy = friction * np.ones(dof + telescope)
    return DeltaOracle(
        base_radius=rng.uniform(0.15, 0.25),
        platform_radius=rng.uniform(0.04, 0.06),
        upper_arm=rng.uniform(0.45, 0.55),
        strut=rng.uniform(1.0, 1.2),
        bodies={n: random_body(rng, rng.uniform(0.3, 1.5), 0.2, centres.get(n, 0)) for n in names},
        has_telescope=telescope,
        azimuths=np.arange(3) * 2 * np.pi / 3 + rng.uniform(-0.2, 0.2, 3),
        viscous=lossy * rng.uniform(0.5, 2, dof + telescope),
        coulomb=lossy * rng.uniform(1, 5, dof + telescope),
        rotor_inertia=rng.uniform(0.01, 0.1, dof),
    )
