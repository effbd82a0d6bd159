"""A small plant: robots whose recordings lie in folders of their own, and its manifest."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from unittest.mock import Mock

import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.fleets.run import FleetRun
from deltaid.fleets.run import fleet as run_fleet
from deltaid.fleets.workers import Workers
from deltaid.model.record import Settings
from deltaid.robot.load import load_robot
from identified import simulated

TYPE = "clavel-delta3"
SETTINGS = Settings(cutoff=15.0, friction="described")
DAYS = ("2026-01-05", "2026-01-07", "2026-01-14")
ROBOTS = ("north", "south")
NAMES = (*(f"north/{day}" for day in DAYS), f"south/{DAYS[0]}")


@cache
def recordings() -> dict[str, pl.DataFrame]:
    """Tables of all recordings, by their names: robot/day."""
    robot = load_robot(TYPE)
    dynamics, found = compiled(robot), dict[str, pl.DataFrame]()
    for k, name in enumerate(NAMES):
        p = prior_parameters(robot)
        p[dynamics.layout.friction] *= 1.2 if name.startswith("south") else 1.0
        found[name] = simulated(robot, p, k, duration=3.0, rate=1000.0)
    return found


@dataclass(frozen=True)
class Plant:
    """Where it is."""

    folder: Path

    @property
    def manifest(self) -> Path:
        """All robots."""
        return self.folder / "fleet.yaml"

    @property
    def output(self) -> Path:
        """The fleet's folder."""
        return self.folder / "fleet"

    def record(self, *names: str) -> "Plant":
        """Recordings come in."""
        for name in names:
            path = self.path(name)
            path.parent.mkdir(parents=True, exist_ok=True)
            recordings()[name].write_parquet(path)
        return self

    def path(self, name: str) -> Path:
        """Of a recording."""
        return self.folder / f"{name}.parquet"

    def run(self, **options) -> FleetRun:
        """A call on this machine, with one worker."""
        return run_fleet(self.manifest, self.output, settings=SETTINGS, workers=1, **options)

    def table(self, name: str = "parameters.parquet") -> pl.DataFrame:
        """One of its tables, without what depends on where files lie."""
        return pl.read_parquet(self.output / name).drop("key")


def plant(folder: Path, robots: Sequence[str] = ROBOTS) -> Plant:
    """One without recordings."""
    folder.mkdir(exist_ok=True)
    (folder / "fleet.yaml").write_text(manifest(robots=robots), encoding="utf-8")
    return Plant(folder)


def manifest(root: str = "", robots: Sequence[str] = ROBOTS) -> str:
    """YAML of robots whose recordings are below a root."""
    lines = (f"  - robot: {name}\n    recordings: {root}{name}/*.parquet\n" for name in robots)
    return f"type: {TYPE}\nrobots:\n{''.join(lines)}"


@contextmanager
def no_workers() -> Iterator[None]:
    """All work is done here, one item after the other."""
    with pytest.MonkeyPatch.context() as patch:
        here = Mock(spec=Workers, done=lambda work, items, failed: map(work, items))
        patch.setattr("deltaid.fleets.run.open_workers", lambda *_: nullcontext(here))
        yield
