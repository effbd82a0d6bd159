"""Limbs that differ though their description says that they share bodies."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import deltaid
from deltaid.dynamics.dynamics import compiled
from deltaid.effects.limbs import UnlikeLimbs
from deltaid.effects.point import TracePoint
from deltaid.identification.generic_motion import measured_base
from deltaid.identification.geometric_rows import Geometry
from deltaid.identification.study import studied_trace
from deltaid.robot.description import RobotDescription
from drives import case
from drives.identify import identified
from drives.judge import judge
from identified import identified as clean


def point_of(name: str, robot: RobotDescription | None = None) -> TracePoint:
    """A recording about the parameters that it gives, or about those of another description."""
    result = clean(name).result
    dynamics = result.problem.dynamics if robot is None else compiled(robot)
    p = result.model.p if robot is None else dynamics.p
    trace = studied_trace(dynamics, result.recordings[0], p)
    assert trace is not None
    return TracePoint(trace, p)


@pytest.mark.parametrize(
    ("name", "driven", "changes"),
    [
        ("clavel-delta3", "U", {"mcx": 0.02, "mcz": -0.01, "Iyy": 0.005}),
        ("linear-delta", "C", {"m": 0.1}),
    ],
)
def test_columns_are_torques_of_limbs_with_own_bodies(
    name: str, driven: str, changes: dict[str, float]
) -> None:
    point = point_of(name)
    columns, own = (
        UnlikeLimbs().columns(point),
        compiled(UnlikeLimbs().opened(point.dynamics.robot)),
    )
    value = dict(zip(point.dynamics.layout.names, point.p.tolist(), strict=True))
    limbs = len(point.dynamics.robot.identical_drives)
    numbered = {f"{body}{i + 1}": body for body in (driven, "S") for i in range(limbs)}
    origin = [entry.split(".") for entry in own.layout.names]
    p = np.array([value[f"{numbered.get(first, first)}.{last}"] for first, last in origin])
    heavier = p.copy()
    for symbol, change in changes.items():
        for limb, share in ((1, 1.0), (2, -0.7), (3, -0.3)):
            heavier[own.layout.names.index(f"{driven}{limb}.{symbol}")] += share * change
    trace = replace(point.trace, dynamics=own)
    added = (trace.model(heavier) - trace.model(p)).ravel()
    assert trace.model(p) == pytest.approx(point.model, abs=1e-9)
    flat = columns.reshape(-1, columns.shape[2])
    left = added - flat @ np.linalg.lstsq(flat, added)[0]
    assert np.linalg.norm(added) > 0
    assert np.linalg.norm(left) < 1e-9 * np.linalg.norm(added)
    common = np.tile(np.eye(columns.shape[2] // (limbs - 1)), limbs)
    assert columns.shape[2] == len(common) * (limbs - 1)


def test_arms_that_were_weighed_are_alike() -> None:
    robot = point_of("clavel-delta3").dynamics.robot
    bodies = dict(robot.bodies)
    weighed = bodies["U"].changed(measured=[{"mass": 1.0, "std": 0.01}])
    alone = robot.changed(bodies=bodies | {"U": weighed})
    together = robot.changed(
        measured=[{"mass": 2.0, "std": 0.01, "of": [{"body": "U"}, {"body": "P"}]}]
    )
    tool = robot.changed(bodies=bodies | {"P": bodies["P"].changed(measured=weighed.measured)})
    counts = [UnlikeLimbs().columns(point_of("clavel-delta3", known)).shape[2]
              for known in (robot, alone, together, tool, UnlikeLimbs().opened(robot))]  # fmt: skip
    assert counts[0] == counts[3] > 0
    assert counts[1] == counts[2] == counts[4] == 0


def test_moves_of_shared_bodies_are_those_of_each_limb() -> None:
    own = measured_base(compiled(UnlikeLimbs().opened(deltaid.load("clavel-delta3").robot)))
    moves: tuple[dict[str, float], ...] = (
        {"U.mcx": 0.1, "P.m": 0.2},
        {"U1.mcx": 0.1, "U2.mcx": 0.1, "U3.mcx": 0.1, "P.m": 0.2},
        {"P.m": 0.2},
    )
    of_shared, of_each, of_none = Geometry.exact(own).with_causes(own, moves).shifts.T
    assert of_shared == pytest.approx(of_each)
    assert np.abs(of_shared - of_none).max() > 0.05


def test_a_heavier_arm_is_named_and_each_limb_has_its_own_bodies(tmp_path: Path) -> None:
    heavy = case("heavy-limb", "delta3", 1)
    result = identified(heavy)
    judged = judge(heavy, result)
    assert set(dict(judged.said)) == {"limb"}
    (odd,) = re.findall(r"driven body of limb (\d)", " ".join(heavy.drawn))
    (correction,) = result.model.corrections
    assert correction.subject == f"limb {odd}"
    assert not judged.verdicts
    assert judged.M < 0.003  # 1.7 % where limbs are identical, with a tilt or a ripple
    assert np.mean(judged.base) > 0.8
    assert not result.robot.limbs.identical
    result.model.save(tmp_path / "model.yaml")
    loaded = deltaid.load(tmp_path / "model.yaml")
    assert loaded.p == pytest.approx(result.model.p)
    assert [name for name in loaded.robot.body_names if name[0] == "U"] == ["U1", "U2", "U3"]
