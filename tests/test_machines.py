"""The catalogue's machines: what their makers publish is what the numbers give, and they run."""

import re

import numpy as np
import pytest

from deltaid.control.comparison import gains
from deltaid.control.control_model import ControlModel
from deltaid.control.infeasible import of_motion, of_tracking
from deltaid.control.tracking import Drives, track
from deltaid.control.trajectory import MotionTrajectory
from deltaid.dynamics.at_rest import AtRest
from deltaid.model.model import Model, load
from deltaid.motion.random_motion import random_motion, tamed
from deltaid.robot.load import catalogue, catalogue_text
from deltaid.robot.workspace import Cylinder
from support import KINDS

MACHINES = tuple(name for name in catalogue() if name not in KINDS)
# Diameter and height of the workspace as the maker has it [m], and how much more than this height
# may be within reach at the full diameter, as a factor: little where the ends of the drives are
# known. None where the workspace tapers and its height is that of the middle.
PUBLISHED = {
    "abb-irb360-1-1130": (1.130, 0.250, 1.03),
    "anycubic-kossel": (0.240, 0.300, None),
    "delta-x-2": (0.320, 0.200, None),
    "fanuc-dr-3ib-8l": (1.600, 0.500, 1.35),
    "flsun-qq-s": (0.260, 0.372, None),
}


# A Delta of 3 axes and a linear one; the others' numbers differ, not what is done with them.
FEW = ("delta-x-2", "anycubic-kossel")


@pytest.fixture(
    scope="module",
    params=[pytest.param(n, marks=() if n in FEW else pytest.mark.slow) for n in MACHINES],
)
def machine(request: pytest.FixtureRequest) -> Model:
    return load(request.param)


def reached(at_rest: AtRest, radius: float) -> float:
    """Height over which a circle about z lies within reach and the machine's own ends [m]."""
    robot, angles = at_rest.robot, np.linspace(0, 2 * np.pi, 24, endpoint=False)
    circle = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    heights = np.linspace(-3.0 * robot.limb_geometry[0].strut, 0.0, 1200)
    points = np.array([[*xy, z] for z in heights for xy in circle])
    poses = at_rest(np.pad(points, ((0, 0), (0, len(robot.drives) - 3))))
    own = [i for i, name in enumerate(at_rest.limits) if "workspace" not in name]
    own = [i for i in own if "telescope" not in at_rest.limits[i]]  # assumed from the workspace
    good = poses.stands & np.all(poses.shares[:, own] <= 1.0, axis=1)
    level = heights[good.reshape(len(heights), -1).all(axis=1)]
    return float(np.ptp(level)) if len(level) else 0.0


def test_there_are_at_least_four_makers() -> None:
    assert set(MACHINES) == set(PUBLISHED)
    makers = {load(name).robot.title.split()[0] for name in MACHINES}
    assert len(makers) == len(MACHINES) >= 5


def test_the_published_workspace_is_reached(machine: Model) -> None:
    robot = machine.robot
    diameter, height, full = PUBLISHED[robot.name]
    assert isinstance(robot.workspace, Cylinder)
    assert robot.workspace.radius == diameter / 2
    low, high = robot.workspace.z
    assert (0.97 * height if full else 0.75 * height) <= high - low <= height
    at_rest = AtRest(machine.dynamics, machine.p)
    rim, axis = reached(at_rest, diameter / 2), reached(at_rest, 0.0)
    if full:
        assert 0.98 * height <= rim <= full * height
    else:
        assert high - low <= rim <= height <= axis
    # Nothing of a machine of another size.
    assert reached(at_rest, 0.65 * diameter) < rim


def test_lengths_have_public_sources(machine: Model) -> None:
    sources = machine.robot.sources
    keys = ("upper_arm", "strut", "base_radius")
    given = [sources[f"limbs.{key}"] for key in keys if f"limbs.{key}" in sources]
    assert len(given) >= 2
    assert all("GitHub" in text for text in given)


def test_it_runs_a_motion_within_its_limits(machine: Model) -> None:
    rng = np.random.default_rng(0)
    motion = tamed(machine.dynamics, machine.p, random_motion(machine.dynamics.kinematics, rng))
    trajectory = MotionTrajectory(machine.dynamics.kinematics, motion, 1.0)
    assert of_motion(machine, trajectory) == ()
    known = ControlModel(machine.robot, machine.p)
    law = gains("computed-torque", known, trajectory, 20.0)
    followed = track(machine, law, known, trajectory, Drives())
    assert of_tracking(machine, followed) == ()
    assert followed.error.platform_max < 1e-3


def test_condition_is_as_stated(machine: Model) -> None:
    text = catalogue_text(machine.robot.name)
    stated = re.search(
        r"(\d+) base parameters; condition over the workspace (\d\.\d) to (\d\.\d)", text
    )
    assert stated
    space = machine.robot.workspace
    assert isinstance(space, Cylinder)
    angles, radii = np.linspace(0, 2 * np.pi, 40), np.linspace(0, space.radius, 5)
    flat = np.array([[r * np.cos(t), r * np.sin(t)] for r in radii for t in angles])
    z = np.array([[*xy, h] for xy in flat for h in np.linspace(*space.z, 5)])
    z = np.pad(z, ((0, 0), (0, machine.dynamics.dof - 3)))
    condition = AtRest(machine.dynamics, machine.p)(z).condition
    assert float(stated[2]) == pytest.approx(condition.min(), abs=0.06)
    assert float(stated[3]) == pytest.approx(condition.max(), abs=0.06)
