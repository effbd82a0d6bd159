"""Inverse dynamics of Delta robots from MuJoCo: a reference that shares no code with the package.

MuJoCo sees the spanning tree that is left when the loops are cut where struts and telescope meet
the platform; `oracle.tree` does the rest.

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

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from oracle.tree import Array, Body, TreeOracle, random_body, rot_z


@dataclass(frozen=True, eq=False)
class DeltaOracle(TreeOracle):
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
        for name in ("viscous", "coulomb"):
            self._fill(name, len(self._lossy))
        self._fill("rotor_inertia", self.dof)

    @classmethod
    def from_json(cls, robot: dict[str, Any], truth: dict[str, Any]) -> "DeltaOracle":
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
    def _actuators(self) -> tuple[str, ...]:
        return ("q0", "q1", "q2", "psi")[: 3 + self.has_telescope]

    @property
    def _lossy(self) -> tuple[str, ...]:
        return (*self._actuators, *(("length",) if self.has_telescope else ()))

    @property
    def _ties(self) -> tuple[dict[str, float], ...]:
        """The limbs', then the telescope's."""
        return tuple({f"cut_{k}": 1.0, f"seat_{k}": -1.0} for k in range(self.dof))

    @property
    def _couplings(self) -> tuple[dict[str, float], ...]:
        return ({"ee": 1.0, "psi": -1.0},) if "EE" in self.bodies else ()

    @cached_property
    def _model(self) -> Any:
        """MuJoCo model of the tree; sites cut_i and seat_i coincide where loop i was cut."""
        spec = self._new_spec()
        hinge, slide = mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE
        ex, ey, ez = np.eye(3)
        world = spec.worldbody

        platform = self._add(world, "P", "P")
        for name, axis in (("px", ex), ("py", ey), ("pz", ez)):
            platform.add_joint(name=name, type=slide, axis=axis)
        for i, phi in enumerate(self.azimuths):
            e_r, quat = rot_z(phi)[:, 0], [np.cos(phi / 2), 0, 0, np.sin(phi / 2)]
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

    def positions(self, z: ArrayLike) -> Array:
        """Actuator coordinates (n, dof) of task coordinates, elbows outward; NaN out of reach."""
        z = np.asarray(z, float)
        q = z.copy()
        for i, phi in enumerate(self.azimuths):
            local = z[..., :3] @ rot_z(phi)
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
            centres[i] = rot_z(phi) @ [reach, 0, -self.upper_arm * np.sin(q[i])]
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
            seat = rot_z(phi).T @ point + [self.platform_radius - self.base_radius, 0, 0]
            x, y, z = (seat - self.upper_arm * arm) / self.strut
            joints |= {f"q{i}": q[i], f"alpha{i}": np.arctan2(-z, x) - q[i]}
            joints[f"beta{i}"] = np.arcsin(y)
        if self.has_telescope:
            bar = rot_z(q[3]).T @ (self.telescope_base - point)
            length = np.linalg.norm(bar)
            x, y, z = bar / length
            a, b = np.arctan2(-y, z), np.arcsin(x)
            joints |= {"psi": q[3], "a": a, "b": b, "length": length, "ee": q[3]}
        return np.array([joints[name] for name in self._index])

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
