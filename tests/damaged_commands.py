"""Every command with a damaged file of every kind that it takes, and what it came to.

A line is judged from outside: exit code, messages, what it leaves behind, what it prints.
"""

import gzip
import os
import random
import re
import shutil
import subprocess
import sys
import traceback
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl

from command import Outcome, run
from damage import largest_memory, unclear
from damaged_texts import damage_input
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import DeltaidError
from deltaid.recording.contents import count_columns
from deltaid.robot.load import catalogue_text, load_robot, read_text
from deltaid.sensors.planning.offers import shipped_text
from deltaid.studio.folder import Folder
from identified import identified
from kinds_of_files import KINDS
from logs import names, recorded, write
from plant import no_workers

EXAMPLES = Path(__file__).parents[1] / "examples"
ROBOT = "clavel-delta3"
DAYS = ("2026-01-05", "2026-01-14")
LARGEST = 1000  # MB
_MAPPING = """time: {column: t, unit: s}
position: {columns: [q1, q2, q3], unit: rad}
torque: {columns: [tau1, tau2, tau3], unit: N m}
"""


@dataclass(frozen=True)
class Line:
    """A command line, the one of its files that is damaged, and how often in a full run."""

    text: str
    damaged: str
    cases: int

    @property
    def name(self) -> str:
        """Of its row: a line is there once for each of its files."""
        return f"{self.text}: {self.damaged}"

    @property
    def codes(self) -> tuple[int, ...]:
        """Exit codes that mean what they mean; those of `check` and `columns` are grades."""
        return (0, 2, 3, 4) if self.text.startswith(("check", "columns")) else (0, 2)

    @property
    def keeps(self) -> bool:
        """Whether refusing one file leaves what came of others."""
        return self.text.startswith(("gather", "fleet"))


def _lines(damaged: str, *lines: tuple[str, int]) -> list[Line]:
    return [Line(text.replace("@", damaged), damaged, cases) for text, cases in lines]


_SENSORS, _EXCITE = "--steps 1 --duration 0.2", "--starts 1 --duration 1 --harmonics 2 -o out.csv"
LINES = [
    *_lines(
        "robot.yaml",
        ("base @", 500), ("check @", 500), ("check @ log.csv", 300), ("show @", 200),
        ("gather @ log.csv -o out", 200), ("identify @ log.csv -o out.yaml", 100),
        ("identify @ g -o out.yaml", 100), ("validate @ full.csv", 300),
        ("torque @ motion.csv -o out.csv", 500), ("simulate @ motion.csv", 100),
        ("compare-controllers model.yaml motion.csv --plant @", 50), ("drift @ g", 100),
        ("export @ --to npz -o out.npz", 300), ("export @ --to mjcf -o out.xml", 100),
        ("forces @ motion.csv", 100), (f"sensors @ motion.csv {_SENSORS}", 50),
        (f"excite @ {_EXCITE}", 50), ("new out.yaml --from @ --yes", 50), ("demo @", 10),
        ("studio @", 300), ("calibrate @ --points points.csv", 50), ("columns log.csv @", 100),
    ),
    *_lines("points.csv", ("calibrate robot.yaml --points @", 200)),
    *_lines("bed.csv", ("calibrate robot.yaml --probe @", 200)),
    *_lines("poses.yaml", ("calibrate robot.yaml --points points.csv --columns @", 200)),
    *_lines(
        "columns.yaml",
        ("torque model.yaml full.csv -o out.csv --columns @", 500),
        ("validate model.yaml full.csv --columns @", 300),
        ("check robot.yaml log.csv --columns @", 200), ("base robot.yaml log.csv --columns @", 200),
        ("gather robot.yaml log.csv -o out --columns @", 200),
        ("identify robot.yaml log.csv -o out.yaml --columns @", 100),
        ("online model.yaml long.csv --columns @", 100),
    ),
    *_lines(
        "moves.yaml",
        ("simulate model.yaml motion.csv --columns @", 200),
        ("forces model.yaml motion.csv --columns @", 100),
        (f"sensors robot.yaml motion.csv {_SENSORS} --columns @", 50),
    ),
    *_lines("long.csv", ("online model.yaml @", 300)),
    *_lines(
        "log.csv",
        ("base robot.yaml @", 300), ("check robot.yaml @", 300), ("columns @ robot.yaml", 200),
        ("gather robot.yaml @ -o out", 300),
        ("identify robot.yaml @ -o out.yaml", 200), ("studio @", 300),
        ("identify robot.yaml long.csv -o out.yaml --verify @", 100),
    ),
    *_lines("own.csv", ("forces model.yaml motion.csv --logs @", 50)),
    *_lines(
        "full.csv",
        ("validate model.yaml @", 500), ("torque model.yaml @ -o out.csv", 500),
        ("gather robot.yaml @ -o out", 200),
    ),
    *_lines(
        "motion.csv",
        ("torque model.yaml @ -o out.csv", 500), ("simulate model.yaml @", 300),
        ("forces model.yaml @", 300), ("compare-controllers model.yaml @ --plant robot.yaml", 50),
        (f"sensors robot.yaml @ {_SENSORS}", 50),
    ),
    *_lines(
        "model.yaml",
        ("validate @ full.csv", 60), ("torque @ motion.csv -o out.csv", 60),
        ("export @ --to npz -o out.npz", 60), ("export @ --to c -o out/", 30), ("show @", 60),
        ("simulate @ motion.csv", 60), ("forces @ motion.csv", 60), ("online @ long.csv", 60),
        ("drift @ g", 60), ("identify @ log.csv -o out.yaml", 30),
        ("sample @ -n 1 -o out.npz", 20),
        ("compare-controllers @ motion.csv --plant robot.yaml", 30),
    ),
    *_lines("offers.yaml", ("sensors robot.yaml motion.csv --list --sensors @", 100),
            (f"sensors robot.yaml motion.csv {_SENSORS} --sensors @", 300)),
    *_lines("mechanism.py", ("--mechanism @ base heli4.yaml", 200)),
    *_lines("heli4.yaml", ("--mechanism mechanism.py base @", 200)),
    *_lines(
        "g/2026-01-05.factors.parquet",
        ("identify robot.yaml g -o out.yaml", 500), ("drift robot.yaml g", 500),
        ("validate robot.yaml @", 500),
    ),
    *(
        line
        for manifest in ("fleet.yaml", "fleet.csv", "fleet.parquet")
        for line in _lines(manifest, ("fleet @ -o out --cutoff 40", 100))
    ),
    *_lines("day-2026-01-05.parquet", ("fleet fleet.csv -o out --cutoff 40", 50)),
    *(
        Line("fleet fleet.yaml -o fleet --cutoff 40", f"fleet/{table}.parquet", 40)
        for table in ("recordings", "parameters", "friction", "drift", "members", "types")
    ),
    Line("fleet fleet.yaml -o fleet --cutoff 40", "fleet/factors/R0/*", 100),
    Line("fleet fleet.yaml -o fleet --cutoff 40", "fleet/members/R0*", 100),
    Line("fleet fleet.yaml -o fleet --cutoff 40", "fleet/models/R0*", 100),
    *(
        line
        for kind in sorted({kind.name for kind in KINDS.values()} | {"log.csv.gz"})
        if kind != "log.csv"
        for line in _lines(kind, ("check robot.yaml @", 100), ("studio @", 50))
    ),
]  # fmt: skip
NAMED = {line.name: line for line in LINES}
assert len(NAMED) == len(LINES)


def make_inputs(folder: Path) -> Path:
    """A folder with a good file of every kind."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.yaml").write_text(catalogue_text(ROBOT), encoding="utf-8")
    (folder / "columns.yaml").write_text(_MAPPING, encoding="utf-8")
    (folder / "moves.yaml").write_text(_MAPPING.rpartition("torque")[0], encoding="utf-8")
    (folder / "offers.yaml").write_text(shipped_text(), encoding="utf-8")
    shutil.copy(EXAMPLES / "heli4" / "robot.yaml", folder / "heli4.yaml")
    shutil.copy(EXAMPLES / "heli4" / "mechanism.py", folder / "mechanism.py")
    shutil.copy(identified(ROBOT).model_file, folder / "model.yaml")
    shutil.copy(identified(ROBOT).log, folder / "own.csv")
    write(folder / "log.csv", recorded(600))
    write(folder / "long.csv", recorded(1500))
    write(folder / "full.csv", recorded(200, derivatives=True))
    write(folder / "motion.csv", recorded(60, derivatives=True).drop(names("tau")))
    rng = np.random.default_rng(1)
    x = rng.uniform([-0.2, -0.2, -1.0], [0.2, 0.2, -0.9], (30, 3))
    q, xyz = compiled(load_robot(ROBOT)).kinematics.inverse(x), x + rng.normal(0, 1e-4, x.shape)
    write(
        folder / "points.csv",
        pl.DataFrame(dict(zip(("q1", "q2", "q3", "px", "py", "pz"), [*q.T, *xyz.T], strict=True))),
    )
    bed = dict(zip("xyz", [*x[:, :2].T, rng.normal(-0.95, 1e-4, len(x))], strict=True))
    write(folder / "bed.csv", pl.DataFrame(bed))
    (folder / "poses.yaml").write_text("points: {noise: 0.0001}\n", encoding="utf-8")
    for kind in KINDS.values():
        if kind.name != "log.csv" and kind.columns is None:  # lines name no mapping for them
            kind.save(folder / kind.name)
    (folder / "log.csv.gz").write_bytes(gzip.compress((folder / "log.csv").read_bytes()))
    for k, day in enumerate(DAYS):
        for suffix, samples in (("csv", 700), ("parquet", 800)):
            table = recorded(samples + 100 * k)  # with other torques, or one would be an excerpt
            other = table.with_columns(pl.col("tau1", "tau2", "tau3") * (1 + 1e-3 * k))
            write(folder / f"day-{day}.{suffix}", other)
    _gathered(folder)
    return folder


def _gathered(folder: Path) -> None:
    """Factor files, and a fleet."""
    (folder / "fleet.yaml").write_text(
        f"type: {ROBOT}\nrobots:\n"
        + "".join(
            # Where they lie for good: from other places they would be other recordings.
            f"  - robot: R{k}\n    recordings:\n"
            f"      - {{path: {folder.resolve()}/day-{day}.parquet, time: {day}}}\n"
            for k, day in enumerate(DAYS)
        ),
        encoding="utf-8",
    )
    table = pl.DataFrame(
        {
            "robot": ["R0", "R1"],
            "recording": [f"day-{day}.parquet" for day in DAYS],
            "type": [ROBOT] * 2,
            "time": list(DAYS),
        }
    )
    write(folder / "fleet.csv", table)
    write(folder / "fleet.parquet", table)
    with inside(folder):
        days = (f"day-{day}.csv" for day in DAYS)
        gathering = ("gather", "robot.yaml", *days, "-o", "g", "--cutoff", "40")
        for line in (gathering, ("fleet", "fleet.yaml", "-o", "fleet", "--cutoff", "40")):
            with no_workers():
                outcome = run(*line)
            assert outcome.code == 0, outcome
    for day in DAYS:
        (file,) = (folder / "g").glob(f"day-{day}-*")
        file.rename(folder / "g" / f"{day}.factors.parquet")


@contextmanager
def inside(folder: Path) -> Generator[None]:
    """Work in a folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


@dataclass(frozen=True)
class Ended:
    """What a case came to.

    Attributes:
        end: refused, read (as without damage), warned, altered (something else, as a file that
            people write may say), or else.
        why: what is wrong, where it is else.
    """

    end: str
    why: str = ""


def judged(line: Line, inputs: Path, place: Path, rng: random.Random) -> Ended:
    """Damage the file of a line, run it, and judge what comes of it."""
    good = _good(line, inputs, place)
    lay_out(line, inputs, place, rng)
    before, memory = _listed(place), largest_memory()
    try:
        outcome = run_line(line, place)
    except Exception:  # what it counts: whatever comes out beside a refusal
        last = traceback.format_exc().splitlines()[-3:]
        return Ended("else", f"traceback: {' | '.join(last)}")
    if largest_memory() - memory > LARGEST:
        return Ended("else", f"took {largest_memory() - memory:.0f} MB")
    if outcome.code not in line.codes:
        return Ended("else", f"exit code {outcome.code}: {outcome.err[-300:]}")
    if outcome.code == 2:
        left = [name for name in _listed(place) - before if not line.keeps]
        why = f"left {left}" if left else _wrong(outcome)
        return Ended("else", why) if why else Ended("refused")
    if outcome.out == good.out:
        return Ended("read")
    return Ended("warned" if outcome.err != good.err else "altered")


def _wrong(outcome: Outcome) -> str:
    """What a refusal lacks."""
    said = re.search(r"^(error|note): (\S[^:]*|.*\.\w+.*?): ", outcome.err, re.MULTILINE)
    if "Traceback" in outcome.err or said is None:
        return f"no place: {outcome.err[:300]!r}"
    return unclear(outcome.err, said[2])


@cache
def _good(line: Line, inputs: Path, place: Path) -> Outcome:
    """The same line without any damage."""
    _copy(inputs, place)
    outcome = run_line(line, place)
    assert outcome.code != 2, f"{line.name}: {outcome.err}"
    return outcome


def run_line(line: Line, place: Path) -> Outcome:
    """A line in this process."""
    with inside(place):
        if not line.text.startswith("studio"):
            with no_workers():
                return run(*line.text.split())
        return _dropped(Path(line.damaged))


def run_alone(line: Line, place: Path) -> Outcome:
    """A line in a process of its own."""
    program = [sys.executable, "-c", "from deltaid.cli import main; main()", *line.text.split()]
    environment = os.environ | {"COLUMNS": "80"}
    done = subprocess.run(
        program, capture_output=True, check=False, cwd=place, encoding="utf-8", env=environment
    )
    return Outcome(done.returncode, done.stdout, done.stderr)


def _dropped(path: Path) -> Outcome:
    """What the studio says of a file that is dropped on it."""
    Folder.open(Path("dropped")).free_name(path.name)
    shutil.rmtree("dropped")
    look = read_text if path.suffix == ".yaml" else count_columns
    try:
        return Outcome(0, repr(look(path)), "")
    except DeltaidError as error:
        return Outcome(2, "", f"error: {error}")


def lay_out(line: Line, inputs: Path, place: Path, rng: random.Random) -> None:
    """A fresh copy of the good files, with that of a line damaged."""
    _copy(inputs, place)
    damage_input(next(place.glob(line.damaged)), rng)


def _copy(inputs: Path, place: Path) -> None:
    """A fresh copy of the good files; links, since nothing writes into a file."""
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(inputs, place, copy_function=os.link)


def _listed(place: Path) -> frozenset[Path]:
    return frozenset(place.rglob("*"))
