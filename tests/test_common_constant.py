"""Constant torques that drives of identical limbs share: they look like weight of all limbs."""

from dataclasses import replace

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.friction import FrictionByDirection
from deltaid.effects.geometry import Tilt
from deltaid.effects.joint import BY_DIRECTION, ONE_WAY, one_way
from deltaid.effects.point import points_of
from deltaid.estimation.drive_rows import TraceRows
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import Span
from deltaid.estimation.traces import trace
from deltaid.identification.common_constant import of_laws, undetected_constant
from deltaid.identification.contest import contest
from deltaid.identification.doubts import inseparable
from deltaid.identification.friction_choice import choose_friction
from deltaid.identification.friction_rows import FrictionRows, friction_rows
from deltaid.recording.recording import open_recordings
from deltaid.robot.load import load_robot
from deltaid.robot.measured import MeasuredTogether
from drives.happening import Happening, Law
from drives.identify import identified
from drives.judge import judge
from drives.robots import machine
from drives.rows import Case
from drives.sensors import Sensors


def with_constant(kind: str, share: float) -> Case:
    """A recording of drives whose friction has the same constant, as a share of Coulomb's mean."""
    m, sensors = machine(kind, 0), Sensors()
    bias = share * m.coulomb.mean() / m.coulomb
    h = Happening(m, 14.0, 5, law=Law(m.viscous, m.coulomb, bias=bias))
    return Case("bias", kind, 0, m, m.robot, (h,), (sensors,), (sensors.recorded(h),))


def rows_of(made: Case) -> FrictionRows:
    dynamics = compiled(made.robot)
    recordings = open_recordings(list(made.logs), dynamics.kinematics, None, None)
    return friction_rows(dynamics, recordings)


@pytest.fixture(scope="module")
def delta3() -> FrictionRows:
    return rows_of(with_constant("delta3", 0.03))


@pytest.mark.parametrize(("kind", "share"), [("delta3", 0.12), ("linear", 0.03)])
def test_intervals_count_a_constant_that_looks_like_weight(kind: str, share: float) -> None:
    """To linear drives it is weight; others show less of it than errors of positions may be."""
    made = with_constant(kind, share)
    result = identified(made)
    assert not any(law.has_constant for law in result.model.robot.friction.values())
    assert np.mean(judge(made, result).curves) == 1.0
    named = [pair.text for pair in result.model.inseparable]
    assert any("weight from a constant of friction (drive1, drive2" in text for text in named)
    # What a rival of the contest does to drives' constants is not weight.
    moves = {f"offset.{drive}": law.coulomb for drive, law in made.robot.friction.items()}
    rival = replace(result.problem, undetected={}, moves=(moves,))
    assert not any("weight" in pair.causes for pair in inseparable(rival, absolute=True))


def test_drives_get_offsets_together_where_none_alone_is_surprising() -> None:
    made = with_constant("par4", 0.12)
    result = identified(made)
    laws = result.model.robot.friction.values()
    assert all(result.model.robot.friction[drive].has_constant for drive in made.robot.drives)
    # A prior as small as an estimate that noise made so would exclude the truth.
    assert all(law.offset is None or law.offset >= ONE_WAY * law.coulomb for law in laws)
    judged = judge(made, result)
    assert judged.friction < 0.02  # 0.066 without offsets
    assert np.mean(judged.curves) == 1.0


def test_nothing_makes_up_for_the_constant_but_what_the_rows_then_lack(
    delta3: FrictionRows,
) -> None:
    """Moves of parameters with those of offsets leave what no column explains."""
    robot = delta3.dynamics.robot
    law = robot.friction["drive1"]
    laws = dict(robot.friction) | {"drive1": law.changed(offset=0.1)}
    moves = undetected_constant(delta3, robot.changed(friction=laws))
    assert min(abs(moves[f"offset.{drive}"]) for drive in robot.drives) > 0
    active = active_columns(delta3.dynamics)
    p = np.array([moves[name] for name in delta3.dynamics.layout.names])[active]
    offsets = delta3.columns([(delta3.joints[drive], one_way) for drive in robot.drives])
    torque = delta3.drive_rows.stack(delta3.Y) @ p
    torque += offsets @ [moves[f"offset.{drive}"] for drive in robot.drives]
    span = delta3.span.with_columns(offsets[:, :1])
    alone = offsets.sum(axis=1) * moves["offset.drive2"]
    lags = Span.of_columns(delta3.extra)
    left = lags.without(np.column_stack([torque, span.without(alone)]))
    np.testing.assert_allclose(left[:, 0], left[:, 1], atol=1e-9 * np.abs(alone).max())


def test_the_recording_excludes_a_constant_beyond_noise(delta3: FrictionRows) -> None:
    noise = 1e-6 * np.random.default_rng(0).standard_normal(len(delta3.tau))
    exact = replace(delta3, tau=delta3.tau - delta3.residual + noise)
    assert undetected_constant(exact, delta3.dynamics.robot) == {}


def test_linear_drives_do_not_show_a_common_constant() -> None:
    linear = rows_of(with_constant("linear", 0.0))
    moves = undetected_constant(linear, linear.dynamics.robot)
    usual = ONE_WAY * linear.dynamics.robot.friction["drive1"].coulomb  # more than it is
    assert moves["offset.drive1"] == pytest.approx(np.sqrt(0.5) * usual)
    robot = linear.dynamics.robot
    odd = {"drive2": robot.friction["drive2"].changed(offset=1.0)}
    moves = undetected_constant(linear, robot.changed(friction=dict(robot.friction) | odd))
    assert moves["offset.drive1"] == pytest.approx(usual)  # one drive has a constant, so others may


def test_only_sums_beyond_chance_make_offsets(delta3: FrictionRows) -> None:
    robot, _ = choose_friction(delta3)
    assert not any(law.has_constant for law in robot.friction.values())


def test_the_estimate_of_a_contest_has_the_constants_of_drives() -> None:
    """Of each drive its own; what an effect changes has them too."""
    m, sensors = machine("delta3", 0), Sensors()
    bias = np.array([0.1, -0.1, 0.05])
    h = Happening(m, 14.0, 5, law=Law(m.viscous, m.coulomb, bias=bias))
    dynamics = compiled(m.robot)
    (recording,) = open_recordings([sensors.recorded(h)], dynamics.kinematics, None, None)
    p = prior_parameters(m.robot)
    points = points_of([trace(dynamics, recording, p, cutoff=None)], p)
    rows = TraceRows.for_dynamics(dynamics, (), 1.0)
    swept = contest(rows, points, (FrictionByDirection(), Tilt()), {})
    named, true = swept.named(swept.estimate), bias * m.coulomb
    fitted = np.array([named[f"offset.{drive}"] for drive in m.robot.drives])
    assert fitted - fitted.mean() == pytest.approx(true - true.mean(), abs=0.1 * true.max())
    assert [named[name] for name in dynamics.layout.names] == swept.p.tolist()
    leans = swept.shrunk.follows([swept.group("tilt")])
    constants = leans[swept.group(BY_DIRECTION).columns[::2]]
    assert np.abs(constants).max() > 0
    for move, expected in zip(swept.follows(["tilt"]), constants.T, strict=True):
        named = swept.named(move)
        offsets = [named[f"offset.{drive}"] for drive in m.robot.drives]
        assert offsets == pytest.approx(expected)


def test_a_constant_by_direction_is_no_offset() -> None:
    robot = load_robot("clavel-delta3")
    law = robot.friction["drive1"]
    changed = law.changed(viscous_back=law.viscous, coulomb_back=law.coulomb)
    robot = robot.changed(friction=dict(robot.friction) | {"drive1": changed})
    moves = {"offset.drive1": 0.3, "coulomb.drive1": 0.1, "offset.drive2": 0.2}
    assert of_laws(moves, robot) == pytest.approx(
        {"coulomb.drive1": 0.4, "coulomb_back.drive1": -0.3, "offset.drive2": 0.2}
    )


def test_offsets_that_no_row_shows_are_not_chosen(delta3: FrictionRows) -> None:
    """A motion may be too poor for any; here all that offsets do is a column already."""
    offsets = delta3.columns([(joint, one_way) for joint in delta3.joints.values()])
    poor = replace(delta3, span=delta3.span.with_columns(offsets))
    robot, _ = choose_friction(poor)
    assert not any(law.has_constant for law in robot.friction.values())


def test_a_scale_that_weighed_all_bodies_knows_the_constant() -> None:
    """What is left of weight is then a constant; without the scale hardly anything is known."""
    m, sensors = machine("linear", 0), Sensors()
    constant = 0.03 * m.coulomb.mean()
    h = Happening(m, 14.0, 5, law=Law(m.viscous, m.coulomb, bias=constant / m.coulomb))
    truth = dict(zip(m.layout.names, m.plant.p.tolist(), strict=True))
    weighed = tuple(
        MeasuredTogether(mass=truth[f"{body}.m"], std=1e-3, of=body) for body in m.robot.body_names
    )
    sizes = list[float]()
    for robot in (m.robot, m.robot.changed(measured=weighed)):
        dynamics = compiled(robot)
        (recording,) = open_recordings([sensors.recorded(h)], dynamics.kinematics, None, None)
        moves = undetected_constant(friction_rows(dynamics, [recording]), robot)
        sizes.append(moves["offset.drive1"])
    unknown, known = sizes
    assert unknown == pytest.approx(np.sqrt(0.5) * ONE_WAY * 30.0)
    assert known == pytest.approx(constant, rel=0.1)
