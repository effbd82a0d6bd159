"""Faults that are added to a recording one after the other."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drives.happening import Happening
from drives.robots import Machine
from drives.sensors import Sensors
from oracle.composed import ComposedOracle
from oracle.tree import Array
from plants import log_uniform


class Made(NamedTuple):
    """A machine and its sensors, with a description of every fault in them."""

    happening: Happening
    sensors: Sensors
    words: tuple[str, ...] = ()

    @property
    def machine(self) -> Machine:
        """The true robot."""
        return self.happening.machine

    def on(self, words: str, **changes: object) -> "Made":
        """The same with changed sensors."""
        return self._replace(sensors=replace(self.sensors, **changes), words=(*self.words, words))

    def but(self, words: str, **changes: object) -> "Made":
        """The same with a changed `happening`."""
        return self._replace(
            happening=replace(self.happening, **changes), words=(*self.words, words)
        )

    def with_oracle(self, words: str, oracle: ComposedOracle, p: Array | None = None) -> "Made":
        """The same with another true robot on the same path."""
        m = self.machine
        plant = replace(m.plant, oracle=oracle, p=m.plant.p if p is None else p)
        M = np.array([oracle.mass_matrix(z) for z in m.poses])
        return self.but(words, machine=replace(m, plant=plant, M=M))


Cause = Callable[[Made, np.random.Generator, float], Made]


@dataclass(frozen=True)
class Faults:
    """A row of the second table: its causes, each with its size or with bounds of a log-uniform
    random size."""

    words: str
    causes: tuple[tuple[Cause, float | tuple[float, float]], ...]

    def make(self, made: Made, rng: np.random.Generator) -> Made:
        """Add one cause after the other."""
        for cause, size in self.causes:
            drawn = log_uniform(rng, *size) if isinstance(size, tuple) else size
            made = cause(made, rng, drawn)
        return made
