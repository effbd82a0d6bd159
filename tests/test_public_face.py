"""What users of Python meet: `import deltaid`, one sample or many, and nothing below it."""

import inspect
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deltaid
from deltaid.motion.excitation.run import Run
from deltaid.motion.fourier import FourierMotion
from deltaid.robot.load import catalogue_text
from logs import recorded, true_parameters, write
from sessions import ROOT, blocks

NAME = "clavel-delta3"


def test_every_name_exists_and_says_what_it_is() -> None:
    for name in deltaid.__all__:
        assert inspect.getdoc(getattr(deltaid, name)), f"{name} has no docstring"
        assert name in dir(deltaid)


def test_no_room_hides_a_public_name() -> None:
    """In a process of its own, after every submodule has been imported."""
    code = (
        "import deltaid, importlib, pkgutil, types\n"
        "for module in pkgutil.walk_packages(deltaid.__path__, 'deltaid.'):\n"
        "    if not module.name.endswith(('jax_functions', 'jax_graph')):\n"
        "        importlib.import_module(module.name)\n"
        "for name in deltaid.__all__:\n"
        "    assert not isinstance(getattr(deltaid, name), types.ModuleType), name\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr


def test_examples_and_generated_python_import_nothing_below() -> None:
    written = [*(ROOT / "examples").rglob("*.py"), ROOT / "src/deltaid/studio/steps.py"]
    inner = re.compile(r"^(?:from deltaid[. ]|import deltaid\.).*$", re.MULTILINE)
    for path in written:
        text = path.read_text(encoding="utf-8")
        if "studio" in path.parts:  # its own imports stand before the first function
            text = text[text.index("\ndef ") :]
        assert not inner.findall(text), path


def test_other_names_are_refused_as_python_does() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = deltaid.no_such_name


def test_the_block_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ((_, code),) = blocks((ROOT / "README.md").read_text(encoding="utf-8"), "python")
    write(tmp_path / "my-robot.yaml", catalogue_text(NAME))
    write(tmp_path / "log.csv", recorded(4000, derivatives=True))
    monkeypatch.chdir(tmp_path)
    q = np.full((4, 3), 0.3)
    space = {"q": q, "qd": 0 * q, "qdd": 0 * q}
    exec(compile(code, "README.md", "exec"), space)
    assert (tmp_path / "model.yaml").is_file()
    at_rest = deltaid.Dynamics(NAME).inverse_dynamics(q, 0 * q, 0 * q, true_parameters())
    np.testing.assert_allclose(space["tau"], at_rest, rtol=1e-3)
    np.testing.assert_allclose(space["terms"].g, at_rest, rtol=1e-3)


KINEMATICS, DYNAMICS = deltaid.Kinematics(NAME), deltaid.Dynamics(NAME)
FORWARD, FORCES = deltaid.ForwardDynamics(NAME), deltaid.ConstraintForces(NAME)
Z = np.array([[0.05, 0.02, -0.95], [-0.1, 0.0, -0.9], [0.0, 0.12, -1.0]])
RATE, TORQUE = np.array([[0.4, -0.2, 0.3]] * 3), np.array([[5.0, -3.0, 4.0]] * 3)
Q = KINEMATICS.inverse(Z)

# What is called, with the arrays that go in.
CALLS: dict[str, tuple[Callable[..., Any], tuple[np.ndarray, ...]]] = {
    "inverse": (KINEMATICS.inverse, (Z,)),
    "forward": (KINEMATICS.forward, (Q,)),
    "forward unchecked": (KINEMATICS.forward_unchecked, (Q,)),
    "jacobian": (KINEMATICS.jacobian, (Z,)),
    "jacobian rate": (KINEMATICS.jacobian_rate, (Z, RATE)),
    "condition": (KINEMATICS.condition, (Z,)),
    "regularity": (KINEMATICS.regularity, (Z,)),
    "motion of drives": (KINEMATICS.drive_motion, (Z, RATE, RATE)),
    "poses": (KINEMATICS.poses, (Z,)),
    "regressor": (DYNAMICS.regressor, (Q, RATE, RATE)),
    "inverse dynamics": (DYNAMICS.inverse_dynamics, (Q, RATE, RATE)),
    "torque": (DYNAMICS.torque, (Z, RATE, RATE)),
    "what gears carry": (DYNAMICS.carried, (Z, RATE, RATE)),
    "mass matrix": (DYNAMICS.mass_matrix, (Q,)),
    "terms": (DYNAMICS.terms, (Q, RATE)),
    "acceleration": (FORWARD.acceleration, (Z, RATE, TORQUE)),
    "acceleration of drives": (FORWARD.drive_acceleration, (Q, RATE, TORQUE)),
    "energy": (FORWARD.energy, (Z, RATE)),
    "forces": (FORCES.evaluate, (Z, RATE, RATE)),
    "coefficients of forces": (FORCES.coefficients, (Z, RATE, RATE)),
}


def arrays(found: Any) -> list[np.ndarray]:
    """All arrays and numbers in what was returned, in their order."""
    if isinstance(found, tuple):
        return [array for part in found for array in arrays(part)]
    if is_dataclass(found):
        held = [getattr(found, field.name) for field in fields(found)]
        return [np.asarray(value) for value in held if not isinstance(value, str)]
    return [np.asarray(found)]


@pytest.mark.parametrize("name", CALLS)
def test_a_vector_gives_what_its_row_gives(name: str) -> None:
    call, given = CALLS[name]
    many, of_vector = arrays(call(*given)), arrays(call(*(array[1] for array in given)))
    rows = arrays(call(*(array[1:2] for array in given)))
    assert len(many) == len(of_vector) == len(rows)
    for several, single, row in zip(many, of_vector, rows, strict=True):
        assert several.shape == (3, *single.shape)
        assert row.shape == (1, *single.shape)
        np.testing.assert_array_equal(row[0], single)
        np.testing.assert_allclose(several[1], single, rtol=1e-12, atol=1e-15)


def test_lists_and_names_of_arguments_will_do() -> None:
    expected = DYNAMICS.inverse_dynamics(Q[0], RATE[0], RATE[0])
    assert expected.shape == (3,)
    found = DYNAMICS.inverse_dynamics(qdd=list(RATE[0]), q=tuple(Q[0]), qd=list(RATE[0]))
    np.testing.assert_array_equal(found, expected)
    whole = KINEMATICS.inverse([[0, 0, -1], [0, 0, -1]])
    assert whole.shape == (2, 3)


def test_one_load_goes_with_one_sample() -> None:
    load = np.array([0.5, -0.5, 0.2])
    found = DYNAMICS.regressor(Q[0], RATE[0], RATE[0], load=load)
    many = DYNAMICS.regressor(Q[:1], RATE[:1], RATE[:1], load=load[None])
    np.testing.assert_array_equal(found, many[0])


def test_no_samples_are_none() -> None:
    assert KINEMATICS.inverse(np.zeros((0, 3))).shape == (0, 3)


@pytest.mark.parametrize("shape", [(), (2,), (4,), (3, 4), (1, 2, 3)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(deltaid.DeltaidError, match=r"z: expected arrays of shape \(samples, 3\)"):
        KINEMATICS.inverse(np.zeros(shape))


def test_a_model_brings_its_parameters_to_all_that_computes() -> None:
    p = 1.5 * deltaid.prior_parameters(NAME)
    model = deltaid.load(deltaid.load_robot(NAME))
    for changed, call, arguments in (
        (DYNAMICS.with_parameters(p), "torque", (Z, RATE, RATE)),
        (FORWARD.with_parameters(p), "acceleration", (Z, RATE, TORQUE)),
        (FORCES.with_parameters(p), "evaluate", (Z, RATE, RATE)),
    ):
        found = getattr(changed, call)(*arguments)
        np.testing.assert_array_equal(found, getattr(changed, call)(*arguments, p))
        assert not np.allclose(found, getattr(changed, call)(*arguments, model.p))
        np.testing.assert_array_equal(changed.p, p)
    np.testing.assert_array_equal(DYNAMICS.p, model.p)  # `at` leaves the other as it was


def test_a_motion_at_one_time() -> None:
    motion = FourierMotion(2.0, np.zeros(3), np.eye(3), 0.5 * np.eye(3))
    run = Run(motion, 0.1, 0.5, 1)
    for moving in (motion, run):
        many = moving.evaluate(np.array([0.2, 0.7]))
        instant = moving.evaluate(0.7)
        for several, single in zip(many, instant, strict=True):
            assert single.shape == (3,)
            np.testing.assert_allclose(several[1], single, rtol=1e-12)
