"""Columns beside those of a robot: fitted with it, judged with it, kept out of its parameters."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import polars as pl

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.identification.fit import fit
from deltaid.identification.judgement import judged_base, judged_parameters
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.recording import Recording, open_recordings
from deltaid.recording.repairs import LeftSpan, Repairs
from deltaid.recording.windows import Samples
from deltaid.robot.load import load_robot
from deltaid.robot.parameter import Parameter

RATE, DURATION = 500.0, 8.0
HUM = 2 * np.pi * 3.1  # rad/s
STRONG = 0.21  # N m, one eighth of the prior's size


@dataclass(frozen=True, eq=False)
class Hum(Addition):
    """A torque sin ωt of unknown size at one drive of one recording."""

    drive: int
    log: str

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("lag", f"drive{self.drive + 1}", "hum", "N*m", -np.inf, np.inf, 0.0, 1.7),
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([self.drive]), np.array([0])

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        here = str(recording.path) == self.log
        return np.sin(HUM * w.time)[None] * here


def moving() -> tuple[Dynamics, np.ndarray]:
    dynamics = compiled(load_robot("clavel-delta3"))
    return dynamics, surrogate_parameters(dynamics.robot, np.random.default_rng(4))


def table(seed: int, hum: float) -> pl.DataFrame:
    dynamics, p = moving()
    rng, t = np.random.default_rng(seed), np.arange(round(DURATION * RATE)) / RATE
    motion = random_motion(dynamics.kinematics, rng, period=3.917)
    q, qd, qdd = dynamics.kinematics.drive_motion(*motion.evaluate(t))
    tau = dynamics.inverse_dynamics(q, qd, qdd, p)
    tau += 0.01 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    tau[:, 1] += hum * np.sin(HUM * t)
    columns = {"t": t} | {f"q{i + 1}": x for i, x in enumerate(q.T)}
    return pl.DataFrame(columns | {f"tau{i + 1}": x for i, x in enumerate(tau.T)})


@cache
def recordings() -> tuple[Recording, ...]:
    dynamics, _ = moving()
    return tuple(open_recordings([table(1, STRONG), table(2, 0.0)], dynamics.kinematics))


def test_an_addition_is_fitted_in_the_recording_that_has_it_and_judged_like_the_rest() -> None:
    dynamics, p = moving()
    hum = Hum(1, str(recordings()[0].path))
    problem = fit(dynamics, recordings(), Settings(), additions=[hum])
    plain = fit(dynamics, recordings(), Settings())
    judged = judged_parameters(problem)[-1]
    assert judged.name == "hum.drive2"
    assert judged.determined_by == "data"
    assert judged.low < STRONG < judged.high
    assert judged.high - judged.low < 0.1 * STRONG
    assert len(problem.p) == len(p) == len(problem.values) - 1
    assert problem.noise < 0.9 * plain.noise
    assert problem.solution.duality_gap <= 1e-5 * problem.solution.objective
    names = [one.representative for one in judged_base(problem)]
    assert "hum.drive2" not in names
    assert names == [one.representative for one in judged_base(plain)]


def test_rows_that_are_left_out_by_time_do_not_count_and_no_others_do_less() -> None:
    dynamics, _ = moving()
    one = recordings()[0]
    spans = (LeftSpan(2.0, 2.5, "contact"), LeftSpan(4.0, 4.1, "spike", (2,)))
    repaired = replace(one, repairs=Repairs(left_out=spans))

    def weights(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        parts = [window.own for window in recording.windows(dynamics.kinematics)]
        time = np.concatenate([w.time for w in parts])
        return time, np.concatenate([w.weights for w in parts])

    time, before = weights(one)
    _, after = weights(repaired)
    gone = np.zeros_like(after, dtype=bool)
    gone[(time >= 2.0) & (time <= 2.5)] = True
    gone[(time >= 4.0) & (time <= 4.1), 2] = True
    assert gone.any(axis=0).all()
    np.testing.assert_array_equal(after, np.where(gone, 0.0, before))
