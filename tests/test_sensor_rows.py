"""Rows of sensors against MuJoCo, and robots whose sensors cannot be told."""

from pathlib import Path

import numpy as np
import pytest

from composed import SINGLE, Make, label
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DescriptionError
from deltaid.robot.load import load_robot
from deltaid.robot.sensors import JointTorque, StrutForce
from deltaid.sensors.robot_sensors import all_sensor_rows, sensor_rows
from oracle.sensors import StrutOracle
from sensor_rows import CHANNELS, SUMS, assert_same, dense, per_drive, plate, sensor_twin, wrenches
from test_own_mechanism import own_delta


def each(*makes: Make) -> pytest.MarkDecorator:
    """With a telescope, of an H4 on rails and of a Par4 by default, the others with --slow."""
    quick = (SINGLE[1], SINGLE[4], SUMS[0])
    marked = [pytest.param(m, marks=() if m in quick else pytest.mark.slow) for m in makes]
    return pytest.mark.parametrize("make", marked, ids=label)


every_robot = each(*SINGLE, *SUMS)


@every_robot
def test_a_base_carries_what_an_independent_library_says(make: Make) -> None:
    twin = sensor_twin(make)
    rows, expected = twin.rows(plate(twin)), wrenches(twin)
    assert rows.parameters == ()
    found = dense(rows, twin.states) @ twin.p
    for part in (slice(0, 3), slice(3, 6)):
        assert_same(found[:, part], expected[:, part])
    assert [channel.name for channel in rows.channels] == [f"s.{x}" for x in CHANNELS]
    assert [channel.unit for channel in rows.channels] == ["N"] * 3 + ["N m"] * 3


@every_robot
def test_spins_of_rotors_that_nobody_knows_are_unknowns(make: Make) -> None:
    twin = sensor_twin(make)
    drives, n = twin.dynamics.robot.drives, twin.oracle.turns
    known = {"drive2": per_drive(twin)["drive2"]}
    rows = twin.rows(plate(twin, motor_turns=known))
    unknown = [i for i, drive in enumerate(drives) if drive != "drive2"]
    names = [f"spin_drive{i + 1}.s" for i in unknown]
    assert [parameter.name for parameter in rows.parameters] == names
    spin = (twin.oracle.rotor_inertia / n)[unknown]
    found = dense(rows, twin.states) @ np.append(twin.p, spin)
    assert_same(found[:, 3:], wrenches(twin)[:, 3:])
    assert all(parameter.std > abs(s) for parameter, s in zip(rows.parameters, spin, strict=True))


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
        assert [channel.unit for channel in rows.channels] == [unit]
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
    for described in (robot, loaded):
        rows = sensor_rows(Dynamics(described), "s", sensor)
        names = Dynamics(described).layout.names
        values = dense(rows, states)[:, 0].T
        shown = zip(names, values, strict=True)
        found[described is loaded] = {name: row.tolist() for name, row in shown if np.any(row)}
    assert found[True] == found[False]


@each(*SINGLE)
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
@pytest.mark.parametrize(
    "at", [*(pytest.param(x, marks=pytest.mark.slow) for x in ("platform", "elbow")), "middle"]
)
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
        assert_same(found, np.array([forces[f"strut{i + 1}.{at}"] for forces in sums]))


def test_a_sum_in_the_middle_has_both_outer_parts() -> None:
    twin = sensor_twin(SINGLE[0])
    columns = {}
    for strut in ("strut2", "strut2a"):
        rows = twin.rows(StrutForce(kind="strut-force", strut=strut, bias=0))
        columns[strut] = dense(rows, twin.states)[:, 0, -2:]
    np.testing.assert_allclose(columns["strut2"], 2 * columns["strut2a"])


# --- robots of the user's own, and what is refused ----------------------------------------------


def test_a_mechanism_of_ones_own_has_the_same_rows(tmp_path: Path) -> None:
    robots = load_robot("clavel-delta3"), own_delta(tmp_path)
    rng, sensor = np.random.default_rng(1), plate()
    states = robots[0].home + rng.uniform(-0.1, 0.1, (5, 3)), *rng.standard_normal((2, 5, 3))
    mine, theirs = (dense(sensor_rows(Dynamics(robot), "s", sensor), states) for robot in robots)
    np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-10 * np.abs(mine).max())
    visible = [np.abs(rows).max(axis=(0, 1)) > 0 for rows in (mine, theirs)]
    np.testing.assert_array_equal(*visible)


def test_motors_of_a_mechanism_of_ones_own_may_turn_about_any_axis(tmp_path: Path) -> None:
    robot = own_delta(tmp_path).changed(rotor_inertia={"drive1": 0.02, "drive3": 0.03})
    rows = sensor_rows(Dynamics(robot), "s", plate(rotation_deg=(0, 0, 0)))
    spins = [f"spin_{axis}_drive{i}.s" for i in (1, 3) for axis in "xyz"]
    assert [parameter.name for parameter in rows.parameters] == spins
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
    described = described.changed(limbs=described.limbs.changed(strut_spacing=None))
    with pytest.raises(DescriptionError, match=r"sensors\.gauge\.strut") as caught:
        sensor_rows(Dynamics(described), "gauge", StrutForce(kind="strut-force", strut=strut))
    assert message in str(caught.value)


def test_other_sensors_without_a_place_are_refused() -> None:
    dynamics = Dynamics(load_robot("par4"))
    with pytest.raises(DescriptionError, match="there is no drive 'drive5'; there are drive1, "):
        sensor_rows(dynamics, "s", JointTorque(kind="joint-torque", drive="drive5"))
    with pytest.raises(DescriptionError, match="no turn moves nothing"):
        sensor_rows(dynamics, "s", plate(motor_turns=0.0))
    pair_dynamics = sensor_twin(SUMS[3]).dynamics
    with pytest.raises(DescriptionError, match="one strut each"):
        sensor_rows(pair_dynamics, "s", StrutForce(kind="strut-force", strut="strut1a"))


def test_a_robot_without_sensors_pays_nothing() -> None:
    dynamics = Dynamics(load_robot("clavel-delta3"))
    assert all_sensor_rows(dynamics) == ()
    assert "equations" not in vars(dynamics)
    sensors = {"plate": plate(), "gauge": StrutForce(kind="strut-force", strut="strut1")}
    robot = dynamics.robot.changed(sensors=sensors)
    rows = all_sensor_rows(Dynamics(robot))
    assert [row.name for row in rows] == ["plate", "gauge"]
