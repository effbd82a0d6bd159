"""Columns of sensors in a wrong unit, sign, order or frame: the verdict that mends them.

Each fault is made in the numbers of a good recording; what the verdict proposes is put into mapping
and description, and then nothing is left to say.
"""

from functools import cache
from typing import Any

import numpy as np
import polars as pl
import pytest

from deltaid.checks.check import check
from deltaid.checks.evidence import evidence
from deltaid.checks.identify import identify
from deltaid.checks.sensing.misfit import MapFit, Misfit
from deltaid.checks.sensing.sensors import checked_sensors
from deltaid.checks.verdicts import changes, with_changes
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.errors import RecordingError
from deltaid.model.record import Settings
from deltaid.model.verdict import Grade, Verdict
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.robot.sensors import BaseWrench, JointTorque, Sensor, StrutForce
from support import KINDS

PLATE = [f"plate.{kind}{axis}" for kind in "fm" for axis in "xyz"]
OFF = np.array([0.1, -0.05, 0.08])
LATE = 7


def sensors(*, tared: bool = False) -> dict[str, Sensor]:
    bias = 0.0 if tared else None
    plate = BaseWrench(
        kind="base-wrench", force_noise=0.5, moment_noise=0.1, force_bias=bias, moment_bias=bias
    )
    gauges = {
        f"gauge{i}": StrutForce(kind="strut-force", strut=f"strut{i}", noise=0.5, bias=bias)
        for i in (1, 2)
    }
    torque = JointTorque(kind="joint-torque", drive="drive1", noise=0.1, bias=bias)
    return {"plate": plate, **gauges, "torque1": torque}


@cache
def recorded(
    name: str = "clavel-delta3", seed: int = 1, *, tared: bool = False
) -> tuple[Dynamics, pl.DataFrame]:
    dynamics = compiled(load_robot(name).changed(sensors=sensors(tared=tared)))
    rng = np.random.default_rng(seed)
    p = surrogate_parameters(dynamics.robot, rng)
    motion = random_motion(dynamics.kinematics, rng)
    return dynamics, simulate_recording(dynamics, p, motion, rng, duration=8.0, noise=SensorNoise())


def judged(
    dynamics: Dynamics, frame: pl.DataFrame, mapping: ColumnMapping | None = None
) -> tuple[Verdict, ...]:
    return checked_sensors(evidence(dynamics.robot, frame, mapping))


def poor(verdicts: tuple[Verdict, ...]) -> list[Verdict]:
    return [verdict for verdict in verdicts if verdict.grade is not Grade.GOOD]


def wrench(of: np.ndarray) -> pl.DataFrame:
    """The recording with other numbers of the plate."""
    _, frame = recorded()
    return frame.with_columns(pl.Series(n, x) for n, x in zip(PLATE, of.T, strict=True))


def turned(angles: tuple[float, float, float]) -> np.ndarray:
    """R = Rz Ry Rx, written out."""
    (a, b, c), R = np.deg2rad(angles), np.eye(3)
    for angle, (i, j) in zip((a, b, c), ((1, 2), (2, 0), (0, 1)), strict=True):
        E = np.eye(3)
        E[i, i] = E[j, j] = np.cos(angle)
        E[i, j], E[j, i] = -np.sin(angle), np.sin(angle)
        R = E @ R
    return R


def fault(name: str) -> pl.DataFrame:
    _, frame = recorded()
    w = frame[PLATE].to_numpy()
    f, m = w[:, :3], w[:, 3:]
    lbf = np.repeat([4.4482216, 0.11298483], 3)
    quarter, tilted = turned((0, 0, 90)), turned((25, -35, 70))
    signs = {"sign of all": [-1] * 6, "sign of fz": [1, 1, -1, 1, 1, 1]}
    signs["sign of moments"] = [1, 1, 1, -1, -1, -1]
    if name in signs:
        return wrench(w * signs[name])
    if name == "gauge in kgf":
        return frame.with_columns(pl.col("gauge1") / 9.80665, -pl.col("torque1"))
    if name == "gauges exchanged":
        return frame.rename({"gauge1": "gauge2", "gauge2": "gauge1"})
    late = np.vstack([np.repeat(w[:1], LATE, axis=0), w[:-LATE]])
    return wrench(
        {
            "kN": w / 1000,
            "kgf": w / 9.80665,
            "lbf and lbf*in": w / lbf,
            "mN*m": w * [1, 1, 1, 1000, 1000, 1000],
            "moments first": np.hstack([m, f]),
            "x and y exchanged": w[:, [1, 0, 2, 4, 3, 5]],
            "fx and fy exchanged": w[:, [1, 0, 2, 3, 4, 5]],
            "a quarter": np.hstack([f @ quarter.T, m @ quarter.T]),
            "upside down": w * [1, -1, -1, 1, -1, -1],
            "tilted": np.hstack([f @ tilted.T, m @ tilted.T]),
            "origin": np.hstack([f, m - np.cross(OFF, f)]),
            "late": late,
        }[name]
    )


FAULTS = {
    "kN": "sensor-unit", "kgf": "sensor-unit", "lbf and lbf*in": "sensor-unit",
    "mN*m": "sensor-unit", "sign of all": "sensor-sign", "sign of fz": "sensor-sign",
    "sign of moments": "sensor-sign", "moments first": "sensor-order",
    "x and y exchanged": "sensor-order", "fx and fy exchanged": "sensor-order",
    "a quarter": "sensor-frame", "upside down": "sensor-frame", "tilted": "sensor-frame",
    "origin": "sensor-frame", "late": "sensor-lag",
}  # fmt: skip


@cache
def verdicts_on(name: str) -> tuple[Verdict, ...]:
    return judged(recorded()[0], fault(name))


QUICK = ("kN", "sign of fz", "moments first", "x and y exchanged", "tilted", "origin", "late")


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=() if x in QUICK else pytest.mark.slow) for x in FAULTS]
)
def test_a_fault_is_reported_and_what_is_proposed_corrects_it(name: str) -> None:
    dynamics, frame, verdicts = recorded()[0], fault(name), poor(verdicts_on(name))
    assert [(verdict.key, verdict.subject) for verdict in verdicts] == [(FAULTS[name], "plate")]
    assert verdicts[0].grade is (Grade.DOUBTFUL if name == "late" else Grade.WRONG)
    data = evidence(dynamics.robot, frame).written_mapping
    mapping = ColumnMapping.model_validate(with_changes(data, changes(verdicts, "mapping")))
    described = with_changes(dynamics.robot.model_dump(mode="json"), changes(verdicts, "robot"))
    robot = compiled(RobotDescription.model_validate(described))
    again = judged(robot, frame, mapping)
    assert [verdict.grade for verdict in again] == [Grade.GOOD] * 4, again


def test_what_was_found_is_what_was_made() -> None:
    def proposed(name: str, key: str) -> Any:
        return dict(poor(verdicts_on(name))[0].proposals[0].changes)[f"sensors.plate.{key}"]

    assert proposed("lbf and lbf*in", "unit") == ["lbf"] * 3 + ["lbf*in"] * 3
    assert proposed("sign of fz", "sign") == [1, 1, -1, 1, 1, 1]
    np.testing.assert_allclose(proposed("origin", "position"), OFF, atol=4e-3)
    angles = proposed("tilted", "rotation_deg")
    np.testing.assert_allclose(turned(angles), turned((25, -35, 70)).T, atol=0.02)
    assert proposed("late", "delay") == pytest.approx(1e-3 * LATE, abs=6e-4)


def test_gauges_are_distinguished() -> None:
    dynamics = recorded()[0]
    unit, sign = poor(judged(dynamics, fault("gauge in kgf")))
    assert (unit.key, unit.subject) == ("sensor-unit", "gauge1")
    assert (sign.key, sign.subject) == ("sensor-sign", "torque1")
    assert dict(unit.proposals[0].changes)["sensors.gauge1.unit"] == "kgf"
    assert dict(sign.proposals[0].changes)["sensors.torque1.sign"] == -1
    exchanged = poor(judged(dynamics, fault("gauges exchanged")))
    assert [verdict.key for verdict in exchanged] == ["sensor-order"] * 2
    assert "the column of gauge2 shows" in exchanged[0].seen


def test_dead_clipped_and_noisy_columns() -> None:
    dynamics, frame = recorded()
    w, rng = frame[PLATE].to_numpy(), np.random.default_rng(2)
    (dead,) = (v for v in judged(dynamics, wrench(rng.normal(size=w.shape))) if v.cause)
    assert (dead.key, dead.grade) == ("sensor-dead", Grade.WRONG)
    most = float(np.quantile(w[:, 2], 0.9))
    clipped = judged(dynamics, frame.with_columns(pl.col("plate.fz").clip(None, most)))
    assert "sensor-clipped" in {v.key for v in clipped if v.grade is Grade.DOUBTFUL}
    noisy = w + rng.normal(size=w.shape) * np.repeat([4.0, 0.0], 3)
    (noise,) = (v for v in judged(dynamics, wrench(noisy)) if v.cause)
    assert noise.key == "sensor-noise"
    value = dict(noise.proposals[0].changes)["sensors.plate.force_noise"]
    assert value == pytest.approx(4.0, rel=0.1)


def test_a_gain_that_is_no_unit_may_be_the_drives() -> None:
    dynamics, frame = recorded()
    gain = [pl.col(f"tau{i + 1}") / 1.6 for i in range(dynamics.dof)]
    found = judged(dynamics, frame.with_columns(gain))
    assert {v.grade for v in found} <= {Grade.GOOD, Grade.DOUBTFUL}
    (plate,) = (v for v in found if v.subject == "plate")
    assert plate.key == "sensor-gain"


def test_a_tolerance_of_the_pose_allows_for_it() -> None:
    robot, frame = recorded()[0].robot, fault("origin")
    plate = robot.sensors["plate"].changed(position_tolerance=0.05)
    wide = compiled(robot.changed(sensors={**robot.sensors, "plate": plate}))
    assert not any(v.key == "sensor-frame" for v in judged(wide, frame))


@pytest.mark.parametrize(
    "seed", [4, 5, *(pytest.param(n, marks=pytest.mark.slow) for n in (0, 1, 2, 3, 6, 7, 8, 9))]
)
def test_good_recordings_of_all_robots_have_no_verdict(seed: int) -> None:
    names = KINDS
    dynamics, frame = recorded(names[seed % len(names)], seed, tared=seed % 3 == 1)
    found = judged(dynamics, frame)
    assert [verdict.grade for verdict in found] == [Grade.GOOD] * 4, found


def test_check_tells_and_identify_refuses() -> None:
    robot, frame = recorded()[0].robot, fault("kN")
    found = check(robot, frame)
    assert [v.key for v in found if v.grade is Grade.WRONG] == ["sensor-unit"]
    with pytest.raises(RecordingError) as caught:
        identify(robot, frame, settings=Settings(lag="none", events=False, friction="described"))
    said = str(caught.value)
    assert "its numbers are to be multiplied by" in said
    assert "unit: [kN, kN, kN, kN*m, kN*m, kN*m]" in said.replace("\n", "").replace("  ", " ")


def test_a_constant_is_no_part_of_how_shown_and_expected_go_together() -> None:
    rng = np.random.default_rng(0)
    shape = rng.standard_normal((2, 200))
    shape -= shape.mean(axis=1, keepdims=True)

    class Moved(Misfit):
        samples, counts, by_torques = np.ones(200), 200.0, np.ones(1)
        noise, moving = np.array([0.5, 2.0]), -2.0 * shape

        def expected(self, theta: np.ndarray) -> np.ndarray:
            return theta[0] * (shape + 30.0)

    assert object.__new__(Moved).correlation == pytest.approx(1.0)


def test_excluded_rows_do_not_count_for_the_share_that_is_unexplained() -> None:
    rng = np.random.default_rng(1)
    kept = np.repeat([1.0, 0.0], [50, 150])
    y, left = (rng.standard_normal((2, 200)) * kept for _ in "yr")

    class Half(Misfit):
        samples, counts, moving, groups = kept, 50.0, y, ([0, 1],)

        def expected(self, theta: np.ndarray) -> np.ndarray:
            return self.y - 0.3 * left

    half = object.__new__(Half)
    half.__dict__["y"] = y
    share = 0.3 * np.linalg.norm(left) / np.linalg.norm(y)
    assert half.unexplained(MapFit(0.0, np.ones(1), 1.0)) == pytest.approx(share)
