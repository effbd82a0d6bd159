"""Rows of sensors against MuJoCo, and columns of their unknowns against exact formulas."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from composed import Make
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DescriptionError
from deltaid.motion.random_motion import random_motion
from deltaid.robot.load import load_robot
from deltaid.robot.sensors import BaseWrench, JointTorque, StrutForce
from deltaid.sensors.about import about
from deltaid.sensors.of_robot import all_sensor_rows, sensor_rows
from oracle.sensors import StrutOracle
from sensor_rows import SensorTwin, dense, sensor_twin
from test_own_mechanism import own_delta

CHANNELS = ("fx", "fy", "fz", "mx", "my", "mz")
PLACE, TURN = (0.11, -0.23, 0.31), (20.0, -35.0, 130.0)
SINGLE = [
    Make(unequal=True, own=True),
    Make(telescope=True, unequal=True, tilt=(-10, 20)),
    Make(linear=True, tilt=(10, 30), inwards=(1,)),
    Make(kind="h4", own=True),
    Make(kind="h4", linear=True, unequal=True),
]
SUMS = [
    Make(kind="par4", unequal=True),
    Make(kind="i4", linear=True),
    Make(kind="i4", own=True),
    Make(telescope=True, struts=1),
]


def label(make: Make) -> str:
    drive = "linear" if make.linear else "rotary"
    return f"{make.kind}-{drive}{'-telescope' if make.telescope else ''}"


every_robot = pytest.mark.parametrize("make", [*SINGLE, *SUMS], ids=label)


def per_drive(twin: SensorTwin) -> dict[str, float]:
    """Turns of motors for a turn of their drives, or for a metre of a rail."""
    robot = twin.dynamics.robot
    return {
        drive: n / (2 * np.pi) if robot.is_linear(drive) else n
        for drive, n in zip(robot.drives, twin.oracle.turns.tolist(), strict=True)
    }


def plate(twin: SensorTwin | None = None, **more: Any) -> BaseWrench:
    """A sensor somewhere, turned, that knows the twin's motors and has no error of its own."""
    known = {"motor_turns": per_drive(twin)} if twin else {}
    own = {"position": PLACE, "rotation_deg": TURN, "force_bias": 0, "moment_bias": 0}
    return BaseWrench.model_validate({"kind": "base-wrench"} | own | known | more)


def axes() -> np.ndarray:
    """Of that sensor: intrinsic yaw, pitch, roll."""
    return Rotation.from_euler("ZYX", TURN[::-1], degrees=True).as_matrix()


def wrenches(twin: SensorTwin) -> np.ndarray:
    """What it shows, by the oracle."""
    states = zip(*twin.states, strict=True)
    return np.array([twin.oracle.base_wrench(*one, np.array(PLACE), axes()) for one in states])


def assert_same(found: np.ndarray, expected: np.ndarray) -> None:
    scale = np.abs(expected).max()
    assert scale > 1.0
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)


@every_robot
def test_a_base_carries_what_an_independent_library_says(make: Make) -> None:
    twin = sensor_twin(make)
    rows, expected = twin.rows(plate(twin)), wrenches(twin)
    assert rows.parameters == ()
    found = dense(rows, twin.states) @ twin.p
    for part in (slice(0, 3), slice(3, 6)):
        assert_same(found[:, part], expected[:, part])
    assert [one.name for one in rows.channels] == [f"s.{x}" for x in CHANNELS]
    assert [one.unit for one in rows.channels] == ["N"] * 3 + ["N m"] * 3


@every_robot
def test_spins_of_rotors_that_nobody_knows_are_unknowns(make: Make) -> None:
    twin = sensor_twin(make)
    drives, n = twin.dynamics.robot.drives, twin.oracle.turns
    known = {"drive2": per_drive(twin)["drive2"]}
    rows = twin.rows(plate(twin, motor_turns=known))
    unknown = [i for i, drive in enumerate(drives) if drive != "drive2"]
    names = [f"spin_drive{i + 1}.s" for i in unknown]
    assert [one.name for one in rows.parameters] == names
    spin = (twin.oracle.rotor_inertia / n)[unknown]
    found = dense(rows, twin.states) @ np.append(twin.p, spin)
    assert_same(found[:, 3:], wrenches(twin)[:, 3:])
    assert all(one.std > abs(s) for one, s in zip(rows.parameters, spin, strict=True))


@every_robot
def test_a_gear_passes_on_what_an_independent_library_says(make: Make) -> None:
    twin = sensor_twin(make)
    z, qd, qdd = twin.states
    expected = twin.oracle.joint_torques(z, qd, qdd)
    for i, drive in ((1, "drive2"), (len(qd[0]) - 1, f"drive{len(qd[0])}")):
        rows = twin.rows(JointTorque(kind="joint-torque", drive=drive, bias=0))
        found = dense(rows, twin.states)[:, 0] @ twin.p
        assert_same(found, expected[:, i])
        unit = "N" if make.linear and i < len(twin.oracle.limbs) else "N m"
        assert [one.unit for one in rows.channels] == [unit]
        parameters = np.array(twin.dynamics.layout.names)[np.unique(rows.pattern[1])]
        assert f"spring.{drive}" in parameters
        assert not {f"{what}.{drive}" for what in ("viscous", "coulomb", "rotor")} & set(parameters)


def test_friction_that_depends_on_load_stands_on_the_motors_side() -> None:
    robot = load_robot("clavel-delta3")
    law = robot.friction["drive1"].model_dump(exclude_none=True) | {"load": 0.1}
    loaded = robot.changed(friction={**robot.friction, "drive1": law})
    sensor = JointTorque(kind="joint-torque", drive="drive1", bias=0)
    rng = np.random.default_rng(0)
    states = np.tile(robot.home, (3, 1)), *rng.standard_normal((2, 3, 3))
    found = {}
    for one in (robot, loaded):
        rows = sensor_rows(Dynamics(one), "s", sensor)
        names = Dynamics(one).layout.names
        values = dense(rows, states)[:, 0].T
        shown = zip(names, values, strict=True)
        found[one is loaded] = {name: row.tolist() for name, row in shown if np.any(row)}
    assert found[True] == found[False]


@pytest.mark.parametrize("make", SINGLE, ids=label)
@pytest.mark.parametrize("at", ["platform", "elbow", "middle"])
def test_a_gauge_shows_what_an_independent_library_says(make: Make, at: str) -> None:
    twin = sensor_twin(make)
    assert isinstance(twin.oracle, StrutOracle)
    reference = [twin.oracle.forces(*state) for state in zip(*twin.states, strict=True)]
    every = np.array([[row[f"strut{i}{s}.{at}.x"] for s in "ab" for i in (1, 2, 3)]
                      for row in reference])  # fmt: skip
    scale = np.abs(every).max()
    for strut, expected in (
        ("strut2b", every[:, 4]),
        ("strut3a", every[:, 2]),
        ("strut1", every[:, 0] + every[:, 3]),
    ):
        sensor = {"kind": "strut-force", "strut": strut, "at": at, "bias": 0}
        rows = twin.rows(StrutForce.model_validate(sensor))
        limb = twin.oracle.limbs[int(strut[5]) - 1]
        beyond = twin.oracle.outer[limb.strut_body]
        u = [beyond.m, beyond.mc[0]] if at == "middle" else []
        assert len(rows.parameters) == len(u)
        found = dense(rows, twin.states)[:, 0] @ np.append(twin.p, u)
        np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9)


@every_robot
@pytest.mark.parametrize("at", ["platform", "elbow", "middle"])
def test_gauges_of_a_limb_show_a_sum_that_is_independent_of_how_its_struts_share(
    make: Make, at: str
) -> None:
    twin = sensor_twin(make)
    sums = [twin.oracle.strut_sums(*state) for state in zip(*twin.states, strict=True)]
    for i in (0, len(twin.oracle.limbs) - 1):
        limb = twin.oracle.limbs[i]
        sensor = {"kind": "strut-force", "strut": f"strut{i + 1}", "at": at, "bias": 0}
        rows, beyond = twin.rows(StrutForce.model_validate(sensor)), twin.oracle.outer
        outer = beyond[limb.strut_body]
        u = [outer.m, outer.mc[0]] if at == "middle" else []
        found = dense(rows, twin.states)[:, 0] @ np.append(twin.p, u)
        assert_same(found, np.array([one[f"strut{i + 1}.{at}"] for one in sums]))


def test_a_sum_in_the_middle_has_both_outer_parts() -> None:
    twin = sensor_twin(SINGLE[0])
    columns = {}
    for strut in ("strut2", "strut2a"):
        rows = twin.rows(StrutForce(kind="strut-force", strut=strut, bias=0))
        columns[strut] = dense(rows, twin.states)[:, 0, -2:]
    np.testing.assert_allclose(columns["strut2"], 2 * columns["strut2a"])


def test_offsets_that_nobody_knows_are_ten_times_what_the_robot_weighs() -> None:
    robot = load_robot("clavel-delta3")
    m = {name: body.prior_parameters()[0] for name, body in robot.bodies.items()}
    weight = 9.81 * (3 * m["U"] + 6 * m["S"] + m["P"])
    above = BaseWrench(kind="base-wrench", position=(0.0, 0.0, 10.0))
    rows = sensor_rows(Dynamics(robot), "s", above)
    force, moment = rows.parameters[0].std, rows.parameters[3].std
    assert force == pytest.approx(10 * weight)
    farthest = 10.0 - robot.home[2]  # the platform
    assert moment == pytest.approx(10 * weight * farthest, rel=1e-6)


# --- unknowns of the sensors themselves ---------------------------------------------------------


def test_errors_of_pose_and_gain_are_slopes_of_what_is_shown() -> None:
    twin = sensor_twin(SINGLE[1])
    sensor = plate(
        twin, force_bias=2.0, moment_bias=None, position_tolerance=1e-3, rotation_tolerance=2e-3,
        gain_tolerance=0.01,
    )  # fmt: skip
    rows = twin.rows(sensor, spread=0.25)
    names = [f"{one}_bias" for one in CHANNELS]
    names += [f"{what}_{axis}" for what in ("position", "rotation") for axis in "xyz"]
    assert [one.name for one in rows.parameters] == [f"{one}.s" for one in (*names, "gain")]
    stds = [2.0] * 3 + [None] * 3 + [1e-3] * 3 + [2e-3] * 3 + [0.01]
    for one, std in zip(rows.parameters, stds, strict=True):
        assert one.std == pytest.approx(0.25 * one.scale)
        assert one.kind == "sensor"
        assert one.signed
        if std is not None:
            assert one.std == pytest.approx(std)
        else:
            assert one.std > 10 * 9.81 * twin.oracle.bodies["U"].m

    nominal = wrenches(twin)

    def shown(u: np.ndarray) -> np.ndarray:
        """Exactly: a sensor at its origin + δ in its axes, then turned by θ, offset, amplified."""
        turn = Rotation.from_rotvec(u[9:12]).as_matrix()
        f = nominal[:, :3] @ turn
        m = (nominal[:, 3:] - np.cross(u[6:9], nominal[:, :3])) @ turn
        return (np.hstack([f, m]) + u[:6]) / (1 - u[12])

    D = dense(rows, twin.states, nominal.T)[:, :, len(twin.p) :]
    h = 1e-4
    for k, e in enumerate(np.eye(13)):
        slope = (8 * (shown(h * e) - shown(-h * e)) - shown(2 * h * e) + shown(-2 * h * e)) / 12 / h
        np.testing.assert_allclose(D[:, :, k], slope, rtol=0, atol=1e-8 * np.abs(slope).max())


def test_one_channel_has_a_bias_and_a_gain() -> None:
    twin = sensor_twin(SINGLE[2])
    for sensor in (
        JointTorque(kind="joint-torque", drive="drive1", gain_tolerance=0.02),
        StrutForce(kind="strut-force", strut="strut1a", at="elbow", gain_tolerance=0.02),
    ):
        rows = twin.rows(sensor)
        assert [one.name for one in rows.parameters] == ["bias.s", "gain.s"]
        weight = 9.81 * sum(body.m for body in twin.oracle.bodies.values())
        assert rows.parameters[0].std > 10 * weight
        assert rows.parameters[0].unit == "N"
        shown = np.arange(1.0, 5.0)
        D = dense(rows, twin.states, shown[None])[:, 0, len(twin.p) :]
        np.testing.assert_array_equal(D, np.column_stack([np.ones(4), shown]))


def test_a_gain_is_told_without_bias_about_what_a_fit_expects() -> None:
    """As measured, y and the gain's column share their noise, and the gain runs off towards one."""
    dynamics = Dynamics(load_robot("clavel-delta3"))
    p, scale = (
        np.array([getattr(one, what) for one in dynamics.layout.parameters])
        for what in ("prior", "scale")
    )
    rng, n, gain = np.random.default_rng(3), 1000, 0.03
    motion = random_motion(dynamics.kinematics, rng)
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, n, endpoint=False))
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    truth = p + 0.1 * scale * rng.standard_normal(len(p))
    rows = sensor_rows(
        dynamics, "s", BaseWrench(kind="base-wrench", force_bias=3.0, gain_tolerance=0.05)
    )
    states, first = (z, qd, qdd), len(p)
    noise, u = np.repeat([1.0, 0.1], 3), np.zeros(len(rows.parameters))
    u[:6], u[-1] = rng.uniform(-3, 3, 6), gain
    exact = about(rows, np.append(truth, u)).expected(*states)
    y = exact + noise[:, None] * rng.standard_normal(exact.shape)
    tau = dynamics.regressor(q, qd, qdd).reshape(3 * n, -1)
    sigma = 0.02 * np.abs(tau @ truth).max()
    torque = tau @ truth + sigma * rng.standard_normal(3 * n)
    prior = np.append(p, np.zeros(len(u)))
    stds = np.append(0.5 * scale, [one.std for one in rows.parameters])

    def fitted(seen: np.ndarray) -> tuple[np.ndarray, float]:
        A = (dense(rows, states, seen) / noise[:, None]).reshape(6 * n, -1)
        wide = np.hstack([tau / sigma, np.zeros((3 * n, len(u)))])
        M = np.vstack([wide, A, np.diag(1 / stds)])
        b = np.concatenate([torque / sigma, (y.T / noise).ravel(), prior / stds])
        found = np.linalg.lstsq(M, b)[0]
        return found, float(np.sqrt(np.linalg.inv(M.T @ M)[-1, -1]))

    plain, std = fitted(y)
    assert plain[-1] > gain + 20 * std
    found = prior
    for _ in range(6):
        found, std = fitted(about(rows, found).expected(*states))
    assert abs(found[-1] - gain) < 3 * std
    np.testing.assert_allclose(found[first : first + 2], u[:2], atol=0.2)  # fz: U.m as well
    same = about(rows, found)
    assert (same.name, same.channels, same.parameters) == ("s", rows.channels, rows.parameters)
    expected = dense(rows, states, same.expected(*states))
    np.testing.assert_array_equal(dense(same, states), expected)


# --- robots of the user's own, and what is refused ----------------------------------------------


def test_a_mechanism_of_ones_own_has_the_same_rows(tmp_path: Path) -> None:
    robots = load_robot("clavel-delta3"), own_delta(tmp_path)
    rng, sensor = np.random.default_rng(1), plate()
    states = robots[0].home + rng.uniform(-0.1, 0.1, (5, 3)), *rng.standard_normal((2, 5, 3))
    mine, theirs = (dense(sensor_rows(Dynamics(one), "s", sensor), states) for one in robots)
    np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-10 * np.abs(mine).max())
    visible = [np.abs(found).max(axis=(0, 1)) > 0 for found in (mine, theirs)]
    np.testing.assert_array_equal(*visible)


def test_motors_of_a_mechanism_of_ones_own_may_turn_about_any_axis(tmp_path: Path) -> None:
    robot = own_delta(tmp_path).changed(rotor_inertia={"drive1": 0.02, "drive3": 0.03})
    rows = sensor_rows(Dynamics(robot), "s", plate(rotation_deg=(0, 0, 0)))
    spins = [f"spin_{axis}_drive{i}.s" for i in (1, 3) for axis in "xyz"]
    assert [one.name for one in rows.parameters] == spins
    qdd = np.array([[2.0, 3.0, 5.0]])
    found = dense(rows, (robot.home[None], np.zeros((1, 3)), qdd))[0, 3:, -6:]
    np.testing.assert_allclose(found, np.hstack([2 * np.eye(3), 5 * np.eye(3)]))
    with pytest.raises(DescriptionError, match="about which axes its motors turn"):
        sensor_rows(Dynamics(robot), "s", plate(motor_turns=4.0))
    gauge = StrutForce(kind="strut-force", strut="strut1")
    with pytest.raises(DescriptionError, match="which joints carry them"):
        sensor_rows(Dynamics(robot), "s", gauge)


@pytest.mark.parametrize(
    ("robot", "strut", "message"),
    [
        ("clavel-delta3", "strut4a", "there is no strut 'strut4a'; there are strut1, strut2, str"),
        ("clavel-delta3", "arm", "there is no strut 'arm'"),
        ("clavel-delta3", "strut2a", "give limbs.strut_spacing, or name the sum of both, strut2"),
        ("par4", "strut2b", "depends on how stiff they are: a platform of kind par4"),
    ],
)
def test_struts_that_are_not_determined_are_refused(robot: str, strut: str, message: str) -> None:
    described = load_robot(robot)
    assert described.limbs is not None
    described = described.changed(limbs=described.limbs.changed(strut_spacing=None))
    with pytest.raises(DescriptionError, match=r"sensors\.gauge\.strut") as told:
        sensor_rows(Dynamics(described), "gauge", StrutForce(kind="strut-force", strut=strut))
    assert message in str(told.value)


def test_other_sensors_without_a_place_are_refused() -> None:
    dynamics = Dynamics(load_robot("par4"))
    with pytest.raises(DescriptionError, match="there is no drive 'drive5'; there are drive1, "):
        sensor_rows(dynamics, "s", JointTorque(kind="joint-torque", drive="drive5"))
    with pytest.raises(DescriptionError, match="no turn moves nothing"):
        sensor_rows(dynamics, "s", plate(motor_turns=0.0))
    one = sensor_twin(SUMS[3]).dynamics
    with pytest.raises(DescriptionError, match="one strut each"):
        sensor_rows(one, "s", StrutForce(kind="strut-force", strut="strut1a"))


def test_a_robot_without_sensors_pays_nothing() -> None:
    dynamics = Dynamics(load_robot("clavel-delta3"))
    assert all_sensor_rows(dynamics) == ()
    assert "equations" not in vars(dynamics)
    told = {"plate": plate(), "gauge": StrutForce(kind="strut-force", strut="strut1")}
    robot = dynamics.robot.changed(sensors=told)
    rows = all_sensor_rows(Dynamics(robot))
    assert [one.name for one in rows] == ["plate", "gauge"]
