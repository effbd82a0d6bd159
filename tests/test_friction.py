"""Friction laws: their torques against the written formula, positivity, identification."""

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError
from deltaid.identification.identify import identify
from deltaid.model.record import Settings
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters, write_recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from identified import simulated

LAWS = {
    "drive1": {"viscous": 1.3, "coulomb": 4.2, "viscous_back": 0.7, "coulomb_back": 3.1},
    "drive2": {"viscous": 1.1, "coulomb": 3.9, "offset": 0.8, "load": 0.07},
    "drive3": {
        "viscous": 1.2,
        "coulomb": 2.7,
        "stribeck": {"coefficient": 1.9, "speed": 0.3, "exponent": 1.4},
    },
    "drive4": {
        "viscous": 0.06,
        "coulomb": 0.5,
        "power": {"coefficient": 0.2, "exponent": 0.6},
        "hess_soom": {"coefficient": 0.3, "speed": 0.7},
    },
    "slide": {
        "viscous": 4.4,
        "coulomb": 5.5,
        "viscous_back": 3.4,
        "coulomb_back": 4.5,
        "stribeck": {"coefficient": 2.0, "speed": 0.2},
    },
}


# Every kind of term once more, for three drives: the slower solver has a smaller robot.
THREE = {
    "drive1": {
        "viscous": 1.3,
        "coulomb": 4.2,
        "viscous_back": 0.7,
        "coulomb_back": 3.1,
        "power": {"coefficient": 0.8, "exponent": 1.8},
    },
    "drive2": LAWS["drive2"],
    "drive3": LAWS["drive3"],
}


ROTORS = {f"drive{i + 1}": 0.05 for i in range(3)}


def with_laws(laws: dict, name: str = "irb360-6-1600") -> RobotDescription:
    return load_robot(name).changed(friction=laws)


def states(dynamics: Dynamics, rng: np.random.Generator, n: int = 200):
    motion = random_motion(dynamics.kinematics, rng)
    z, zd, zdd = motion.evaluate(rng.uniform(0, motion.period, n))
    return (z, *dynamics.kinematics.drive_motion(z, zd, zdd)), zd


def written_law(law: dict, v: np.ndarray) -> np.ndarray:
    """The formula of the documentation, without the load term."""
    back = v < 0
    viscous = np.where(back, law.get("viscous_back", law["viscous"]), law["viscous"])
    coulomb = np.where(back, law.get("coulomb_back", law["coulomb"]), law["coulomb"])
    total = viscous * v + coulomb * np.sign(v) + law.get("offset", 0.0)
    if power := law.get("power"):
        total += power["coefficient"] * np.sign(v) * np.abs(v) ** power["exponent"]
    if s := law.get("stribeck"):
        bump = np.exp(-((np.abs(v) / s["speed"]) ** s.get("exponent", 1.0)))
        total += s["coefficient"] * np.sign(v) * bump
    if s := law.get("hess_soom"):
        total += s["coefficient"] * np.sign(v) / (1 + (v / s["speed"]) ** 2)
    return total


def truth(robot: RobotDescription) -> np.ndarray:
    """The described coefficients; an offset's own number instead of its prior, zero."""
    p = prior_parameters(robot)
    layout = Dynamics(robot).layout
    for i, size in layout.signed.items():
        p[i] = size
    return p


def test_torques_of_every_law_are_those_of_the_written_formula():
    robot = with_laws(LAWS).changed(rotor_inertia=ROTORS)
    dynamics, p = Dynamics(robot), truth(robot)
    without = p.copy()
    without[dynamics.layout.friction] = 0.0
    (z, q, qd, qdd), zd = states(dynamics, np.random.default_rng(1))
    rigid = dynamics.torque(z, qd, qdd, without)
    # The slide's speed is that of the distance of its universal joints, both at the centres.
    length = np.linalg.norm(z[:, :3], axis=1)
    slide_speed = np.sum(z[:, :3] * zd[:, :3], axis=1) / length
    force = written_law(LAWS["slide"], slide_speed)
    drives = [written_law(LAWS[f"drive{i + 1}"], qd[:, i]) for i in range(4)]
    expected = rigid + np.column_stack(drives)
    # Virtual work: the slide's force times ∂(length)/∂q, by central differences over q.
    for i in range(4):
        h = np.zeros(4)
        h[i] = 1e-6
        ahead, behind = (
            np.linalg.norm(dynamics.kinematics.forward(q + s * h)[:, :3], axis=1) for s in (1, -1)
        )
        expected[:, i] += force * (ahead - behind) / 2e-6
    # Drive 2 loses a share of what its gear carries: all but its motor's own friction and rotor.
    rotor = p[dynamics.layout.names.index("rotor.drive2")]
    carried = expected[:, 1] - written_law(LAWS["drive2"], qd[:, 1]) - rotor * qdd[:, 1]
    expected[:, 1] += LAWS["drive2"]["load"] * np.sign(qd[:, 1]) * np.abs(carried)
    torque = dynamics.torque(z, qd, qdd, p)
    np.testing.assert_allclose(torque, expected, atol=1e-6 * np.abs(torque).max())


def test_regressor_at_the_load_gives_the_torque_back():
    robot = with_laws(LAWS).changed(rotor_inertia=ROTORS)
    dynamics, p = Dynamics(robot), truth(robot)
    (z, q, qd, qdd), _ = states(dynamics, np.random.default_rng(2))
    torque = dynamics.torque(z, qd, qdd, p)
    Y = dynamics.regressor(q, qd, qdd, dynamics.carried(z, qd, qdd, p))
    np.testing.assert_allclose(Y @ p, torque, atol=1e-9 * np.abs(torque).max())
    with pytest.raises(DescriptionError, match="load"):
        dynamics.regressor(q, qd, qdd)


def test_friction_only_ever_takes_energy():
    laws = {joint: {k: v for k, v in law.items() if k != "offset"} for joint, law in LAWS.items()}
    robot = with_laws(laws)
    dynamics, p = Dynamics(robot), prior_parameters(robot)
    rng = np.random.default_rng(3)
    p[dynamics.layout.friction] *= np.exp(rng.uniform(-2, 0.5, len(p[dynamics.layout.friction])))
    (z, q, qd, qdd), _ = states(dynamics, rng)
    without = p.copy()
    without[dynamics.layout.friction] = 0.0
    loss = dynamics.torque(z, qd, qdd, p) - dynamics.torque(z, qd, qdd, without)
    assert np.all(np.sum(loss * qd, axis=1) > 0)
    f = dynamics.terms(q, qd, p).f
    assert np.all(np.sum(f * qd, axis=1) > 0)


@pytest.mark.parametrize(
    ("method", "share", "laws", "name"),
    [("conic", 1e-4, LAWS, "irb360-6-1600"), ("log-cholesky", 1e-2, THREE, "clavel-delta3")],
)
def test_every_law_is_identified_from_a_recording_without_noise(
    tmp_path, method, share, laws, name
):
    robot = with_laws(laws, name)
    layout, rng = compiled(robot).layout, np.random.default_rng(4)
    p = surrogate_parameters(robot, rng)
    p[layout.names.index("offset.drive2")] = -0.6
    recording = simulated(robot, p, rng, None, duration=6.0, rate=1000.0)
    write_recording(recording, tmp_path / "log.csv")
    only = Settings(
        method=method,
        friction="described",
        lag="none",
        compliance="none",
        effects="none",
        events=False,
    )
    model = identify(robot, [tmp_path / "log.csv"], settings=only).model
    np.testing.assert_allclose(model.p[layout.friction], p[layout.friction], rtol=share)
    model.save(tmp_path / "model.yaml")
    loaded = type(model).load(tmp_path / "model.yaml")
    np.testing.assert_array_equal(loaded.p, model.p)
    assert loaded.robot == robot


@pytest.mark.parametrize(
    ("joint", "law", "message"),
    [
        ("drive1", {"viscous": 1, "coulomb": 1, "coulomb_back": 1}, "together"),
        ("slide", {"viscous": 1, "coulomb": 1, "load": 0.1}, "only drives"),
        ("drive1", {"viscous": 1, "coulomb": 1, "load": 1.0}, "less than 1"),
        (
            "drive1",
            {"viscous": 1, "coulomb": 1, "offset": 1, "viscous_back": 1, "coulomb_back": 1},
            "offset",
        ),
        ("drive2", {"viscous": 1, "coulomb": 1, "power": {"coefficient": 1}}, "exponent"),
    ],
)
def test_laws_that_cannot_be_are_refused(joint, law, message):
    with pytest.raises(DescriptionError, match=message):
        with_laws({joint: law})


@pytest.mark.slow
def test_a_motion_is_optimised_for_every_law():
    settings = ExcitationSettings(harmonics=3, duration=6.0, starts=1)
    exciter = Exciter(compiled(with_laws(LAWS)), settings)
    result = exciter.optimise()
    assert result.criterion_after < result.criterion_before
    assert all(limit.share <= 1.0 for limit in result.limits)
    units = {p.formula: p.unit for p in result.predictions}
    assert units["power.drive4"] == "N m (s/rad)^0.6"
    assert {"stribeck.drive3", "load.drive2", "offset.drive2", "coulomb_back.slide"} <= set(units)
