"""Recordings that come near a singular pose, pass through one, or jump to another branch."""

import numpy as np
import polars as pl
import pytest

from deltaid.mechanism.kinematics import Kinematics, Regularity
from deltaid.motion.surrogate import write_recording
from deltaid.recording.branch import BranchCheck
from deltaid.recording.log import open_log
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


def test_the_first_sample_near_a_singular_pose_is_told_with_its_time(par4, tmp_path):
    time = np.arange(2000) / 1000
    z = np.repeat(par4.home[None], len(time), axis=0)
    z[:, 3] = np.deg2rad(85) * par4.robot.platform.ratio * time / time[-1]
    q = par4.inverse(z)
    tau = np.ones_like(q) * np.sin(time)[:, None]
    columns = {"t": time} | {f"q{i + 1}": q[:, i] for i in range(4)}
    columns |= {f"tau{i + 1}": tau[:, i] for i in range(4)}
    write_recording(pl.DataFrame(columns), tmp_path / "log.csv")
    log = open_log(tmp_path / "log.csv", par4)
    first = int(np.flatnonzero(par4.regularity(z).worst > par4.robot.largest_condition)[0])
    (warning,) = (text for text in log.warnings if "singular" in text)
    assert f"{len(time) - first} of 2000 samples" in warning
    assert f"row {first + 2} at {time[first]:.6g} s" in warning


def state(kinematics: Kinematics, n: int = 40) -> tuple[np.ndarray, ...]:
    """A smooth way: times, drives, poses, and how regular they are."""
    time = np.linspace(0, 1, n)
    z = np.repeat(kinematics.home[None], n, axis=0)
    z[:, 0] += 0.02 * time
    return time, kinematics.inverse(z), z, kinematics.regularity(z)


def test_a_way_on_one_branch_passes_whole_or_in_pieces(par4):
    time, q, z, regular = state(par4)
    check = BranchCheck(par4)
    for part in (slice(0, 13), slice(13, 14), slice(14, None)):
        pieces = Regularity(*(getattr(regular, f)[part] for f in Regularity.__match_args__))
        assert check.add(time[part], q[part], z[part], pieces) is None


def test_a_determinant_that_changes_its_sign_is_a_passage(par4):
    time, q, z, regular = state(par4)
    determinant = np.where(time > 0.5, -regular.determinant, regular.determinant)
    flipped = Regularity(regular.condition, determinant, regular.gain, regular.hold)
    at, what = BranchCheck(par4).add(time, q, z, flipped)
    assert at == np.flatnonzero(time > 0.5)[0]
    assert f"between {time[at - 1]:.6g} s and {time[at]:.6g} s" in what


def test_a_platform_that_moves_while_the_drives_rest_has_jumped(par4):
    time, q, z, regular = state(par4)
    z = z.copy()
    z[25:, 1] += 0.1
    at, what = BranchCheck(par4).add(time, q, z, regular)
    assert at == 25
    assert "jumps by 0.1" in what
    assert f"{time[25]:.6g} s" in what
