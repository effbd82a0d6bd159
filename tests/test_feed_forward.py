"""Feed-forward along plans of positions alone: every row, beside motions with known derivatives."""

import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from command import accepted, refused
from deltaid.control.trajectory import open_trajectory
from deltaid.errors import RecordingError
from deltaid.model.model import Model
from deltaid.sensors.planning.rows import motion_of_file
from identified import identified
from logs import names

RATE = 1000
WAY = np.array([0.5, -0.4, 0.3])  # of the drives [rad]


@cache
def robot() -> Model:
    return deltaid.load("clavel-delta3")


@cache
def smooth() -> Model:
    """The same without friction, whose steps no filter follows."""
    return robot().without_friction()


@dataclass(frozen=True)
class Plan:
    """A motion with its derivatives in closed form, one sample a row."""

    time: np.ndarray
    q: np.ndarray
    qd: np.ndarray
    qdd: np.ndarray

    @property
    def torque(self) -> np.ndarray:
        return robot().dynamics.inverse_dynamics(self.q, self.qd, self.qdd, smooth().p)

    def frame(self, step: float = 0.0) -> pl.DataFrame:
        """Time and positions, on the steps of an encoder."""
        q = step * np.round(self.q / step) if step else self.q
        return pl.DataFrame(dict(zip(names("t", "q"), [self.time, *q.T], strict=True)))

    def error(self, found: pl.DataFrame) -> np.ndarray:
        """Of each row, as a share of the largest torque."""
        np.testing.assert_array_equal(found["t"], self.time)
        off = np.abs(found.select(names("tau")).to_numpy() - self.torque)
        return off.max(axis=1) / np.abs(self.torque).max()


def start() -> np.ndarray:
    return robot().dynamics.kinematics.inverse(robot().home[None])[0] - 0.5 * WAY


def point_to_point(duration: float, rest: float = 0.0) -> Plan:
    """Polynomial of seventh degree from rest to rest, whose jerk begins at zero."""
    c = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    time = np.arange(round((duration + 2 * rest) * RATE)) / RATE
    duration -= 1 / RATE  # from the first row to the last
    s = np.clip((time - rest) / duration, 0, 1)
    orders = [c.deriv(k)(s) / duration**k if k else c(s) for k in range(3)]
    q, qd, qdd = (x[:, None] * WAY for x in orders)
    return Plan(time, start() + q, qd, qdd)


def circling(duration: float, period: float, closed: bool = False) -> Plan:
    """Cosines of two harmonics, at no time at rest."""
    time = np.arange(round(duration * RATE) + closed) / RATE
    q, qd, qdd = np.tile(start() + 0.5 * WAY, (len(time), 1)), *np.zeros((2, len(time), 3))
    for harmonic, size in ((1, 0.25), (2, 0.05)):
        w = 2 * np.pi * harmonic / period
        phase = w * time[:, None] + np.array([0.3, 1.7, 3.9]) * harmonic
        q += size * np.cos(phase)
        qd -= size * w * np.sin(phase)
        qdd -= size * w**2 * np.cos(phase)
    return Plan(time, q, qd, qdd)


@pytest.mark.parametrize(
    ("duration", "rest"), [(0.2, 0.0), (0.8, 0.0), (0.8, 0.1), (3.0, 0.0), (20.0, 0.0)]
)
@pytest.mark.parametrize("step", [0.0, 1e-5])
def test_a_plan_that_rests_at_both_ends_keeps_every_row(
    duration: float, rest: float, step: float
) -> None:
    plan = point_to_point(duration, rest)
    assert_every_row(plan, step, periodic=False)


def test_a_fast_plan_rests_though_the_model_comes_from_slow_recordings() -> None:
    """Whether an end rests is a question of the plan, not of the recordings' cut-off."""
    model = identified("clavel-delta3").result.model
    result = deltaid.torque(model, point_to_point(0.1).frame())
    assert result.without == (0, 0)


def test_a_plan_of_few_rows_a_second_and_one_with_a_hole_need_no_rate_of_recordings() -> None:
    """Nor a length: the cut-off of the model's recordings is about their noise."""
    model, plan = identified("clavel-delta3").result.model, point_to_point(1.2)
    assert deltaid.torque(model, plan.frame().gather_every(20)).without == (0, 0)
    rows = deltaid.torque(model, plan.frame().filter(pl.col("t") != 0.5)).table()
    assert rows["tau1"].is_not_null().sum() > 900


def thinned(plan: Plan, every: int) -> Plan:
    return Plan(*(x[::every] for x in (plan.time, plan.q, plan.qd, plan.qdd)))


def trapezoid() -> Plan:
    """Along a line for half a second, whose speed rises, stays and falls in thirds, at 50 Hz."""
    time, s = np.arange(26) / 50, np.arange(26) / 25
    ends, way = np.minimum(s, 1 - s), np.array([0.24, -0.08, 0.1])
    place = np.where(ends < 1 / 3, 2.25 * ends**2, 1.5 * ends - 0.25)
    place = np.where(s > 0.5, 1 - place, place)
    speed = np.minimum(4.5 * ends, 1.5) / 0.5
    slope = np.where(ends < 1 / 3, 4.5, 0.0) * np.sign(0.5 - s) / 0.25
    z, zd, zdd = ([-0.12, 0.03, -0.9] + place[:, None] * way, speed[:, None] * way,
                  slope[:, None] * way)  # fmt: skip
    return Plan(time, *robot().dynamics.kinematics.drive_motion(z, zd, zdd))


def jump() -> Plan:
    """From one place to another in one row."""
    time = np.arange(500) / RATE
    q = start() + WAY * (time > 0.25)[:, None]
    return Plan(time, q, 0 * q, 0 * q)


@pytest.mark.parametrize("every", [1, 10])
def test_accelerations_that_the_filter_takes_are_said(every: int) -> None:
    """Of a jump all; of rows far apart a part. Rows that are near enough are not."""
    fine = deltaid.torque(smooth(), thinned(point_to_point(0.5), every).frame())
    assert (fine.without, fine.warnings) == ((0, 0), ())
    assert not deltaid.torque(smooth(), thinned(point_to_point(0.5), every).frame(1e-5)).warnings
    coarse = thinned(point_to_point(0.3), 20)
    found = deltaid.torque(smooth(), coarse.frame())
    assert found.without == (0, 0)
    assert coarse.error(found.table()).max() > 0.1
    (said,) = found.warnings
    assert "the filter, 5 Hz for rows at 50 Hz, removes" in said
    (said,) = deltaid.torque(smooth(), trapezoid().frame()).warnings
    assert re.search(r"removes 2\d % of drive", said)
    (said,) = deltaid.torque(smooth(), thinned(jump(), every).frame()).warnings
    assert "removes 100 % of drive" in said
    assert "or it jumps" in said


@pytest.mark.parametrize("whose", ["prior", "identified"])
def test_forces_reach_from_the_first_row_of_a_plan_to_its_last(whose: str) -> None:
    """The worst force may be at an end, and of a motion faster than the model's recordings."""
    model = smooth() if whose == "prior" else identified("clavel-delta3").result.model
    plan, forces = point_to_point(0.2), deltaid.ConstraintForces(model.robot)
    table = deltaid.forces(model, plan.frame()).to_frame()
    np.testing.assert_array_equal(table["t"], plan.time)
    z = forces.kinematics.forward(plan.q)
    expected = forces.evaluate(z, plan.qd, plan.qdd, model.p)
    np.testing.assert_allclose(
        table[:, 1:].to_numpy(), expected, atol=5e-3 * np.abs(expected).max()
    )


def test_sensors_are_planned_along_a_whole_plan() -> None:
    model, plan = identified("clavel-delta3").result.model, point_to_point(0.3)
    assert motion_of_file(model, model.dynamics, plan.frame()).duration == pytest.approx(0.3)


def test_forces_of_ends_that_move_are_said_to_be_unknown() -> None:
    warnings = deltaid.forces(robot(), circling(4.0, 1.3).frame()).warnings
    assert any("rows have no forces" in text for text in warnings)


def test_a_simulation_follows_a_plan_from_its_first_row_to_its_last() -> None:
    plan = point_to_point(0.2)
    trajectory, _ = open_trajectory(plan.frame(), robot().dynamics.kinematics)
    assert trajectory.duration == pytest.approx(plan.time[-1])
    desired = trajectory.desired(plan.time)
    np.testing.assert_allclose(desired.q, plan.q, atol=1e-4)
    np.testing.assert_allclose(desired.qdd, plan.qdd, atol=5e-3 * np.abs(plan.qdd).max())


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("step", [0.0, 1e-5])
def test_a_periodic_plan_keeps_every_row(closed: bool, step: float) -> None:
    assert_every_row(circling(1.0, 1.0, closed), step, periodic=True)


def assert_every_row(plan: Plan, step: float, *, periodic: bool) -> None:
    result = deltaid.torque(smooth(), plan.frame(step), periodic=periodic)
    assert result.without == (0, 0)
    assert plan.error(result.table()).max() < (5e-3 if step else 2e-3)


def test_rows_that_are_there_twice_count_once(tmp_path: Path) -> None:
    plan = point_to_point(0.5)
    known = [plan.time, *plan.q.T, *plan.qd.T, *plan.qdd.T]
    rows = pl.DataFrame(dict(zip(names("t", "q", "qd", "qdd"), known, strict=True)))
    pl.concat([rows, rows]).sort("t").write_csv(tmp_path / "plan.csv")
    out = tmp_path / "tau.csv"
    outcome = accepted("torque", "clavel-delta3", tmp_path / "plan.csv", "-o", out)
    assert f"{len(rows)} of {2 * len(rows)} samples" in outcome.out
    assert len(pl.read_csv(out)) == len(rows)


def test_rows_of_ends_that_move_are_there_without_torques(tmp_path: Path) -> None:
    plan, out = circling(4.0, 1.3), tmp_path / "torque.csv"
    plan.frame().write_csv(tmp_path / "plan.csv")
    outcome = accepted("torque", "clavel-delta3", tmp_path / "plan.csv", "-o", out)
    assert out.read_text().startswith("t,tau1,tau2,tau3\n")  # no comment: any reader takes it
    assert "rows have no torque" in outcome.err.replace("\n", " ")
    written = pl.read_csv(out)
    known = written["tau1"].is_not_null().to_numpy()
    first, last = np.flatnonzero(known)[[0, -1]]
    assert known[first : last + 1].all()
    assert 0 < first == len(plan.time) - 1 - last < 400
    assert f"wrote {known.sum()} of 4000 samples" in outcome.out.replace("\n", " ")
    assert deltaid.columns(out) is not None  # the file is one that deltaid reads


@pytest.mark.parametrize("step", [0.0, 1e-5])
def test_friction_of_what_rests_has_no_sign(step: float) -> None:
    """Where a plan waits, torques are those of rest, not friction of what rounding leaves."""
    plan = point_to_point(0.8, 0.4)
    found = deltaid.torque(robot(), plan.frame(step)).table().select(names("tau")).to_numpy()
    waits, goes = plan.time < 0.3, (plan.qd**2).max(axis=1) > 0.01
    at_rest = found[waits] - plan.torque[waits]
    assert np.abs(at_rest).max() < 0.01 * np.abs(plan.torque).max()
    friction = (found - plan.torque)[goes]
    assert (np.sign(friction) == np.sign(plan.qd[goes])).all()


@pytest.mark.parametrize(("rate", "given"), [(RATE, 2), (RATE, 1), (50, 0)])
def test_an_end_at_rest_has_no_friction_whatever_the_plan_gives(rate: int, given: int) -> None:
    """Neither by the filter, which takes speed from beside an end, nor by rounding of speeds."""
    plan, every = point_to_point(0.8, 0.1), RATE // rate
    frame = plan.frame().with_columns(
        pl.Series(f"{kind}{k + 1}", x[:, k])
        for kind, x in (("qd", plan.qd + 1e-15), ("qdd", plan.qdd))[:given]
        for k in range(3)
    )
    found = deltaid.torque(robot(), frame.gather_every(every)).table().select(names("tau"))
    at_ends = (found.to_numpy() - plan.torque[::every])[[0, -1]]
    assert np.abs(at_ends).max() < 0.01 * np.abs(plan.torque).max()


def test_one_end_may_rest() -> None:
    plan = point_to_point(0.8)
    half = Plan(*(x[:400] for x in (plan.time, plan.q, plan.qd, plan.qdd)))
    result = deltaid.torque(smooth(), half.frame())
    assert result.without[0] == 0
    assert 0 < result.without[1] < 200
    error = half.error(result.table())
    assert np.nanmax(error) < 2e-3
    assert np.isnan(error[-result.without[1] :]).all()


def test_what_is_not_periodic_or_too_short_is_refused(tmp_path: Path) -> None:
    circling(1.1, 1.0).frame().write_csv(tmp_path / "open.csv")
    circling(0.04, 1.0).frame().write_csv(tmp_path / "short.csv")
    out = ("-o", tmp_path / "torque.csv")
    command = ("torque", "clavel-delta3")
    said = refused(*command, tmp_path / "open.csv", "--periodic", *out, folder=tmp_path)
    assert "does not go on as it begins" in said
    assert "q" in said
    said = refused(*command, tmp_path / "short.csv", *out, folder=tmp_path)
    assert "too few to filter" in said
    with pytest.raises(RecordingError, match="does not go on"):
        deltaid.torque(robot(), point_to_point(0.5).frame(), periodic=True)
