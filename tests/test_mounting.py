"""Limbs that are mounted otherwise than described: exact application, and what is identified."""

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.geometry import grown_torques
from deltaid.effects.geometry import reshaped
from deltaid.effects.mounting import direction, numbers_of
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.robot.mounting import remounted
from drives import case
from drives.identify import identified
from drives.judge import judge

# Four decades above rounding of positions, and so small that squares vanish.
SMALL = 1e-6


def tilted_rails() -> RobotDescription:
    robot = load_robot("linear-delta")
    assert robot.limbs is not None
    return robot.changed(limbs=robot.limbs.changed(tilt_deg=-32.0))


def by_points() -> RobotDescription:
    robot = load_robot("clavel-delta3")
    assert robot.limbs is not None
    return robot.changed(limbs=robot.limbs.changed(**remounted(robot.limbs, [{}] * 3)))


ROBOTS = {name: load_robot(name) for name in ("clavel-delta3", "linear-delta", "h4", "par4")} | {
    "tilted rails": tilted_rails(),
    "points": by_points(),
}


@pytest.mark.parametrize("name", [*ROBOTS])
def test_a_robot_is_remounted_as_its_slopes_say(name: str) -> None:
    """Slopes are those of machines that an oracle builds so: test_calibration_torques."""
    robot, rng = ROBOTS[name], np.random.default_rng(3)
    numbers = numbers_of(robot)
    values = SMALL * rng.standard_normal(len(numbers))
    kinematics = compiled(robot).kinematics
    z = kinematics.home + 0.03 * rng.standard_normal((4, kinematics.dof))
    grown = grown_torques(robot, mounted=True)
    growth = sum(
        value * direction(kind, limb, robot.limb_geometry, grown.symbols)
        for value, (limb, kind) in zip(values, numbers, strict=True)
    )
    expected = grown.position(z, growth)[0] - grown.position(z, 0.0 * growth)[0]
    other = compiled(reshaped(robot, mounted=values.tolist())).kinematics
    moved = other.inverse(z) - kinematics.inverse(z)
    assert np.abs(moved).max() > 0.1 * SMALL
    np.testing.assert_allclose(moved, expected, atol=1e-4 * SMALL)


def test_numbers_are_those_that_no_length_is_and_that_a_description_states() -> None:
    kinds = {name: {kind for _, kind in numbers_of(robot)} for name, robot in ROBOTS.items()}
    assert kinds["clavel-delta3"] == {"base_across", "base_up", "azimuth", "tilt"}
    assert kinds["points"] == kinds["clavel-delta3"] | {"base_out"}
    assert kinds["linear-delta"] == {"rail_across", "lean_out"}
    assert kinds["tilted rails"] == {"rail_across", "lean_out", "lean_across"}


@pytest.mark.parametrize(
    "kind",
    ["delta3", *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("delta4", "par4", "h4"))],
)
def test_a_limb_that_is_mounted_otherwise_is_corrected(kind: str) -> None:
    """It made M 2 to 5 % wrong as friction by direction, hoses and compliance."""
    made = case("mounting", kind)
    result = identified(made)
    judged = judge(made, result)
    assert judged.M < 0.007
    assert judged.friction_shape < 0.01
    corrected = {c.subject: c.text for c in result.model.corrections if c.kind == "mounting"}
    assert len(corrected) == len(result.robot.limb_geometry)
    assert all("axis azimuth" in text and "mrad" in text for text in corrected.values())
