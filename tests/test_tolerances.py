"""Lengths, zeros and mounting that may be off: slopes of torques, shifts, intervals."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.geometry import across, geometric_errors, torque_slopes
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DescriptionError
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.identification.identify import Identification, identify
from deltaid.identification.least_squares import identify_base
from deltaid.model.parameter_record import Parameter
from deltaid.model.record import IdentifiedModel
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.recording.memory import Recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.view.parameters import share_table, shares_sentence
from poor_priors import PLAIN
from support import along
from sweeps import slow

STEP = 1e-5  # m or rad
LENGTH, ZERO = 1e-3, np.deg2rad(0.5)
EXACT = {"lengths": 0.0, "homing": 0.0, "mounting": 0.0}


def longer(robot: RobotDescription, name: str, by: float, limb: int | None) -> RobotDescription:
    """One length of one limb or of all, or a platform's, changed."""
    if name == "platform":
        half = robot.platform.half_length + by
        return robot.changed(platform=robot.platform.changed(half_length=half))
    if name == "telescope":
        x, y, z = robot.telescope.base_joint
        return robot.changed(telescope=robot.telescope.changed(base_joint=(x, y, z + by)))
    limbs, places = robot.limbs, range(robot.limbs.count)
    off = np.array([by if limb in (None, i + 1) else 0.0 for i in places])
    if getattr(limbs, name) is None:  # radii are given as points
        name = name.replace("radius", "points")
        out = [limb.R_WL[:, 0] for limb in robot.limb_geometry]
        points = [np.array(getattr(limbs, name)[i]) + off[i] * out[i] for i in places]
        return robot.changed(limbs=limbs.changed(**{name: tuple(map(tuple, points))}))
    values = np.broadcast_to(getattr(limbs, name), len(places)) + off
    return robot.changed(limbs=limbs.changed(**{name: tuple(values.tolist())}))


def moved(name: str, samples: int = 40) -> tuple[Dynamics, tuple[np.ndarray, ...], np.ndarray]:
    """A robot of which everything may be off by one, a motion, and parameters."""
    ones = {"lengths": 0.05, "homing": 0.2, "mounting": 0.2}
    dynamics = compiled(load_robot(name).changed(tolerances=ones))
    motion = along(dynamics.kinematics, np.random.default_rng(4), np.linspace(0, 4, samples))
    return dynamics, motion, prior_parameters(dynamics.robot)


def effects(dynamics: Dynamics, *at: np.ndarray) -> dict[str, np.ndarray]:
    """Torques of each error by its name."""
    return {error.name: error.effect for error in geometric_errors(dynamics, *at)}


@pytest.mark.parametrize(
    ("name", "length", "limb"),
    [
        ("irb360-6-1600", "telescope", None),
        ("clavel-delta3", "strut", 2),
        slow("irb360-6-1600", "upper_arm", None),
        slow("linear-delta", "base_radius", 3),
        slow("h4", "platform", None),
    ],
)
def test_slopes_are_those_of_changed_lengths(name: str, length: str, limb: int | None) -> None:
    dynamics, (z, q, qd, qdd), p = moved(name)
    changed = Dynamics(longer(dynamics.robot, length, STEP, limb))
    later = changed.torque(changed.kinematics.forward(q), qd, qdd, p)
    expected = 0.05 / STEP * (later - dynamics.torque(z, qd, qdd, p)).T
    found = effects(dynamics, z, qd, qdd, p)
    mine = found[length if limb is None else f"{length} of limb {limb}"]
    assert np.abs(mine).max() > 0
    np.testing.assert_allclose(mine, expected, atol=1e-3 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["irb360-6-1600", slow("par4-linear")])
def test_slopes_are_those_of_zeros_and_of_gravity(name: str) -> None:
    dynamics, (z, q, qd, qdd), p = moved(name)
    found = effects(dynamics, z, qd, qdd, p)
    for i, drive in enumerate(dynamics.robot.drives):
        step = STEP * np.eye(dynamics.dof)[i]
        up, down = (dynamics.inverse_dynamics(q + s * step, qd, qdd, p).T for s in (1, -1))
        expected = 0.2 * (up - down) / (2 * STEP)
        near = 1e-5 * np.abs(expected).max() + 1e-12
        if f"zero of {drive}" not in found:  # a tool turned about its own axis
            assert np.abs(expected).max() < 1e-9
            continue
        np.testing.assert_allclose(found[f"zero of {drive}"], expected, atol=near)
    gravity = np.array(dynamics.robot.gravity)
    tilts = [torques for name, torques in found.items() if name.startswith("tilt")]
    for axis, torques in zip(across(gravity), tilts, strict=True):
        turned = gravity + 0.2 * np.cross(axis, gravity)
        other = Dynamics(dynamics.robot.changed(gravity=tuple(turned.tolist())))
        expected = (other.torque(z, qd, qdd, p) - dynamics.torque(z, qd, qdd, p)).T
        np.testing.assert_allclose(torques, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["h4", "irb360-6-1600"])
def test_friction_of_a_joint_that_hardly_turns_keeps_its_direction(name: str) -> None:
    """Steps of differences are larger than what would turn it round, 1 µrad/s or µm/s."""
    dynamics, (z, _, qd, _), p = moved(name)
    (k,) = [
        k for k in range(dynamics.layout.coulomb.start, dynamics.layout.coulomb.stop)
        if dynamics.layout.parameters[k].owner not in dynamics.robot.drives
    ]  # fmt: skip
    dry, still = np.zeros_like(p), np.zeros_like(qd)
    dry[k] = p[k]
    # The torque of a passive joint goes by its speed's slope, so along it the joint turns fastest.
    along = dynamics.torque(z, qd, still, dry)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    hardly = qd - np.sum(along * qd, axis=1, keepdims=True) * along + 1e-9 * along

    def slopes(speed: np.ndarray) -> np.ndarray:
        found = torque_slopes(dynamics, z, speed, still, dry)
        return np.array([found.of_zero(drive) for drive in range(dynamics.dof)])

    expected = slopes(hardly + along)
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(slopes(hardly), expected, atol=1e-6 * np.abs(expected).max())


def recorded(
    name: str, true: RobotDescription, zeros: np.ndarray, noise: float, seed: int = 3
) -> tuple[Recording, np.ndarray]:
    """A recording of a machine with a geometry of its own, and its parameters."""
    rng = np.random.default_rng(seed)
    dynamics, p = compiled(true), surrogate_parameters(load_robot(name), rng)
    motion = random_motion(dynamics.kinematics, rng)
    table = simulate_recording(
        dynamics, p, motion, rng, duration=12.0, rate=500.0, noise=SensorNoise(noise, 1e-7)
    )
    q, tau = (
        np.stack([table[f"{x}{i + 1}"].to_numpy() for i in range(dynamics.dof)], axis=1)
        for x in ("q", "tau")
    )
    return Recording.from_arrays(q=q + zeros, tau=tau, rate=500.0), p


def off(robot: RobotDescription, rng: np.random.Generator) -> RobotDescription:
    """All lengths of all limbs off by a millimetre, up or down."""
    for name in ("base_radius", "platform_radius", "upper_arm", "strut"):
        for limb in range(1, robot.limbs.count + 1):
            robot = longer(robot, name, LENGTH * rng.choice([-1, 1]), limb)
    return robot


@dataclass(frozen=True, eq=False)
class Wrong:
    """A machine that is not built as described, identified with and without tolerances."""

    robot: RobotDescription
    recording: Recording
    p: np.ndarray
    exact: Identification
    honest: Identification


@pytest.fixture(scope="module")
def wrong() -> Wrong:
    described, rng = load_robot("clavel-delta3"), np.random.default_rng(0)
    machine, zeros = off(described, rng), ZERO * rng.choice([-1, 1], 3)
    # So little noise that what the geometry does is more than what noise makes of intervals.
    recording, p = recorded(described.name, machine, zeros, noise=0.005)
    stated = {"lengths": LENGTH, "homing": ZERO, "mounting": 0.0}
    robot = described.changed(tolerances=stated)
    exact = identify(described.changed(tolerances=EXACT), recording, settings=PLAIN)
    return Wrong(robot, recording, p, exact, identify(robot, recording, settings=PLAIN))


def test_a_length_shifts_parameters_as_predicted() -> None:
    """Without noise, the error of the base parameters is the shift by the length that is off."""
    name, tolerances = "clavel-delta3", EXACT | {"lengths": LENGTH}
    robot = load_robot(name).changed(tolerances=tolerances)
    recording, p = recorded(name, longer(robot, "upper_arm", LENGTH, 1), np.zeros(3), 1e-9)
    problem = identify(robot, recording, settings=PLAIN).problem
    predicted = problem.geometry.shifts[:, problem.geometry.names.index("upper_arm of limb 1")]
    error = problem.estimate.values - true_values(problem.base, p)
    size = np.linalg.norm(problem.estimate.noise.root @ error)
    left = np.linalg.norm(problem.estimate.noise.root @ (error - predicted))
    assert left < 0.1 * size
    large = np.abs(predicted) > 0.3 * np.linalg.norm(problem.geometry.shifts, axis=1)
    np.testing.assert_allclose(error[large], predicted[large], rtol=0.1)


def width(parameter: Parameter) -> float:
    """Of a 95 % interval."""
    return parameter.high - parameter.low


def held(result: Identification, p: np.ndarray) -> float:
    """Share of the base parameters' intervals that hold the truth."""
    own = [group.representative < len(p) for group in result.base.groups]
    truth = true_values(result.base, p)[own]
    pairs = zip(result.model.base_parameters, truth, strict=True)
    return float(np.mean([parameter.low <= value <= parameter.high for parameter, value in pairs]))


def true_values(base: BaseParameters, p: np.ndarray) -> np.ndarray:
    """Base parameters of the true bodies; nothing was late or loaded."""
    return base.values(np.append(p, np.zeros(len(base.layout.names) - len(p))))


def test_intervals_of_a_machine_that_is_not_as_described_hold(wrong: Wrong) -> None:
    exact, honest = wrong.exact, wrong.honest
    assert held(exact, wrong.p) < 0.8
    assert held(honest, wrong.p) >= 0.9
    # Values are the same: tolerances speak of intervals only.
    assert np.array_equal(exact.model.p, honest.model.p)
    pairs = zip(exact.model.parameters, honest.model.parameters, strict=True)
    wider = [b.std / a.std for a, b in pairs if a.std]
    assert min(wider) >= 1 - 1e-9
    assert max(wider) > 1.3
    base, estimate = identify_base(compiled(wrong.robot), wrong.recording)
    values = [0.5 * width(parameter) for parameter in honest.model.base_parameters]
    assert base.rank == len(values)
    np.testing.assert_allclose(estimate.interval, values, rtol=0.05)


def test_shares_say_what_an_interval_comes_from(wrong: Wrong, tmp_path: Path) -> None:
    result = wrong.honest
    shared = [p for p in result.model.parameters if p.determined_by in ("data", "sum")]
    for parameter in (*shared, *result.model.base_parameters):
        share = parameter.share
        assert share.noise + share.prior + share.geometry + share.unseen == pytest.approx(1.0)
        assert parameter.share.prior == 0  # these intervals take no prior on trust
    decided = [p for p in shared if p.determined_by == "data"]
    assert max(parameter.share.geometry for parameter in decided if parameter.share) > 0.5
    assert max(parameter.share.unseen for parameter in shared if parameter.share) > 0.5
    assert all(parameter.share.unseen == 0 for parameter in result.model.base_parameters)
    assert all(p.share is None for p in result.model.parameters if p not in shared)
    # An interval without the part of the geometry is that of a robot without tolerances, but for
    # Student's t, which is larger where all comes from noise. That of a sum ends where bodies would
    # not be possible, so its parts do not just add up.
    for parameter, other in zip(result.model.parameters, wrong.exact.model.parameters, strict=True):
        if parameter in decided and parameter.share:
            assert width(parameter) ** 2 * (1 - parameter.share.geometry) == pytest.approx(
                width(other) ** 2, rel=0.3
            )
    table = share_table(result.model)
    assert len(table.rows) == len(decided) + len(result.model.base_parameters)
    assert "geometry" in shares_sentence(result.model)
    result.model.save(tmp_path / "model.yaml")
    loaded = IdentifiedModel.load(tmp_path / "model.yaml")
    assert loaded.parameters == result.model.parameters
    assert loaded.robot.tolerances == result.model.robot.tolerances


def test_tolerances_by_name() -> None:
    robot = load_robot("clavel-delta3")
    some = robot.changed(tolerances={"lengths": {"strut": 1e-3}, "homing": {"drive2": 1e-2}})
    usual = robot.tolerances
    assert some.tolerances.of_length("strut") == 1e-3
    assert some.tolerances.of_length("upper_arm") == usual.of_length("upper_arm") > 0
    assert some.tolerances.of_drive("drive2") == 1e-2
    assert some.tolerances.of_drive("drive1") == usual.of_drive("drive1") > 0
    assert some.tolerances.mounting == usual.mounting > 0
    assert not some.tolerances.exact
    assert robot.changed(tolerances=EXACT).tolerances.exact


@pytest.mark.parametrize(
    ("tolerances", "message"),
    [
        ({"lengths": {"forearm": 1e-3}}, "forearm"),
        ({"homing": {"drive4": 1e-3}}, "drive4"),
        ({"homing": 0.5}, "rad"),
        ({"lengths": 0.5}, "in metres"),
        ({"mounting": -0.001}, "mounting"),
    ],
)
def test_tolerances_that_cannot_be(tolerances: dict, message: str) -> None:
    with pytest.raises(DescriptionError, match=message):
        load_robot("clavel-delta3").changed(tolerances=tolerances)


def test_lengths_given_one_a_limb_have_no_error_in_common() -> None:
    robot = load_robot("clavel-delta3")
    limbs = robot.limbs.changed(upper_arm=(0.42, 0.42, 0.42))
    dynamics = compiled(robot.changed(limbs=limbs))
    _, (z, _, qd, qdd), p = moved("clavel-delta3")
    names = effects(dynamics, z, qd, qdd, p)
    assert "upper_arm" not in names
    assert "upper_arm of limb 1" in names
    assert "strut" in names
