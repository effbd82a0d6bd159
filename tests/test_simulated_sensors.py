"""Simulated recordings of robots with sensors: truth of independent physics, noise as described."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import with_prior
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.robot.load import load_robot, save_yaml
from deltaid.robot.sensors import BaseWrench, JointTorque, StrutForce
from deltaid.sensors.robot_sensors import all_sensor_rows, drawn_unknowns

WRENCH = BaseWrench(
    kind="base-wrench", force_noise=0.3, moment_noise=0.02, force_bias=2.0, moment_bias=0.5,
    gain_tolerance=0.05, rotation_tolerance=0.01, position_tolerance=0.005,
)  # fmt: skip
SENSORS = {
    "plate": WRENCH,
    "gauge": StrutForce(kind="strut-force", strut="strut2", noise=0.2, bias=1.0),
    "torque": JointTorque(kind="joint-torque", drive="drive1", noise=0.01, bias=0.1),
}


def robot() -> Dynamics:
    return compiled(load_robot("clavel-delta3").changed(sensors=SENSORS))


def recording(noise: SensorNoise | None, seed: int = 3) -> pl.DataFrame:
    dynamics, rng = robot(), np.random.default_rng(seed)
    p = surrogate_parameters(dynamics.robot, np.random.default_rng(1))
    motion = random_motion(dynamics.kinematics, np.random.default_rng(2), period=4.0)
    return simulate_recording(dynamics, p, motion, rng, duration=4.0, rate=500.0, noise=noise)


def test_a_plate_carries_weight_and_momentum() -> None:
    """Over a whole period the mean force is the weight and the mean moment that of the weight."""
    dynamics, clean = robot(), recording(None)
    p = surrogate_parameters(dynamics.robot, np.random.default_rng(1))
    mass = sum(
        body.count * p[dynamics.layout.body(body.name)][0]
        for body in dynamics.kinematics.mechanism.bodies
    )
    force = clean["plate.fx", "plate.fy", "plate.fz"].to_numpy().mean(axis=0)
    np.testing.assert_allclose(force, [0, 0, 9.81 * mass], atol=1e-6 * mass)


def test_a_torque_sensor_lacks_the_motors_friction() -> None:
    dynamics, clean = robot(), recording(None)
    p = surrogate_parameters(dynamics.robot, np.random.default_rng(1))
    viscous, coulomb = (p[part][0] for part in (dynamics.layout.viscous, dynamics.layout.coulomb))
    qd = clean["qd1"].to_numpy()
    expected = clean["tau1"].to_numpy() - viscous * qd - coulomb * np.sign(qd)
    np.testing.assert_allclose(clean["torque"].to_numpy(), expected, atol=1e-9)


def test_noise_and_unknowns_are_those_described() -> None:
    clean, first, again = recording(None), recording(SensorNoise()), recording(SensorNoise())
    other = recording(SensorNoise(), seed=4)
    assert first.equals(again)
    for rows in all_sensor_rows(robot()):
        for channel in rows.channels:
            noise = (first[channel.name] - other[channel.name]).to_numpy() / np.sqrt(2)
            assert np.std(noise) == pytest.approx(channel.noise, rel=0.05)
    # The same unknowns in every recording: what differs but for noise is bias, gain and pose.
    (plate, gauge, _) = all_sensor_rows(robot())
    u = dict(
        zip(
            (parameter.symbol for parameter in gauge.parameters), drawn_unknowns(gauge), strict=True
        )
    )
    off = (first["gauge"] - clean["gauge"]).to_numpy()
    slope = np.cov(off, clean["gauge"].to_numpy())[0, 1] / clean["gauge"].var()
    assert abs(slope) < 0.1
    assert u["bias"] != 0
    gain = dict(
        zip(
            (parameter.symbol for parameter in plate.parameters), drawn_unknowns(plate), strict=True
        )
    )
    assert 0 < abs(gain["gain"]) < 0.2
    shown = clean["plate.fz"].to_numpy()
    off = (first["plate.fz"] - clean["plate.fz"]).to_numpy()
    slope = np.cov(off, shown)[0, 1] / np.var(shown, ddof=1)
    assert slope == pytest.approx(gain["gain"] / (1 - gain["gain"]), abs=0.02)


def test_recordings_without_sensors_stay_as_they_were() -> None:
    dynamics = compiled(load_robot("clavel-delta3"))
    p = surrogate_parameters(dynamics.robot, np.random.default_rng(1))
    motion = random_motion(dynamics.kinematics, np.random.default_rng(2), period=4.0)
    rng = np.random.default_rng(3)
    noise = SensorNoise()
    bare = simulate_recording(dynamics, p, motion, rng, duration=4.0, rate=500.0, noise=noise)
    assert recording(SensorNoise())[bare.columns].equals(bare)


def test_simulate_writes_what_sensors_show(tmp_path: Path) -> None:
    from command import run

    plant = with_prior(robot().robot, surrogate_parameters(robot().robot, np.random.default_rng(1)))
    save_yaml(plant, tmp_path / "robot.yaml")
    clean = recording(None).head(500)
    clean.write_csv(tmp_path / "motion.csv")
    run("simulate", tmp_path / "robot.yaml", tmp_path / "motion.csv", "-o", tmp_path / "log.csv")
    log = pl.read_csv(tmp_path / "log.csv")
    assert set(clean.columns) - set(log.columns) <= {f"q{d}{i}" for d in ("d", "dd") for i in "123"}
    at = np.isin(np.round(log["t"], 6), np.round(clean["t"], 6))
    for name in ("plate.fz", "plate.mx"):
        x, y = log[name].to_numpy()[at], clean[name].to_numpy()
        n = min(len(x), len(y))
        assert np.corrcoef(x[50:n], y[50:n])[0, 1] > 0.95
