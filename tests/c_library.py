"""An export to C as a library that takes arrays, in either precision."""

import ctypes
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from deltaid.exports.c_code import c_code
from deltaid.exports.text import DOUBLE, Precision
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.model.model import Model
from exports import CC, model, states
from support import assert_close

OK, NOT_CLOSED, OTHER_MODE, OUT_OF_REACH, SINGULAR, BAD_INPUT = range(6)
WARNINGS = ("-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Wdouble-promotion", "-Werror")
FURTHER = ("constraint-forces", "passive-joints", "regressor")
# clang of the ziglang wheel where the machine has none.
_ZIG = [sys.executable, "-m", "ziglang"] if find_spec("ziglang") else []
COMPILERS = {
    "gcc": [CC, "-std=c99"] if CC else [],
    "g++": [shutil.which("g++"), "-std=c++11", "-xc++"] if shutil.which("g++") else [],
    "clang": [*([shutil.which("clang")] if shutil.which("clang") else [*_ZIG, "cc"]), "-std=c99"],
    "clang++": [
        *([shutil.which("clang++")] if shutil.which("clang++") else [*_ZIG, "c++"]),
        "-std=c++11",
        "-xc++",
    ],
}


class Library:
    """The functions of a compiled export, on arrays of its precision."""

    def __init__(self, path: Path, dof: int, precision: Precision = DOUBLE) -> None:
        self.library, self.dof = ctypes.CDLL(str(path)), dof
        self.type = np.float64 if precision is DOUBLE else np.float32

    def call(self, name: str, *inputs: np.ndarray, out: np.ndarray) -> int:
        """Call delta_NAME; the last argument is filled."""
        return self.fill(name, *inputs, outs=(out,))

    def fill(self, name: str, *inputs: np.ndarray, outs: tuple[np.ndarray, ...]) -> int:
        """Call delta_NAME; the last arguments are filled."""
        function = getattr(self.library, f"delta_{name}")
        function.restype = ctypes.c_int
        arrays = [np.ascontiguousarray(x, dtype=self.type) for x in inputs]
        results = [np.ascontiguousarray(x, dtype=self.type) for x in outs]
        status = function(*[ctypes.c_void_p(x.ctypes.data) for x in (*arrays, *results)])
        for out, result in zip(outs, results, strict=True):
            out[...] = result
        return status

    def rows(self, name: str, *inputs: np.ndarray, size: int) -> np.ndarray:
        """The results of a function, sample by sample."""
        out = np.full((len(inputs[0]), size), np.nan)
        for i, row in enumerate(out):
            assert self.call(name, *(x[i] for x in inputs), out=row) == OK, name
        return out

    @property
    def home(self) -> np.ndarray:
        """The constant delta_home."""
        number = ctypes.c_double if self.type == np.float64 else ctypes.c_float
        return np.array((number * self.dof).in_dll(self.library, "delta_home"))


def written(
    subject: Model, folder: Path, precision: Precision = DOUBLE, further: tuple[str, ...] = ()
) -> Path:
    """delta.h and delta.c in a folder."""
    code = c_code(subject, "delta", precision, further)
    (folder / "delta.h").write_text(code.text(".h"))
    (folder / "delta.c").write_text(code.text(".c"))
    return folder / "delta.c"


def build(
    subject: Model,
    folder: Path,
    *options: str,
    precision: Precision = DOUBLE,
    further: tuple[str, ...] = (),
) -> Library:
    """The export of a model, compiled with every warning an error."""
    source, library = written(subject, folder, precision, further), folder / "delta.so"
    command = [*COMPILERS["gcc"], *WARNINGS, *options, "-shared", "-fPIC", "-o", library]
    done = subprocess.run([*command, source, "-lm"], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    return Library(library, subject.dynamics.dof, precision)


def assert_same(library: Library, subject: Model, n: int = 40) -> None:
    """Every function against the package, at random states."""
    dynamics, dof = subject.dynamics, subject.dynamics.dof
    share, solved = 1e-12, 1e-11
    z, q, qd, qdd = states(subject, n)
    expected = model(subject, z, qd, qdd)
    tau = library.rows("inverse_dynamics_at", z, qd, qdd, size=dof)
    assert_close(tau, expected.tau, share)
    M = library.rows("mass_matrix", z, size=dof * dof).reshape(-1, dof, dof)
    assert_close(M, expected.M, share)
    assert_close(library.rows("gravity", z, size=dof), expected.g, share)
    assert_close(library.rows("bias", z, qd, size=dof), expected.bias, share)
    J = library.rows("jacobian", z, size=dof * dof).reshape(-1, dof, dof)
    assert_close(J, dynamics.kinematics.jacobian(z), share)
    assert_close(library.rows("inverse_kinematics", z, size=dof), q, share)
    qdd_again = library.rows("forward_dynamics", z, qd, expected.tau, size=dof)
    assert_close(qdd_again, qdd, solved)
    near = z + 0.005 * np.random.default_rng(3).uniform(-1, 1, z.shape)
    for i in range(n):
        pose, torque = near[i].copy(), np.zeros(dof)
        assert library.call("forward_kinematics", q[i], out=pose) == OK
        assert_close(pose, dynamics.kinematics.forward(q[i : i + 1])[0], share)
        pose = near[i].copy()
        status = library.fill("inverse_dynamics", q[i], qd[i], qdd[i], outs=(pose, torque))
        assert status == OK
        assert_close(pose, z[i], share)
        assert_close(torque, expected.tau[i], share)


def assert_each(found: np.ndarray, expected: np.ndarray, share: float) -> None:
    """To a share of each state's own largest entry."""
    for state, other in zip(found, expected, strict=True):
        assert_close(state, other.ravel(), share)


def assert_further(
    library: Library,
    subject: Model,
    z: np.ndarray,
    qd: np.ndarray,
    qdd: np.ndarray,
    share: float = 1e-12,
) -> None:
    """Functions by choice against the package."""
    dynamics, forces = subject.dynamics, ConstraintForces(subject.robot)
    F = library.rows("constraint_forces", z, qd, qdd, size=len(forces.names))
    assert_each(F, forces.evaluate(z, qd, qdd, subject.p), share)
    Y = library.rows("regressor", z, qd, qdd, size=z.shape[1] * len(subject.p))
    q, load = dynamics.kinematics.inverse(z), dynamics.carried(z, qd, qdd, subject.p)
    assert_each(Y, dynamics.regressor(q, qd, qdd, load), share)
    joints = dynamics.kinematics.passive_joints(z, qd)
    x = np.zeros((2, len(z), len(joints.names)))
    assert joints.velocity is not None
    for i in range(len(z)):
        assert library.fill("passive_joints", z[i], qd[i], outs=(x[0, i], x[1, i])) == OK
    assert_each(x[0], joints.position, share)
    assert_each(x[1], joints.velocity, share)
