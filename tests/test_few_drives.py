"""Mechanisms of the user's own with one or two drives, with and without gravity."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from command import accepted, run
from deltaid import load_mapping, load_robot, use_mechanism
from deltaid.checks.evidence import evidence
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError
from deltaid.exports.handover import reference_states
from deltaid.exports.text import DOUBLE
from deltaid.identification.identify import identify
from deltaid.identification.prediction import validate
from deltaid.model.verdict import Grade
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import (
    SensorNoise,
    simulate_recording,
    surrogate_parameters,
    write_recording,
)
from deltaid.robot.description import RobotDescription
from support import example

PLANAR = Path(__file__).resolve().parents[1] / "examples" / "planar_delta"

SLED = """
import casadi as ca
import deltaid

def mechanism(z):
    origin = ca.vertcat(z[0], 0, 0)
    body = deltaid.BodyPose("sled", ca.SX.eye(3), origin)
    return deltaid.MechanismParts(drives=[z[0]], bodies=[body])
"""
SLED_ROBOT = """
name: sled
mechanism: {drives: [linear], coordinates: [x], bodies: [sled]}
gravity: [0, 0, 0]
bodies:
  sled: {prior: [{shape: point_mass, centre: [0, 0, 0], mass: 80}], free: [m]}
friction: {drive1: {viscous: 200, coulomb: 20, offset: 5}}
workspace: {shape: box, x: [-0.1, 0.3]}
"""
# Of a sled that was recorded.
TRUE = {"sled.m": 95.0, "viscous.drive1": 203.0, "coulomb.drive1": 20.0, "offset.drive1": -3.0}
PENDULUM = """
import casadi as ca
import deltaid

def mechanism(z):
    c, s = ca.cos(z[0]), ca.sin(z[0])
    turn = ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))
    body = deltaid.BodyPose("rod", turn, ca.SX.zeros(3))
    return deltaid.MechanismParts(drives=[z[0]], bodies=[body])
"""
PENDULUM_ROBOT = """
name: pendulum
mechanism: {drives: [rotary], coordinates: [psi], bodies: [rod]}
bodies:
  rod: {prior: [{shape: point_mass, centre: [0.3, 0, 0], mass: 2}], free: [mcx, Sxx]}
workspace: {shape: box}
"""


def robot_from(folder: Path, code: str, description: str) -> RobotDescription:
    """A robot from two texts."""
    (folder / "mechanism.py").write_text(code, encoding="utf-8")
    (folder / "robot.yaml").write_text(description, encoding="utf-8")
    use_mechanism(folder / "mechanism.py")
    return load_robot(folder / "robot.yaml")


@pytest.fixture
def planar() -> RobotDescription:
    return example("planar_delta")


def held_points(q: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The platform point of the planar example in x, z by two circles that meet, and directions.

    Directions are the unit vectors along arms and rods, by limb; z is counted upwards.
    """
    shift, arm, rod = 0.12 - 0.04, 0.28, 0.60
    out = np.array([1.0, -1.0])
    along = np.stack([out * np.cos(q), -np.sin(q)], axis=1)
    elbows = np.stack([out * shift, np.zeros(2)], axis=1) + arm * along
    middle, across = elbows.mean(axis=0), elbows[0] - elbows[1]
    half = 0.5 * np.linalg.norm(across)
    down = np.array([across[1], -across[0]]) / (2 * half)
    down = down if down[1] < 0 else -down
    held = middle + np.sqrt(rod**2 - half**2) * down
    return held, {"arm": along, "rod": (held - elbows) / rod, "elbow": elbows}


def test_torques_of_the_planar_delta_are_those_of_its_mass_points(planar: RobotDescription):
    """d'Alembert: Qᵢ = Σ m (r̈ − g) · ∂r/∂qᵢ over points fixed to the bodies, by differences."""
    dynamics, rng = Dynamics(planar), np.random.default_rng(3)
    bodies = {}
    p = np.zeros(len(dynamics.layout.names))
    for name in dynamics.layout.bodies:
        m, x, z = rng.uniform(0.2, 1.0, 4), rng.uniform(-0.3, 0.5, 4), rng.uniform(-0.1, 0.1, 4)
        bodies[name] = m, x, z
        p[dynamics.layout.body(name)] = [
            m.sum(), m @ x, 0, m @ z, m @ z**2, m @ (x**2 + z**2), m @ x**2, 0, 0, -m @ (x * z),
        ]  # fmt: skip

    def points(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places (x, z) of all mass points, and masses; rods count twice."""
        held, at = held_points(q)
        places, masses = [], []
        for i, out in enumerate((1.0, -1.0)):
            base = np.array([out * (0.12 - 0.04), 0.0])
            for name, origin, times in (("arm", base, 1), ("rod", at["elbow"][i], 2)):
                m, x, z = bodies[name]
                e_x = at[name][i]
                e_z = out * np.array([-e_x[1], e_x[0]])  # x × z = −y: limb 2 is seen from behind
                places.append(origin + np.outer(x, e_x) + np.outer(z, e_z))
                masses.append(times * m)
        m, x, z = bodies["platform"]
        places.append(held + np.stack([x, z], axis=1))
        masses.append(m)
        return np.concatenate(places), np.concatenate(masses)

    def path(t: float) -> np.ndarray:
        return q_0 + qd_0 * t + 0.5 * qdd_0 * t**2

    q_0, qd_0, qdd_0 = rng.uniform(0.1, 0.6, 2), rng.normal(size=2), rng.normal(size=2) * 5
    h = 1e-4
    before, now, after = (points(path(t))[0] for t in (-h, 0.0, h))
    masses = points(q_0)[1]
    effort = masses[:, None] * ((after - 2 * now + before) / h**2 + [0, 9.81])
    slopes = [(points(q_0 + h * e)[0] - points(q_0 - h * e)[0]) / (2 * h) for e in np.eye(2)]
    expected = [float(np.sum(effort * slope)) for slope in slopes]

    z = held_points(q_0)[0][None]
    assert np.allclose(dynamics.kinematics.inverse(z), q_0, atol=1e-12)
    tau = dynamics.torque(z, qd_0[None], qdd_0[None], p)[0]
    assert tau == pytest.approx(expected, rel=1e-5)


def test_the_planar_delta_is_identified_and_simulated(planar: RobotDescription):
    dynamics, rng = Dynamics(planar), np.random.default_rng(1)
    truth = surrogate_parameters(planar, rng)
    how, recordings = {"duration": 10.0, "noise": SensorNoise(torque=0.01)}, []
    for _ in range(2):
        motion = random_motion(dynamics.kinematics, rng)
        recordings.append(simulate_recording(dynamics, truth, motion, rng, **how))
    model = identify(planar, recordings[0]).model
    home = dynamics.kinematics.home[None]
    at_home = dynamics.kinematics.inverse(home)
    M, M_true = (dynamics.mass_matrix(at_home, x)[0] for x in (model.p, truth))
    assert np.allclose(M, M_true, rtol=0, atol=0.01 * M_true.max())
    assert max(validate(model, recordings[1])[0].nrmse) < 0.01
    zd, zdd = rng.normal(size=(1, 2)), rng.normal(size=(1, 2))
    _, qd, qdd = dynamics.kinematics.drive_motion(home + 0.01, zd, zdd)
    tau = dynamics.torque(home + 0.01, qd, qdd, truth)
    forward = ForwardDynamics(planar)
    assert np.allclose(forward.acceleration(home + 0.01, zd, tau, truth), zdd, atol=1e-9)


def test_vectors_of_an_export_are_poses_of_the_planar_delta(planar: RobotDescription) -> None:
    model = deltaid.load(planar)
    states = reference_states(model, DOUBLE)
    z, q = model.dynamics.kinematics.forward_unchecked(states["q"])[0], states["q"]
    assert z.shape == q.shape == (100, len(planar.drives))
    np.testing.assert_allclose(z, states["z"], atol=1e-9)


def test_one_drive_without_gravity(tmp_path: Path):
    robot = robot_from(tmp_path, SLED, SLED_ROBOT)
    dynamics = Dynamics(robot)
    p = np.array([TRUE.get(name, 0.0) for name in dynamics.layout.names])
    z, v, a = np.array([[0.2]]), np.array([[-0.3]]), np.array([[2.0]])
    assert dynamics.torque(z, v, a, p)[0, 0] == pytest.approx(95 * 2 - 203 * 0.3 - 20 - 3)
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0))
    rng = np.random.default_rng(5)
    noise = SensorNoise(torque=0.02)
    recording = simulate_recording(dynamics, p, motion, rng, duration=10.0, noise=noise)
    write_recording(recording, tmp_path / "log.csv")
    names_of_files = ("mechanism.py", "robot.yaml", "log.csv", "r.html", "m.yaml")
    code, description, log, page, model = (tmp_path / name for name in names_of_files)
    accepted("--mechanism", code, "identify", description, log, "--report", page, "-o", model)
    found = identify(robot, tmp_path / "log.csv").model
    by_name = {parameter.name: parameter for parameter in found.parameters}
    for name, value in TRUE.items():
        assert by_name[name].value == pytest.approx(value, rel=0.02, abs=0.1)


def test_a_drive_may_turn_in_place(tmp_path: Path):
    robot = robot_from(tmp_path, PENDULUM, PENDULUM_ROBOT)
    dynamics = Dynamics(robot)
    assert robot.task.names == ("psi",)
    p = np.zeros(len(dynamics.layout.names))
    p[dynamics.layout.body("rod")] = [2.0, 0.6, 0, 0, 0, 0.18, 0.18, 0, 0, 0]
    z, v, a = np.array([[0.7]]), np.array([[3.0]]), np.array([[2.0]])
    # Positive turns about world y move the rod down, so gravity helps.
    expected = 0.18 * 2.0 - 0.6 * 9.81 * np.cos(0.7)
    assert dynamics.torque(z, v, a, p)[0, 0] == pytest.approx(expected)
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0))
    assert np.abs(motion.evaluate(np.linspace(0, 10, 500))[0]).max() <= np.pi


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("coordinates: [x], ", "", "has 1 drive, so say which coordinates"),
        ("coordinates: [x]", "coordinates: [x, z]", "has 1 drives, but 2 coordinates"),
        ("[linear], coordinates: [x]", "[linear, linear], coordinates: [z, x]", "in the order"),
        ("shape: box, x: [-0.1, 0.3]", "shape: box, z: [-0.1, 0.3]", "lacks x, along which"),
        ("x: [-0.1, 0.3]", "x: [-0.1, 0.3], y: [0, 1]", "has y, along which this robot does not"),
        ("shape: box, x: [-0.1, 0.3]", "shape: hemisphere, radius: 1, top: 0", "only along x"),
    ],
)
def test_coordinates_and_workspace_go_together(tmp_path: Path, old: str, new: str, message: str):
    with pytest.raises(DescriptionError, match=message.replace("[", "\\[")):
        robot_from(tmp_path, SLED, SLED_ROBOT.replace(old, new))


def test_what_a_robot_can_reach_is_shown_in_space_only(planar: RobotDescription):
    output = run("--mechanism", PLANAR / "mechanism.py", "show", PLANAR / "robot.yaml")
    assert output.code == 2
    assert "moves along x and z only" in output.err


def test_an_axis_in_a_mat_file_with_the_files_of_the_example(tmp_path: Path):
    """Variables named and shaped as the public recording has them; its gain is in the mapping."""
    from scipy.io import savemat

    emps = PLANAR.parent / "emps"
    dynamics, rng = Dynamics(example("emps")), np.random.default_rng(2)
    p = np.array([TRUE.get(name, 0.0) for name in dynamics.layout.names])
    time = np.arange(20_000) / 1000.0
    z, v, a = random_motion(dynamics.kinematics, rng).evaluate(time)
    force = dynamics.torque(z, v, a, p)
    noisy = force + rng.normal(scale=0.02 * np.abs(force).max(), size=force.shape)
    columns = {"t": time[:, None], "qm": z, "vir": noisy / 35.15065, "gtau": 35.15065}
    savemat(tmp_path / "log.mat", columns)
    texts = [(emps / name).read_text("utf-8") for name in ("robot.yaml", "columns.yaml")]
    assert sum(text.count("\n") for text in texts) <= 20
    mapping = load_mapping(emps / "columns.yaml")
    model = identify(emps / "robot.yaml", tmp_path / "log.mat", columns=mapping).model
    for parameter in model.parameters:
        if parameter.name in TRUE:
            assert parameter.value == pytest.approx(TRUE[parameter.name], rel=0.01, abs=0.1)


def swept(robot: RobotDescription, hertz: float) -> dict[str, np.ndarray]:
    """Twenty seconds of two sines within the workspace of a lone drive: t, q, tau with noise."""
    dynamics, rng, t = Dynamics(robot), np.random.default_rng(5), np.arange(5000) / 250
    centre, half = robot.within(0.0)
    w = 2 * np.pi * hertz * np.array([1.0, 2.3])
    size = (half[0] or 1.0) * np.array([0.6, 0.3])  # a pendulum turns without bounds
    q, qd, qdd = (np.sin(np.outer(t, w) + 0.5 * np.pi * k) @ (size * w**k) for k in range(3))
    q = (q + centre[0])[:, None]
    tau = dynamics.torque(q, qd[:, None], qdd[:, None], 1.1 * prior_parameters(robot))
    tau += 0.01 * np.abs(tau).max() * rng.standard_normal(tau.shape)
    return {"t": t, "q1": q[:, 0], "tau1": tau[:, 0]}


def found_wrong(robot: RobotDescription, columns: dict[str, np.ndarray]) -> list[tuple[str, str]]:
    """Keys and grades of verdicts on columns that are not good."""
    found = checked_wiring(evidence(robot, pl.DataFrame(columns)))
    assert found
    return [(v.key, str(v.grade)) for v in found if v.grade is not Grade.GOOD]


def test_columns_of_a_lone_drive(tmp_path: Path) -> None:
    sled = robot_from(tmp_path, SLED, SLED_ROBOT)
    right = swept(sled, 0.5)
    assert found_wrong(sled, right) == []
    assert found_wrong(sled, right | {"q1": 1e3 * right["q1"]}) == [("angle-unit", "wrong")]
    assert found_wrong(sled, right | {"tau1": 1e3 * right["tau1"]}) == [("torque-unit", "wrong")]
    # Without gravity neither sign can be told from the other.
    either = [("torque-sign", "doubtful"), ("angle-sign", "doubtful")]
    assert found_wrong(sled, right | {"tau1": -right["tau1"]}) == either


def test_signs_of_a_pendulum(tmp_path: Path) -> None:
    pendulum = robot_from(tmp_path, PENDULUM, PENDULUM_ROBOT)
    right = swept(pendulum, 0.4)
    assert found_wrong(pendulum, right) == []
    assert found_wrong(pendulum, right | {"q1": -right["q1"]}) == [("angle-sign", "wrong")]
    assert found_wrong(pendulum, right | {"tau1": -right["tau1"]}) == [("torque-sign", "wrong")]
