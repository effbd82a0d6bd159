"""The report of an identification: one page that loads nothing, with what the fit found."""

import base64
import gzip
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command import refused
from deltaid.dynamics.dynamics import compiled
from deltaid.identification.identify import Identification, identify
from deltaid.identification.prediction import validate
from deltaid.identification.torque_error import torque_error
from deltaid.model.corrections import Correction
from deltaid.robot.load import load_robot, save_yaml
from deltaid.view.comparison import TorqueComparison, compare
from deltaid.view.corrections import correction_section
from deltaid.view.friction_laws import law
from deltaid.view.html import render
from deltaid.view.model_pages import identification_page, validation_page
from deltaid.view.page import Figure, Table
from deltaid.view.parameters import parameter_section
from html_page import HOSTILE, Document
from logs import recorded, write


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
def comparison(result: Identification) -> TorqueComparison:
    dynamics = compiled(result.model.robot)
    return compare(dynamics, result.model.p, result.recordings[0])


def test_a_page_is_one_file_that_loads_nothing(result: Identification) -> None:
    html = render(identification_page(result))
    document = Document(html)
    assert document.loaded == []
    assert not re.search(r"@import|url\(", html[: html.index("</style>")])
    policies = [a.get("content") or "" for tag, a in document.tags if tag == "meta"]
    assert any(p.startswith("default-src 'none'") and "http" not in p for p in policies)
    packed = [base64.b64decode(s) for s in document.scripts if len(s) > 1e6]
    assert [b"Plotly" in gzip.decompress(script) for script in packed] == [True]
    assert len(html.encode()) < 4e6


def test_names_from_files_stay_text(result: Identification) -> None:
    recording = result.recordings[0]
    verification = validate(result.model, recording.path)
    pages = (identification_page(result, verification), validation_page(verification))
    for page in pages:
        document = Document(render(page))
        assert not [tag for tag, _ in document.tags if tag in ("img", "iframe", "object")]
        assert not [a for _, a in document.tags if any(name.startswith("on") for name in a)]
        assert HOSTILE in document.texts
        assert any("<img src=x onerror=alert(2)>.csv" in text for text in document.texts)


def test_sections(result: Identification) -> None:
    recording = result.recordings[0]
    verification = validate(result.model, recording.path)
    page = identification_page(result, verification)
    titles = [section.title for section in page.sections]
    assert titles == [
        "Torques", "Verification", "Motion", "Parameters", "Friction", "Bodies", "Base parameters",
        "Data and settings",
    ]  # fmt: skip
    assert len(Document(render(page)).headings) == len(titles)
    figures = [sum(isinstance(b, Figure) for b in s.blocks) for s in page.sections]
    assert figures == [4, 3, 1, 1, 1, 1, 2, 0]
    assert sum(isinstance(b, Figure) for b in page.front) == 1


def test_what_was_corrected_stands_first(result: Identification) -> None:
    assert not correction_section(result.model).blocks
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
            reach = 0.5 * (parameter.high - parameter.low)
            ends = [float(end) for end in half.split(" … ")]
            if len(ends) == 1:
                assert ends[0] == pytest.approx(reach, rel=0.25)  # nearly symmetric
            else:
                assert ends == pytest.approx([parameter.low, parameter.high], abs=0.1 * reach)
            assert float(value) == pytest.approx(parameter.value, abs=0.1 * reach)
        elif parameter.determined_by == "prior" and parameter.prior and half.endswith(" %"):
            width = (parameter.high - parameter.prior) / abs(parameter.prior)
            assert float(half.removesuffix(" %")) == pytest.approx(100 * width, rel=0.02)
        elif parameter.determined_by == "prior" and parameter.prior:
            factor = float(half.removeprefix("×÷ "))
            assert factor == pytest.approx(parameter.high / parameter.prior, rel=0.05)
        else:
            assert half == ""
        assert decided == parameter.determined_by


def test_torque_errors_are_drawn(result: Identification, comparison: TorqueComparison) -> None:
    recording = result.recordings[0]
    error = torque_error(compiled(result.model.robot), result.model.p, recording)
    drawn = comparison.measured - comparison.predicted
    np.testing.assert_allclose(np.sqrt(np.mean(drawn**2, axis=0)), error.rms, rtol=0.1)
    np.testing.assert_array_equal(drawn, comparison.residual)
    step = recording.filter.thinned / recording.log.rate
    np.testing.assert_allclose(np.diff(comparison.time), step, rtol=1e-6)
    # Parseval: the spectrum holds the power of what was recorded, but for its slowest part.
    bandwidth = comparison.frequency[1] - comparison.frequency[0]
    power = np.sum(comparison.residual_density**2, axis=0) * bandwidth
    np.testing.assert_allclose(np.sqrt(power), error.rms_unfiltered, rtol=0.2)


def test_friction_curves_are_the_models_laws(result: Identification) -> None:
    v = np.array([-2.0, -0.1, 0.1, 3.0])
    viscous, coulomb = (result.model.value(f"{kind}.drive2") for kind in ("viscous", "coulomb"))
    curve = law(result.model.robot, "drive2", v, result.model.p)
    np.testing.assert_allclose(curve, viscous * v + coulomb * np.sign(v), rtol=1e-12)


def test_a_report_that_cannot_be_written_is_refused_before_any_work(
    folder: Path, tmp_path: Path
) -> None:
    robot, log = folder / "robot.yaml", next(folder.glob("*.csv"))
    for command in (("identify", robot, log), ("validate", robot, log), ("excite", robot)):
        assert ".html" in refused(*command, "--report", tmp_path / "page.pdf", folder=tmp_path)
    page = tmp_path / "log.html"
    page.write_bytes(log.read_bytes())
    assert "overwrite" in refused("identify", robot, page, "--report", page, folder=tmp_path)
