"""The HTML report: everything in one file, nothing from outside, numbers that are the model's."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import polars as pl
import pytest

from command import refused, run
from deltaid.dynamics.dynamics import compiled
from deltaid.identification.identify import Identification, identify
from deltaid.identification.torque_error import torque_error
from deltaid.identification.validation import validate
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.model.corrections import Correction
from deltaid.model.record import Settings
from deltaid.recording.opening import open_log
from deltaid.recording.recording import with_filter
from deltaid.report.bodies import ellipsoid
from deltaid.report.comparison import Comparison, compare
from deltaid.report.friction import law
from deltaid.report.identification import Verification, identification_page
from deltaid.report.numbers import percent
from deltaid.report.page import Fact, Figure, Page, Section, Table, Text, render
from deltaid.report.parameters import parameter_section
from deltaid.report.put_right_section import put_right_sections
from deltaid.report.torques import torque_blocks
from deltaid.report.validation import validation_page
from deltaid.robot.joint_units import TURNING
from deltaid.robot.load import catalogue, load_robot, save_yaml
from deltaid.robot.shapes import HollowCylinder
from logs import recorded, write

HOSTILE = "</script><img src=x onerror=alert(1)>&amp;"


class Document(HTMLParser):
    """Tags with their attributes, contents of scripts, and all other text."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.texts: list[str] = []
        self._inside = ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._inside = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside == "script":
            self.scripts[-1] += data
        elif self._inside != "style":
            self.texts.append(data)

    @property
    def headings(self) -> list[str]:
        """Entries of the contents list."""
        links = [a.get("href") or "" for tag, a in self.tags if tag == "a"]
        return [link for link in links if link.startswith("#section")]

    @property
    def loaded(self) -> list[str]:
        """Everything that a browser would fetch."""
        names = ("src", "srcset", "data", "poster", "action", "background", "xlink:href")
        found = [a[name] for _, a in self.tags for name in names if a.get(name)]
        found += [a["href"] for tag, a in self.tags if tag != "a" and a.get("href")]
        return [str(link) for link in found if not str(link).startswith("data:")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording with a hostile name, of a robot with a hostile name and title."""
    path = tmp_path_factory.mktemp("report")
    robot = load_robot("clavel-delta3").model_copy(update={"name": HOSTILE, "title": HOSTILE})
    save_yaml(robot, path / "robot.yaml")
    write(path / "<img src=x onerror=alert(2)>.csv", recorded(3000))
    return path


@pytest.fixture(scope="module")
def result(folder: Path) -> Identification:
    return identify(load_robot(folder / "robot.yaml"), sorted(folder.glob("*.csv")))


@pytest.fixture(scope="module")
def comparison(result: Identification) -> Comparison:
    dynamics = compiled(result.model.robot)
    return compare(dynamics, result.model.p, result.recordings[0])


def test_a_page_is_one_file_that_loads_nothing(result: Identification) -> None:
    html = render(identification_page(result))
    document = Document(html)
    assert document.loaded == []
    assert not re.search(r"@import|url\(", html[: html.index("</style>")])
    policies = [a.get("content") or "" for tag, a in document.tags if tag == "meta"]
    assert any(p.startswith("default-src 'none'") and "http" not in p for p in policies)
    assert sum("Plotly" in s and len(s) > 1e6 for s in document.scripts) == 1
    assert len(html.encode()) < 6e6


def test_names_from_files_stay_text(result: Identification) -> None:
    recording = result.recordings[0]
    error, _ = validate(result.model, recording.path)
    pages = (
        identification_page(result, Verification(recording, error)),
        validation_page(result.model, recording, error),
    )
    for page in pages:
        document = Document(render(page))
        assert not [tag for tag, _ in document.tags if tag in ("img", "iframe", "object")]
        assert not [a for _, a in document.tags if any(name.startswith("on") for name in a)]
        assert HOSTILE in document.texts
        assert any("<img src=x onerror=alert(2)>.csv" in text for text in document.texts)


def test_hostile_text_in_every_part_of_a_page() -> None:
    figure = go.Figure(go.Scatter(x=[1, 2], y=[1, 2], name=HOSTILE))
    page = Page(
        HOSTILE,
        HOSTILE,
        (Fact(HOSTILE, HOSTILE, HOSTILE),),
        (
            Section(
                HOSTILE,
                (
                    Text(HOSTILE),
                    Table((HOSTILE,), ((HOSTILE,),), HOSTILE),
                    Figure(figure, HOSTILE),
                ),
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


def test_sections(result: Identification) -> None:
    recording = result.recordings[0]
    error, _ = validate(result.model, recording.path)
    page = identification_page(result, Verification(recording, error))
    titles = [section.title for section in page.sections]
    assert titles == [
        "Torques", "Verification", "Motion", "Parameters", "Friction", "Bodies", "Base parameters",
        "Data and settings",
    ]  # fmt: skip
    assert len(Document(render(page)).headings) == len(titles)
    figures = [sum(isinstance(b, Figure) for b in s.blocks) for s in page.sections]
    assert figures == [4, 4, 1, 1, 1, 1, 2, 0]


def test_what_was_put_right_stands_first(result: Identification) -> None:
    assert not put_right_sections(result.model)
    alike = [
        Correction(
            kind="lag", subject=drive, value=2e-3, low=1.7e-3, high=2.3e-3, unit="s", text="late"
        )
        for drive in ("drive1", "drive2")
    ]
    other = Correction(kind="temperature", value=5.9, unit="s", text="warm")
    changed = replace(result, model=result.model.changed(corrections=(*alike, other)))
    first = identification_page(changed).sections[0]
    assert first.title == "Corrections"
    (table,) = first.blocks
    assert isinstance(table, Table)
    assert table.rows == (
        ("lag", "drive1, drive2", "2.00 ± 0.30 ms", "late"),
        ("temperature", "all", "5.9 s", "warm"),
    )


def test_only_the_data_gives_intervals(result: Identification) -> None:
    tables = [b for b in parameter_section(result.model).blocks if isinstance(b, Table)]
    rows = {row[0]: row for row in tables[0].rows}
    shown = [p for p in result.model.parameters if p.determined_by != "structure"]
    assert list(rows) == [p.name for p in shown]
    assert {p.determined_by for p in shown} >= {"data", "prior"}
    for parameter in shown:
        _, _, value, half, unit, decided = rows[parameter.name]
        assert unit == parameter.unit
        if parameter.determined_by in ("data", "sum", "limit"):
            assert parameter.high is not None
            assert parameter.low is not None
            reach = 0.5 * (parameter.high - parameter.low)
            ends = [float(end) for end in half.split(" … ")]
            if len(ends) == 1:
                assert ends[0] == pytest.approx(reach, rel=0.25)  # nearly symmetric
            else:
                assert ends == pytest.approx([parameter.low, parameter.high], abs=0.1 * reach)
            assert float(value) == pytest.approx(parameter.value, abs=0.1 * reach)
            assert decided.startswith(("data", "at the limit"))
        else:
            assert half == ""
            assert decided.startswith(("prior", "fixed", "consistency"))


def test_what_is_drawn_is_the_torque_error(result: Identification, comparison: Comparison) -> None:
    recording = result.recordings[0]
    error = torque_error(compiled(result.model.robot), result.model.p, recording)
    drawn = comparison.measured - comparison.predicted
    np.testing.assert_allclose(np.sqrt(np.mean(drawn**2, axis=0)), error.rms, rtol=0.1)
    np.testing.assert_array_equal(drawn, comparison.residual)
    step = recording.thinned / recording.log.rate
    np.testing.assert_allclose(np.diff(comparison.time), step, rtol=1e-6)
    # Parseval: the spectrum holds the power of what was recorded, but for its slowest part.
    bandwidth = comparison.frequency[1] - comparison.frequency[0]
    power = np.sum(comparison.residual_density**2, axis=0) * bandwidth
    np.testing.assert_allclose(np.sqrt(power), error.rms_unfiltered, rtol=0.2)


def test_a_long_recording_is_thinned_and_keeps_its_outlier(tmp_path: Path) -> None:
    frame = recorded(50_000, derivatives=True)
    outlier = 31_234
    torque = frame["tau2"].to_numpy().copy()
    torque[outlier] += 30.0
    path = write(tmp_path / "long.parquet", frame.with_columns(pl.Series("tau2", torque)))
    robot = load_robot("clavel-delta3")
    dynamics = compiled(robot)
    only = Settings(friction="described", events=False, lag="none")
    p = identify(robot, [path], settings=only).model.p
    c = compare(dynamics, p, with_filter(open_log(path, dynamics.kinematics)))
    assert c.stretch == 3
    assert len(c.time) == len(c.residual) == -(-50_000 // 3)
    worst = np.argmax(np.abs(c.measured - c.predicted)[:, 1])
    assert c.time[worst] == pytest.approx(frame["t"][outlier])
    assert np.all(np.diff(c.time) > 0)


@pytest.mark.parametrize("name", catalogue())
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
    assert len(render(Page("t", "", (), (Section("s", blocks),)))) > 4e6


def test_friction_curves_are_the_models_laws(result: Identification) -> None:
    v = np.array([-2.0, -0.1, 0.1, 3.0])
    viscous, coulomb = (result.model.value(f"{kind}.drive2") for kind in ("viscous", "coulomb"))
    curve = law(result.model.robot, "drive2", v, result.model.p)
    np.testing.assert_allclose(curve, viscous * v + coulomb * np.sign(v), rtol=1e-12)


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


def test_commands_write_the_report(folder: Path, tmp_path: Path) -> None:
    robot, log = folder / "robot.yaml", next(folder.glob("*.csv"))
    model, page = tmp_path / "model.yaml", tmp_path / "page.html"
    outcome = run("identify", robot, log, "-o", model, "--verify", log, "--report", page)
    assert outcome.code == 0
    assert f"wrote {page}" in outcome.out
    assert "Verification" in Document(page.read_text("utf-8")).texts
    outcome = run("validate", model, log, "--report", page, "--json")
    assert json.loads(outcome.out)["rms"]
    assert "The model" in Document(page.read_text("utf-8")).texts
    outcome = run("excite", "clavel-delta3", "--starts", 1, "--duration", 3, "--report", page)
    assert f"wrote {page}" in outcome.out
    texts = Document(page.read_text("utf-8")).texts
    assert {"Motion", "Limits", "What it will tell", "Search"} <= set(texts)


def test_a_report_that_cannot_be_written_is_refused_before_any_work(
    folder: Path, tmp_path: Path
) -> None:
    robot, log = folder / "robot.yaml", next(folder.glob("*.csv"))
    for report, complaint in (
        (tmp_path / "page.pdf", ".html"),
        (robot / "page.html", "robot.yaml is a file, not a folder"),
        (f"{tmp_path}/none/", "is a folder"),
    ):
        for command in (("identify", robot, log), ("excite", "clavel-delta3")):
            assert complaint in refused(*command, "--report", report, folder=tmp_path)
    assert ".html" in refused("validate", robot, log, "--report", "r.txt", folder=tmp_path)
    page = tmp_path / "log.html"
    page.write_bytes(log.read_bytes())
    assert "overwrite" in refused("identify", robot, page, "--report", page, folder=tmp_path)
