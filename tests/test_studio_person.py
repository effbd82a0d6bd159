"""A person's path in headless Chromium: a recording of motors in German to its mapping, with no
line of YAML written by hand."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from logs import recorded
from studios import GEAR, TORQUE_CONSTANT, Studio, Visitor, german
from visit import CHROMIUM, chromium

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium on the path"),
]
# A drive that counts the other way, and rows of the first recording.
TURNED, SAMPLES = 2, 4000


@pytest.fixture
def visitor(tmp_path: Path) -> Iterator[Visitor]:
    log = recorded(6000)
    german(tmp_path / "Messung.csv", log[:SAMPLES], turned=TURNED)
    german(tmp_path / "Probe.csv", log[SAMPLES:], turned=TURNED)
    with Studio(tmp_path / "work") as studio, chromium() as browser:
        found = Visitor(browser, studio)
        found.context.set_default_timeout(240_000)
        yield found
        assert found.said == []
        assert found.others == []
    assert "Traceback" not in studio.errors()


def test_a_recording_in_german_is_mapped_in_at_most_eight_interactions(
    visitor: Visitor, tmp_path: Path
) -> None:
    page, work, done = visitor.page, tmp_path / "work", list[str]()

    def drop(name: str) -> None:
        with page.expect_file_chooser() as chooser:
            page.get_by_role("button", name="Choose a recording").click()
        chooser.value.set_files(tmp_path / name)
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
    assert len([*done, "Use these"]) <= 8
    visitor.see("Kept in mapping.yaml")
    drop("Probe.csv")
    visitor.see("mapping.yaml is the mapping of Messung.csv too.")
    assert (work / "mapping.yaml").read_text().count("torque_constant: 0.11") == 3
