"""Co-simulation of units: the package's own time steps, friction at rest included."""

from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.fmi2 import FMU2Slave
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from deltaid.control.simulation import step_through
from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.model import Model
from exports import at_home, dry_friction, every_friction_term, needs_compiler, subject
from support import assert_close, example
from sweeps import slow, swept
from units import names, unit, write

pytestmark = needs_compiler


def swinging(chosen: Model, time: float) -> np.ndarray:
    """Torques that hold the robot at home, and swing beyond friction and back."""
    loss = np.maximum(np.abs(dry_friction(chosen)), 0.1)
    return at_home(chosen).g[0] + 1.6 * loss * np.sin(40.0 * time + np.arange(len(loss)))


@pytest.mark.parametrize(
    ("make", "h"),
    [
        (every_friction_term, 7e-4),
        slow(lambda: subject("irb360-6-1600"), 1e-3),
    ],
    ids=["every-friction-term", "4-dof"],
)
def test_steps_are_those_of_the_package(make: object, h: float, tmp_path: Path) -> None:
    """With drives that stick and let go; 0.7 ms are three time steps."""
    chosen = make()  # pyright: ignore[reportCallIssue]
    dof, steps, forward = chosen.dynamics.dof, 100, chosen.forward
    path = step_through(
        forward, chosen.p, chosen.home[None], np.zeros((1, dof)), steps * h,
        lambda t, q, qd: swinging(chosen, t)[None], rate=1 / h,
    )  # fmt: skip
    _, speeds = forward.drive_motion(path.z[:, 0], path.zd[:, 0])
    assert (np.abs(speeds[1:]) < 1e-12).any()
    assert np.abs(speeds).max() > 0.002
    with unit(chosen, "fmu", tmp_path) as found:
        found.fmu.exitInitializationMode()
        for k in range(steps):
            found.set(names("tau", dof), swinging(chosen, k * h))
            found.fmu.doStep(k * h, h)
            assert_close(found.get(*names("z", dof)), path.z[k + 1, 0], 1e-11)
            assert_close(found.get(*names("qd", dof)), speeds[k + 1], 1e-11)


def test_below_breakaway_nothing_moves(tmp_path: Path) -> None:
    """Nine tenths of Coulomb friction on every drive, for two seconds, in uneven steps."""
    chosen = subject("linear-delta")
    gravity, loss = at_home(chosen).g[0], dry_friction(chosen)
    with unit(chosen, "fmu", tmp_path) as found:
        found.set(names("tau", 3), gravity + 0.9 * loss * [1, -1, 1])
        found.fmu.exitInitializationMode()
        before, time = found.get(*names("q", 3)), 0.0
        for h in np.tile([1e-3, 0.0, 1e-2, 3.3e-4, 5e-5], 176):
            found.fmu.doStep(time, h)
            time += h
        assert time == pytest.approx(2.0, rel=0.01)
        assert np.abs(found.get(*names("q", 3)) - before).max() < 1e-14
        assert np.abs(found.get(*names("qd", 3))).max() < 1e-15
        assert np.abs(found.get(*(f"der(qd{i})" for i in (1, 2, 3)))).max() < 1e-12
        found.set(names("tau", 3), gravity + 1.1 * loss)
        found.fmu.doStep(time, 0.01)
        assert (found.get(*names("qd", 3)) > 1e-4).any()


def test_a_payload_that_comes_and_goes(tmp_path: Path) -> None:
    """While it is held the unit is the loaded robot, and nothing jumps."""
    chosen, dof, h = subject("linear-delta"), 3, 1e-3
    forward, z, zd = chosen.forward, chosen.home[None], np.zeros((1, 3))
    with unit(chosen, "fmu", tmp_path) as found:
        found.fmu.exitInitializationMode()
        for part, mass in enumerate((0.0, 2.5, 0.0)):
            p = chosen.with_load(np.append(mass, np.zeros(9))).p if mass else chosen.p
            start = 0.03 * part
            path = step_through(
                forward, p, z, zd, 0.03,
                lambda t, q, qd, start=start: swinging(chosen, start + t)[None], rate=1 / h,
            )  # fmt: skip
            z, zd = path.z[-1], path.zd[-1]
            found.set(["payload"], np.array([mass]))
            for k in range(30):
                found.set(names("tau", dof), swinging(chosen, start + k * h))
                found.fmu.doStep(start + k * h, h)
            assert_close(found.get(*names("z", dof)), z[0], 1e-11)
            _, qd = forward.drive_motion(z, zd)
            assert_close(found.get(*names("qd", dof)), qd[0], 1e-10)
        for wrong in (-0.1, np.nan, np.inf):
            found.set(["payload"], np.array([wrong]))
            with pytest.raises(Exception, match="fmi2DoStep"):
                found.fmu.doStep(0.09, h)


@pytest.mark.slow
def test_a_mechanism_of_ones_own_without_a_platform_has_no_payload(tmp_path: Path) -> None:
    robot = example("planar_delta")
    chosen = Model(robot, prior_parameters(robot), "planar")
    path = write(chosen, "fmu", tmp_path)
    described = fmpy.read_model_description(str(path)).modelVariables
    inputs = [variable.name for variable in described if variable.causality == "input"]
    assert inputs == ["tau1", "tau2"]
    fallen = fmpy.simulate_fmu(
        str(path), fmi_type="CoSimulation", stop_time=0.05, output_interval=0.05
    )
    path_of_ours = step_through(
        chosen.forward, chosen.p, chosen.home[None], np.zeros((1, 2)), 0.05, rate=20.0
    )
    assert [fallen["x"][-1], fallen["z"][-1]] == pytest.approx(path_of_ours.z[-1, 0], abs=1e-12)


def test_a_state_can_be_saved_and_gone_back_to(tmp_path: Path) -> None:
    chosen = subject("linear-delta")
    with unit(chosen, "fmu", tmp_path) as found:
        found.set(["tau1"], np.array([-80.0]))
        found.fmu.exitInitializationMode()
        found.fmu.doStep(0.0, 0.05)
        kept = found.fmu.getFMUstate()
        stored = found.fmu.serializeFMUstate(kept)
        found.fmu.doStep(0.05, 0.05)
        later = found.get("x", "y", "z", "qd1")
        found.fmu.setFMUstate(found.fmu.deSerializeFMUstate(stored))
        assert (found.get("x", "y", "z", "qd1") != later).any()
        found.fmu.doStep(0.05, 0.05)
        assert (found.get("x", "y", "z", "qd1") == later).all()
        found.fmu.freeFMUstate(kept)


@pytest.mark.parametrize("wrong", ["torque", "step", "reach"])
def test_a_step_that_fails_leaves_the_unit_where_it_was(wrong: str, tmp_path: Path) -> None:
    chosen = subject("linear-delta")
    with unit(chosen, "fmu", tmp_path) as found:
        found.fmu.exitInitializationMode()
        found.fmu.doStep(0.0, 0.01)
        before = found.get("x", "y", "z", "qd1")
        tau = {"torque": np.nan, "step": 0.0, "reach": -9e4}[wrong]
        found.set(["tau1"], np.array([tau]))
        with pytest.raises(Exception, match="fmi2DoStep"):
            found.fmu.doStep(0.01, -0.01 if wrong == "step" else 1.0)
        assert (found.get("x", "y", "z") == before[:3]).all() if wrong != "torque" else True
        found.set(["tau1"], np.array([0.0]))
        assert (found.get("x", "y", "z", "qd1") == before).all()


@pytest.mark.parametrize("target", swept(["fmu", "fmu-inverse"], "fmu"))
def test_fmi_3_is_the_same_unit(target: str, tmp_path: Path) -> None:
    """Bit by bit, in both kinds of simulation."""
    chosen, outs = subject("linear-delta"), []
    start = {"tau1": -80.0} if target == "fmu" else {"qd1": 0.5, "qdd2": 1.0}
    for version in ("2", "3"):
        path = write(chosen, target, tmp_path, version)
        assert validate_fmu(str(path)) == []
        outs.append([
            fmpy.simulate_fmu(str(path), fmi_type=kind, stop_time=0.02, output_interval=1e-3,
                              start_values=start, step_size=1e-4)
            for kind in ("CoSimulation", "ModelExchange")
        ])  # fmt: skip
    for two, three in zip(*outs, strict=True):
        names_ = [name for name in two.dtype.names if name != "time"]
        assert any(np.ptp(two[name]) > 0 for name in names_) == (target == "fmu")
        assert all((two[name] == three[name]).all() for name in names_)


def test_a_state_of_fmi_3(tmp_path: Path) -> None:
    path = write(subject("linear-delta"), "fmu", tmp_path, "3")
    description = fmpy.read_model_description(str(path))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    found = FMU3Slave(
        guid=description.guid,
        unzipDirectory=fmpy.extract(str(path), str(tmp_path / "unzipped")),
        modelIdentifier=description.coSimulation.modelIdentifier,
        instanceName="instance",
    )
    found.instantiate()
    found.enterInitializationMode(startTime=1.0)
    found.setFloat64([reference["tau1"]], [-80.0])
    found.exitInitializationMode()
    wanted = [reference[name] for name in ("x", "z", "qd1", "time")]
    found.doStep(1.0, 0.01)
    stored = found.serializeFMUState(found.getFMUState())
    found.doStep(1.01, 0.01)
    later = found.getFloat64(wanted)
    found.setFMUState(found.deserializeFMUState(stored))
    assert found.getFloat64(wanted)[-1] == pytest.approx(1.01)
    found.doStep(1.01, 0.01)
    assert found.getFloat64(wanted) == later
    assert later[-1] == pytest.approx(1.02)
    with pytest.raises(Exception, match="fmi3SetFloat64"):
        found.setFloat64([reference["x"] + 1000], [0.0])
    found.terminate()
    found.freeInstance()


def test_an_instance_of_another_unit_is_refused(tmp_path: Path) -> None:
    path = write(subject("linear-delta"), "fmu", tmp_path)
    found = FMU2Slave(
        guid="{other}",
        unzipDirectory=fmpy.extract(str(path), str(tmp_path / "unzipped")),
        modelIdentifier="unit",
        instanceName="instance",
    )
    with pytest.raises(Exception, match="instantiate"):
        found.instantiate()
