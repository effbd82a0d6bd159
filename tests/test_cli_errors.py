"""What goes wrong on the command line: one message on standard error, code 2, nothing written."""

import errno
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from command import refused, run
from deltaid.errors import DeltaidError
from deltaid.files import require_writable, written_whole
from deltaid.model.record import FORMAT
from deltaid.robot.load import catalogue_text
from descriptions import replaced
from identified import identified
from logs import names, recorded, text, write

ROBOT = "clavel-delta3"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with good and bad files, none of which any test changes."""
    place = tmp_path_factory.mktemp("errors")
    write(place / "log.csv", recorded(1500))
    write(place / "motion.csv", recorded(60, derivatives=True).drop(names("tau")))
    write(place / "short.csv", recorded(200))
    write(place / "nan.csv", text(recorded(700)).replace("0.348,", "nan,"))
    write(place / "cut.csv", text(recorded(700))[:-30])
    write(place / "columns.yaml", "position: [{column: q1, unit: rad}]")
    write(place / "units.yaml", "time: {unit: furlong}")
    short = catalogue_text(ROBOT).replace("strut: 1.055", "strut: 0.05").replace("0.420", "0.1")
    write(place / "robot.yaml", short)
    (place / "sub").mkdir()
    shutil.copy(identified(ROBOT).model_file, place / "model.yaml")
    return place


BAD = [
    ("identify clavel log.csv", "did you mean clavel-delta3?"),
    ("identify robot.yaml log.csv", "robot.yaml: line 5, limbs: the limbs cannot close"),
    ("identify log.csv clavel-delta3", "log.csv: does not hold keys with values"),
    ("identify sub log.csv", "sub: is a folder, not a file"),
    ("identify irb360-6-1600 log.csv", "log.csv, row 1: has no column q4, tau4"),
    ("identify clavel-delta3 missing.csv", "missing.csv: no such file"),
    ("identify clavel-delta3 sub", "sub: is a folder, not a file"),
    ("identify clavel-delta3 nan.csv", "nan.csv, row 350: column t is 'nan'"),
    ("identify clavel-delta3 log.csv nan.csv", "nan.csv, row 350: column t is 'nan'"),
    ("identify clavel-delta3 cut.csv -o sub/new.yaml", "cut.csv, row 701: has "),
    ("identify clavel-delta3 short.csv", "short.csv: has 200 samples, too few"),
    ("identify clavel-delta3 motion.csv", "motion.csv, row 1: has no torque columns"),
    ("identify clavel-delta3 log.csv --verify missing.csv", "missing.csv: no such file"),
    ("identify clavel-delta3 log.csv --verify nan.csv -o sub/new.yaml", "nan.csv, row 350"),
    ("identify clavel-delta3 log.csv --columns missing.yaml", "missing.yaml: no such file"),
    ("drift clavel-delta3 missing", "missing: no such file"),
    ("identify clavel-delta3 log.csv --columns columns.yaml", "columns.yaml, position: lists 1"),
    ("identify clavel-delta3 log.csv --columns units.yaml", "units.yaml, time.unit: unit"),
    ("identify clavel-delta3 log.csv --columns robot.yaml", "line 2, name: unknown key"),
    ("identify clavel-delta3 log.csv -o other.csv", "other.csv: must end in .yaml or .yml"),
    ("torque clavel-delta3 log.csv -o tau.parquet", "tau.parquet: must end in .csv"),
    ("identify clavel-delta3 log.csv -o missing/", "missing/: is a folder; give the name of a"),
    ("identify clavel-delta3 log.csv -o sub", "sub: is a folder"),
    ("identify robot.yaml log.csv -o robot.yaml", "robot.yaml: would overwrite an input"),
    ("identify clavel-delta3 log.csv -o log.csv/new.yaml", "log.csv is a file, not a folder"),
    ("identify clavel-delta3 log.csv -o /dev/null", "is no regular file"),
    ("identify clavel-delta3 log.csv --gamma 0", "--gamma: must be a positive number, not 0"),
    ("identify clavel-delta3 log.csv --gamma 1e-300", "--gamma: must lie between 1e-18 and 1000"),
    ("identify clavel-delta3 log.csv --prior-spread 0", "--prior-spread: must be a positive"),
    ("identify clavel-delta3 log.csv --prior-spread 1e300", "--prior-spread: must lie between"),
    ("identify clavel-delta3 log.csv --cutoff 0", "--cutoff: must be a positive number"),
    ("identify clavel-delta3 log.csv --cutoff 1e-9", "log.csv: a cut-off of 1e-09 Hz does not go"),
    ("identify clavel-delta3 log.csv --cutoff 0.1", "log.csv: has 1500 samples, too few"),
    ("identify clavel-delta3 log.csv --regularizer riemannian", "not convex"),
    ("validate missing.yaml log.csv", "no robot file and no catalogue robot called 'missing.yaml'"),
    ("validate robot.yaml log.csv", "robot.yaml: line 5, limbs: the limbs cannot close"),
    ("validate log.csv model.yaml", "log.csv: does not hold keys with values"),
    ("validate model.yaml motion.csv --json", "motion.csv, row 1: has no torque columns"),
    ("torque model.yaml cut.csv -o sub/new.csv", "cut.csv, row 701: has "),
    ("torque model.yaml motion.csv -o motion.csv", "motion.csv: would overwrite an input"),
    ("robots irb360", "did you mean irb360-6-1600? the catalogue has: abb-irb360-1-1130"),
    ("robots robot.yaml", "error: no catalogue robot called 'robot.yaml'"),
    ("gather clavel-delta3 log.csv -o short.csv", "short.csv: is a file; factor files need a fol"),
    ("base robot.yaml", "robot.yaml: line 5, limbs: the limbs cannot close"),
    ("show clavel-delta3 -o log.csv/x/new.html", "log.csv is a file, not a folder"),
    ("excite clavel-delta3 --plot sub/new.gif", "must end in .png or .svg"),
    ("excite clavel-delta3 -o a.csv --verify-out ./a.csv", "a.csv: is the file of --output"),
    ("excite clavel-delta3 -o a.csv --verify-out sub/../a.csv", "is the file of --output"),
    ("excite clavel-delta3 --duration 1e-12", "--duration: must lie between 0.1 and 3600"),
    ("excite clavel-delta3 --rate 1e12", "--rate: must lie between 1 and 100000"),
    ("demo clavel-delta3 --keep log.csv", "log.csv is a file, not a folder"),
]


@pytest.mark.parametrize(("line", "fragment"), BAD)
def test_errors(folder: Path, monkeypatch, line: str, fragment: str) -> None:
    monkeypatch.chdir(folder)
    message = refused(*line.split(), folder=folder)
    assert message.startswith("error: ")
    assert fragment in message


@pytest.mark.parametrize(
    "line",
    [
        "nothing",
        "identify",
        "identify clavel-delta3",
        "identify clavel-delta3 log.csv --gamma x",
        "identify clavel-delta3 log.csv --method newton",
        "identify clavel-delta3 log.csv --nothing",
        "base clavel-delta3 --seed -1",
        "sensors clavel-delta3 --steps 0",
    ],
)
def test_wrong_usage(folder: Path, monkeypatch, line: str) -> None:
    monkeypatch.chdir(folder)
    outcome = run(*line.split())
    assert (outcome.code, outcome.out) == (2, "")
    assert "Usage: deltaid" in outcome.err
    assert max(map(len, outcome.err.splitlines())) <= 80


DAMAGES = {
    "format": (
        f"format: {FORMAT}",
        f"format: {FORMAT + 1}\ndrawing: none",
        f"model.yaml: is a model of format {FORMAT + 1}, and this deltaid reads up to {FORMAT}\n"
        "  → update deltaid",
    ),
    "no version": (
        f"format: {FORMAT}",
        "format: 0",
        "line 1, format: must be greater than or equal to 1",
    ),
    "no format": ("\ndeltaid:", "\ndeltaidd:", "deltaid: is missing"),
    "not a number": ("determined_by", "value: x\n  determined_by", "is not valid YAML"),
    "method": ("method: conic", "method: guess", "settings.method: must be 'conic'"),
    "robot": ("upper_arm: 0.42", "upper_arm: -0.42", "limbs.upper_arm: must be greater"),
    "syntax": ("\nrobot:", "\nrobot", "is not valid YAML"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_damaged_models(folder: Path, tmp_path: Path, name: str) -> None:
    old, new, fragment = DAMAGES[name]
    path = tmp_path / "model.yaml"
    write(path, replaced(old, new, (folder / "model.yaml").read_text()))
    message = refused("validate", path, folder / "log.csv", folder=tmp_path)
    assert message.startswith(f"error: {path}")
    assert fragment in message


@pytest.mark.parametrize("key", ["value", "std", "prior"])
@pytest.mark.parametrize(
    "number",
    [".nan", "1e300", "-1e9", *(pytest.param(n, marks=pytest.mark.slow) for n in (".inf", "x"))],
)
def test_models_with_impossible_numbers(folder: Path, tmp_path: Path, key, number) -> None:
    text_of_model = (folder / "model.yaml").read_text()
    pattern = re.compile(rf"(name: S\.m\b[^}}]*?\b{key}: )[^\s,}}]+")
    changed, count = pattern.subn(rf"\g<1>{number}", text_of_model, count=1)
    assert count == 1
    path = write(tmp_path / "model.yaml", changed)
    outcome = run("validate", path, identified(ROBOT).log)
    assert outcome.code in (0, 2)
    harmless = {("prior", "-1e9"), ("std", "1e300")}
    assert (outcome.code == 0) == ((key, number) in harmless)
    assert outcome.errors == (outcome.code == 2)
    assert "top level" not in outcome.err


def test_places_that_cannot_be_written(folder: Path, tmp_path: Path, monkeypatch) -> None:
    def denied(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(Path, "touch", denied)  # as root, no permission stops anyone
    out = tmp_path / "new.csv"
    arguments = ["torque", folder / "model.yaml", folder / "motion.csv", "-o", out]
    assert "cannot be written: Permission denied" in refused(*arguments, folder=tmp_path)


def test_what_a_link_leads_to_is_written(tmp_path: Path) -> None:
    path, link = write(tmp_path / "model.yaml", "old"), tmp_path / "link.yaml"
    link.symlink_to(path)
    with written_whole(link) as file:
        file.write("new")
    assert link.is_symlink()
    assert path.read_text() == "new"
    require_writable(tmp_path / "other.yaml", [path])
    with pytest.raises(DeltaidError, match="would overwrite an input"):
        require_writable(link, [path])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["link.yaml", "model.yaml"]


STREAMS = {
    "full disk": ("robots > /dev/full", 2, "error: standard output: cannot be written: No space"),
    "full disk, JSON": ("base clavel-delta3 --json > /dev/full", 2, "error: standard output"),
    "full disk, help": ("--help > /dev/full", 2, "error: standard output"),
    "full disk, errors": ("robots nobody 2> /dev/full", 2, ""),
    "no output": ("robots >&-", 0, ""),
    "no output, an error": ("robots nobody >&-", 2, "error: no catalogue robot"),
    "no input": ("new <&-", 2, "choose from"),
    "nothing": ("robots nobody <&- >&- 2>&-", 2, ""),
    "no reader": ("robots | true", 0, ""),
}


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="the system has no full disk to try")
@pytest.mark.parametrize("stream", STREAMS)
def test_streams_that_take_or_give_nothing(tmp_path: Path, stream: str) -> None:
    command, code, message = STREAMS[stream]
    line = f"{shlex.quote(sys.executable)} -m deltaid {command}"
    ended = subprocess.run(line, shell=True, capture_output=True, text=True, cwd=tmp_path)
    assert ended.returncode == code, ended.stderr
    assert message in ended.stderr
    assert "Traceback" not in ended.stderr
    assert ended.stderr.count("error: ") <= 1


def test_a_fleet_without_recordings_says_so(tmp_path: Path) -> None:
    text = "type: clavel-delta3\nrobots:\n- robot: a\n  recordings: []\n"
    outcome = run("fleet", write(tmp_path / "fleet.yaml", text), "-o", tmp_path / "out")
    assert (outcome.code, outcome.errors) == (2, 1)
    assert "fleet.yaml: no robot could be fitted\n  → list recordings" in outcome.err


@pytest.mark.parametrize(
    ("pattern", "new", "message"),
    [
        (r"delay: \[.*?\]", "delay: [0, 0.1]", "sources[1].delay: must have one number"),
        (r"delay: \[.*?\]", "delay: [0, 0, 9]", "sources[1].delay[3]: must be less than or equal"),
        ("corrections: .*", "corrections: [{kind: gain, subject: drive9, value: 1, text: x}]",
         "corrections[1].subject: is no drive: drive9"),
        ("corrections: .*", "corrections: [{kind: gain, subject: drive1, value: 0, text: x}]",
         "corrections[1].value: must be positive"),
        ("\neffects: .*", "\neffects: [{name: hose, values: [1]}]", "has the effect 'hose'"),
        ("\neffects: .*", "\neffects: [{name: platform-force, values: [1]}]",
         "has the effect 'platform-force' of the platform"),
        ("\neffects: .*", "\neffects: [{name: ripple, drives: [drive1], values: [1, 2]}]",
         "has the effect 'ripple' of drive1"),
        ("\neffects: .*", "\neffects: [{name: cable, values: [1, 2, 3, 4, 5], orders: [1, 2]}]",
         "has the effect 'cable' of the platform"),
        ("low: 0.*", "low: 1000", "low: is above high"),
        ("rms: .*", "rms: [-1, 1, 1]", "fit.rms[1]: must be greater than or equal to 0"),
    ],
)  # fmt: skip
def test_records_that_no_identification_writes(
    tmp_path: Path, pattern: str, new: str, message: str
) -> None:
    text = (identified(ROBOT).folder / "model.yaml").read_text(encoding="utf-8")
    changed, count = re.subn(pattern, new, text, count=1)
    assert count == 1
    outcome = run("validate", write(tmp_path / "model.yaml", changed), identified(ROBOT).log)
    assert outcome.code == 2
    assert message in outcome.err
