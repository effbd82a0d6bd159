"""Every catalogue robot through the whole pipeline: what its file states, motion, fit, commands."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.stats import qmc

from command import Outcome, accepted, json_of, run
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.demo import mass_matrix_error
from deltaid.identification.generic_motion import random_motion_base
from deltaid.model.record import IdentifiedModel
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import (
    Motion,
    SensorNoise,
    simulate_recording,
    surrogate_parameters,
    write_recording,
)
from deltaid.robot.description import RobotDescription
from deltaid.robot.limits import Box, Cylinder
from deltaid.robot.load import catalogue_text, load_robot
from deltaid.robot.platform import I4Platform, Par4Platform, RigidPlatform
from html_page import Document
from support import KINDS

_RANGE = r"([\d.]+)\s+(?:# )?to\s+(?:# )?(\d+\.\d+)"
STATED = re.compile(
    rf"(\d+) base parameters; condition over the workspace {_RANGE}"
    rf"(?:, of\s+(?:# )?what keeps the bars parallel {_RANGE})?\."
)


@dataclass(frozen=True)
class Case:
    """A catalogue robot, compiled, and what its file says of it.

    Attributes:
        condition: range of the Jacobian's condition.
        hold: of the condition of what keeps the platform's parts parallel, where the file has one.
    """

    name: str
    dynamics: Dynamics
    base: int
    condition: tuple[float, float]
    hold: tuple[float, float] | None

    @property
    def robot(self) -> RobotDescription:
        return self.dynamics.robot


def each(*quick: str) -> pytest.MarkDecorator:
    """Every robot as `case`: these by default, the others with --slow."""
    others = [pytest.param(name, marks=pytest.mark.slow) for name in KINDS if name not in quick]
    return pytest.mark.parametrize("case", [*quick, *others], indirect=True)


@pytest.fixture(scope="module")
def case(request) -> Case:
    stated = STATED.search(catalogue_text(request.param))
    assert stated, "the file does not state base parameters and condition"
    base, *ranges = stated.groups()
    low, high, *hold = [float(number) for number in ranges if number is not None]
    dynamics = compiled(load_robot(request.param))
    return Case(request.param, dynamics, int(base), (low, high), tuple(hold) or None)


def over_workspace(robot: RobotDescription, power: int = 13) -> np.ndarray:
    """Poses z all over the workspace and the range of ψ, and on their edges."""
    u = np.clip(1.3 * (qmc.Sobol(4, seed=0).random_base2(power) - 0.5) + 0.5, 0, 1)
    space = robot.workspace
    if isinstance(space, Cylinder):
        radius, angle = space.radius * np.sqrt(u[:, 0]), 2 * np.pi * u[:, 1]
        low, high = space.z
        height = low + u[:, 2] * (high - low)
        z = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    else:
        assert isinstance(space, Box)
        bounds = np.array([space.x, space.y, space.z])
        z = bounds[:, 0] + u[:, :3] * np.diff(bounds).T
    if len(robot.drives) == 3:
        return z
    turn = robot.turn
    return np.column_stack([z, turn.low + u[:, 3] * (turn.high - turn.low)])


def held_points(robot: RobotDescription, z: np.ndarray) -> list[np.ndarray]:
    """Middle of each limb's strut joints on the platform, from the formulas of the literature."""
    limbs, platform = robot.limbs, robot.platform
    points = []
    for i, azimuth in enumerate(np.deg2rad(limbs.azimuth_deg)):
        if limbs.platform_points is not None:
            fixed = np.array(limbs.platform_points[i])
        else:
            fixed = limbs.platform_radius * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        point = z[:, :3] + fixed
        if not isinstance(platform, RigidPlatform):
            joint, side = z[:, 3] / platform.ratio, 1 if i + 1 in platform.first else -1
            if isinstance(platform, I4Platform):
                e = np.deg2rad(platform.direction_deg)
                point += 0.5 * side * joint[:, None] * [np.cos(e), np.sin(e), 0.0]
            else:
                par4 = isinstance(platform, Par4Platform)
                length = 0.5 * platform.length if par4 else platform.half_length
                across = np.column_stack([np.cos(joint), np.sin(joint), np.zeros_like(joint)])
                point += side * length * across
        points.append(point)
    return points


@each("irb360-6-1600", "h4", "i4-linear", "par4")
def test_the_file_states_base_parameters_and_condition(case: Case) -> None:
    for seed in range(3):
        assert random_motion_base(case.dynamics, seed).rank == case.base
    z = over_workspace(case.robot)
    regular = case.dynamics.kinematics.regularity(z)
    ranges = [(case.condition, regular.condition)]
    ranges += [(case.hold, regular.hold)] if case.hold else []
    for (low, high), condition in ranges:
        assert low <= condition.min() <= low + 0.15
        assert high - 0.15 <= condition.max() <= high
    assert regular.worst.max() < case.robot.largest_condition
    assert np.ptp(np.sign(regular.determinant)) == 0  # no singularity in between


@each("irb360-6-1600", "h4", "i4-linear", "par4")
def test_loops_close_over_the_workspace(case: Case) -> None:
    kinematics, robot = case.dynamics.kinematics, case.robot
    z = over_workspace(robot, 10)
    q = kinematics.inverse(z)
    poses = kinematics.poses(z)
    limbs, driven = robot.limb_geometry, [p for p in poses if p.name in ("U", "C")]
    struts = [p for p in poses if p.name == "S"]
    for i, held in enumerate(held_points(robot, z)):
        end = struts[i].r_WB + limbs[i].strut * struts[i].R_WB[:, :, 0]
        np.testing.assert_allclose(end, held, atol=1e-12)
        elbow = driven[i].r_WB + limbs[i].upper_arm * driven[i].R_WB[:, :, 0]
        np.testing.assert_allclose(struts[i].r_WB, elbow, atol=1e-12)
        given = robot.drive_limits[f"drive{i + 1}"].range
        assert given[0] <= q[:, i].min() <= q[:, i].max() <= given[1]
    np.testing.assert_allclose(kinematics.forward(q), z, atol=1e-9)


@each("irb360-6-1600", "i4-linear")
def test_an_excitation_keeps_its_limits(case: Case) -> None:
    exciter = Exciter(case.dynamics, ExcitationSettings(starts=1, harmonics=2))
    result = exciter.optimise()
    assert result.criterion_after < result.criterion_before - 1
    assert len(result.predictions) == case.base
    assert max(limit.share for limit in result.limits) <= 1 + 1e-9
    z, zd, zdd = result.run.evaluate(np.linspace(0, result.run.duration, 5000))
    q, _, _ = case.dynamics.kinematics.drive_motion(z, zd, zdd)
    for i, drive in enumerate(case.robot.drives):
        given = case.robot.drive_limits[drive]
        low, high = given.range or (-np.inf, np.inf)
        assert low <= q[:, i].min() <= q[:, i].max() <= high
        assert given.effort is None or result.torque_max[i] <= given.effort
    assert np.all(case.robot.workspace.contains(z[:, :3]))
    assert case.dynamics.kinematics.condition(z).max() < case.robot.largest_condition
    assert np.abs(zd[[0, -1]]).max() < 1e-9


@dataclass(frozen=True)
class Found:
    """What `deltaid identify` makes of a recording without noise: its words, and a model file."""

    truth: np.ndarray
    motion: Motion
    outcome: Outcome
    model: Path


@pytest.fixture(scope="module")
def commanded(case: Case, tmp_path_factory) -> Found:
    folder, rng = tmp_path_factory.mktemp(case.name), np.random.default_rng(1)
    truth = surrogate_parameters(case.robot, rng)
    motion = random_motion(case.dynamics.kinematics, rng)
    recording = simulate_recording(case.dynamics, truth, motion, rng, duration=10.0, rate=200.0)
    write_recording(recording, folder / "log.csv")
    outcome = accepted("identify", case.name, folder / "log.csv", "-o", folder / "model.yaml")
    return Found(truth, motion, outcome, folder / "model.yaml")


@each("h4", "i4-linear")
def test_an_identification_without_noise_finds_the_truth(case: Case, commanded: Found) -> None:
    dynamics, truth, model = case.dynamics, commanded.truth, IdentifiedModel.load(commanded.model)
    assert model.consistent
    assert model.fit.base_parameters == case.base
    friction = dynamics.layout.friction
    np.testing.assert_allclose(model.p[friction], truth[friction], rtol=1e-4)
    z, _, _ = commanded.motion.evaluate(np.linspace(0, 10, 300))
    assert max(mass_matrix_error(dynamics, z, truth, model.p)) < 1e-4


@each("h4", "i4-linear")
def test_commands_and_pages(case: Case, commanded: Found) -> None:
    linear, rng = case.robot.is_linear("drive1"), np.random.default_rng(2)
    folder = commanded.model.parent
    page, log = folder / "page.html", folder / "verify.csv"
    recording = simulate_recording(
        case.dynamics, commanded.truth, random_motion(case.dynamics.kinematics, rng), rng,
        duration=5.0, rate=400.0, noise=SensorNoise(),
    )  # fmt: skip
    write_recording(recording, log)
    assert ("force error, N " if linear else "torque error, N m") in commanded.outcome.out
    full = run("identify", case.name, folder / "log.csv", "--full").out
    assert ("N s/m" if linear else "N m s/rad") in full
    assert max(json_of("validate", commanded.model, log, "--report", page)["nrmse"]) < 0.03
    text = page.read_text(encoding="utf-8")
    unit, other = ("N", "N m") if linear else ("N m", "N")
    assert f"drive1 [{unit}]" in text
    assert f"residual [{unit}]" in text
    assert f"residual [{other}]" not in text
    accepted("torque", commanded.model, log, "-o", folder / "torque.csv")
    predicted = pl.read_csv(folder / "torque.csv")
    assert predicted.columns == ["t", *(f"tau{i + 1}" for i in range(len(case.robot.drives)))]
    assert json_of("base", case.name)["base_parameters"] == case.base


@pytest.mark.slow
@pytest.mark.parametrize("name", ["par4", "h4-linear"])
def test_demo(name: str) -> None:
    outcome = accepted("demo", name, "--full")
    assert "viscous.platform" in outcome.out
    share = re.search(r"mass matrix within ([\d.]+) % on .*friction within ([\d.]+) %", outcome.out)
    assert max(map(float, share.groups())) < 10


def test_pages_of_an_excitation_with_linear_drives(tmp_path: Path) -> None:
    page, motion = tmp_path / "page.html", tmp_path / "motion.csv"
    arguments = ("-o", motion, "--plot", tmp_path / "m.png", "--report", page)
    outcome = accepted("excite", "i4-linear", "--starts", 1, "--harmonics", 2, *arguments)
    assert f"wrote {page}" in outcome.out
    text = page.read_text(encoding="utf-8")
    assert {"Motion", "Limits", "Predicted deviations", "Search"} <= set(Document(text).texts)
    assert re.search(r"Good: [\d.]+ s from rest to rest, within all \d+ limits; ", text)
    assert all(word in text for word in ("position [m]", "speed [m", "force [N]"))
    assert not any(word in text for word in ("angle [deg]", "speed [deg", "torque [N m]"))
    assert re.search(r"largest forces at the prior: [\d., ]+ N\n", outcome.out)


def test_equal_rotors_differ_by_nothing_at_the_prior() -> None:
    # Par4's torques show differences of its rotors' inertias, which the catalogue has equal.
    dynamics = compiled(load_robot("par4"))
    base, p = random_motion_base(dynamics), prior_parameters(dynamics.robot)
    values = dict(zip(base.formulas, base.values(p), strict=True))
    assert p[dynamics.layout.names.index("rotor.drive1")] > 0
    assert [values[f"rotor.drive{i} − rotor.drive4"] for i in (1, 2, 3)] == [0.0, 0.0, 0.0]
    np.testing.assert_allclose(base.values(p), base.combination() @ p, rtol=1e-12, atol=1e-15)
