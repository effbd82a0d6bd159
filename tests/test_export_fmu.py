"""The functional mock-up units, checked and run by FMPy, against the package."""

import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Model
from fmpy.validation import validate_fmu

from deltaid.exports.fmu import fmu
from deltaid.exports.fmu_binaries import Compiler
from deltaid.model.model import Model
from exports import (
    at_home,
    compiled,
    dry_friction,
    every_friction_term,
    model,
    needs_compiler,
    states,
    subject,
)
from support import assert_close
from sweeps import slow, swept
from units import names, unit, write

NAMES = swept(["par4-linear", "linear-delta"], "linear-delta")
pytestmark = needs_compiler


@pytest.mark.parametrize(
    ("name", "target"),
    [("linear-delta", "fmu"), ("linear-delta", "fmu-inverse"), slow("par4-linear", "fmu-inverse")],
)
def test_units_are_valid_and_their_sources_strict(name: str, target: str, tmp_path: Path) -> None:
    path = write(subject(name), target, tmp_path)
    assert validate_fmu(str(path)) == []
    described = fmpy.read_model_description(str(path))
    said = (described.author, described.license, described.version)
    assert all(said)
    assert described.defaultExperiment.stopTime == "1"
    lacking = {v.name for v in described.modelVariables if v.unit is None}
    assert lacking <= {"friction_speed"}
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path)
    page = (tmp_path / "documentation" / "index.html").read_text()
    assert all(f"<td>{v.name}</td>" in page for v in described.modelVariables)
    for source in ("unit.c", "fmi2.c"):
        compiled(tmp_path / "sources" / source, tmp_path / f"{source}.so")
    binary = (tmp_path / "binaries").rglob("unit.*")
    assert len(list(binary)) == 1


@pytest.mark.parametrize("name", NAMES)
def test_inverse_dynamics(name: str, tmp_path: Path) -> None:
    chosen = subject(name)
    dof = chosen.dynamics.dof
    z, q, qd, qdd = states(chosen, 8, share=0.4)
    with unit(chosen, "fmu-inverse", tmp_path) as found:
        still = found.get(*names("tau", dof))
        assert_close(still, at_home(chosen).tau[0], 1e-12)
        found.fmu.exitInitializationMode()
        tau = model(chosen, z, qd, qdd).tau
        for i in range(len(z)):
            for what, values in (("q", q[i]), ("qd", qd[i]), ("qdd", qdd[i])):
                found.set(names(what, dof), values)
            found.fmu.doStep(0.01 * i, 0.01)
            assert_close(found.get(*names("tau", dof)), tau[i], 1e-11)
            assert_close(found.get(*names("z", dof)), z[i], 1e-12)
        found.set(["q1"], np.array([np.nan]))
        with pytest.raises(Exception, match="fmi2GetReal"):
            found.get("tau1")


def accelerations(chosen: Model, folder: Path, tau: np.ndarray, n: int) -> None:
    """q̈ of the unit against the package, at speeds at which friction has its whole size."""
    dof = chosen.dynamics.dof
    z, _, qd, qdd = states(chosen, n)
    qd = np.sign(qd) * (1.0 + np.abs(qd))
    expected = model(chosen, z, qd, qdd)
    with unit(chosen, "fmu", folder, FMU2Model) as found:
        found.fmu.exitInitializationMode()
        for i in range(n):
            found.set(names("tau", dof), expected.tau[i] + tau)
            found.fmu.setContinuousStates((fmpy.fmi2.fmi2Real * (2 * dof))(*z[i], *qd[i]), 2 * dof)
            more = np.linalg.solve(expected.M[i], tau)
            got = found.get(*(f"der(qd{k + 1})" for k in range(dof)))
            assert_close(got, qdd[i] + more, 1e-9)
            zd = np.linalg.solve(chosen.dynamics.kinematics.jacobian(z[i : i + 1])[0], qd[i])
            rates = found.get(*(f"der({name})" for name in names("z", dof)))
            assert_close(rates, zd, 1e-11)
        loaded = chosen.with_load(np.append(1.5, np.zeros(9)))
        found.set(["payload"], np.array([1.5]))
        found.set(names("tau", dof), model(loaded, z[-1:], qd[-1:], qdd[-1:]).tau[0])
        got = found.get(*(f"der(qd{k + 1})" for k in range(dof)))
        assert_close(got, qdd[-1], 1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_accelerations(name: str, tmp_path: Path) -> None:
    chosen = subject(name)
    if passive := set(chosen.robot.joints) - set(chosen.robot.drives):  # may stand still
        p = chosen.p.copy()
        p[[chosen.dynamics.layout.names.index(f"coulomb.{joint}") for joint in passive]] = 0.0
        chosen = Model(chosen.robot, p, name)
    accelerations(chosen, tmp_path, 1.0 + np.arange(len(chosen.home)), 8)


@pytest.mark.slow
def test_accelerations_with_every_friction_term(tmp_path: Path) -> None:
    """Friction that depends on load takes its share of the motor's torque: no torque added here."""
    accelerations(every_friction_term(), tmp_path, np.zeros(3), 20)


def test_in_model_exchange_friction_holds_the_robot_but_for_a_creep(tmp_path: Path) -> None:
    chosen = subject("linear-delta")
    gravity, loss, path = at_home(chosen).g[0], dry_friction(chosen), write(chosen, "fmu", tmp_path)
    start = {f"tau{i + 1}": gravity[i] + 0.5 * loss[i] for i in range(3)}
    out = fmpy.simulate_fmu(
        str(path), fmi_type="ModelExchange", stop_time=0.3, start_values=start, output_interval=0.01
    )
    speeds = np.array([out[f"qd{i + 1}"][-1] for i in range(3)])
    assert np.abs(speeds).max() < 0.01
    assert speeds == pytest.approx(0.01 * np.arctanh(0.5), rel=0.1)


@pytest.mark.parametrize("speed", [0.0, -0.01, np.nan])
def test_friction_that_would_drive_is_refused(speed: float, tmp_path: Path) -> None:
    """tanh(v / s) with s < 0 adds energy; in model exchange nothing steps that would find out."""
    with unit(subject("linear-delta"), "fmu", tmp_path, FMU2Model) as found:
        found.set(["friction_speed"], np.array([speed]))
        with pytest.raises(Exception, match="fmi2GetReal"):
            found.get("der(qd1)")


def test_the_same_model_gives_the_same_file() -> None:
    none = Compiler((), ())  # the same library again takes a compiler: test_fmu_binaries
    first, again = (
        fmu(subject("linear-delta"), "unit", forward=True, compiler=none) for _ in range(2)
    )
    assert again.parts[".fmu"] == first.parts[".fmu"]
