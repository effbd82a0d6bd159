"""Recordings beside measured poses: slopes of torques by every number, and what they add."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import polars as pl
import pytest

import deltaid
from calibrated import Machine, as_read, machine, oracle_of, poses_at
from command import accepted, refused
from deltaid.calibration import torques
from deltaid.calibration.torques import GeometryNumbers, torque_rows
from deltaid.calibration.unknowns import unknowns
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.geometry import torque_slopes
from deltaid.effects.mounting import Mounting, numbers_of
from deltaid.effects.point import TracePoint
from deltaid.identification.contest import Contest
from deltaid.identification.contest_sweeps import swept_beside
from deltaid.robot.load import save_yaml
from oracle.measured_delta import DRAWINGS, BuiltDelta, built
from oracle.tree import EZ, Array, rot_z
from plants import true_parameters

STEP, LIMB, SAMPLES = 1e-5, 1, 3
CLAVEL = "clavel-delta3"


def off(delta: BuiltDelta, kind: str, by: float) -> BuiltDelta:
    """With one number of a limb off, or that of the platform."""
    if kind == "half":
        return replace(delta, half=delta.half + by)
    limb = delta.limbs[LIMB]
    out, aside = rot_z(np.deg2rad(delta.drawing.azimuths[LIMB])).T[:2]
    across = out if limb.arm is not None else np.cross(limb.along, aside)
    ((length, *ends),) = limb.struts
    leans = {"lean_out": across, "lean_across": aside}
    turned = {"azimuth": EZ, "tilt": out}
    turned |= {lean: np.cross(limb.along, way) for lean, way in leans.items()}
    moved = {"base_out": out, "base_across": aside, "base_up": EZ, "rail_out": across}
    if kind in moved or kind == "rail_across":
        limb = replace(limb, base=limb.base + by * moved.get(kind, aside))
    elif kind in turned:
        along, front = (v + by * np.cross(turned[kind], v) for v in (limb.along, limb.out))
        limb = replace(limb, along=along, out=front)
    else:
        limb = {
            "upper_arm": lambda: replace(limb, arm=limb.arm + by),
            "zero": lambda: replace(limb, zero=by),
            "scale": lambda: replace(limb, scale=1 + by),
            "strut": lambda: replace(limb, struts=((length + by, *ends),)),
        }[kind]()
    return replace(delta, limbs=[*delta.limbs[:LIMB], limb, *delta.limbs[LIMB + 1 :]])


@pytest.mark.parametrize("name", [*DRAWINGS])
def test_slopes_of_torques_by_each_number_are_those_of_machines_built_so(name: str) -> None:
    robot, rng = deltaid.load_robot(name), np.random.default_rng(0)
    drawing = replace(DRAWINGS[name], spacing=None)
    dynamics, known = compiled(robot), unknowns(robot)
    p = true_parameters(robot, rng)
    p[dynamics.layout.friction] = 0.0
    z = np.tile(dynamics.kinematics.home, (SAMPLES, 1))
    z[:, : len(drawing.low)] = drawing.poses(rng, SAMPLES)
    q = dynamics.kinematics.inverse(z)
    qd, qdd = rng.normal(0, 1, q.shape), rng.normal(0, 10, q.shape)

    def torques_of(delta: BuiltDelta) -> Array:
        zeros, scales = as_read(delta, q.shape[1])
        oracle = oracle_of(delta, robot, p)
        rows = zip(poses_at(oracle, zeros + scales * q, z), scales * qd, scales * qdd, strict=True)
        return np.array([oracle.inverse_dynamics(*row) for row in rows]).T

    exact = built(rng, drawing, length=0.0, angle=0.0)
    slopes = torque_slopes(dynamics, z, qd, qdd, p)
    point = Mock(
        spec=TracePoint, dynamics=dynamics, dof=q.shape[1], slopes=slopes, q=q,
        motion=Mock(qd=qd, qdd=qdd), weighted=lambda slopes: np.stack(slopes, axis=2),
    )  # fmt: skip
    columns = GeometryNumbers(known).columns(point)
    assert columns.shape[2] == len(known.numbers) + 2
    of_effect = dict(zip(numbers_of(robot), Mounting().columns(point).T, strict=True))
    assert of_effect
    for k, number in enumerate(known.numbers):
        if number.limb not in (LIMB, -1):
            continue
        up, down = (torques_of(off(exact, number.kind, by)) for by in (STEP, -STEP))
        expected = (up - down) / (2 * STEP)
        near = 1e-4 * np.abs(expected).max()
        np.testing.assert_allclose(columns[:, :, k], expected, atol=near, err_msg=number.kind)
        same = of_effect.get((number.limb, number.kind), columns[:, :, k].T)
        np.testing.assert_array_equal(same.T, columns[:, :, k])


def test_torques_add_to_a_probe_and_what_they_decided_is_said(tmp_path: Path) -> None:
    delta = machine(CLAVEL, 0, length=1e-3, angle=5e-3, noise=0.005)
    save_yaml(delta.robot.changed(tolerances={"mounting": 2e-4}), tmp_path / "robot.yaml")
    delta.recording.write_csv(tmp_path / "log.csv")
    pl.DataFrame(delta.measured("probe")["probe"]).write_csv(tmp_path / "bed.csv")
    given = {"robot": tmp_path / "robot.yaml", "probe": tmp_path / "bed.csv"}
    size, truth = {"lengths": 1e-3, "angles": 5e-3}, delta.built.numbers()
    bed = deltaid.calibrate(**given, **size)
    both = deltaid.calibrate(**given, **size, torques=tmp_path / "log.csv")
    errors = both.values - [truth[name] for name in both.names]
    # of 24 numbers, correlated: of 95 % three standard deviations may be missing
    assert np.mean(np.abs(errors) < 1.96 * both.std) > 0.8
    assert both.after.position < 0.9 * bed.after.position
    zeros = both.known.of_kind("zero")
    assert both.sources == ("description", "probe", "torques")
    assert both.shares.sum(axis=0) == pytest.approx(1.0)
    assert both.shares[-1, zeros].min() > 0.2
    rows = both.known.torques
    left = rows.b - rows.A @ [truth[name] for name in both.names]
    assert 0.3 < left @ left / len(left) < 2.5  # in units of their noise
    files = given["robot"], "--probe", given["probe"], "--torques", tmp_path / "log.csv"
    done = accepted("calibrate", *files, "--lengths", 1e-3, "--angles", 0.02, "--full")
    assert "log.csv: torques, decide limb1.zero, " in " ".join(done.out.split())
    (row,) = (line for line in done.out.splitlines() if line.startswith("zero, "))
    assert row.split()[-1] == "torques"


def test_no_other_error_of_the_description_takes_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any would take what torques say of the numbers."""
    swept = list[Contest]()

    def spied(*args: object) -> Contest | None:
        contest = swept_beside(*args)  # pyright: ignore[reportArgumentType]
        assert contest is not None
        swept.append(contest)
        return contest

    monkeypatch.setattr(torques, "swept_beside", spied)
    delta = machine(CLAVEL, 1, length=1e-3, angle=1e-3, noise=0.005, duration=4.0)
    known = unknowns(deltaid.load_robot(CLAVEL))
    torque_rows(deltaid.load_robot(CLAVEL), [delta.recording], None, known, lambda _: None)
    (contest,) = swept
    names = {unknown.name for unknown in contest.unknowns}
    assert "calibration" in names
    assert not names & {"zero", "length", "mounting", "tilt"}


@pytest.fixture(scope="module")
def recorded() -> Machine:
    return machine(CLAVEL, 1, length=1e-3, angle=1e-3, noise=0.005, duration=4.0)


FAULTS = {
    "torque reversed": ([-pl.col("tau2")], "the torque of drive2 counts the other way"),
    "drive reversed": ([-pl.col("q2")], "only with the other sign of drive2"),
    "exchanged": ([pl.col("tau2").alias("tau1"), pl.col("tau1").alias("tau2")],
                  "belong together only in another order"),
    "degrees": ([pl.col("q1", "q2", "q3") * 180 / np.pi], "make sense only times 0.0175"),
    "N mm": ([pl.col("tau1", "tau2", "tau3") * 1e3], "torques are in mN m"),
    "copied": ([pl.col("tau1").alias("tau2")], "are one signal"),
    "noise": ([pl.col("tau2").shuffle(seed=1)], " % of a drive's torque is unmodelled"),
    "at rest": ([pl.lit(0.3).alias(f"q{i + 1}") for i in range(3)], "no drive moves"),
}  # fmt: skip


def test_faults_of_recordings_are_named(recorded: Machine, tmp_path: Path) -> None:
    pl.DataFrame(recorded.measured("probe")["probe"]).write_csv(tmp_path / "bed.csv")
    given = ("calibrate", CLAVEL, "--probe", tmp_path / "bed.csv", "--torques")
    for fault, (columns, named) in FAULTS.items():
        recorded.recording.with_columns(columns).write_csv(tmp_path / "log.csv")
        said = refused(*given, tmp_path / "log.csv", folder=tmp_path)
        assert named in " ".join(said.split()), fault
        assert "log.csv" in said
    recorded.recording.head(0).write_csv(tmp_path / "log.csv")
    empty = refused(*given, tmp_path / "log.csv", folder=tmp_path)
    assert "log.csv: has fewer than two rows of data" in empty
    alone = ("calibrate", CLAVEL, "--torques", tmp_path / "log.csv")
    assert "no poses were measured" in refused(*alone, folder=tmp_path)


def test_a_base_that_nobody_says_is_level_may_lean(recorded: Machine) -> None:
    robot = recorded.robot
    known, level = unknowns(robot), {"mounting": robot.tolerances.mounting}
    stated, unstated = (
        torque_rows(described, [recorded.recording], None, known, lambda _: None).A
        for described in (robot.changed(tolerances=level), robot)
    )
    assert np.linalg.norm(unstated @ known.G) < 0.9998 * np.linalg.norm(stated @ known.G)
