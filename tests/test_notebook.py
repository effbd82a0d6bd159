"""What values say of themselves at a prompt and in a notebook: short, safe, and of use."""

import re
from datetime import datetime
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
import polars as pl
import pytest

import deltaid
from deltaid.fleets.fleet import Recorded
from deltaid.fleets.gather_plan import GatherResult
from deltaid.model.verdict import Grade
from deltaid.sensors.planning.offers import shipped_offers
from deltaid.view.show import _KINDS, Card
from html_page import HOSTILE, Document
from identified import identified, simulated
from logs import recorded

NAME = "clavel-delta3"
PRINTER = Path(__file__).parents[1] / "examples" / "printer"
Z = np.array([0.05, 0.02, -0.95])
GATHERED = GatherResult(Recorded("R1", datetime(2026, 1, 5), "monday.csv", NAME), "key")
SHORT, LINES, WIDE = 600, 10, 110


@pytest.fixture(scope="module")
def result():
    return identified(NAME).result


@pytest.fixture(scope="module")
def motion() -> deltaid.Excitation:
    settings = deltaid.ExcitationSettings(harmonics=3, duration=4.0, starts=1)
    return deltaid.Exciter(NAME, settings).optimise(progress=False)


@pytest.fixture(scope="module")
def values(result, motion) -> dict[str, object]:
    """One of every kind that `import deltaid` leads to."""
    wrong = recorded(3000).with_columns(tau2=-pl.col("tau2"))
    log, dynamics = recorded(1200), deltaid.Dynamics(NAME)
    unseen = simulated(dynamics.robot, identified(NAME).p, seed=1)[:1200]
    still, frictionless = np.zeros(3), deltaid.load(NAME).without_friction().p
    return {
        "a description": deltaid.load_robot(NAME),
        "a prior": deltaid.load(NAME),
        "a model": deltaid.load(result),
        "a model's record": result.model,
        "an identification": result,
        "kinematics": deltaid.Kinematics(NAME),
        "dynamics": dynamics,
        "forward dynamics": deltaid.ForwardDynamics(NAME),
        "forces": deltaid.ConstraintForces(NAME),
        "a recording": deltaid.Recording.from_table(log),
        "a surveyed recording": result.recordings[0],
        "a log": result.recordings[0].log,
        "a mapping": deltaid.ColumnMapping(position={"column": "q", "unit": "deg"}),
        "a fleet": deltaid.FleetRun((GATHERED,), (), (), (), ()),
        "checks": deltaid.check(NAME, wrong, progress=False),
        "a check": result.verdicts[0],
        "a comparison": deltaid.validate(result, unseen),
        "drawn models": result.model.sample(20, progress=False),
        "an exciter": motion.exciter,
        "an optimised motion": motion,
        "a run": motion.run,
        "a periodic motion": motion.run.motion,
        "a plan": deltaid.sensor_plan(NAME, progress=False),
        "offers": shipped_offers(),
        "a geometry": deltaid.calibrate("anycubic-kossel", probe=PRINTER / "gauge.csv",
                                        columns=PRINTER / "columns.yaml"),
        "forces along a motion": deltaid.forces(NAME, log, progress=False),
        "feed-forward": deltaid.torque(NAME, log, progress=False),
        "a simulation": deltaid.simulate(NAME, motion.run, progress=False),
        "controllers": deltaid.compare_controllers(
            result, motion.run, plant=NAME, progress=False
        ),
        "poses": dynamics.kinematics.poses(Z)[0],
        "terms": dynamics.terms(dynamics.kinematics.inverse(Z), still),
        "regularity": dynamics.kinematics.regularity(Z),
        "torque errors": deltaid.validate(result, unseen).error,
        "base parameters": result.base,
        "a path": deltaid.integrate(
            deltaid.ForwardDynamics(NAME), frictionless, Z[None], 0 * Z[None], np.arange(9.0) / 100
        ),
    }  # fmt: skip


@pytest.mark.slow
def test_every_kind_is_inspected(values: dict[str, object]) -> None:
    seen = {
        f"{kind.__module__.removeprefix('deltaid.')}.{kind.__qualname__}"
        for value in values.values()
        for kind in type(value).__mro__
    }
    assert set(_KINDS) <= seen


def test_a_prompt_shows_a_few_lines(values: dict[str, object]) -> None:
    for what, value in values.items():
        said = repr(value)
        assert 20 < len(said) <= SHORT, f"{what}: {len(said)} characters\n{said}"
        assert len(said.splitlines()) <= LINES, what
        assert max(map(len, said.splitlines())) <= WIDE, what
        assert " object at 0x" not in said, what


def test_much_to_say_is_cut_and_what_to_do_next_stays() -> None:
    lines = ("word " * 200, *(f"line {k}" for k in range(30)))
    said = Card("Title", lines, "", (("n", "1"),) * 50, methods=(".plot()",)).text()
    assert len(said.splitlines()) <= LINES
    assert len(said) <= 2 * SHORT
    assert said.splitlines()[-2:] == ["  …", "→ .plot()"]


def test_they_say_what_matters(values: dict[str, object]) -> None:
    assert "3-DOF Delta" in repr(values["a description"])
    assert "bodies U, S, P" in repr(values["kinematics"])
    for what in ("a model", "an identification"):
        assert "Untested: fits torques of its own recording" in repr(values[what])
        assert re.search(r"\d+ of \d+ numbers come from the recording", repr(values[what]))
    assert "Nothing has been identified".lower() in repr(values["a prior"]).lower()
    assert "wrong, torque-sign: the torque of drive2" in repr(values["checks"])
    assert "Good: predicts torques of an unseen motion within" in repr(values["a comparison"])
    assert "samples 1200" in repr(values["a recording"])
    assert "rate 1000 Hz" in repr(values["a recording"])
    assert "duration" in repr(values["an optimised motion"])
    assert "position q [deg]" in repr(values["a mapping"])
    assert "array of shape (9, 1, 3)" in repr(values["a path"])
    assert re.search(r"[1-9]\d* of 1200 rows have torques", repr(values["feed-forward"]))


def test_methods_that_are_named_are_there(values: dict[str, object]) -> None:
    for what, value in values.items():
        last = repr(value).splitlines()[-1]
        for name in re.findall(r"(?<!\w)\.([a-z_]+)", last) if last.startswith("→") else ():
            assert hasattr(value, name), f"{what} has no {name}"
            assert name in dir(value), f"{what}: {name} is not completed"


def test_names_that_are_completed_are_our_own(values: dict[str, object]) -> None:
    for what, value in values.items():
        names = dir(value)
        assert names, what
        strange = [
            n for n in names if n.startswith(("_", "model_")) or n in ("json", "dict", "copy")
        ]
        assert not strange, f"{what}: {strange}"
        assert all(hasattr(value, name) for name in names), what
    assert {"body", "dynamics", "p", "plot", "robot", "sample"} <= set(dir(values["a model"]))
    assert dir(deltaid) == sorted([*deltaid.__all__, "__version__"])
    assert {"method", "lag"} <= set(dir(deltaid.Settings()))
    assert "model_dump" not in dir(deltaid.Settings())


def test_a_notebook_shows_a_card(values: dict[str, object]) -> None:
    for what, value in values.items():
        page = value._repr_html_()
        document = Document(page)
        assert not document.scripts, what
        assert {tag for tag, _ in document.tags} <= {
            "div", "strong", "span", "table", "tr", "th", "td", "details", "summary",
        }, what  # fmt: skip
        words = " ".join(document.texts)
        assert repr(value).splitlines()[0][:40] in words, what
        assert len(page) < 60_000, what
        assert page.count("<div") == page.count("</div>"), what
        assert page.count("<tr") == page.count("</tr>"), what
    wrong = values["checks"]._repr_html_()
    assert re.search(r'background:#b42318[^>]*">wrong</span>', wrong)


def test_verdicts_are_reported_the_worst_first() -> None:
    grades = (Grade.DOUBTFUL, Grade.GOOD, Grade.WRONG, Grade.CANNOT_TELL)
    found = deltaid.Verdicts(
        deltaid.Verdict(f"key{k}", grade, "seen", cause="cause", cure="cure")
        for k, grade in enumerate(grades)
    )
    assert found.grade == "wrong"
    assert found.poor[0].key == "key2"
    assert {verdict.key for verdict in found.poor} == {"key0", "key2", "key3"}
    assert repr(found).index("key2") < repr(found).index("key0")
    assert "key1" not in repr(found)


def test_names_cannot_become_markup(result) -> None:
    robot = deltaid.load_robot(NAME).changed(title=HOSTILE)
    log = recorded(1200).rename({"tau3": HOSTILE})
    shown = [
        robot,
        deltaid.load(robot),
        deltaid.Dynamics(robot),
        deltaid.Recording.from_table(log, name=HOSTILE.replace("/", "")),
        deltaid.check(robot),
        result.model.changed(robot=result.model.robot.changed(title=HOSTILE), warnings=(HOSTILE,)),
        deltaid.ColumnMapping(position={"column": HOSTILE, "unit": "rad"}),
    ]
    for value in shown:
        document = Document(value._repr_html_())
        assert not document.scripts
        assert "img" not in {tag for tag, _ in document.tags}
        assert "onerror=alert(1)" in " ".join(document.texts)
    names = [curve.name for curve in deltaid.Recording.from_table(log).plot().data]
    assert names[-1].startswith("&lt;/script&gt;")
    assert "\x1b" not in repr(deltaid.load_robot(NAME).changed(title="red \x1b[31m"))


def test_figures(values: dict[str, object]) -> None:
    drawn = {type(value): what for what, value in values.items() if hasattr(value, "plot")}
    assert len(drawn) >= 12
    drawn = [what for what in drawn.values() if "dynamics" not in what]  # those of the robot
    for what in drawn:
        figure = values[what].plot()
        assert isinstance(figure, go.Figure), what
        assert figure.data, what
        assert figure.layout.template.layout.paper_bgcolor == "rgba(0,0,0,0)", what
    names = {curve.name for curve in values["an identification"].plot().data}
    assert {"measured", "predicted", "residual"} <= names
    assert [c.name for c in values["a recording"].plot().data] == recorded(1).columns[1:]


def test_a_long_recording_is_drawn_with_its_spikes() -> None:
    tau = np.zeros(100_001)
    tau[54_321] = 7.0
    recording = deltaid.Recording.from_table({"t": np.arange(len(tau)) / 1000, "tau1": tau})
    (curve,) = recording.plot().data
    assert len(curve.x) < 5000
    assert np.max(curve.y) == 7.0
    assert curve.x[np.argmax(curve.y)] == pytest.approx(54.3, abs=0.1)


def test_tables(values: dict[str, object], result) -> None:
    tables = {what: v for what, v in values.items() if hasattr(v, "to_frame")}
    assert len(tables) >= 9
    for what, value in tables.items():
        frame = value.to_frame()
        assert isinstance(frame, pl.DataFrame), what
        assert len(frame), what
        other = value.to_frame("pandas")
        assert type(other).__module__.startswith("pandas"), what
        assert list(other.columns) == frame.columns, what
        assert len(other) == len(frame), what
    frame = tables["a model"].to_frame()
    assert frame["name"].to_list() == list(result.model.layout.names)
    np.testing.assert_array_equal(frame["value"], result.model.p)
    np.testing.assert_array_equal(tables["a model"].to_frame("pandas")["value"], result.model.p)
    assert tables["a recording"].to_frame().equals(recorded(1200))
    assert tables["checks"].to_frame().filter(grade="wrong")["key"].to_list() == ["torque-sign"]


def test_a_table_needs_its_library(result, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(deltaid.DeltaidError, match="there are no tables of 'dask'"):
        result.to_frame("dask")
    monkeypatch.setattr("deltaid.view.show.find_spec", lambda _: None)
    with pytest.raises(deltaid.DeltaidError, match="pandas is not installed"):
        result.to_frame("pandas")


def test_pages(values: dict[str, object], tmp_path: Path) -> None:
    words = {"checks": "torque-sign", "a model": "viscous.drive1", "a comparison": "drive3"}
    for what, word in words.items():
        path = values[what].report(tmp_path / "x.html")
        assert path == tmp_path / "x.html"
        text = path.read_text(encoding="utf-8")
        assert word in text, what
        assert "Content-Security-Policy" in text, what
    result, proof = values["an identification"], values["a comparison"]
    proved = result.report(str(tmp_path / "proved.html"), proof).read_text(encoding="utf-8")
    assert "Good: predicts torques of an unseen motion" in proved
    with pytest.raises(deltaid.DeltaidError, match=r"must end in \.html"):
        result.report(tmp_path / "x.pdf")
    assert not (tmp_path / "x.pdf").exists()


def test_a_card_says_each_doubt_once() -> None:
    model = identified("clavel-delta3").result.model
    warnings = ("the plate is loose", "the clock is slow")
    doubtful = model.model_copy(update={"warnings": warnings})
    words = " ".join(Document(doubtful._repr_html_()).texts)
    assert words.count("the plate is loose") == 1
    assert words.count("the clock is slow") == 1
