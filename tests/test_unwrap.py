"""Angles and counts that start again after a turn or an overflow, and arms about ±180°."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.errors import RecordingError
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.opening import open_log
from deltaid.recording.time.counts import Unwrapper, _numbers
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from identified import simulated
from logs import read, recorded, tabled, write
from support import along

TURN, BITS = 360.0, 2.0**16


def unwrapped(unwrapper: Unwrapper, x: np.ndarray, *cuts: int) -> np.ndarray:
    """All numbers, given in pieces."""
    rows = np.array([0, *cuts, len(x)])
    pieces = zip(np.split(x, list(cuts)), rows[:-1], strict=True)
    return np.concatenate([unwrapper.add(piece, int(row)) for piece, row in pieces])


def angle() -> Unwrapper:
    return Unwrapper("q", (TURN,), ())


def counter() -> Unwrapper:
    return Unwrapper("q", (), (2.0**16, 2.0**24))


@pytest.mark.parametrize("low", [0.0, -0.5], ids=["from zero on", "about zero"])
def test_angles_go_on_as_they_went(low: float) -> None:
    """In whatever pieces they come; forth and back, over many turns."""
    t = np.arange(300)
    whole = 800.0 * np.sin(0.05 * t) + 170.0 * np.sin(0.13 * t)
    wrapped = (whole - low * TURN) % TURN + low * TURN
    whole += wrapped[0] - whole[0]
    crossed = np.flatnonzero(np.abs(np.diff(wrapped)) > 0.5 * TURN)
    for cuts in ((), (1, 2, 3), tuple(range(1, 300)), tuple(crossed), tuple(crossed + 1)):
        unwrapper = angle()
        np.testing.assert_allclose(unwrapped(unwrapper, wrapped, *cuts), whole, atol=1e-9)
        assert (unwrapper.count, unwrapper.first) == (len(crossed), crossed[0] + 1)
        assert unwrapper.period == TURN


def test_pieces_number_their_first_row() -> None:
    unwrapper = angle()
    unwrapper.add(np.array([340.0, 350.0]), 100)
    assert unwrapper.count == 0
    np.testing.assert_array_equal(unwrapper.add(np.array([0.0, 10.0]), 102), [360.0, 370.0])
    np.testing.assert_array_equal(unwrapper.add(np.array([20.0]), 104), [380.0])
    assert (unwrapper.count, unwrapper.first) == (1, 102)


@pytest.mark.parametrize("period", [TURN, BITS])
@pytest.mark.parametrize(
    ("before", "after", "inside"),
    [
        (1.005, 0.005, True), (1.02, 0.02, False),  # a little over the highest number
        (0.99, -0.005, True), (0.5, -0.505, True), (0.48, -0.52, False),  # and below the lowest
        (-0.5, 0.5, True), (-0.52, 0.48, False), (0.0, 1.005, True), (0.02, 1.02, False),
        (1.7, 0.7, False), (-1.2, -0.2, False), (0.2, -0.8, False),
        (0.95, -0.25, True), (0.95, -0.35, False),  # a leap may miss the period by a quarter
    ],
)  # fmt: skip
def test_a_new_round_begins_within_the_range(
    period: float, before: float, after: float, inside: bool
) -> None:
    """From 0 to one period, or half of it to either side, and a hundredth beyond: what leaps
    elsewhere has moved."""
    x = np.round(period * np.array([before, before, after, after]), 0)
    unwrapper = angle() if period == TURN else counter()
    back = np.sign(before - after) * period if inside else 0.0
    np.testing.assert_allclose(unwrapped(unwrapper, x), x + np.array([0.0, 0.0, back, back]))
    assert unwrapper.count == inside


@pytest.mark.parametrize(
    ("steps", "rounds"),
    [
        ([0, -280, 0], 1), ([0, -260, 0], 0),  # three quarters of a turn
        ([80, -340, 80], 1), ([100, -340, 0], 0), ([0, -340, 100], 0), ([-100, -250, 0], 0),
    ],
)  # fmt: skip
def test_a_leap_between_small_steps_is_a_new_round(steps: list[int], rounds: int) -> None:
    """It misses a period by less than a quarter; so do the steps beside it from rest."""
    x = 270.0 - steps[0] + np.cumsum([0.0, *steps])
    for cuts in ((), (1,), (2,), (1, 2)):
        unwrapper = angle()
        unwrapped(unwrapper, x, *cuts)
        assert unwrapper.count == rounds


def test_counts_are_whole_numbers() -> None:
    """A leap of 65 536 of what has fractions is none of a counter of 16 bits."""
    x = np.array([65_530.0, 65_535.0, 1.0, 6.0])
    unwrapper, other = counter(), counter()
    np.testing.assert_array_equal(unwrapped(unwrapper, x), [65_530.0, 65_535.0, 65_537.0, 65_542.0])
    assert unwrapper.period == 2.0**16
    np.testing.assert_array_equal(unwrapped(other, x + 0.5), x + 0.5)


def test_the_nearest_period_is_taken_and_kept() -> None:
    unwrapper = Unwrapper("q", (65_000.0,), (2.0**16, 2.0**24))
    x = np.array([65_000.0, 65_530.0, 2.0, 10.0])
    np.testing.assert_array_equal(unwrapped(unwrapper, x)[2:], x[2:] + 2.0**16)
    assert unwrapper.period == 2.0**16
    other = Unwrapper("q", (), (2.0**16, 2.0**24))
    top = np.array([2.0**24 - 8.0, 2.0**24 - 1.0, 6.0, 14.0])
    leap = np.array([65_540.0, 65_541.0])  # as far as a smaller counter goes, on a larger one
    found = unwrapped(other, np.concatenate([top, leap]), 4)
    np.testing.assert_array_equal(found[2:], 2.0**24 + np.concatenate([top[2:], leap]))


def test_time_only_counts_up() -> None:
    """A leap back is a new round, one ahead is none: it lacks rows."""
    for x, expected in (([250.0, 2.0, 10.0], [250.0, 258.0, 266.0]), ([2.0, 250.0, 255.0], None)):
        unwrapper = Unwrapper("q", (), (2.0**8,), rising=True)
        np.testing.assert_array_equal(unwrapped(unwrapper, np.array(x)), expected or x)


@pytest.mark.parametrize(
    ("period", "words"),
    [(1.0, "1, one turn,"), (360.0, "360, one turn,"), (1000.0, "1000, one turn,"),
     (256.0, "256 counts (8 bits)"), (65536.0, "65536 counts (16 bits)")],
)  # fmt: skip
def test_a_turn_is_no_counter_however_large_its_number(period: float, words: str) -> None:
    assert _numbers(period) == words


@pytest.mark.parametrize(
    ("unit", "turn"), [("rad", 2 * np.pi), ("deg", 360.0), ("rev", 1.0), ("360/1000 deg", 1000.0)]
)
@pytest.mark.parametrize("declared", [True, False])
def test_a_turn_is_one_in_the_unit_of_the_column(
    tmp_path: Path, unit: str, turn: float, declared: bool
) -> None:
    """Whether a mapping says the unit or the log does, and whatever gear comes before it."""
    whole = turn * (0.9 + 0.2 * np.arange(20) / 20)
    frame = recorded(20).with_columns(q2=pl.Series(whole % turn))
    mapping = None
    names, *rows = frame.write_csv().splitlines()
    if declared:
        columns = [{"column": f"q{i}", "unit": unit, "gear": 5.0} for i in (1, 2, 3)]
        mapping = ColumnMapping.model_validate({"position": columns})
    else:
        rows = [f"s,rad,{unit},rad,N m,N m,N m", *rows]
    values = read(write(tmp_path / "log.csv", "\n".join([names, *rows, ""])), mapping)[:, 2]
    expected = 2 * np.pi * whole / turn / (5.0 if declared else 1.0)
    np.testing.assert_allclose(values, expected, rtol=1e-9)


def turned(angle_deg: tuple[float, float] | None) -> RobotDescription:
    """Clavel's Delta with its arms folded inwards and level, elbows behind their motors."""
    data = load_robot("clavel-delta3").model_dump(exclude_none=True)
    data["name"] = "turned"
    data["limbs"]["working_mode"] = "inwards"
    data["workspace"] = {"shape": "cylinder", "radius": 0.15, "z": [-1.08, -0.96]}
    own = {"torque": 150.0} | ({"angle_deg": angle_deg} if angle_deg else {})
    data["drive_limits"] = {f"drive{i}": own for i in (1, 2, 3)}
    data |= {"strut_swing_deg": 60.0}
    return RobotDescription.model_validate(data)


@pytest.mark.parametrize(
    ("angle_deg", "middle"), [((150.0, 230.0), 190.0), ((-220.0, -140.0), -180.0), (None, -178.9)]
)
def test_angles_are_continuous_around_half_a_turn(angle_deg, middle) -> None:
    kinematics = compiled(turned(angle_deg)).kinematics
    motion = random_motion(kinematics, np.random.default_rng(0))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, 4000))
    q, qd, _ = kinematics.drive_motion(z, zd, zdd)
    assert np.abs(np.diff(q, axis=0)).max() < np.deg2rad(1.0)
    assert (q.min(axis=0) < np.pi * np.sign(middle)).all()  # both sides of ±180° are visited
    assert (q.max(axis=0) > np.pi * np.sign(middle)).all()
    assert np.abs(q - np.deg2rad(middle)).max() < np.deg2rad(60)
    slope = np.gradient(q, motion.period / 3999, axis=0)
    assert np.abs(slope - qd)[1:-1].max() < 1e-3 * np.abs(qd).max()


@pytest.mark.parametrize("name", ["clavel-delta3", "h4"])
def test_an_encoder_that_counts_whole_turns_more_is_read_the_same(name: str) -> None:
    kinematics = compiled(load_robot(name)).kinematics
    motion = random_motion(kinematics, np.random.default_rng(0))
    z = motion.evaluate(np.linspace(0, 1, 100))[0]
    q = kinematics.inverse(z)
    q[:, 1] += 2 * np.pi
    q[:, 2] -= 2 * np.pi
    np.testing.assert_allclose(kinematics.forward(q), z, atol=1e-9)


def test_a_log_is_read_with_any_count_of_turns(tmp_path: Path) -> None:
    kinematics = compiled(turned((150.0, 230.0))).kinematics
    time = np.arange(400) / 1000
    _, q, qd, qdd = along(kinematics, np.random.default_rng(0), time)
    frame = tabled(t=time, q=q, qd=qd, qdd=qdd, tau=np.sin(time[:, None] + [1, 2, 3]))
    for turns in (0, -1):
        frame.with_columns(pl.col("q1", "q2", "q3") + turns * 2 * np.pi).write_csv(
            tmp_path / "log.csv"
        )
        assert open_log(tmp_path / "log.csv", kinematics).samples == 400


def test_a_wrapped_fourth_axis_goes_on(tmp_path) -> None:
    robot, rng = load_robot("irb360-6-1600"), np.random.default_rng(0)
    kinematics, truth = compiled(robot).kinematics, surrogate_parameters(robot, rng)
    recording = simulated(robot, truth, rng, None, duration=10.0, rate=1000.0)
    whole = _written(recording, tmp_path / "whole.csv")
    q4 = recording["q4"].to_numpy()
    wrapped = np.mod(q4 + np.pi, 2 * np.pi) - np.pi
    rows = np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi) + 3  # header, and rows from 1
    path = _written(recording.with_columns(pl.Series("q4", wrapped)), tmp_path / "wrapped.csv")
    log = open_log(path, kinematics)
    (warning,) = log.warnings
    assert warning.startswith(
        f"column q4 starts again after 6.28319, one turn, in {len(rows)} rows, the first row "
        f"{rows[0]}: taken to go on; likeliest cause: the controller keeps angles within one turn"
    )
    a, b = (
        np.concatenate(list(open_log(source, kinematics).batches())) for source in (whole, path)
    )
    shift = b[0, 4] - a[0, 4]
    assert abs(shift / (2 * np.pi) - round(shift / (2 * np.pi))) < 1e-12
    np.testing.assert_allclose(b[:, 4] - shift, a[:, 4], rtol=0, atol=1e-12)
    # A step of five sixths of a turn is neither motion nor a new round.
    leap = np.where(np.arange(len(q4)) < 700, q4, q4 + np.deg2rad(295) * np.sign(np.diff(q4)[699]))
    path = _written(recording.with_columns(pl.Series("q4", leap)), tmp_path / "leap.csv")
    with pytest.raises(RecordingError, match=r"row 702: column q4 jumps by -?29"):
        open_log(path, kinematics)


def _written(recording: pl.DataFrame, path):
    recording.write_csv(path)
    return path
