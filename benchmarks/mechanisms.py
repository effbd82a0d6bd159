"""Nanoseconds a sample of every kernel for every mechanism of the catalogue, on one core.

    pip install '.[benchmark]'
    python benchmarks/mechanisms.py

Counted are the kernels of the regressor's nonzero entries, of inverse dynamics, of the mass matrix
and of all terms of (1), on random motions of as many samples as a window of a recording has: one
thread, CPU time, compiling not counted. Operations are the scalar operations of the graph that is
compiled, so that a time can be set against the graph's size. Forward kinematics is timed on the
same motion: closed form for three limbs on one platform, Newton's method for all others.
"""

import time

import _alone  # noqa: F401
import numpy as np
from _timing import machine, measure, options

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.kernel.batch import BatchKernel
from deltaid.robot.load import catalogue, load_robot
from support import along

CPU = time.process_time


def main() -> None:
    samples = options(__doc__, samples=8_000).samples
    print(f"{machine()}\noperations, ns/sample\n")
    head = ("regressor", "torque", "mass matrix", "terms")
    print(f"{'robot':<18}{''.join(f'{name:>14}' for name in head)}{'forward, ns':>14}")
    for name in catalogue():
        cells, forward = measured(name, samples)
        row = "".join(f"{operations:>8} {1e9 * seconds:>5.0f}" for operations, seconds in cells)
        print(f"{name:<18}{row}{1e9 * forward:>14.0f}")


def measured(name: str, samples: int) -> tuple[list[tuple[int, float]], float]:
    """Operations and seconds a sample of each kernel, seconds a sample of forward kinematics."""
    robot = load_robot(name)
    dynamics, p = Dynamics(robot), prior_parameters(robot)
    z, q, qd, qdd = along(dynamics.kinematics, np.random.default_rng(0), samples)
    cells = [
        timed(dynamics._regressor_kernel, (z, qd, qdd), None),
        timed(dynamics._torque_kernel, (z, qd, qdd), p),
        timed(dynamics._mass_kernel, (z,), p),
        timed(dynamics._terms_kernel, (z, qd), p),
    ]
    forward = measure(lambda: dynamics.kinematics.forward_unchecked(q), clock=CPU)
    return cells, forward / samples


def timed(
    kernel: BatchKernel, inputs: tuple[np.ndarray, ...], p: np.ndarray | None
) -> tuple[int, float]:
    """Operations of a kernel's graph and seconds a sample."""
    x = np.hstack(inputs).T.copy()
    extra = kernel.n_in + kernel.n_out + kernel.n_uniform
    seconds = measure(lambda: kernel(x, p, threads=1), repeats=51, clock=CPU)
    return kernel.function.n_instructions() - extra, seconds / x.shape[1]


if __name__ == "__main__":
    main()
