"""Gains of drives as columns of a fit: what is known of them before, and what torques follow."""

from dataclasses import dataclass

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.identification.gains import SPREAD, Gains
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.load import load_robot
from deltaid.robot.parameter import Parameter

GAIN = np.array([1.2, 0.9, 1.05])


@dataclass(frozen=True, eq=False)
class Push(Addition):
    """A torque of the second drive, told by a load that is known."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("load", "push", "m", "N m", -np.inf, np.inf, 0.0, 1.0),)

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([1]), np.array([0])

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        return np.ones((1, len(w.time)))

    @property
    def is_absolute(self) -> bool:
        return True

    @property
    def witness(self) -> str:
        return "a push"


def gains(alike: tuple[int, ...] = ()) -> tuple[Dynamics, Gains]:
    """With a push of 3 N m, beside what the prior says of a robot."""
    dynamics = compiled(load_robot("clavel-delta3"))
    values = np.append(prior_parameters(dynamics.robot), 3.0)
    return dynamics, Gains(dynamics, (Push(),), values, GAIN, prior_spread=0.5, alike=alike)


def test_before_any_recording_torque_constants_are_right_to_a_tenth() -> None:
    """Where torques have been multiplied by c already, what is left is 1/c."""
    _, found = gains()
    left = np.exp([one.prior for one in found.parameters])
    np.testing.assert_allclose(GAIN * left, 1.0)
    np.testing.assert_allclose([0.5 * one.scale for one in found.parameters], SPREAD)
    np.testing.assert_array_equal(found.free.A, np.eye(3))


def test_before_any_recording_drives_of_limbs_that_are_alike_are_alike() -> None:
    """Ratios are right to a tenth; what is common to all is left as it is."""
    _, found = gains(alike=(0, 1, 2))
    free = found.free
    left = free.A @ [one.prior for one in free.variables]
    total = GAIN * np.exp(left)
    np.testing.assert_allclose(total, np.exp(np.mean(np.log(GAIN))))
    np.testing.assert_allclose([0.5 * one.scale for one in free.variables], SPREAD)
    np.testing.assert_allclose(free.A.T @ free.A, np.eye(2), atol=1e-12)
    np.testing.assert_allclose(free.A.sum(axis=0), 0.0, atol=1e-12)


def test_torques_that_gains_multiply_are_all_that_drives_bear() -> None:
    """Those of the robot, of other additions, and of what is held; −ε of them is missing."""
    dynamics, found = gains()
    rng, n = np.random.default_rng(0), 5
    z = dynamics.kinematics.home + 0.02 * rng.standard_normal((n, 3))
    qd, qdd, carried = rng.standard_normal((3, n, 3))
    none = np.zeros((n, 0))
    w = Samples(np.arange(n) * 0.1, z, qd, qdd, none, none, none, carried)
    own = dynamics.sparse_regressor(z, qd, qdd, np.zeros_like(qd)).values
    torque = dynamics.torque(z, qd, qdd) + carried + [0.0, 3.0, 0.0]
    recording = object.__new__(Recording)  # no addition here asks whose samples they are
    np.testing.assert_allclose(found.entries(w, own, recording), -torque.T, rtol=1e-9)
    drives, columns = found.pattern
    np.testing.assert_array_equal(drives, columns)


def judged(std: float) -> list[Judged]:
    """What a fit leaves of each drive's gain: 2 %."""
    return [
        Judged(
            name=f"gain.drive{i}", value=0.02, std=std, low=0.02 - 2 * std, high=0.02 + 2 * std,
            unit="", prior=0.0, determined_by="data",
        )
        for i in (1, 2, 3)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("alike", "std", "words"),
    [((), 0.01, "told by a push"), ((), 0.06, "hardly shows"),
     ((0, 1), 0.01, "drive3 is taken to be right")],
)  # fmt: skip
def test_what_is_told_is_the_whole_gain_with_its_interval(
    alike: tuple[int, ...], std: float, words: str
) -> None:
    """c times what is left of it; told by a load where its prior is not most of what is known."""
    told = gains(alike)[1].to_corrections(judged(std))
    assert [one.subject for one in told] == ["drive1", "drive2", "drive3"][: len(alike) or 3]
    for c, one in zip(GAIN, told, strict=False):
        expected = c * np.exp([0.02 - 2 * std, 0.02, 0.02 + 2 * std])
        np.testing.assert_allclose([one.low, one.value, one.high], expected)
        assert words in one.text
