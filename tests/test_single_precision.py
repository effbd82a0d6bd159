"""The export in single precision against the package at the same floats, towards singularities.

Inputs and parameters are floats for both, so that what differs is rounding within the code: what a
float does to q is as large near a singularity, and is nobody's to mend.
"""

import ctypes
import subprocess
from fractions import Fraction
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from c_library import FURTHER, OK, WARNINGS, Library, assert_each, assert_further, build
from deltaid.exports.digits import Care, OutputPart
from deltaid.exports.straight_line import Array, straight_line
from deltaid.exports.text import SINGLE, pairs_of_c, rendered, split
from deltaid.model.model import Model
from deltaid.online.instant import pose
from exports import (
    CC,
    compiled,
    floats,
    model,
    needs_compiler,
    states,
    subject,
    towards_singularities,
)
from support import assert_close
from sweeps import slow

SHARE, POSES = 1e-5, 24


def assert_same(library: Library, model_: Model, z: np.ndarray) -> None:
    rng, dynamics, dof = np.random.default_rng(1), model_.dynamics, z.shape[1]
    qd, qdd = floats(2 * rng.standard_normal(z.shape)), floats(10 * rng.standard_normal(z.shape))
    kinematics, expected = dynamics.kinematics, model(model_, z, qd, qdd)
    tau = floats(expected.tau)
    assert_each(library.rows("inverse_kinematics", z, size=dof), kinematics.inverse(z), SHARE)
    assert_each(library.rows("jacobian", z, size=dof * dof), kinematics.jacobian(z), SHARE)
    assert_each(library.rows("mass_matrix", z, size=dof * dof), expected.M, SHARE)
    assert_each(library.rows("gravity", z, size=dof), expected.g, SHARE)
    assert_each(library.rows("bias", z, qd, size=dof), expected.bias, SHARE)
    assert_each(library.rows("inverse_dynamics_at", z, qd, qdd, size=dof), expected.tau, SHARE)
    rest = (tau - expected.bias)[..., None]
    solved = np.linalg.solve(expected.M, rest)[..., 0]
    assert_each(library.rows("forward_dynamics", z, qd, tau, size=dof), solved, SHARE)
    q = floats(kinematics.inverse(z))
    exact = np.vstack([kinematics.forward(row[None]) for row in q])
    wanted = model(model_, exact, qd, qdd).tau
    for i, near in enumerate(z + 0.003 * rng.uniform(-1, 1, z.shape)):
        pose, torque = near.copy(), np.zeros(dof)
        assert library.call("forward_kinematics", q[i], out=pose) == OK
        assert_close(pose, exact[i], SHARE)
        pose = near.copy()
        assert library.fill("inverse_dynamics", q[i], qd[i], qdd[i], outs=(pose, torque)) == OK
        assert_close(torque, wanted[i], SHARE)


@needs_compiler
@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("clavel-delta3", "-O0"),
        slow("irb360-6-1600", "-O0"),
        slow("h4", "-O0"),
        slow("i4-linear", "-O1"),
    ],
)
def test_below_a_condition_of_100(name: str, option: str, tmp_path: Path) -> None:
    chosen = Model(subject(name).robot, floats(subject(name).p), name)
    further = FURTHER if name == "clavel-delta3" else ()
    library = build(chosen, tmp_path, option, precision=SINGLE, further=further)
    z = towards_singularities(chosen, POSES)
    assert_same(library, chosen, z)
    if further:
        qd, qdd = floats(np.random.default_rng(2).standard_normal((2, *z.shape)))
        assert_further(library, chosen, z, qd, qdd, SHARE)
    assert "double" not in (tmp_path / "delta.c").read_text().replace("double precision", "")


@needs_compiler
def test_the_online_cycle_closes_its_loops(tmp_path: Path) -> None:
    """A pose that is found by iteration, millimetres away the cycle before."""
    chosen = subject("par4")
    mechanism, near = chosen.dynamics.kinematics.mechanism, ca.SX.sym("near", 4)
    inputs = [Array("near", near), Array("q", mechanism.q_symbols)]
    out = "out", ca.vertcat(*pose(mechanism, near, mechanism.q_symbols))
    text = straight_line("cycle", inputs, out, precision=SINGLE).removeprefix("static ")
    head = text.partition("{")[0].strip()  # as -Wmissing-prototypes would have it
    (tmp_path / "pose.c").write_text(f"#include <math.h>\n{head};\n{text}\n")
    cycle = ctypes.CDLL(str(compiled(tmp_path / "pose.c", tmp_path / "pose.so"))).cycle
    z, q, *_ = states(chosen, 20)
    for start, drives in zip(z, q, strict=True):
        given = [x.astype(np.float32) for x in (start + 0.003, drives, np.empty(5))]
        cycle(*(ctypes.c_void_p(x.ctypes.data) for x in given))
        assert given[2][4] == 1
        assert_close(given[2][:4].astype(float), start, SHARE)


PAIRS = """
#include <math.h>
#define OF_TWO(name) float test_##name(const float *x, float *rest);\\
    float test_##name(const float *x, float *rest) {\\
    return pair_##name(x[0], x[1], x[2], x[3], rest); }
#define OF_ONE(name) float test_##name(const float *x, float *rest);\\
    float test_##name(const float *x, float *rest) { return pair_##name(x[0], x[1], rest); }
--
OF_TWO(sum) OF_TWO(product) OF_TWO(quotient) OF_ONE(root) OF_ONE(sine) OF_ONE(cosine)
"""


@needs_compiler
@pytest.mark.parametrize("options", [("-O2",), ("-O2", "-march=native"), ("-O0",)])
def test_sums_of_two_floats(options: tuple[str, ...], tmp_path: Path) -> None:
    """To 2⁻⁴³ with multiply-add, in one rounding, and without; -std=gnu99 contracts by itself."""
    names = ("sum", "product", "quotient", "root", "sine", "cosine")
    pairs = pairs_of_c(" ".join(f"pair_{name}(" for name in names))
    (tmp_path / "pairs.c").write_text(
        rendered("pairs.c.jinja", pairs=pairs).join(PAIRS.split("--"))
    )
    command = [CC, "-std=gnu99", *WARNINGS, *options, "-shared", "-fPIC", "-o", "pairs.so"]
    subprocess.run([str(part) for part in (*command, "pairs.c", "-lm")], cwd=tmp_path, check=True)
    library, rng = ctypes.CDLL(str(tmp_path / "pairs.so")), np.random.default_rng(0)
    values = rng.uniform(-1, 1, (200, 2)) * 10.0 ** rng.uniform(-3, 3, (200, 2))
    values[:50, 1] = -values[:50, 0] * (1 + 1e-6 * rng.uniform(-1, 1, 50))  # what cancels
    for a, b in values:
        (a, da), (b, db) = split(a), split(b)
        x, y = Fraction(a) + Fraction(da), Fraction(b) + Fraction(db)
        of_one, size = float(x), float(abs(x) + abs(y))
        for name, wanted, least in (
            ("sum", float(x + y), size),
            ("product", float(x * y), 0.0),
            ("quotient", float(x / y), 0.0),
            ("root", np.sqrt(abs(of_one)), 0.0),
            ("sine", np.sin(of_one), max(1.0, abs(of_one))),
            ("cosine", np.cos(of_one), max(1.0, abs(of_one))),
        ):
            positive = abs(of_one) if name == "root" else None
            given = [*split(positive), 0.0, 0.0] if positive else [a, da, b, db]
            found = called(library, name, given)
            assert abs(found - wanted) <= 2.0**-43 * max(abs(wanted), least), (name, a, b)
    assert called(library, "root", [0.0, 0.0, 0.0, 0.0]) == 0.0
    assert np.isnan(called(library, "root", [-1.0, 0.0, 0.0, 0.0]))


def called(library: ctypes.CDLL, name: str, given: list[float]) -> float:
    function, rest = getattr(library, f"test_{name}"), ctypes.c_float()
    function.restype = ctypes.c_float
    found = function((ctypes.c_float * 4)(*given), ctypes.byref(rest))
    return float(found) + rest.value


def judged(value: ca.SX, a: float, b: float, *parts: OutputPart) -> list[int]:
    """Operations of a function of a and b that are carried as pairs."""
    x = ca.SX.sym("x", 2)
    f = ca.Function("f", [x], [ca.substitute(value, SYMBOLS, x)])
    states = np.tile([[a], [b]], (1, 3)) * np.array([1.0, 1.001, 1.002])
    found = Care({"x": states}).pairs(f, ["x"], parts or [OutputPart(1)])
    return sorted(f.instruction_id(k) for k in found)


A, B = ca.SX.sym("a"), ca.SX.sym("b")
SYMBOLS = ca.vertcat(A, B)


def test_what_cancels_has_more_digits() -> None:
    difference, sum_ = A**2 - B**2, A**2 + B**2
    assert judged(difference, 1.0, 0.999) == [ca.OP_SUB, ca.OP_SQ, ca.OP_SQ]
    assert judged(sum_, 1.0, 0.999) == []
    assert judged(difference, 1.0, 0.5) == []
    # A float's rest is not lost on the way: reading one pair as a float does as much.
    assert judged(ca.sqrt(difference) + 1e-3 * A, 1.0, 0.999999).count(ca.OP_SQ) == 2
    assert ca.OP_SUB in judged(difference - 0.002 * B, 1.0, 0.999)


def test_numbers_that_are_no_floats_have_a_rest() -> None:
    assert judged(A - 0.1, 0.1001, 1.0) == [ca.OP_SUB, ca.OP_CONST]
    assert judged(A - 0.125, 0.1251, 1.0) == []
    assert judged(A - 0.1, 1.0, 1.0) == []


def test_only_outputs_that_count_are_inspected() -> None:
    both = ca.vertcat(A**2 - B**2, A * B)
    assert judged(both, 1.0, 0.999, OutputPart(1, None), OutputPart(1)) == []
    # Beside a large entry a small one may be off.
    assert judged(both, 1.0, 0.999, OutputPart(2)) == []
    assert judged(both, 1.0, 0.999, OutputPart(1), OutputPart(1)) == [ca.OP_SUB, ca.OP_SQ, ca.OP_SQ]
    assert judged(both, 1.0, 0.999, OutputPart(1, "x"), OutputPart(1)) == []
