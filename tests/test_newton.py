"""Forward kinematics by iteration, and recordings near a singular pose or on another branch."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from composed import Make, dynamics, turn, twin
from deltaid.errors import KinematicsError, RecordingError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import write_recording
from deltaid.recording.opening import open_log
from deltaid.recording.reach import BranchCheck, Stretch
from deltaid.robot.load import load_robot
from logs import tabled

MAKES = {
    "h4": Make("h4", unequal=True),
    "par4": Make("par4"),
    "par4, rails": Make("par4", linear=True),
    "i4": Make("i4"),
    "i4, rails": Make("i4", linear=True),
}
every_make = pytest.mark.parametrize("name", MAKES)


def poses(name: str, n: int, share: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Random z in a cube of half a metre and a share of the tool's range, and the oracle's q."""
    oracle, rng = twin(MAKES[name]).oracle, np.random.default_rng(3)
    middle, reach = turn(oracle)
    z = np.column_stack(
        [
            rng.uniform((-0.25, -0.25, -1.0), (0.25, 0.25, -0.5), (n, 3)),
            middle + share * reach * rng.uniform(-1, 1, n),
        ]
    )
    q = oracle.positions(z)
    reached = np.isfinite(q).all(axis=1)
    assert reached.mean() > 0.8
    return z[reached], q[reached]


@every_make
def test_a_recording_is_solved_to_rounding(name: str) -> None:
    kinematics = dynamics(MAKES[name]).kinematics
    motion = random_motion(kinematics, np.random.default_rng(4))
    z, _, _ = motion.evaluate(np.linspace(0, motion.period, 5000))
    q = kinematics.inverse(z)
    np.testing.assert_allclose(kinematics.forward(q), z, rtol=0, atol=1e-12)
    assert kinematics.passages(z).size == 0


@every_make
def test_samples_in_any_order(name: str) -> None:
    """Far apart from one to the next; θ is found in its own turn and not one further."""
    z, q = poses(name, 3000, share=1.5)
    kinematics = dynamics(MAKES[name]).kinematics
    clear = kinematics.condition(z) < 8
    assert clear.mean() > 0.9
    np.testing.assert_allclose(kinematics.forward(q[clear]), z[clear], rtol=0, atol=1e-11)


@pytest.mark.parametrize("name", [name for name in MAKES if name != "i4"])  # its slide gives way
def test_a_position_that_closes_no_loop_is_named(name: str) -> None:
    z, q = poses(name, 100)
    q[70, 2] += 2.0
    kinematics = dynamics(MAKES[name]).kinematics
    with pytest.raises(KinematicsError, match="no platform position closes the loops") as caught:
        kinematics.forward(q)
    assert caught.value.where == "sample 70"
    solved, good = kinematics.forward_unchecked(q)
    np.testing.assert_array_equal(np.flatnonzero(~good), [70])
    assert np.isnan(solved[70]).all()
    np.testing.assert_allclose(solved[good], z[good], rtol=0, atol=1e-11)


def beyond(name: str, n: int) -> tuple[Kinematics, np.ndarray]:
    """A motion of the platform's own joint from home through the singularity at a quarter turn."""
    t, kinematics = twin(MAKES[name]), dynamics(MAKES[name]).kinematics
    z = np.tile([0.05, -0.03, -0.8, 0.0], (n, 1))
    z[:, 3] = t.oracle.ratio * np.linspace(0, np.deg2rad(170), n)
    return kinematics, z


@pytest.mark.parametrize("name", ["h4", "par4"])
@pytest.mark.parametrize("samples", [101, 1000])
def test_a_passage_through_a_singularity_is_detected(name: str, samples: int) -> None:
    """The drives' coordinates alone look as if the platform had turned back."""
    kinematics, z = beyond(name, samples)
    at = int(np.argmax(kinematics.condition(z)))
    solved, good = kinematics.forward_unchecked(twin(MAKES[name]).oracle.positions(z))
    np.testing.assert_allclose(solved[: at - 1], z[: at - 1], rtol=0, atol=1e-9)
    assert good.all()
    assert np.abs(solved[-1] - z[-1]).max() > 0.1
    for motion in (solved, z):
        (seen,) = kinematics.passages(motion)
        assert abs(seen - at) <= 1
    assert kinematics.passages(z[: at - 5]).size == 0


@pytest.mark.parametrize("name", ["h4", "par4"])
def test_turning_back_before_a_singularity_is_no_passage(name: str) -> None:
    kinematics, z = beyond(name, 2)
    z = np.repeat(z[:1], 1000, axis=0)
    z[:, 3] = twin(MAKES[name]).oracle.ratio * 1.4 * np.sin(np.linspace(0, 20, 1000))
    assert kinematics.condition(z).max() > 8
    assert kinematics.passages(z).size == 0


def test_other_branches_are_not_taken_for_the_home_pose_s() -> None:
    """Poses beyond singularities: not good, or another pose on this side that the drives share."""
    make = Make("i4", linear=True, tilt=(15.0, 35.0))
    kinematics, oracle = dynamics(make).kinematics, twin(make).oracle
    rng, (middle, reach) = np.random.default_rng(5), turn(oracle)
    z = rng.uniform((-0.4, -0.4, -1.0, middle - reach), (0.4, 0.4, -0.3, middle + reach), (4000, 4))
    q = oracle.positions(z)
    reached = np.isfinite(q).all(axis=1)
    z, q = z[reached], q[reached]
    side = np.sign(np.linalg.det(kinematics.jacobian(z)))
    other = side != np.sign(np.linalg.det(kinematics.jacobian(kinematics.home[None])))
    assert other.sum() > 20
    solved, good = kinematics.forward_unchecked(q[other])
    assert np.isnan(solved[~good]).all()
    np.testing.assert_allclose(oracle.gaps(solved[good], q[other][good]), 0, atol=1e-11)
    home = np.sign(np.linalg.det(kinematics.jacobian(solved[good])))
    assert (home == -side[other][0]).all()


@pytest.fixture(scope="module")
def par4() -> Kinematics:
    """A Par4 whose rods may turn nearly square to their middle position, where J is singular."""
    robot = load_robot("par4")
    ratio = robot.platform.ratio
    platform = robot.platform.changed(angle_deg=(-89.0 * ratio, 89.0 * ratio))
    return Kinematics(robot.changed(platform=platform, drive_limits={}))


def written(time: np.ndarray, q: np.ndarray, folder: Path) -> Path:
    """A log with these drive positions."""
    tau = np.ones_like(q) * np.sin(time)[:, None]
    write_recording(tabled(t=time, q=q, tau=tau), folder / "log.csv")
    return folder / "log.csv"


def test_the_first_sample_near_a_singular_pose_is_reported_with_its_time(par4, tmp_path):
    time = np.arange(2000) / 1000
    z = np.repeat(par4.home[None], len(time), axis=0)
    z[:, 3] = np.deg2rad(85) * par4.robot.platform.ratio * time / time[-1]
    q = par4.inverse(z)
    log = open_log(written(time, q, tmp_path), par4)
    first = int(np.flatnonzero(par4.regularity(z).worst > par4.robot.largest_condition)[0])
    (warning,) = (text for text in log.warnings if "singular" in text)
    assert f"{len(time) - first} of 2000 samples" in warning
    assert f"row {first + 2} at {time[first]:.6g} s" in warning


def way_through(kinematics: Kinematics, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and poses of two seconds in which the rods turn evenly from 0 to 120°."""
    time = np.arange(n) / (n / 2)
    z = np.repeat(kinematics.home[None], n, axis=0)
    z[:, 3] = np.deg2rad(120.0) * kinematics.robot.platform.ratio * time / time[-1]
    return time, z


@pytest.mark.parametrize("step", [0.0, 1e-7, 1e-6, 1e-5, 1e-4])
@pytest.mark.parametrize("samples", [1998, 2000, 2001])
def test_a_recording_through_a_singularity_is_refused_with_its_time(par4, tmp_path, samples, step):
    """z(q) turns back there, so no determinant shows it; encoder steps may leave no solution."""
    time, z = way_through(par4, samples)
    q = par4.inverse(z)
    q = np.round(q / step) * step if step else q
    at = int(np.argmax(par4.condition(z)))
    with pytest.raises(RecordingError, match=r"singular pose (between|at) ") as caught:
        open_log(written(time, q, tmp_path), par4)
    reported_time = float(re.search(r"([\d.]+) s[:, ]", str(caught.value)).group(1))
    assert abs(reported_time - time[at]) < (0.01 if step < 1e-4 else 0.03)


def test_a_passage_is_detected_wherever_the_samples_are_cut(par4):
    time, z = way_through(par4, 200)
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


@pytest.mark.parametrize("name", ["h4", "i4, rails"])
def test_far_angles_name_the_limb_that_is_turned_over_and_no_singularity(name: str) -> None:
    """The oracle's inverse kinematics, of the described mode, differs at that limb."""
    oracle, kinematics = twin(MAKES[name]).oracle, dynamics(MAKES[name]).kinematics
    home, rng = kinematics.inverse(kinematics.home), np.random.default_rng(0)
    far, named = 0.3 if kinematics.robot.is_linear("drive1") else 1.0, 0
    for _ in range(40):
        q = home + far * rng.uniform(-2, 2, 4)
        z, closed = kinematics._forward(q[None]).z[0], kinematics._forward(q[None]).closed[0]
        reason = kinematics.why_not(q[None]) if not kinematics.forward_unchecked(q)[1] else ""
        limb = re.search(r"limb (\d)", reason)
        if closed and reason:
            other = np.abs(oracle.positions(z[None])[0] - q) > 1e-6
            assert other.any() == (limb is not None), reason
            named += bool(limb and other[int(limb[1]) - 1])
            assert ("singularity" in reason) == (limb is None)
    assert named > 3
