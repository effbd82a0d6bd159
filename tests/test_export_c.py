"""The C export, compiled by a C compiler with every warning an error, against the package."""

import ctypes
import re
import subprocess
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from c_library import FURTHER, NOT_CLOSED, OTHER_MODE, OUT_OF_REACH, SINGULAR, assert_same, build
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DeltaidError
from deltaid.exports.c_code import c_code
from deltaid.exports.straight_line import Array, straight_line
from deltaid.kernel.llvm_ir import _WRITTEN_OUT, LIBM_BINARY, LIBM_UNARY
from deltaid.model.model import Model
from deltaid.robot.load import load_robot
from exports import (
    CC,
    OF_ONE,
    OF_TWO,
    STRICT,
    compiled,
    disturbed,
    every_friction_term,
    needs_compiler,
    states,
    subject,
)
from sessions import ROOT, blocks
from support import KINDS, example
from sweeps import swept


@needs_compiler
@pytest.mark.parametrize("name", swept(KINDS, "irb360-6-1600", "h4"))
def test_all_functions_of_the_catalogue(name: str, tmp_path: Path) -> None:
    assert_same(build(subject(name), tmp_path), subject(name))


@needs_compiler
def test_optimised_code_with_springs_and_every_friction_term(tmp_path: Path) -> None:
    springs = {"drive2": {"stiffness": 30.0, "rest": 0.05}}
    rich = disturbed(every_friction_term().robot.changed(springs=springs))
    assert_same(build(rich, tmp_path, "-O2"), rich)


@needs_compiler
def test_it_needs_nothing_but_mathematics(tmp_path: Path) -> None:
    library = build(subject("linear-delta"), tmp_path, further=FURTHER)
    assert library.home == pytest.approx(subject("linear-delta").home)
    listed = subprocess.run(
        ["nm", "-u", tmp_path / "delta.so"], capture_output=True, encoding="utf-8", check=True
    )
    needed = {row.split()[-1].partition("@")[0] for row in listed.stdout.splitlines()}
    needed = {name for name in needed if not name.startswith("_")}
    assert needed <= {"sqrt", "atan2", "sin", "cos", "asin", "pow", "exp", "fabs"}
    data = subprocess.run(
        ["nm", tmp_path / "delta.so"], capture_output=True, encoding="utf-8", check=True
    )
    own = [row.split() for row in data.stdout.splitlines() if "delta_" in row]
    assert own
    assert {kind for *_, kind, _ in own} <= {"T", "R", "r"}  # code and constants, no state


@needs_compiler
@pytest.mark.parametrize("name", ["linear-delta", "par4-linear"])
def test_failures_are_reported_and_change_nothing(name: str, tmp_path: Path) -> None:
    library, dof = build(subject(name), tmp_path), subject(name).dynamics.dof
    z, q, *_ = states(subject(name), 1)
    kept = np.full(dof, 7.0)
    far = z[0] + np.array([9.0, *np.zeros(dof - 1)])
    assert library.call("inverse_kinematics", far, out=kept) == OUT_OF_REACH
    assert (kept == 7.0).all()
    still = np.zeros(dof)
    assert library.call("forward_dynamics", far, still, still, out=kept) == SINGULAR
    assert (kept == 7.0).all()
    apart = q[0] + np.array([5.0, *np.zeros(dof - 1)])
    pose = z[0].copy()
    assert library.call("forward_kinematics", apart, out=pose) == NOT_CLOSED
    assert (pose == z[0]).all()


@needs_compiler
def test_other_working_mode_is_reported(tmp_path: Path) -> None:
    """An arm turned to where the platform stays but the elbow points inwards."""
    chosen = subject("clavel-delta3")
    library = build(chosen, tmp_path)
    inwards = {"working_mode": ("inwards", "outwards", "outwards")}
    limbs = chosen.robot.limbs.changed(**inwards)
    other = disturbed(chosen.robot.changed(limbs=limbs))
    pose = np.zeros(3)
    q = other.dynamics.kinematics.inverse(other.home[None])[0]
    assert library.call("forward_kinematics", q, out=pose) == OTHER_MODE


@pytest.mark.parametrize("prefix", ["", "3d", "a b", "x;", "_x", "a" * 50])
def test_names_that_c_cannot_have(prefix: str) -> None:
    with pytest.raises(DeltaidError, match="cannot begin the names"):
        c_code(subject("linear-delta"), prefix)


@pytest.mark.parametrize("prefix", ["math", "Math", "features", "fmi2", "fmi3"])
def test_a_header_that_would_hide_another_one(prefix: str) -> None:
    """<math.h> with -I., and fmi2.c of a unit, which its own sources would overwrite."""
    with pytest.raises(DeltaidError, match=f"'{prefix}.h' would be mistaken"):
        c_code(subject("linear-delta"), prefix)


def test_a_title_cannot_end_the_comment() -> None:
    robot = load_robot("linear-delta").changed(title="*//* int x; /*/\n#error")
    code = c_code(Model(robot, prior_parameters(robot), "a.yaml"), "delta")
    for text in (code.text(".h"), code.text(".c")):
        assert "int x" not in re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
        assert "#error" not in map(str.strip, text.splitlines())
        assert "/*" not in re.findall(r"/\*(.*?)\*/", text, flags=re.DOTALL)[0]


@needs_compiler
def test_the_example_of_the_documentation_compiles(tmp_path: Path) -> None:
    code = c_code(subject("irb360-6-1600"), "irb360")
    (tmp_path / "irb360.h").write_text(code.text(".h"))
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    [(_, example)] = blocks(page, "c")
    (tmp_path / "cycle.c").write_text(example + "\n")
    compiled(tmp_path / "cycle.c", tmp_path / "cycle.so")


@pytest.mark.slow
@needs_compiler
def test_a_mechanism_of_ones_own(tmp_path: Path) -> None:
    chosen = disturbed(example("heli4"))
    assert_same(build(chosen, tmp_path), chosen, 10)


@needs_compiler
def test_every_operation_of_a_kernel_is_c99_too(tmp_path: Path) -> None:
    """A mechanism of the user's own may use any that the kernel knows."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    values = [f(a) for f in OF_ONE] + [f(a, b) for f in OF_TWO]
    values += [ca.acosh(2 + a), ca.if_else(a > b, a, b), 1 / a, -a, a * a, a + a, a**2.5]
    output = ca.vertcat(*values)
    function = ca.Function("f", [a, b], [output])
    present = {function.instruction_id(k) for k in range(function.n_instructions())}
    assert {*LIBM_UNARY, *LIBM_BINARY, *_WRITTEN_OUT} - present <= {ca.OP_ASSIGN}
    text = straight_line("f", [Array("a", a), Array("b", b)], ("out", output))
    source, library = tmp_path / "f.c", tmp_path / "f.so"
    source.write_text(f"#include <math.h>\n{text.removeprefix('static ')}\n")
    subprocess.run([CC, *STRICT, "-shared", "-fPIC", source, "-o", library, "-lm"], check=True)
    call, pointer = ctypes.CDLL(str(library)).f, ctypes.c_void_p
    for x, y in ([0.3, 0.7], [0.7, 0.3], [0.25, 0.25], [0.5, 0.0]):
        found = np.empty(output.numel())
        arrays = np.array([x]), np.array([y]), found
        call(*(array.ctypes.data_as(pointer) for array in arrays))
        np.testing.assert_allclose(found, np.array(function(x, y)).ravel(), rtol=1e-15)
