"""C by choice: single precision, further functions; NaN, sanitizers, several compilers."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

from c_library import BAD_INPUT, COMPILERS, FURTHER, OK, WARNINGS, assert_further, build
from c_library import written as written_to
from deltaid.errors import DeltaidError
from deltaid.exports.c_code import c_code
from deltaid.exports.files import export
from deltaid.exports.mjcf import mjcf
from deltaid.exports.options import FURTHER as NAMES
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.exports.urdf import urdf
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.model.model import Model
from deltaid.online.settings import OnlineSettings
from exports import disturbed, needs_compiler, states, subject
from support import example
from sweeps import slow, swept


@needs_compiler
def test_further_functions(tmp_path: Path) -> None:
    chosen = subject("irb360-6-1600")
    library = build(chosen, tmp_path, further=FURTHER)
    z, _, qd, qdd = states(chosen, 10)
    assert_further(library, chosen, z, qd, qdd)
    header = (tmp_path / "delta.h").read_text()
    for name, unit in zip(*named_forces(chosen), strict=True):
        assert f"] {name}, {unit}\n" in header or f"] {name}, {unit} */" in header
    assert "] limb1_swing, rad\n" in header
    assert "] limb1_swing, rad/s\n" in header
    assert "] slide, m\n" in header


def named_forces(subject: Model) -> tuple[tuple[str, ...], tuple[str, ...]]:
    forces = ConstraintForces(subject.robot)
    return forces.names, forces.units


@needs_compiler
@pytest.mark.parametrize(
    ("name", "precision"),
    [("h4-linear", DOUBLE), slow("linear-delta", SINGLE)],
    ids=["double", "single"],
)
def test_no_input_that_is_no_number_passes(name: str, precision: Precision, tmp_path: Path) -> None:
    library = build(subject(name), tmp_path, precision=precision, further=FURTHER)
    z, q, qd, qdd = (x[0] for x in states(subject(name), 1))
    at = {"z": z, "q": q, "qd": qd, "qdd": qdd, "tau": qdd}
    functions = {
        "inverse_kinematics": "z", "forward_kinematics": "q", "inverse_dynamics_at": "z qd qdd",
        "inverse_dynamics": "q qd qdd", "forward_dynamics": "z qd tau", "jacobian": "z",
        "mass_matrix": "z", "bias": "z qd", "gravity": "z", "constraint_forces": "z qd qdd",
        "passive_joints": "z qd", "regressor": "z qd qdd",
    }  # fmt: skip
    iterated = library.fill("forward_kinematics", q, outs=(np.full(z.size, np.nan),))
    assert iterated == (BAD_INPUT if "h4" in name else OK)
    for function, names in functions.items():
        good = [at[name] for name in names.split()]
        for k, value in enumerate(good):
            for wrong in (np.nan, np.inf, -np.inf):
                spoilt = value.copy()
                spoilt[k % value.size] = wrong
                inputs = [*good[:k], spoilt, *good[k + 1 :]]
                outs = (np.full(2000, 7.0), np.full(2000, 7.0))
                outs[0][: z.size] = z  # where forward kinematics starts
                before = outs[0].copy()
                assert library.fill(function, *inputs, outs=outs) == BAD_INPUT
                assert (outs[1] == 7.0).all()
                assert (outs[0].astype(library.type) == before.astype(library.type)).all()


@pytest.mark.parametrize(
    ("compiler", "precision"),
    [
        ("g++", DOUBLE),
        *(slow(x, SINGLE) for x in ("g++", "clang", "clang++")),
        slow("clang", DOUBLE),
    ],
)
def test_compilers_have_nothing_to_say(compiler: str, precision: Precision, tmp_path: Path) -> None:
    if not COMPILERS[compiler]:
        pytest.skip(f"there is no {compiler}")
    source = written_to(subject("h4-linear"), tmp_path, precision, FURTHER)
    command = [*COMPILERS[compiler], *WARNINGS, "-c", source, "-o", tmp_path / "delta.o"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8")
    assert (done.returncode, done.stderr) == (0, "")


def test_number_literals_of_floats_keep_their_value() -> None:
    assert SINGLE.c_number(0.1) == "0.1f"
    assert SINGLE.c_number(-2.0) == "(-2.0f)"
    assert float(SINGLE.digits(1e-60)) > 0  # a guard against zero stays one
    assert float(DOUBLE.digits(1e-60)) == 1e-60


@pytest.mark.parametrize("precision", swept([DOUBLE, SINGLE], DOUBLE), ids=["double", "single"])
def test_what_a_mechanism_of_ones_own_has_not(precision: Precision) -> None:
    chosen = disturbed(example("heli4"))
    c_code(chosen, "heli", precision, ("regressor",))
    for name in ("constraint-forces", "passive-joints"):
        with pytest.raises(DeltaidError, match="mechanism of"):
            c_code(chosen, "heli", DOUBLE, (name,))
    for target in (mjcf, urdf):
        with pytest.raises(DeltaidError, match="has a mechanism of its own"):
            target(chosen)
    with pytest.raises(DeltaidError, match=r"(?s)no body EE or P .* one of arm, rod, half, tool"):
        chosen.with_load(np.append(1.0, np.zeros(9)))
    assert chosen.with_load(np.append(1.0, np.zeros(9)), "tool")["tool.m"] > chosen["tool.m"]


def test_choices_are_reported_where_they_do_not_apply(tmp_path: Path) -> None:
    for options in ({"single": True}, {"functions": ["regressor"]}):
        with pytest.raises(DeltaidError, match="urdf is none"):
            export("linear-delta", "urdf", tmp_path / "r.urdf", **options)
    with pytest.raises(DeltaidError, match="no further function 'regresor'"):
        export("linear-delta", "c", tmp_path / "r.c", functions="regressor, regresor")
    both = {"plain_friction": True, "without_friction": True}
    with pytest.raises(DeltaidError, match="no friction is left"):
        export("linear-delta", "c", tmp_path / "r.c", **both)
    with pytest.raises(DeltaidError, match="which is not asked for"):
        export("linear-delta", "c", tmp_path / "r.c", online=OnlineSettings(rate=500.0))
    assert not list(tmp_path.iterdir())
    found = export("linear-delta", "c", tmp_path / "r.c", single=True, functions=NAMES[:1])
    assert "single" in (tmp_path / "r.h").read_text()
    assert "only the sum of the forces" in found.warnings[0]  # of struts, as `deltaid forces` says


MAIN = """
#include "delta.h"
#include <stdlib.h>
#include <string.h>
#define D DELTA_DOF
/* Each array alone on the heap, so that a step beyond its end is seen. */
static {real} *filled(int n, {real} value)
{{
    {real} *x = ({real} *)malloc((size_t)n * sizeof *x);
    int i;
    for (i = 0; i < n; ++i)
        x[i] = value;
    return x;
}}
int main(void)
{{
    static const {real} values[3] = {{0, 1, 1e30f}};
    int k, good = 0;
    for (k = 0; k < 4; ++k) {{
        {real} *z = filled(D, values[k % 3]), *q = filled(D, 0), *v = filled(D, values[k % 3]);
        {real} *tau = filled(D, 0), *M = filled(D * D, 0), *F = filled({forces}, 0);
        {real} *Y = filled({regressor}, 0), *x = filled({joints}, 0), *xd = filled({joints}, 0);
        if (k == 3) {{
            memcpy(z, delta_home, sizeof delta_home);
            good += delta_inverse_kinematics(z, q) == 0;
        }}
        good += delta_forward_kinematics(q, z) == 0;
        good += delta_inverse_dynamics(q, v, v, z, tau) == 0;
        good += delta_inverse_dynamics_at(z, v, v, tau) == 0;
        good += delta_forward_dynamics(z, v, tau, v) == 0;
        good += delta_jacobian(z, M) == 0;
        good += delta_mass_matrix(z, M) == 0;
        good += delta_bias(z, v, tau) == 0;
        good += delta_gravity(z, tau) == 0;
        good += delta_constraint_forces(z, v, v, F) == 0;
        good += delta_passive_joints(z, v, x, xd) == 0;
        good += delta_regressor(z, v, v, Y) == 0;
        free(z), free(q), free(v), free(tau), free(M), free(F), free(Y), free(x), free(xd);
    }}
    return good >= 12 ? 0 : 1;
}}
"""


@pytest.mark.slow
@needs_compiler
def test_sanitizers_find_nothing(tmp_path: Path) -> None:
    """Address and undefined behaviour, with numbers from 0 to 1e30 and a good pose."""
    chosen, precision = subject("h4-linear"), DOUBLE
    source = written_to(chosen, tmp_path, precision, FURTHER)
    sizes = {
        "forces": len(ConstraintForces(chosen.robot).names),
        "regressor": 4 * len(chosen.p),
        "joints": len(chosen.dynamics.kinematics.passive_joints(chosen.home[None]).names),
    }
    (tmp_path / "main.c").write_text(MAIN.format(real=precision.c_type, **sizes))
    options = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-O0"]
    command = [*COMPILERS["gcc"], *options, source, tmp_path / "main.c", "-o", tmp_path / "run"]
    made = subprocess.run([*command, "-lm"], capture_output=True, encoding="utf-8")
    if "asan" in made.stderr:
        pytest.skip("the compiler has no sanitizers")
    assert made.returncode == 0, made.stderr
    ran = subprocess.run([tmp_path / "run"], capture_output=True, encoding="utf-8")
    assert (ran.returncode, ran.stderr) == (0, "")


@needs_compiler
def test_fast_mathematics_is_refused(tmp_path: Path) -> None:
    source = written_to(subject("linear-delta"), tmp_path)
    command = [*COMPILERS["gcc"], "-ffast-math", "-c", source, "-o", tmp_path / "delta.o"]
    done = subprocess.run(command, capture_output=True, encoding="utf-8")
    assert "compile without -ffast-math" in done.stderr
