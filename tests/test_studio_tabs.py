"""The studio in headless Chromium when files change, tabs are two, and what is dropped is odd."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from deltaid.robot.load import catalogue_text
from foreign_logs import foreign
from logs import recorded
from studios import Visitor, visited
from visit import VISITS

pytestmark = VISITS


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot, and recordings of other programs beside it."""
    place = tmp_path_factory.mktemp("tabs")
    folder = place / "work"
    folder.mkdir()
    (folder / "robot.yaml").write_text(catalogue_text("clavel-delta3"))
    (folder / "studio.yaml").write_text("robot: robot.yaml\n")
    foreign(place / "axes.csv", recorded(800))
    other = foreign(place / "other.csv", recorded(600))
    other.write_text(other.read_text().replace("Axis", "Motor"))
    return folder


@pytest.fixture(scope="module")
def visitor(work: Path) -> Iterator[Visitor]:
    with visited(work) as found:
        yield found


def test_what_is_written_survives_a_reload_and_another_program(
    visitor: Visitor, work: Path
) -> None:
    page = visitor.page
    page.goto(f"{visitor.studio.base}/robot")
    visitor.see("Describe it: robot.yaml")
    page.locator(".cm-content").click()
    page.keyboard.press("Control+Home")
    page.keyboard.type("# mine\n")
    visitor.see("Valid; not saved yet.")
    page.reload()
    page.locator(".cm-content").get_by_text("# mine").wait_for()
    # Another program changes the file: what was written stays, and is asked about.
    text = (work / "robot.yaml").read_text()
    (work / "robot.yaml").write_text("# theirs\n" + text)
    visitor.see("has been changed meanwhile")
    page.locator(".cm-content").get_by_text("# mine").wait_for()
    visitor.press("Take the file as it is")
    page.locator(".cm-content").get_by_text("# theirs").wait_for()
    assert (work / "robot.yaml").read_text() == "# theirs\n" + text


def test_the_robot_goes_where_keys_ask_it_to(visitor: Visitor) -> None:
    page = visitor.page
    page.get_by_text("use of the limits").wait_for()
    status = page.locator(".live").get_by_role("status")
    before = status.inner_text()
    page.locator(".live .q-slider__track-container").last.focus()
    for _ in range(6):
        page.keyboard.press("ArrowUp")
    page.wait_for_function("b => document.querySelector('.live [role=status]').innerText !== b",
                           arg=before)  # fmt: skip
    visitor.press("Home")
    page.wait_for_function("b => document.querySelector('.live [role=status]').innerText === b",
                           arg=before)  # fmt: skip


def test_a_file_that_is_chosen_while_the_page_is_redrawn_is_taken(
    visitor: Visitor, work: Path
) -> None:
    """As by a check that ends meanwhile; and the same file is taken again after it was removed."""
    page = visitor.page
    visitor.go("Recording")
    with page.expect_file_chooser() as chooser:
        page.get_by_role("button", name="Choose a recording").click()
    (work / "later.csv").write_text("t,q1\n0,1\n1,2\n")
    page.get_by_role("button", name="Use later.csv").wait_for()
    chooser.value.set_files(work.parent / "axes.csv")
    for _ in range(2):
        visitor.see("axes.csv: which column is what")
        page.get_by_role("button", name="Forget axes.csv").click()
        page.get_by_role("button", name="Use axes.csv").wait_for()
        (work / "axes.csv").unlink()
        page.get_by_role("button", name="Use axes.csv").wait_for(state="detached")
        visitor.choose(work.parent / "axes.csv")
    visitor.see("axes.csv: which column is what")
    page.get_by_role("button", name="Forget axes.csv").click()
    for name in ("axes.csv", "later.csv"):
        (work / name).unlink()
        page.get_by_role("button", name=f"Use {name}").wait_for(state="detached")


def test_what_is_no_recording_is_refused_and_names_stay_inside(
    visitor: Visitor, work: Path
) -> None:
    page = visitor.page
    visitor.go("Recording")
    (work.parent / "picture.csv").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(range(256)))
    visitor.choose(work.parent / "picture.csv")
    page.get_by_role("alert").get_by_text("picture.csv: holds no column of numbers").wait_for()
    field = page.locator("input[type=file]")
    data = {"name": "../../up.csv", "mimeType": "text/csv", "buffer": b"t,q1\n0,1\n1,2\n"}
    field.set_input_files([data])
    visitor.see("up.csv: which column is what")
    assert sorted(path.name for path in work.iterdir() if path.is_file()) == [
        "robot.yaml", "studio.yaml", "up.csv",
    ]  # fmt: skip
    page.get_by_role("button", name="Forget up.csv").click()
    page.get_by_role("button", name="Use up.csv").wait_for()


def test_each_recording_gets_the_mapping_that_it_needs(visitor: Visitor, work: Path) -> None:
    page = visitor.page
    visitor.choose(work.parent / "axes.csv")
    visitor.press("Use these, write mapping.yaml")
    visitor.see("Kept in mapping.yaml")
    visitor.choose(work.parent / "other.csv")
    visitor.see("other.csv: which column is what")
    visitor.press("Use these, write mapping-other.yaml")
    visitor.see("Kept in mapping-other.yaml")
    assert "Motor2.ActPos" in (work / "mapping-other.yaml").read_text()
    # Its column is taken away: nothing is written, also after a reload, and the check says what.
    before = (work / "mapping-other.yaml").read_text()
    clear = page.locator(".q-select", has=page.get_by_label("position of drive1: column")).last
    clear.get_by_role("button").first.click()
    visitor.see("position of drive1: choose its column")
    page.reload()
    visitor.see("position of drive1: choose its column")
    assert (work / "mapping-other.yaml").read_text() == before


def test_a_file_that_vanishes_is_said_in_every_tab(visitor: Visitor, work: Path) -> None:
    page, other = visitor.page, visitor.tab(f"{visitor.studio.base}/check")
    (work / "axes.csv").unlink()
    visitor.see("axes.csv is no longer in the folder")
    visitor.see("axes.csv: no longer in the folder", other)
    assert other.get_by_role("button", name="Check", exact=True).is_disabled()
    page.get_by_role("button", name="Forget axes.csv").click()
    visitor.see("Of robot.yaml with other.csv", other)
    other.close()
