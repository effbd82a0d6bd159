"""What no row sees: how many directions, in words, and that nothing changes along them."""

from functools import cache

import numpy as np
import pytest

from composed import Make, twin
from deltaid.dynamics.dynamics import compiled
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.robot.load import load_robot
from deltaid.robot.sensors import BaseWrench, StrutForce
from deltaid.sensors.planning.exchange import exchanges, instances
from deltaid.sensors.planning.null_space import NullSpace, null_space, openings
from deltaid.sensors.planning.rows import (
    PlannedRecording,
    generic_motion,
    planned_rows,
    torque_rows,
)
from deltaid.sensors.planning.uses import Use
from deltaid.sensors.robot_sensors import sensor_rows

ELBOW = "mass at the elbow's ball joints may pass between upper arm and strut"
CARRIAGE = "mass at the carriage's ball joints may pass between carriage and strut"
PLATFORM = "mass at the platform's ball joints may pass between strut and {}"
TARED = {"force_bias": 0.0, "moment_bias": 0.0, "motor_turns": 20.0}
TOOL = "{} on the tool's axis may pass between {} and end effector"

# By robot: parameters seen, combinations told, and what stays open to torques and a tared wrench.
KNOWN = {
    "clavel-delta3": (26, 24, {ELBOW, PLATFORM.format("platform")}),
    "linear-delta": (26, 24, {CARRIAGE, PLATFORM.format("platform")}),
    "irb360-6-1600": (
        58,
        46,
        {
            ELBOW,
            PLATFORM.format("platform"),
            "mass at the lower universal joint may pass between platform and lower telescope bar",
            TOOL.format("mass", "platform"),
            TOOL.format("first moment", "platform"),
            "mass at rest in the base may pass between upper arm and upper telescope bar",
            *(
                f"the second moment {name} may pass between upper telescope bar and lower "
                "telescope bar"
                for name in ("Sxx", "Syy", "Szz", "Sxy", "Syz", "Sxz")
            ),
        },
    ),
    "par4": (
        48,
        42,
        {
            ELBOW,
            PLATFORM.format("main part"),
            "mass at the rods' ends may pass between main part and rod",
            "first moment at the rods' ends may pass between main part and rod",
            TOOL.format("mass", "rod"),
            TOOL.format("first moment", "rod"),
        },
    ),
    "h4": (
        45,
        39,
        {
            ELBOW,
            PLATFORM.format("side bar"),
            "mass at the middle bar's ends may pass between side bar and middle bar",
            "first moment at the middle bar's ends may pass between side bar and middle bar",
            TOOL.format("mass", "middle bar"),
            TOOL.format("first moment", "middle bar"),
        },
    ),
    "i4": (
        40,
        36,
        {
            ELBOW,
            PLATFORM.format("half platform"),
            "mass where rack and pinion meet may pass between half platform and end effector",
            "first moment along z may pass between half platform and end effector",
        },
    ),
}
# The same by torques alone.
ALONE = {
    "clavel-delta3": (20, 18), "linear-delta": (21, 19), "irb360-6-1600": (48, 37),
    "par4": (36, 30), "h4": (32, 27), "i4": (32, 28),
}  # fmt: skip


@cache
def recorded(name: str) -> PlannedRecording:
    dynamics = compiled(load_robot(name))
    motion = generic_motion(dynamics, 20.0, 1)
    return PlannedRecording.with_noise(dynamics, motion, len(motion.z) / motion.duration, 1.0)


def left_open(name: str, *sensors: BaseWrench | StrutForce) -> NullSpace:
    where = recorded(name)
    dynamics, motion = where.dynamics, where.motion
    rows = [torque_rows(where)]
    rows += [planned_rows(where, sensor_rows(dynamics, "s", sensor))[1] for sensor in sensors]
    along = instances(dynamics.kinematics, motion.z[::50])
    found = exchanges(dynamics.robot, dynamics.layout, along)
    return null_space(np.vstack(rows)[:, : len(where.p)], dynamics.layout, found)


@pytest.mark.parametrize("name", KNOWN)
def test_all_directions_by_name_with_a_wrench(name: str) -> None:
    null = left_open(name, BaseWrench(kind="base-wrench", **TARED))
    seen, rank, words = KNOWN[name]
    assert (null.visible, null.rank) == (seen, rank)
    assert {direction.words for direction in null.directions} == words
    assert len(null.directions) == seen - rank == len(words)


@pytest.mark.parametrize("name", ALONE)
def test_all_directions_by_name_by_torques_alone(name: str) -> None:
    null = left_open(name)
    assert (null.visible, null.rank) == ALONE[name]
    assert len(null.directions) == null.visible - null.rank
    assert not any(
        "combination" in direction.words or "together" in direction.words
        for direction in null.directions
    )
    assert "P.Sxx" not in null.invisible
    assert all(
        entry not in null.invisible for direction in null.directions for entry in direction.entries
    )


def test_an_offset_that_nobody_knows_hides_what_only_weighs() -> None:
    tared = left_open("irb360-6-1600", BaseWrench(kind="base-wrench", **TARED))
    open_ = left_open("irb360-6-1600", BaseWrench(kind="base-wrench", motor_turns=20.0))
    assert (tared.rank, open_.rank) == (46, 45)
    assert {"U.m", "TU.m"} <= set(open_.invisible)
    # A rotor whose spin is not known takes what the plate tells of the tool.
    spun = left_open("irb360-6-1600", BaseWrench(kind="base-wrench"))
    assert spun.rank == 44
    words = "inertia may pass between the rotor of drive4 and the tool"
    assert words in {direction.words for direction in spun.directions}


@pytest.mark.parametrize("name", [n for n in KNOWN if n != "linear-delta"])
def test_nothing_changes_along_a_direction(name: str) -> None:
    # From outside of rows and null spaces: torques of two different robots.
    where, rng = recorded(name), np.random.default_rng(2)
    dynamics, motion = where.dynamics, where.motion
    null = left_open(name, BaseWrench(kind="base-wrench", **TARED))
    some = slice(None, None, 100)
    states = motion.z[some], motion.qd[some], motion.qdd[some]
    wrench = sensor_rows(dynamics, "s", BaseWrench(kind="base-wrench", **TARED))
    channels, columns = wrench.pattern
    entries = wrench.entries(*states, np.zeros((6, len(states[0]))))

    def shown(p: np.ndarray) -> np.ndarray:
        values = np.zeros((6, len(states[0])))
        np.add.at(values, channels, entries * p[columns][:, None])
        return np.hstack([dynamics.torque(*states, p), values.T])

    for direction in null.directions:
        p = where.p * rng.uniform(0.5, 2.0, len(where.p))
        size = 0.1 / max(np.abs(direction.direction / where.p[where.p != 0].max()).max(), 1e-9)
        before, after = shown(p), shown(p + size * direction.direction)
        assert np.abs(after - before).max() < 1e-8 * np.abs(before).max(), direction.words
        assert np.abs(direction.direction).max() > 0


def test_forces_at_the_joint_do_change() -> None:
    where = recorded("clavel-delta3")
    forces, motion = ConstraintForces(where.dynamics.robot), where.motion
    null = left_open("clavel-delta3")
    states = motion.z[::200], motion.qd[::200], motion.qdd[::200]
    C = forces.coefficients(*states)
    by_words = {direction.words: C @ direction.direction for direction in null.directions}
    elbow, platform = forces.index("strut1.elbow.x"), forces.index("strut1.platform.x")
    at_elbow, at_platform = by_words[ELBOW], by_words[PLATFORM.format("platform")]
    assert np.abs(at_elbow[:, elbow]).max() > 1.0 > 1e-9 > np.abs(at_elbow[:, platform]).max()
    assert np.abs(at_platform[:, platform]).max() > 1.0 > 1e-9 > np.abs(at_platform[:, elbow]).max()


@pytest.mark.parametrize(
    "make",
    [
        Make(unequal=True),
        Make(unequal=True, own=True),
        Make(own=True),
        Make(telescope=True, tilt=(-10, 10)),
        Make(linear=True),
        Make(kind="par4"),
    ],
    ids=["unequal", "all unequal", "own", "telescope", "linear", "par4"],
)
def test_random_robots_have_all_of_their_directions_named(make: Make) -> None:
    robot = twin(make, 4).robot
    dynamics = compiled(robot)
    motion = generic_motion(dynamics, 20.0, 0)
    where = PlannedRecording(dynamics, motion, 1.0, np.ones(dynamics.dof))
    rows = torque_rows(where)[:, : len(where.p)]
    along = instances(dynamics.kinematics, motion.z[::50])
    found = exchanges(robot, dynamics.layout, along)
    null = null_space(rows, dynamics.layout, found)
    words = [direction.words for direction in null.directions]
    assert len(words) == null.visible - null.rank > 0
    assert not any("combination" in word for word in words), words
    # Struts that are alike in limbs of unequal lengths share no end with any of them.
    assert any("the platform's ball joints" in word for word in words) == (
        make.own or not make.unequal
    )
    if make.own:
        assert any("strut 3" in word for word in words)


def test_what_parts_a_direction_is_what_leaves_it_no_way_out() -> None:
    where = recorded("clavel-delta3")
    layout = where.dynamics.layout
    torque = torque_rows(where)

    def weighed(*bodies: str) -> Use:
        row = np.zeros((1, where.width))
        for body in bodies:
            row[0, layout.body(body).start] = 1e3
        return Use(f"scale:{'+'.join(bodies)}", "", "scale", "scale", 0.0, 0.0, row, row)

    uses = [weighed("S"), weighed("P"), weighed("U"), weighed("S", "P")]
    none = np.zeros((0, where.width))
    found = openings(where.dynamics, where.motion, torque, none, uses, [])
    assert [outlook.name for outlook in found] == ["torques", *(use.name for use in uses)]
    parted = {
        direction.words: names
        for direction, names in zip(found[0].null.directions, found[0].parted, strict=True)
    }
    # The arm's own mass is seen by no torque, so weighing it says nothing of what passes there.
    assert parted[ELBOW] == ("scale:S", "scale:S+P")
    assert parted[PLATFORM.format("platform")] == ("scale:S", "scale:P", "scale:S+P")
    assert [len(outlook.null.directions) for outlook in found] == [2, 1, 1, 2, 1]
