"""A person's path in headless Chromium: a recording of motors in German to a verified model and
feed-forward, with no line of YAML written by hand."""

from collections.abc import Iterator
from pathlib import Path

import polars as pl
import pytest

from deltaid.model.model import load
from deltaid.studio.folder import Folder
from deltaid.studio.runs import runs
from foreign_logs import GEAR, TORQUE_CONSTANT, german
from logs import recorded
from studios import Visitor, visited
from visit import VISITS

pytestmark = VISITS
# Rows that the model is fitted to; a proposed fix is judged by rows held out, so not too few.
TURNED, SAMPLES = 2, 4000


@pytest.fixture
def visitor(tmp_path: Path) -> Iterator[Visitor]:
    log = recorded(6000)
    german(tmp_path / "Messung.csv", log[:SAMPLES], turned=TURNED)
    # The motion repeats itself, and without noise its rows would be those of the first recording.
    other = log[SAMPLES:].with_columns(pl.col("tau1", "tau2", "tau3") * 1.001)
    german(tmp_path / "Probe.csv", other, turned=TURNED)
    with visited(tmp_path / "work") as found:
        found.context.set_default_timeout(240_000)
        yield found


def test_a_recording_in_german_becomes_a_verified_model_and_feed_forward(
    visitor: Visitor, tmp_path: Path
) -> None:
    page, work = visitor.page, tmp_path / "work"
    done = ["Robot", "clavel-delta3", "Recording"]

    def drop(name: str) -> None:
        visitor.choose(tmp_path / name)
        done.append(name)

    def fill(label: str, value: float) -> None:
        field = page.get_by_label(label, exact=True)
        field.fill(f"{value:g}")
        field.press("Enter")
        done.append(label)

    page.get_by_role("combobox", name="Robot").fill("clavel")
    page.get_by_role("option", name="clavel-delta3").click()
    visitor.go("Recording")
    # Signals are plotted, and the table is filled in, before anything is mapped.
    drop("Messung.csv")
    page.locator(".js-plotly-plot .main-svg").first.wait_for()
    visitor.see("Still missing, so nothing is saved: torque of drive1: a current in A needs its")
    page.get_by_role("link", name="2 Recording, open").wait_for()
    assert not (work / "mapping.yaml").exists()
    fill("position of drive1: gear", GEAR)
    fill("torque of drive1: gear", GEAR)
    fill("torque of drive1: N m per A", TORQUE_CONSTANT)
    visitor.press("Use these, write mapping.yaml")
    page.get_by_role("link", name="2 Recording, done").wait_for()
    assert len([*done, "Use these"]) <= 8, done
    visitor.see("Kept in mapping.yaml")
    # What is counted the other way is found, and corrected by a click.
    visitor.go("Check")
    visitor.press("Check")
    visitor.see("Something is wrong")
    page.get_by_role("button", name="Show the change to the mapping").first.click()
    visitor.press("Apply")
    visitor.see("have changed since the last check")
    visitor.press("Check")
    page.get_by_text("Something is wrong").wait_for(state="detached")
    # A recording with the same columns takes the same mapping.
    visitor.go("Recording")
    drop("Probe.csv")
    visitor.see("mapping.yaml is the mapping of Messung.csv too.")
    visitor.go("Check")
    visitor.press("Check")
    page.get_by_text("have changed since the last check").wait_for(state="detached")
    visitor.go("Fit")
    visitor.press("Fit")
    visitor.press("See the result")
    # The report is as dark as the page around it.
    report = page.frame_locator("iframe")
    report.locator("html.drawn").wait_for(state="attached")
    page.get_by_role("button", name="Theme: system").click()
    report.locator("html.drawn[data-theme=dark]").wait_for(state="attached")
    visitor.go("Use")
    visitor.press("Feed-forward")
    page.get_by_role("link", name="feed-forward.csv").wait_for()
    page.get_by_role("combobox", name="Form").click()
    page.get_by_role("option", name="C code").click()
    visitor.press("Export")
    page.get_by_role("link", name="clavel_delta3_vectors.csv").wait_for()
    page.get_by_text("README of this folder").click()
    visitor.see("Compile `clavel_delta3.c` with your code")
    made = {run.kind: run for run in reversed(runs(Folder.open(work)))}
    model = load(work / made["fit"].file("model.yaml")).identified
    assert max(model.verification.nrmse) < 0.02
    torques = pl.read_csv(work / made["torque"].file("feed-forward.csv"))
    assert len(torques) == SAMPLES
    assert sorted(path.name for path in work.glob("*.yaml")) == ["mapping.yaml", "studio.yaml"]
