"""Progress: told to a function, shown where someone watches, silent elsewhere."""

import io
import re
import sys
import time
from types import SimpleNamespace

import pytest

import deltaid
from deltaid import progress
from deltaid.progress import share_of, watched
from logs import recorded

NAME = "clavel-delta3"


class Terminal(io.StringIO):
    """Somebody sits before it."""

    def isatty(self) -> bool:
        return True


def terminal_of(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Standard error that is a terminal, from now on: pytest sets its own before each phase."""
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(sys, "stderr", found := Terminal())
    return found


class Display:
    """What IPython displays, in place of a notebook."""

    def __init__(self) -> None:
        self.shown: list[dict[str, str]] = []

    def __call__(self, data: dict[str, str], *, raw: bool, display_id: bool) -> "Display":
        assert raw
        assert display_id
        self.shown.append(data)
        return self

    def update(self, data: dict[str, str], *, raw: bool) -> None:
        assert raw
        self.shown.append(data)


@pytest.fixture
def notebook(monkeypatch: pytest.MonkeyPatch) -> Display:
    """A shell with a kernel."""
    found = Display()
    shell = SimpleNamespace(kernel=object())
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    monkeypatch.setitem(sys.modules, "IPython.display", SimpleNamespace(display=found))
    return found


def say(watch: progress.Watch, *stages: str) -> None:
    with watched(watch, "work") as tell:
        for stage in stages:
            tell(stage)


def test_a_script_is_silent(capsys: pytest.CaptureFixture[str]) -> None:
    say(None, "one", "2 of 3")
    say(False, "one")
    deltaid.sensor_plan(NAME, recorded(1200))
    assert capsys.readouterr() == ("", "")


def test_a_script_in_a_terminal_is_silent_and_a_prompt_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = terminal_of(monkeypatch)
    monkeypatch.delattr(sys, "ps1", raising=False)
    say(None, "one")
    assert terminal.getvalue() == ""
    monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    say(None, "one [red]stage[/red]")
    assert "work: one [red]stage[/red]" in terminal.getvalue()


def test_a_terminal_shows_the_time_since_the_start_and_that_left_where_it_is_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = terminal_of(monkeypatch)
    with watched(True, "work") as say_so:
        say_so("preparing")
        time.sleep(1.1)
        say_so("looking")  # another stage
        assert "left" not in terminal.getvalue()
        assert re.search(r"0:00:0[1-9] work: looking", terminal.getvalue())
        for k in range(1, 4):
            say_so(f"start {k} of 4")
            time.sleep(0.6)
    plain = re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", terminal.getvalue())
    assert re.search(r"0:00:0\d 0:00:0\d left work: start \d of 4", plain)


def test_a_prompt_without_a_terminal_is_silent(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "ps1", ">>> ", raising=False)
    say(None, "one")
    assert capsys.readouterr() == ("", "")


def test_it_is_shown_where_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = terminal_of(monkeypatch)
    deltaid.check(NAME, progress=True)
    assert "check: checking the description" in terminal.getvalue()


def test_a_notebook_has_a_bar_that_goes_away(notebook: Display) -> None:
    say(None, "start 1 of 4", "<b>file</b>")
    starting, first, second, last = notebook.shown
    assert starting["text/plain"] == "work: starting"
    assert 'value="0.250"' in first["text/html"]
    assert "value=" not in second["text/html"].replace("vertical", "")
    assert "work: &lt;b&gt;file&lt;/b&gt;" in second["text/html"]
    assert set(last.values()) == {""}
    assert all(set(bundle) == {"text/plain", "text/html"} for bundle in notebook.shown)


def test_the_bar_goes_away_after_a_failure(notebook: Display) -> None:
    with pytest.raises(deltaid.DeltaidError):
        deltaid.sensor_plan(NAME, "no such file.csv")
    assert len(notebook.shown) > 1
    assert notebook.shown[-1]["text/html"] == ""


def test_false_is_silent_in_a_notebook(notebook: Display) -> None:
    deltaid.check(NAME, progress=False)
    assert not notebook.shown


def test_a_function_receives_every_stage(notebook: Display) -> None:
    stages = list[str]()
    deltaid.sensor_plan(NAME, recorded(1200), progress=stages.append)
    assert stages[0] == "looking at the motion"
    assert "comparing" in stages
    assert not notebook.shown


@pytest.mark.parametrize(
    ("text", "share"),
    [("start 3 of 4", 0.75), ("0 of 4", 0.0), ("one of four", None), ("3 of 0", None), ("", None)],
)
def test_how_far_it_is(text: str, share: float | None) -> None:
    assert share_of(text) == share
