"""`deltaid forces`: worst cases, files and messages."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from command import accepted, json_of, refused, run
from deltaid.identification.sources import model_filtered
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.joint_forces.forces import with_struts
from deltaid.model.record import IdentifiedModel
from deltaid.recording.opening import open_log
from deltaid.recording.planned import motion_of, planned
from identified import identified

SPACING, SPRING = 0.12, 60.0
OPTIONS = ("--strut-spacing", SPACING, "--socket-force", SPRING)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, demonstration: Path) -> Path:
    """A demonstration's robot, recordings of 20 s and model."""
    return shutil.copytree(demonstration, tmp_path_factory.mktemp("forces") / "demo")


def test_worst_cases_are_those_of_all_samples(folder: Path) -> None:
    """Over several windows of the recording, against all of them at once."""
    model, motion = folder / "model.yaml", folder / "verify.csv"
    out = folder / "forces.csv"
    done = accepted("forces", model, motion, *OPTIONS, "-o", out, "--json")
    assert "note:" not in done.err  # the demonstration has verified it
    report = json.loads(done.out)
    rows = pl.read_csv(out)
    identified = with_struts(IdentifiedModel.load(model), SPACING, SPRING)
    forces = ConstraintForces(identified.robot)
    log = open_log(motion, forces.kinematics)
    parts = list(motion_of(model_filtered(identified, log, planned), forces.kinematics))
    assert len(parts) > 2
    values = np.vstack([forces.evaluate(m.z, m.qd, m.qdd, identified.p) for m in parts])
    np.testing.assert_allclose(rows.to_numpy()[:, 1:], values, rtol=1e-12, atol=1e-12)
    assert rows.columns == ["t", *forces.names]
    table = {name: rows[name].to_numpy() for name in rows.columns}
    for case in report["worst"]:
        at = int(np.argmin(np.abs(table["t"] - case["time"])))
        assert table[case["channel"]][at] == pytest.approx(case["value"])
        strut = case["part"]
        if case["kind"] == "tension":
            ends = [table[f"{strut}.{end}.x"].max() for end in ("platform", "elbow")]
            assert case["value"] == pytest.approx(max(ends))
        if case["kind"] == "socket":
            ends = [table[f"{strut}.{end}.out"].min() for end in ("platform", "elbow")]
            assert case["margin"] == pytest.approx(SPRING + min(ends))
        if case["kind"] == "load":
            assert abs(case["value"]) == pytest.approx(np.abs(table[case["channel"]]).max())
    kinds = [case["kind"] for case in report["worst"]]
    assert [kinds.count(kind) for kind in ("tension", "compression", "socket")] == [6, 6, 6]
    for name, extreme in report["extremes"].items():
        assert (extreme["least"], extreme["largest"]) == pytest.approx(
            (table[name].min(), table[name].max())
        )
    assert all(case["low"] is None and case["open"] >= 0 for case in report["worst"])


def test_ranges_and_report(folder: Path) -> None:
    page = folder / "forces.html"
    command = ("forces", folder / "model.yaml", folder / "verify.csv", *OPTIONS)
    with_logs = ("--logs", folder / "identify.csv")
    report = json_of(*command, *with_logs)
    for case in report["worst"]:
        assert case["low"] <= case["value"] <= case["high"]
        assert case["high"] > case["low"]
    done = accepted(*command, *with_logs, "--report", page, width=120)
    for word in ("strut3b", "tension is positive", "margin", "U.m", "… "):
        assert word in done.out
    text = page.read_text(encoding="utf-8")
    assert "strut3b" in text
    assert "Worst cases" in text
    along = [c["value"] for c in report["worst"] if c["kind"] in ("tension", "compression")]
    assert "Good: all ball joints hold, with" in text
    assert f"forces along the struts reach from −{-min(along):#.3g} N" in text
    turn = next(c["z"][3] for c in report["worst"] if c["kind"] == "tension")
    assert f">{np.degrees(turn):.2f}<".replace("-", "−") in text
    run(*command[:-1], 1.0, "--report", page)
    assert "Poor: a ball joint comes apart; forces along" in page.read_text(encoding="utf-8")


def test_without_spacing_it_says_what_is_missing(folder: Path) -> None:
    done = accepted("forces", folder / "model.yaml", folder / "verify.csv")
    assert "strut_spacing" in done.err
    assert "strut1a" not in done.out
    assert "± open" in done.out


def test_what_cannot_be_is_refused(folder: Path) -> None:
    command = ("forces", folder / "model.yaml", folder / "verify.csv")
    assert "--strut-spacing" in refused(*command, "--strut-spacing", -1, folder=folder)
    millimetres = refused(*command, "--strut-spacing", 80, folder=folder)
    assert "--strut-spacing: must lie between" in millimetres
    assert "would overwrite" in refused(*command, "-o", folder / "verify.csv", folder=folder)
    assert "must end in .csv" in refused(*command, "-o", folder / "a.html", folder=folder)
    other = refused(*command, "--logs", folder / "verify.csv", folder=folder)
    assert "is not a recording that the model was identified from" in " ".join(other.split())
    assert "identify.csv" in other
    missing = folder / "no.csv"
    half = (*command, "-o", folder / "half.csv", "--logs", missing)
    assert "no.csv" in refused(*half, folder=folder)
    assert "--logs" in refused(*command, "--log-columns", missing, folder=folder)


def test_what_sensors_showed_is_reported_as_excluded_from_ranges() -> None:
    log, model = identified("plate").log, identified("plate").model_file
    assert "what plate showed" in run("forces", model, log, "--logs", log).err
    assert "what plate showed" not in run("forces", model, log).err
