"""Functional mock-up units of models, for this machine only, opened by FMPy."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
from fmpy.fmi2 import FMU2Slave

from deltaid.exports.fmu import fmu
from deltaid.exports.fmu_binaries import own_compiler
from deltaid.exports.options import FmiVersion
from deltaid.model.model import Model


@cache
def content(chosen: Model, target: str, version: FmiVersion = "2") -> bytes:
    """A unit's file, with a library for this machine."""
    compiler = own_compiler()
    found = fmu(chosen, "unit", forward=target == "fmu", version=version, compiler=compiler)
    assert compiler
    assert all("runs as it is on " + compiler.systems[0].name in text for text in found.warnings)
    return found.parts[".fmu"]


def write(chosen: Model, target: str, folder: Path, version: FmiVersion = "2") -> Path:
    """That file."""
    path = folder / f"unit{version}.fmu"
    path.write_bytes(content(chosen, target, version))
    return path


class Unit:
    """An instance of a unit, its variables by name."""

    def __init__(self, path: Path, folder: Path, kind: type) -> None:
        self.description = fmpy.read_model_description(str(path))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        unzipped = fmpy.extract(str(path), str(folder / "unzipped"))
        self.fmu = kind(
            guid=self.description.guid,
            unzipDirectory=unzipped,
            modelIdentifier=self.description.coSimulation.modelIdentifier,
            instanceName="instance",
        )
        self.fmu.instantiate()
        self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()

    def get(self, *names: str) -> np.ndarray:
        """Values."""
        return np.array(self.fmu.getReal([self.references[name] for name in names]))

    def set(self, names: list[str], values: np.ndarray) -> None:
        """Set values."""
        self.fmu.setReal([self.references[name] for name in names], list(values))


@contextmanager
def unit(chosen: Model, target: str, folder: Path, kind: type = FMU2Slave) -> Iterator[Unit]:
    """An instance, freed at the end."""
    found = Unit(write(chosen, target, folder), folder, kind)
    yield found
    found.fmu.terminate()
    found.fmu.freeInstance()


def names(what: str, dof: int) -> list[str]:
    """Variables of a group."""
    if what == "z":
        return ["x", "y", "z", "psi"][:dof]
    return [f"{what}{i + 1}" for i in range(dof)]
