"""Recordings that come near a singular pose, pass through one, or jump to another branch."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.errors import RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.surrogate import write_recording
from deltaid.recording.opening import open_log
from deltaid.recording.reach import BranchCheck, Stretch
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot


@pytest.fixture(scope="module")
def par4() -> Kinematics:
    """A Par4 whose rods may turn nearly square to their middle position, where J is singular."""
    data = load_robot("par4").model_dump(exclude_none=True)
    ratio = data["platform"]["ratio"]
    data["platform"]["angle_deg"] = (-89.0 * ratio, 89.0 * ratio)
    data["drive_limits"] = {}
    return Kinematics(RobotDescription.model_validate(data))


def written(time: np.ndarray, q: np.ndarray, folder: Path) -> Path:
    """A log with these drive positions."""
    tau = np.ones_like(q) * np.sin(time)[:, None]
    columns = {"t": time} | {f"q{i + 1}": q[:, i] for i in range(4)}
    columns |= {f"tau{i + 1}": tau[:, i] for i in range(4)}
    write_recording(pl.DataFrame(columns), folder / "log.csv")
    return folder / "log.csv"


def test_the_first_sample_near_a_singular_pose_is_told_with_its_time(par4, tmp_path):
    time = np.arange(2000) / 1000
    z = np.repeat(par4.home[None], len(time), axis=0)
    z[:, 3] = np.deg2rad(85) * par4.robot.platform.ratio * time / time[-1]
    q = par4.inverse(z)
    log = open_log(written(time, q, tmp_path), par4)
    first = int(np.flatnonzero(par4.regularity(z).worst > par4.robot.largest_condition)[0])
    (warning,) = (text for text in log.warnings if "singular" in text)
    assert f"{len(time) - first} of 2000 samples" in warning
    assert f"row {first + 2} at {time[first]:.6g} s" in warning


def way_through(kinematics: Kinematics, angle_deg: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and poses of two seconds in which the rods turn evenly from 0 to an angle."""
    time = np.arange(n) / (n / 2)
    z = np.repeat(kinematics.home[None], n, axis=0)
    z[:, 3] = np.deg2rad(angle_deg) * kinematics.robot.platform.ratio * time / time[-1]
    return time, z


@pytest.mark.parametrize("step", [0.0, 1e-7, 1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("samples", [1998, 2000, 2001])
def test_a_recording_through_a_singularity_is_refused_with_its_time(par4, tmp_path, samples, step):
    """z(q) turns back there, so no determinant shows it; encoder steps may leave no solution."""
    time, z = way_through(par4, 120.0, samples)
    q = par4.inverse(z)
    q = np.round(q / step) * step if step else q
    at = int(np.argmax(par4.condition(z)))
    with pytest.raises(RecordingError, match=r"singular pose (between|at) ") as caught:
        open_log(written(time, q, tmp_path), par4)
    told = float(re.search(r"([\d.]+) s[:, ]", str(caught.value)).group(1))
    assert abs(told - time[at]) < (0.01 if step < 1e-4 else 0.03)


def test_a_passage_is_seen_wherever_the_samples_are_cut(par4):
    time, z = way_through(par4, 120.0, 200)
    solved, good = par4.forward_unchecked(par4.inverse(z))
    assert good.all()
    at = int(np.argmax(par4.condition(z)))
    for cut in range(at - 4, at + 6):
        check, seen, done = BranchCheck(par4), [], 0
        for part in (slice(0, cut), slice(cut, None)):
            regular = par4.regularity(solved[part])
            left = check.add(Stretch(time[part], z[part], solved[part], regular))
            seen += [] if left is None else [left[0] + done]
            done = cut
        assert len(seen) == 1
        assert abs(seen[0] - at) <= 1


def state(kinematics: Kinematics, n: int = 40) -> Stretch:
    """A smooth way."""
    time = np.linspace(0, 1, n)
    z = np.repeat(kinematics.home[None], n, axis=0)
    z[:, 0] += 0.02 * time
    return Stretch(time, kinematics.inverse(z), z, kinematics.regularity(z))


def test_a_way_on_one_branch_passes_whole_or_in_pieces(par4):
    way, check = state(par4), BranchCheck(par4)
    for part in (slice(0, 13), slice(13, 14), slice(14, None)):
        assert check.add(way.part(part)) is None


def test_a_determinant_that_changes_its_sign_is_a_passage(par4):
    way = state(par4)
    time, regular = way.time, way.regular
    determinant = np.where(time > 0.5, -regular.determinant, regular.determinant)
    at, what = BranchCheck(par4).add(
        replace(way, regular=replace(regular, determinant=determinant))
    )
    assert at == np.flatnonzero(time > 0.5)[0]
    assert f"between {time[at - 1]:.6g} s and {time[at]:.6g} s" in what


def test_a_platform_that_moves_while_the_drives_rest_has_jumped(par4):
    way = state(par4)
    z = way.z.copy()
    z[25:, 1] += 0.1
    at, what = BranchCheck(par4).add(replace(way, z=z))
    assert at == 25
    assert "jumps by 0.1" in what
    assert f"{way.time[25]:.6g} s" in what
