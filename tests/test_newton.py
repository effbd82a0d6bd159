"""Forward kinematics by iteration: any order of samples, and honest about what it did not find."""

from __future__ import annotations

import numpy as np
import pytest

from composed import Make, dynamics, turn, twin
from deltaid.errors import KinematicsError
from deltaid.mechanism.kinematics import Kinematics
from deltaid.motion.random_motion import random_motion
from deltaid.robot.workspace import Box

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
def test_a_passage_through_a_singularity_is_seen(name: str, samples: int) -> None:
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


def test_a_home_pose_out_of_reach_is_said_so() -> None:
    robot = twin(MAKES["par4"]).robot
    far = Box(shape="box", x=(2.0, 2.2), y=(-0.1, 0.1), z=(-0.9, -0.7))
    kinematics = Kinematics(robot.changed(workspace=far))
    with pytest.raises(KinematicsError, match="middle of the workspace") as caught:
        kinematics.forward(np.zeros((1, 4)))
    assert caught.value.where == "workspace"
