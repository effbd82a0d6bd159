"""What differs on systems that these tests do not run on, as docs/systems.md says it."""

import io
import sys
import zipfile
from pathlib import Path

import pytest

import deltaid
from deltaid.exports import fmu_binaries
from deltaid.exports.fmu import fmu
from deltaid.kernel import store
from deltaid.recording.formats import frames


@pytest.fixture(autouse=True)
def _home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(store.VARIABLE, raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("LOCALAPPDATA", raising=False)
    monkeypatch.setattr(Path, "home", lambda: tmp_path)


@pytest.mark.parametrize(
    ("system", "below"),
    [
        ("linux", ".cache/deltaid"),
        ("darwin", "Library/Caches/deltaid"),
        ("win32", "AppData/Local/deltaid"),
    ],
)
def test_kernels_are_kept_where_a_system_keeps_such_things(
    system: str, below: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", system)
    place = store.folder()
    assert place.is_relative_to(tmp_path / below)
    if system == "win32":
        monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "Local"))
        place = store.folder()
        assert place.is_relative_to(tmp_path / "Local" / "deltaid")


def test_no_signal_is_touched_where_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(frames.ctypes, "CDLL", lambda _: pytest.fail("there is no such library"))
    with frames.last_words("message", 2):
        pass


def test_a_unit_without_binary_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    model = deltaid.load("clavel-delta3")
    monkeypatch.setattr(sys, "platform", "win32")
    monkeypatch.setattr(fmu_binaries, "find_spec", lambda _: None)
    monkeypatch.setattr(fmu_binaries.shutil, "which", lambda name: f"C:/{name}.exe")
    made = fmu(model, "unit", forward=False)
    assert len(made.warnings) == 1
    assert "binaries for this machine are not known" in made.warnings[0]
    with zipfile.ZipFile(io.BytesIO(made.parts[".fmu"])) as unit:
        names = unit.namelist()
    assert any(name.startswith("sources/") for name in names)
    assert not any(name.startswith("binaries/") for name in names)
