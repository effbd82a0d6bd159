"""A fleet's folder through what happens to a plant, at random: shares that are away, other options
and versions, calls that are killed and calls at the same time.

After each call every row that was gathered before is still there, or the call was refused with exit
code 2 and has changed no byte.
"""

import hashlib
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

from plant import NAMES, Plant, plant, recordings

# The command as another version of the package.
_PROGRAM = """
import importlib.metadata, sys
known, other = importlib.metadata.version, sys.argv.pop(1)
importlib.metadata.version = lambda name: other if name == "deltaid" else known(name)
from deltaid.cli.app import main
main()
"""
ACTS = ("unmounted", "mounted", "options", "version", "regathered", "killed", "two at once")
# A call of a fleet of a few robots takes no longer [s].
_LONGEST = 300.0


class Asked(NamedTuple):
    """What a call asks for."""

    cutoff: int = 15
    version: str = "1.0"
    regather: bool = False


_FIRST = Asked()


@dataclass
class WalkedFleet:
    """A fleet whose robots have recordings of two days each; `asked` is what was asked last and
    not refused."""

    plant: Plant
    robots: Sequence[str]
    rng: np.random.Generator
    asked: Asked = _FIRST

    @classmethod
    def drawn(cls, folder: Path, robots: int, seed: int) -> "WalkedFleet":
        """A fleet in a folder, gathered once."""
        names = [f"robot{k:02d}" for k in range(robots)]
        fleet = cls(plant(folder, names), names, np.random.default_rng(seed))
        for k, name in enumerate(names):
            (folder / name).mkdir()
            for day in range(2):
                table = recordings()[NAMES[(k + day) % len(NAMES)]]
                table = table.with_columns(pl.col("tau1") + 1e-6 * k)  # of no other robot
                table.write_parquet(folder / name / f"2026-01-{5 + day:02d}.parquet")
        assert fleet.started(fleet.asked).wait(_LONGEST) == 0
        return fleet

    def step(self) -> tuple[str, str]:
        """Something happens, and the fleet is called.

        Returns:
            What happened, and how it ended; an end in capitals must not be.
        """
        act, rows, files = str(self.rng.choice(ACTS)), self.rows(), self.files()
        asked = self._asked(act)
        calls = [self.started(asked) for _ in range(2 if act == "two at once" else 1)]
        if act == "killed":
            with suppress(subprocess.TimeoutExpired):
                calls[0].wait(self.rng.uniform(0.5, 6.0))
            calls[0].kill()
        codes = {call.wait(_LONGEST) for call in calls}
        if codes == {2}:
            return act, "refused" if self.files() == files else "REFUSED, AND CHANGED"
        if not codes <= {0, 2, -signal.SIGKILL}:
            return act, f"ENDED WITH {codes}"
        if 0 in codes:
            self.asked = asked._replace(regather=False)
        return act, "kept" if rows <= self.rows() else "LOST"

    def _asked(self, act: str) -> Asked:
        """What is asked for when something has happened."""
        other = 35 - self.asked.cutoff
        match act:
            case "unmounted":
                for name in self.rng.choice(self.robots, 1 + len(self.robots) // 4, replace=False):
                    _moved(self.plant.folder / name, self.plant.folder / f"{name}.away")
            case "mounted" | "regathered":
                for name in self.robots:
                    _moved(self.plant.folder / f"{name}.away", self.plant.folder / name)
        match act:
            case "options":
                return self.asked._replace(cutoff=other)
            case "version":
                return self.asked._replace(version="1.1")
            case "regathered":
                return self.asked._replace(cutoff=other, regather=True)
        return self.asked

    def started(self, asked: Asked) -> "subprocess.Popen[bytes]":
        """A call of `deltaid fleet`."""
        words = ["fleet", self.plant.manifest, "-o", self.plant.output, "--workers", "1"]
        words += ["--cutoff", asked.cutoff, "--friction", "described"]
        words += ["--regather"] * asked.regather
        program = [sys.executable, "-c", _PROGRAM, asked.version, *map(str, words)]
        return subprocess.Popen(program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def rows(self) -> set[tuple[str, ...]]:
        """Recordings of which something is gathered, with their hashes."""
        folder = self.plant.output
        table = pl.read_parquet(folder / "recordings.parquet").filter(pl.col("reason") == "")
        assert all((folder / file).exists() for file in table["file"])
        return set(table.select("robot", "path", "sha256").iter_rows())

    def files(self) -> dict[str, str]:
        """A hash of each file of the fleet's folder."""
        folder = self.plant.output
        return {
            str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(folder.rglob("*"))
            if path.is_file()
        }


def _moved(path: Path, to: Path) -> None:
    if path.exists():
        path.rename(to)
