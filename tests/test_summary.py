"""The verdict in plain words: its grade follows its rules, and it says what it does not know."""

import shutil
from dataclasses import replace
from datetime import date, timedelta
from pathlib import Path

import numpy as np
import pytest

from command import accepted, refused, run
from deltaid.checks.identify import Judged
from deltaid.checks.verdicts import Verdicts
from deltaid.identification.prediction import validate
from deltaid.identification.torque_error import TorqueError
from deltaid.model.corrections import Correction, LeftOut
from deltaid.model.model import load
from deltaid.model.record import IdentifiedModel
from deltaid.model.verdict import Grade, Verdict
from deltaid.view.model_pages import identification_page
from deltaid.view.model_tables import error_table
from deltaid.view.page import Fact, Summary, Table, Trust
from deltaid.view.summary import (
    provenance_section,
    provenance_tables,
    summary,
    without_doubts,
)
from html_page import Document
from identified import identified, simulated
from logs import write


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot, a recording of it, the model that it gives, and a recording of another motion."""
    path, found = tmp_path_factory.mktemp("summary"), identified("clavel-delta3")
    shutil.copytree(found.folder, path, dirs_exist_ok=True)
    write(path / "verify.csv", simulated(found.robot, found.p, seed=1)[:1500])
    return path


@pytest.fixture(scope="module")
def result() -> Judged:
    return identified("clavel-delta3").result


@pytest.fixture(scope="module")
def model(result: Judged) -> IdentifiedModel:
    return result.model


@pytest.fixture(scope="module")
def error(folder: Path, model: IdentifiedModel) -> TorqueError:
    return validate(model, folder / "verify.csv")[0]


def off(error: TorqueError, worst: float) -> TorqueError:
    """The same with the second drive's error as such a share of its torque."""
    shares = np.array([0.01, worst, 0.002])
    return replace(error, nrmse=shares, rms=error.rms * shares / error.nrmse)


@pytest.mark.parametrize(
    ("worst", "grade", "words"),
    [
        (0.012, Trust.GOOD, "Good: predicts torques of an unseen motion within 1.2 %"),
        (0.049, Trust.GOOD, "within 4.9 %"),
        (0.051, Trust.FAIR, "Fair: predicts torques of an unseen motion within 5.1 %"),
        (0.149, Trust.POOR, "within 15 %"),
        (0.3, Trust.POOR, "Poor: predicts torques of an unseen motion only within 30 %"),
        (np.nan, Trust.POOR, "Poor"),
    ],
)
def test_the_worst_drive_decides(
    model: IdentifiedModel, error: TorqueError, worst: float, grade: Trust, words: str
) -> None:
    said = summary(model, off(error, worst))
    assert said.grade is grade
    assert words in said.sentence
    assert "drive2" in said.sentence


def test_fair_reaches_to_its_limit_where_the_fit_was_no_better(
    model: IdentifiedModel, error: TorqueError
) -> None:
    rough = model.changed(fit=model.fit.changed(rms=tuple(off(error, 0.1).rms)))
    assert summary(rough, off(error, 0.149)).grade is Trust.FAIR
    assert summary(rough, off(error, 0.151)).grade is Trust.POOR


def test_without_an_unseen_motion_it_is_never_good(
    folder: Path, model: IdentifiedModel, error: TorqueError
) -> None:
    alone = summary(model)
    assert alone.grade is Trust.UNTESTED
    assert "no unseen motion" in alone.sentence
    own_error, own = validate(model, folder / "log.csv")
    on_its_own = summary(model, own_error, own)
    assert on_its_own.grade is Trust.UNTESTED
    assert "no unseen motion" in on_its_own.sentence
    bad = model.changed(fit=model.fit.changed(nrmse=(0.01, 0.2, 0.01)))
    assert summary(bad).grade is Trust.POOR


def test_doubts_are_reported_by_cause_and_lower_the_grade(
    model: IdentifiedModel, error: TorqueError
) -> None:
    texts = tuple(f"thing {k} is odd; likeliest cause: that; do this" for k in range(5))
    poor = summary(model.changed(warnings=texts), off(error, 0.3))
    assert "only within 30 % (rms; the worst is drive2), and six things" in poor.sentence
    said = summary(model.changed(warnings=texts), off(error, 0.01))
    assert said.grade is Trust.FAIR
    assert "but five things are doubtful" in said.sentence
    doubts = [line for line in said.lines if line.startswith("Doubtful: ")]
    assert doubts[:3] == [f"Doubtful: thing {k} is odd." for k in range(3)]
    assert "two more things" in doubts[3]
    assert not [line for line in without_doubts(said).lines if "odd" in line]


def test_verdicts_weigh_as_they_are_graded(result: Judged, error: TorqueError) -> None:
    def with_verdict(grade: Grade, key: str = "torque-sign", number: float = 0.0) -> Summary:
        verdict = Verdict(key, grade, "seen so", cause="so", cure="wire it", number=number)
        model = Verdicts((verdict,)).noted(result.model.changed(warnings=(verdict.sentence,)))
        return summary(replace(result, model=model), off(error, 0.01))

    assert with_verdict(Grade.CANNOT_TELL).grade is Trust.GOOD
    assert with_verdict(Grade.DOUBTFUL).grade is Trust.FAIR
    assert with_verdict(Grade.DOUBTFUL, "residual", 14.9).grade is Trust.FAIR
    assert with_verdict(Grade.DOUBTFUL, "residual", 15.1).grade is Trust.POOR
    wrong = with_verdict(Grade.WRONG)
    assert wrong.grade is Trust.POOR
    assert wrong.sentence.endswith("; found wrong: torque-sign.")


def test_what_the_checks_say_stands_once_on_the_page(result: Judged) -> None:
    verdict = Verdict("clock", Grade.DOUBTFUL, "rows repeat", cause="lost", cure="log anew")
    model = result.model.changed(warnings=(verdict.sentence, "something else"))
    good = Verdict("rate", Grade.GOOD, "1000 Hz")
    page = identification_page(replace(result, model=model, verdicts=Verdicts((verdict, good))))
    assert page.warnings == ("something else",)
    assert ("doubtful", "clock", "rows repeat", "lost → log anew") in page.front[0].rows
    assert Fact("checks", "1 doubtful", "clock") in page.facts
    assert "two things are doubtful" in page.verdict.sentence


def test_tables_say_which_recording_and_setting_is_meant(
    model: IdentifiedModel, error: TorqueError
) -> None:
    assert "verify rms" in error_table(load(model), error).caption
    assert "verify rms" not in error_table(load(model), None).caption
    tables = [b for b in provenance_section(load(model), "s").blocks if isinstance(b, Table)]
    rows = {row[0]: row[1] for table in tables for row in table.rows}
    assert (rows["keep all"], rows["events"]) == ("no", "yes")


def test_recordings_and_fit_are_listed_with_filter_and_certificate(model: IdentifiedModel) -> None:
    turning = LeftOut(reason="reversal", why="turns", drives=("drive1",), share=0.01)
    filtered = {"cutoff_hz": 12.0, "motion_cutoff_hz": 49.3, "left_out": (turning,)}
    bare = {"cutoff_hz": None, "motion_cutoff_hz": None, "left_out": ()}
    sources = tuple(model.sources[0].changed(**changed) for changed in (filtered, bare))
    table, _ = provenance_tables(model.changed(sources=sources))
    assert [row[4:7] for row in table.rows] == [("12", "49.3", "1.0 %"), ("—", "—", "")]
    for gap, said in {1e-9: "(certified)", 0.3: "(within 30 %)", None: "not convex"}.items():
        exact = gap and gap * model.fit.objective
        fit = model.fit.changed(duality_gap=exact)
        rows = dict(provenance_tables(model.changed(fit=fit))[1].rows)
        assert said in rows["duality gap, J minus its certified bound"]


def test_numbers_and_corrections_are_counted(model: IdentifiedModel, error: TorqueError) -> None:
    kinds = ["data"] * 4 + ["sum", "measured", "limit", "prior", "fixed"]
    shown = [p for p in model.parameters if p.determined_by != "structure"]
    kinds += ["prior"] * (len(shown) - len(kinds))
    new = iter(kinds)
    parameters = tuple(
        p if p.determined_by == "structure" else p.changed(determined_by=next(new))
        for p in model.parameters
    )
    made = ("lag", "drive1"), ("lag", "drive3"), ("gain", "drive2")
    corrections = tuple(
        Correction(kind=kind, subject=subject, text="why") for kind, subject in made
    )
    changed = model.changed(parameters=parameters, corrections=corrections)
    text = " ".join(summary(changed, error).lines)
    assert f"6 of {len(shown)} numbers come from the recording" in text
    assert "(1 of them as sums with others, 1 mostly from what was weighed or measured)" in text
    assert "one is at its bound" in text
    assert (
        "Two corrections were made: lag between torques and positions (drive1, drive3), "
        "torque constant (drive2)." in text
    )


@pytest.mark.parametrize(
    ("case", "rests"), [("clavel-delta3", True), ("weighed", False), ("plate", False)]
)
def test_the_absolute_scale_rests_on_torque_constants_or_is_known(case: str, rests: bool) -> None:
    lines = summary(identified(case).result).lines
    scale_lines = [
        line for line in lines if "torque constants" in line and "absolute scale" in line
    ]
    assert len(scale_lines) == rests


def test_a_robot_at_its_prior_is_not_called_identified(folder: Path) -> None:
    robot = folder / "robot.yaml"
    assert summary(load(robot)).grade is Trust.UNTESTED
    error, log = validate(robot, folder / "verify.csv")
    said = summary(load(robot), error, log)
    assert "the description alone" in said.sentence
    assert "nothing has been identified" in said.lines[0]


def test_terminal_and_page_say_the_same(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    outcome = run("validate", folder / "model.yaml", folder / "verify.csv", "--report", page)
    (line,) = [line for line in outcome.out.splitlines() if line.startswith("Good:")]
    texts = Document(page.read_text("utf-8")).texts
    assert any(text and line.startswith(text) for text in texts if text.startswith("Good:"))
    made = f"deltaid validate {folder / 'model.yaml'} {folder / 'verify.csv'} --report {page}"
    assert made in texts


def test_a_model_keeps_its_verdict(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "model.yaml"
    words = ("identify", folder / "robot.yaml", folder / "log.csv", "-o", file)
    outcome = accepted(*words, "--verify", folder / "verify.csv")
    known = load(file)
    said = summary(known)
    assert said.grade is Trust.GOOD
    assert said.sentence in outcome.out
    assert known.identified.verification.log.endswith("verify.csv")
    assert f"{said.sentence} Verified on" in known.provenance
    day = known.identified.identified_on
    assert abs(date.today() - day) <= timedelta(days=1)
    assert f"Model {known.identified.digest} of {day}, deltaid" in known.provenance
    other = known.identified.changed(identified_on=date(2020, 1, 1))
    assert other.digest == known.identified.digest != other.changed(wrong=("a",)).digest
    own = IdentifiedModel.load(folder / "model.yaml")
    again = validate(own, folder / "log.csv").noted(own)
    assert again.verification is None  # its own recording verifies nothing


def test_what_a_model_is_worth_is_said_where_it_is_used(folder: Path, tmp_path: Path) -> None:
    untested = accepted(
        "torque", folder / "model.yaml", folder / "verify.csv", "-o", tmp_path / "a.csv"
    )
    assert "note: " in untested.err
    assert "Untested: fits torques" in untested.err
    file, target = tmp_path / "poor.yaml", tmp_path / "robot.xml"
    IdentifiedModel.load(folder / "model.yaml").changed(wrong=("torque-sign",)).save(file)
    words = ("export", file, "--to", "mjcf", "-o", target)
    message = refused(*words, folder=tmp_path)
    assert "poor.yaml: Poor: " in message
    assert "found wrong: torque-sign" in message
    assert run(*words, "--force").code == 0
    assert "found wrong: torque-sign. Model " in target.read_text(encoding="utf-8")
    for line in (["excite"], ["sensors"], ["drift", folder / "log.csv"]):
        planned = refused(line[0], file, *line[1:], folder=tmp_path)
        assert "poor.yaml: Poor: " in planned
        assert "go on with --force" in planned
    assert "poor.yaml: Poor: " in run("show", file).err


def test_a_file_that_was_changed_by_hand_says_so(folder: Path, tmp_path: Path) -> None:
    text = (folder / "model.yaml").read_text(encoding="utf-8")
    file = tmp_path / "model.yaml"
    for ending in ("\n", "\r\n"):
        file.write_text(text, encoding="utf-8", newline=ending)
        assert load(file).identified.warnings == load(folder / "model.yaml").identified.warnings
    file.write_text(text.replace("title:", "title:  "), encoding="utf-8")
    (first, *_) = load(file).identified.warnings
    assert "was changed after deltaid wrote it" in first
    used = accepted("torque", file, folder / "verify.csv", "-o", tmp_path / "a.csv")
    assert f"warning: {file.name}: {first}" in used.err
    without = [line for line in text.splitlines() if "sha256:" not in line or line[0] != "#"]
    file.write_text("\n".join(without), encoding="utf-8")
    assert load(file).identified.warnings[0].endswith("its checksum is missing")
