"""Numbers on the command line that cannot be: one message before any work."""

from pathlib import Path

import pytest

from command import run
from deltaid.errors import DescriptionError
from deltaid.joint_forces.forces import with_struts
from deltaid.model.model import load
from logs import recorded, write

OPTIONS = {
    "base clavel-delta3 log.csv": ["--cutoff", "--seed"],
    "identify clavel-delta3 log.csv -o m.yaml": ["--gamma", "--prior-spread", "--cutoff"],
    "excite clavel-delta3 -o m.csv": [
        "--duration", "--harmonics", "--repeats", "--velocity-weight", "--torque-noise", "--rate",
        "--starts", "--seed",
    ],
    "forces clavel-delta3 log.csv -o f.csv": ["--strut-spacing", "--socket-force"],
    "simulate clavel-delta3 log.csv -o s.csv": [
        "--rate", "--bandwidth", "--encoder", "--delay", "--payload", "--current-loop",
    ],
    "export clavel-delta3 --to c -o r.c --with online": [
        "--rate", "--payload-max", "--false-alarms", "--payload",
    ],
    "compare-controllers clavel-delta3 log.csv --plant clavel-delta3": [
        "--rate", "--bandwidth", "--encoder", "--delay",
    ],
    "demo clavel-delta3 --keep kept": ["--noise", "--seed"],
    "reproduce surrogate -o folder": ["--starts", "--seed"],
    "show clavel-delta3 --live": ["--port"],
}  # fmt: skip
# No number, below every range, above every range. One option is tried with all of them: what is
# refused is decided where a setting is declared, for all kinds of settings alike.
SOME, ALL = ("nan", "-1", "1e300"), ("nan", "inf", "-inf", "-1", "1e300", "x", "")


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("numbers")
    write(folder / "log.csv", recorded(300))
    return folder


@pytest.mark.parametrize("command", OPTIONS)
def test_numbers_that_cannot_be(place: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.chdir(place)
    for k, option in enumerate(OPTIONS[command]):
        for value in SOME if k else ALL:
            outcome = run(*command.split(), f"{option}={value}")
            assert outcome.code == 2, (option, value)
            assert outcome.out == ""
            assert option in outcome.err or "cut-off of 1e+300 Hz" in outcome.err
            assert [path.name for path in place.iterdir()] == ["log.csv"]


@pytest.mark.parametrize("force", ["1e20", "1e-300", "0", "99999999999999999999999"])
def test_a_socket_force_that_cannot_be(place: Path, monkeypatch, force: str) -> None:
    monkeypatch.chdir(place)
    outcome = run("forces", "clavel-delta3", "log.csv", f"--socket-force={force}")
    assert (outcome.code, outcome.err.count("error: --socket-force: must ")) == (2, 1)
    with pytest.raises(DescriptionError, match="Limbs: socket_force: "):
        with_struts(load("clavel-delta3"), None, float(force) or -1.0)


def test_a_run_of_more_rows_than_a_disk_holds(place: Path, monkeypatch) -> None:
    monkeypatch.chdir(place)
    outcome = run("excite", "clavel-delta3", "--duration=30", "--repeats=1000", "--rate=1e5")
    assert (outcome.code, outcome.out) == (2, "")
    assert "rows (duration, repeats, rate): must lie between 0 and 3e+07, not 3e+09" in outcome.err
