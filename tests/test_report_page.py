"""Parts of a report's page by themselves: text, tables, figures of a robot and of its torques."""

import json
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.robot.joint_units import TURNING
from deltaid.robot.load import load_robot
from deltaid.robot.shapes import HollowCylinder
from deltaid.view.bodies import ellipsoid
from deltaid.view.comparison import Comparison, compare
from deltaid.view.html import render
from deltaid.view.numbers import percent
from deltaid.view.page import Fact, Figure, Page, Section, Table, Text
from deltaid.view.torques import torque_blocks
from html_page import HOSTILE, Document
from logs import recorded, true_parameters, write
from support import KINDS


def test_hostile_text_in_every_part_of_a_page() -> None:
    figure = go.Figure(go.Scatter(x=[1, 2], y=[1, 2], name=HOSTILE))
    page = Page(
        HOSTILE,
        HOSTILE,
        (Fact(HOSTILE, HOSTILE, HOSTILE),),
        (
            Section(
                HOSTILE,
                (Text(HOSTILE), Table((HOSTILE,), ((HOSTILE,),), HOSTILE), Figure(figure, HOSTILE)),
            ),
        ),
        (HOSTILE,),
    )
    document = Document(render(page))
    assert not [tag for tag, _ in document.tags if tag == "img"]
    # Title twice, subtitle, fact 3, warning, contents, heading, text, column, cell, 2 captions.
    assert document.texts.count(HOSTILE) == 14
    data = [json.loads(s) for s in document.scripts if s.startswith('{"data"')]
    assert [trace["name"] for one in data for trace in one["data"]] == [HOSTILE]


def test_a_long_recording_is_thinned_and_keeps_its_outlier(tmp_path: Path) -> None:
    frame = recorded(50_000, derivatives=True)
    outlier = 31_234
    torque = frame["tau2"].to_numpy().copy()
    torque[outlier] += 30.0
    path = write(tmp_path / "long.parquet", frame.with_columns(pl.Series("tau2", torque)))
    robot = load_robot("clavel-delta3")
    dynamics = compiled(robot)
    c = compare(dynamics, true_parameters(), with_filter(open_log(path, dynamics.kinematics)))
    assert c.stretch == 3
    assert len(c.time) == len(c.residual) == -(-50_000 // 3)
    worst = np.nanargmax(np.abs(c.measured - c.predicted)[:, 1])  # NaN where it does not count
    assert c.time[worst] == pytest.approx(frame["t"][outlier])
    assert np.all(np.diff(c.time) > 0)


@pytest.mark.parametrize("name", KINDS)
def test_skeleton_has_the_robots_lengths(name: str) -> None:
    robot = load_robot(name)
    kinematics = Kinematics(robot)
    skeleton = Skeleton(robot, kinematics.mechanism)
    rng = np.random.default_rng(3)
    centre, half = robot.workspace.inner_box
    z = np.zeros((20, kinematics.dof))
    z[:, :3] = centre + half * rng.uniform(-1, 1, (20, 3))
    z[:, 3:] = rng.uniform(-1, 1, (20, kinematics.dof - 3))
    ends = skeleton.evaluate(z)
    bodies = np.array([segment.body for segment in skeleton.segments])
    lengths = np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2)
    np.testing.assert_allclose(lengths[:, bodies == "S"], robot.limbs.strut, rtol=1e-12)
    assert (bodies == "S").sum() == robot.limbs.count * robot.limbs.struts_per_limb
    if robot.limbs.drive == "rotary":
        arms = np.isclose(lengths[:, bodies == "U"], robot.limbs.upper_arm, rtol=1e-12)
        assert np.all(arms.sum(axis=1) == robot.limbs.count)
    platform = ends[:, bodies == robot.platform.bodies[0]].mean(axis=(1, 2))
    np.testing.assert_allclose(platform, z[:, :3], atol=1e-12)
    assert np.ptp(ends[:, bodies == "base"], axis=0).max() < 1e-12


def test_ellipsoid_of_a_cylinder_has_its_mass_centre_and_moments() -> None:
    length, radius, at = 0.6, 0.1, (0.3, -0.1, 0.5)
    rod = HollowCylinder(
        shape="hollow_cylinder", axis="y", length=length, outer_radius=radius, centre=at, mass=2.0
    )
    centre, A = ellipsoid(rod.parameters())
    np.testing.assert_allclose(centre, at, atol=1e-12)
    # Second moments: of the rod m L²/12 along and m R²/4 across, of an ellipsoid m h²/5.
    halves = [np.sqrt(5 / 4) * radius, np.sqrt(5 / 4) * radius, np.sqrt(5 / 12) * length]
    np.testing.assert_allclose(np.linalg.norm(A, axis=0), halves, rtol=1e-9)
    np.testing.assert_allclose(np.abs(A[:, 2]), [0, halves[2], 0], atol=1e-9)


def test_a_drive_at_rest_and_times_since_1970() -> None:
    n, rng = 500, np.random.default_rng(2)
    time = 1.7e9 + 0.001 * np.arange(n)
    torque = rng.normal(size=(n, 2))
    frequency = np.arange(1.0, 20.0)
    c = Comparison(
        time=time,
        measured=torque,
        predicted=np.zeros((n, 2)),
        stretch=1,
        speed=np.column_stack([np.zeros(n), rng.normal(size=n)]),
        residual=torque,
        frequency=frequency,
        measured_density=np.ones((19, 2)),
        residual_density=np.ones((19, 2)),
        cutoff=None,
        events=np.array([[time[10], time[20]], [time[40], time[45]]]),
    )
    blocks = torque_blocks(c, {"drive1": TURNING, "drive2": TURNING})
    np.testing.assert_array_equal(blocks[0].figure.data[0].x, time)
    assert blocks[0].figure.data[0].y.dtype == np.float32
    (marks, _) = (one for one in blocks[0].figure.data if one.name == "left out: events")
    np.testing.assert_array_equal(marks.x[[0, 1, 3, 4]], time[[10, 20, 40, 45]])
    assert len(render(Page("t", "", (), (Section("s", blocks),)))) > 1.9e6


def test_shares_have_no_powers_of_ten_where_people_would_not_write_any() -> None:
    shares = (0.00123, 0.0712, 0.99, 0.996, 1.94, 35.0, 1e6, -1.5)
    shown = ("0.12 %", "7.1 %", "99 %", "100 %", "194 %", "3500 %", "1e+08 %", "-150 %")
    assert tuple(percent(share) for share in shares) == shown


def test_numbers_are_typeset_and_names_are_not() -> None:
    cells = ("-1.2e-05", "-0.3 … 1.5e+07", "≥ 3", "log-2.csv", "9e-1f")
    html = render(Page("t", "", (), (Section("s", (Table(("a",), tuple((c,) for c in cells)),)),)))
    texts = Document(html).texts
    for text in ("−1.2·10⁻⁵", "−0.3 … 1.5·10⁷", "≥ 3", "log-2.csv", "9e-1f"):
        assert text in texts
