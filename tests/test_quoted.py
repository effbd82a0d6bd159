"""Messages quote at most 200 characters of what stands in a file."""

import json
from pathlib import Path

import polars as pl
import pytest

from command import refused, run
from logs import recorded, write

ROBOTS = "type: clavel-delta3\nrobots:\n- robot: a\n  recordings: NAME\n"
TABLE = "robot,recording,type"
# File, what it holds with LONG in it, and the command that reads it.
CASES = {
    "recording of a manifest": ("f.yaml", ROBOTS.replace("NAME", "LONG")),
    "period of a manifest": ("f.yaml", ROBOTS + "period: LONG\n"),
    "key of a manifest": ("f.yaml", ROBOTS + "? LONG\n: 3\n"),
    "column of a manifest": ("f.csv", f"{TABLE},LONG\na,b,c,d\n"),
    "types of a manifest": ("f.csv", f"{TABLE}\na,b,LONG\na,b,c\n"),
    "column of a mapping": ("m.yaml", "load: {column: LONG, mass: 1}\n"),
    "unit of a mapping": ("m.yaml", "time: {column: t, unit: LONG}\n"),
    "cell": ("l.csv", "t,q1,q2,q3,tau1,tau2,tau3\n" + "0,0,0,0,LONG,0,0\n" * 9),
    "alias": ("r.yaml", "name: *LONG\n"),
    "key of a robot": ("r.yaml", "? LONG\n: 3\n"),
}
COMMANDS = {
    "f": ("fleet", "FILE", "-o", "out"),
    "m": ("check", "clavel-delta3", "log.csv", "--columns", "FILE"),
    "l": ("check", "clavel-delta3", "FILE"),
    "r": ("base", "FILE"),
}


@pytest.mark.parametrize("words", ["x", "x y "])
@pytest.mark.parametrize("case", CASES)
def test_messages_stay_short(tmp_path: Path, monkeypatch, case: str, words: str) -> None:
    name, text = CASES[case]
    words = "x_y_" if case == "alias" else words
    long = (words * 100_000)[:100_000]
    write(tmp_path / name, text.replace("LONG", long if case == "alias" else json.dumps(long)))
    write(tmp_path / "log.csv", recorded(300))
    monkeypatch.chdir(tmp_path)
    command = [word.replace("FILE", name) for word in COMMANDS[name[0]]]
    message = refused(*command, folder=tmp_path)
    assert words * (200 // len(words) + 1) not in message
    assert len(message) < 800


@pytest.mark.parametrize("words", ["x", "x y "])
def test_a_path_in_quarantine(tmp_path: Path, words: str) -> None:
    manifest = tmp_path / "f.yaml"
    manifest.write_text(ROBOTS.replace("NAME", f"{words * (4000 // len(words))}*.csv"))
    message = run("fleet", manifest, "-o", tmp_path / "out").err
    assert "no file answers to it" in message
    assert words * (200 // len(words) + 1) not in message


def test_text_of_a_recording_in_memory() -> None:
    import deltaid

    table = pl.DataFrame({"t": [0.0, 1.0], "x y " * 1000: ["a", "b"]})
    with pytest.raises(deltaid.DeltaidError) as error:
        deltaid.check("clavel-delta3", table)
    assert len(str(error.value)) < 800
