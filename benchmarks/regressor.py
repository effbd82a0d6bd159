"""Regressor evaluations a second on one core: deltaid, CasADi's map, Pinocchio's route.

    pip install '.[benchmark]'
    python benchmarks/regressor.py

At the same random motions of one 4-DOF Delta; CPU time, with two threads wall time. Counted is:

deltaid    `Dynamics.sparse_regressor(z, q̇, q̈)`: stacking the inputs, allocating the output, all
           144 structurally nonzero entries of Y, loop closure included. Compiling is not.
CasADi     a serial `Function.map` of that function through CasADi's buffer interface on
           preallocated arrays, its fastest call.
Pinocchio  for each sample `computeJointTorqueRegressor` of the spanning tree and the product with
           Gᵀ, G = ∂(tree velocities)/∂(drive velocities), then the sum over identical limbs'
           columns; no friction or rotor columns. Loop closure is NOT counted; a line of its own
           has the speed with it (NumPy over Pinocchio's Jacobians).

The run fails if Pinocchio's projected regressor and deltaid's inertial columns differ.
"""

import sys
import time
from collections.abc import Callable

import _alone  # noqa: F401
import casadi as ca
import numpy as np
from _pinocchio_delta import BODIES, PARAMETER_ORDER, Array, PinocchioDelta, TreeMotion
from _timing import machine, measure, options

from deltaid.dynamics.dynamics import Dynamics, SparseRegressor
from deltaid.robot.load import load_robot

ROBOT = "irb360-6-1600"
TOLERANCE = 1e-9  # relative, and for the loops' gaps in metres

OURS, OURS_2 = "a   deltaid", "a2  deltaid, 2 threads"
CASADI = "b   CasADi's map"
PINOCCHIO, PINOCCHIO_CLOSED = "c   Pinocchio, projected", "c+  the same with loop closure"

CPU = time.process_time
Motion = tuple[Array, Array, Array]


def main() -> int:
    """Measure, check, print; 1 if the regressors disagree."""
    arguments = options(__doc__, samples=8_000, repeats=7, seed=0)
    dynamics = Dynamics(load_robot(ROBOT))
    motion = random_motion(dynamics, arguments.samples, np.random.default_rng(arguments.seed))
    tree = PinocchioDelta(dynamics.robot)
    closed = tree.motion(*motion)
    mapped, casadi_result = casadi_map(dynamics._regressor_kernel.function, motion)
    speeds = _ours(dynamics, motion, arguments.repeats)
    speeds[CASADI] = arguments.samples / measure(mapped, arguments.repeats, CPU)
    speeds |= _pinocchio(tree, closed, motion, arguments.repeats)
    repeats = f"median of {arguments.repeats} (a, a2: of {10 * arguments.repeats})"
    print(f"{machine()}\n{ROBOT}, {arguments.samples} samples, {repeats}\n")
    _print_table(speeds)
    ours = dynamics.sparse_regressor(*motion)
    errors = {
        "CasADi's map": largest_difference(casadi_result, ours.values.T),
        "Pinocchio": largest_difference(*_inertial_columns(dynamics, ours, tree, closed)),
    }
    return _verdict(errors, tree.largest_gap(closed))


def random_motion(dynamics: Dynamics, samples: int, rng: np.random.Generator) -> Motion:
    """Task coordinates all over the workspace, drive velocities and accelerations of brisk work."""
    space = dynamics.robot.workspace
    radius = space.radius * np.sqrt(rng.uniform(0, 1, samples))
    azimuth, psi = rng.uniform(-np.pi, np.pi, (2, samples))
    height = rng.uniform(*space.z, samples)
    z = np.column_stack([radius * np.cos(azimuth), radius * np.sin(azimuth), height, psi])
    dynamics.kinematics.inverse(z)  # raises if a pose is out of reach
    qd, qdd = rng.standard_normal((2, samples, dynamics.dof))
    return z, 3.0 * qd, 50.0 * qdd


def casadi_map(function: ca.Function, motion: Motion) -> tuple[Callable[[], None], Array]:
    """A call of CasADi's serial map over all samples, and the array that it fills."""
    x = np.hstack(motion)  # a sample a row, which is a column to CasADi
    out = np.empty((len(x), function.numel_out(0)))
    buffer, evaluate = function.map(len(x)).buffer()
    buffer.set_arg(0, x.data)
    buffer.set_res(0, out.data)

    def call(_keep: tuple[object, ...] = (buffer, x)) -> None:  # `evaluate` points into them only
        evaluate()

    return call, out


def largest_difference(a: Array, b: Array) -> float:
    """Largest difference between two arrays, relative to the largest of its column (last axis).

    A column smaller than a thousandth of the largest column counts as that big: some columns are
    zero up to rounding and have no size of their own.
    """
    size = np.abs(b).reshape(-1, b.shape[-1]).max(axis=0)
    return float((np.abs(a - b) / np.maximum(size, 1e-3 * size.max())).max())


def _ours(dynamics: Dynamics, motion: Motion, repeats: int) -> dict[str, float]:
    """Samples a second of deltaid with one and with two threads.

    `sparse_regressor` itself has no choice of threads; this is its body. It is called ten times as
    often as the others, as its calls are so short that other work on the machine disturbs them.
    """
    kernel, samples = dynamics._regressor_kernel, len(motion[0])
    one_thread = measure(lambda: kernel(np.hstack(motion).T, threads=1), 10 * repeats, CPU)
    two_threads = measure(lambda: kernel(np.hstack(motion).T, threads=2), 10 * repeats)
    return {OURS: samples / one_thread, OURS_2: samples / two_threads}


def _pinocchio(
    tree: PinocchioDelta, closed: TreeMotion, motion: Motion, repeats: int
) -> dict[str, float]:
    """Samples a second of Pinocchio's route, without and with loop closure."""
    samples = len(motion[0])
    projected = measure(lambda: tree.regressor(closed), repeats, CPU)
    closure = measure(lambda: tree.motion(*motion), 1, CPU)
    return {PINOCCHIO: samples / projected, PINOCCHIO_CLOSED: samples / (projected + closure)}


def _inertial_columns(
    dynamics: Dynamics, ours: SparseRegressor, tree: PinocchioDelta, closed: TreeMotion
) -> tuple[Array, Array]:
    """Pinocchio's and deltaid's inertial columns, in deltaid's order."""
    bodies = dynamics.layout.bodies
    order = [10 * BODIES.index(body) + entry for body in bodies for entry in PARAMETER_ORDER]
    theirs = tree.regressor(closed)[:, :, order]
    Y = np.zeros((len(theirs), dynamics.dof, len(dynamics.layout.names)))
    Y[:, ours.rows, ours.columns] = ours.values.T
    return theirs, Y[:, :, : len(order)]


def _print_table(speeds: dict[str, float]) -> None:
    print(f"{'':30} {'samples/s':>12} {'a is faster by':>15}")
    for name, speed in speeds.items():
        ratio = "" if name == OURS else f"{speeds[OURS] / speed:15.2f}"
        print(f"{name:30} {speed:12,.0f} {ratio}")
    print("One core each, but for a2. Loop closure is counted in a, b and c+, not in c.")


def _verdict(errors: dict[str, float], gap: float) -> int:
    """Print how far the others' regressors are from deltaid's; 1 if too far."""
    print()
    for name, error in errors.items():
        print(f"largest relative difference from {name}: {error:.1e}")
    print(f"largest gap where the tree was cut: {gap:.1e} m")
    bad = [name for name, error in errors.items() if not error < TOLERANCE]
    bad += ["the tree's loops"] if not gap < TOLERANCE else []
    if bad:
        print(f"DISAGREEMENT beyond {TOLERANCE:g}: {', '.join(bad)}", file=sys.stderr)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
