"""Samples a second of the regressor kernel for every mechanism of the catalogue, on one core.

    pip install deltaid[benchmark]
    python benchmarks/mechanisms.py

Counted is the kernel of the regressor's structurally nonzero entries on random motions, as in
`regressor.py`: one thread, CPU time, compiling not counted. Operations are the scalar operations
of the graph that is compiled, so that a mechanism's time can be set against its size: 'per
operation' is that time relative to the 4-DOF Delta. Forward kinematics is timed on a recording of
the same motion: closed form for three limbs on one platform, Newton's method for all others.
"""

import argparse
import os
import time

os.environ["OMP_NUM_THREADS"] = "1"  # before NumPy comes in, so that one core is one core
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from _timing import machine, measure

from deltaid.dynamics.dynamics import Dynamics
from deltaid.motion.random_motion import random_motion
from deltaid.robot.load import catalogue, load_robot

REFERENCE = "irb360-6-1600"
CPU = time.process_time


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--samples", type=int, default=50_000)
    samples = parser.parse_args().samples
    print(machine(), "\n")
    names = [REFERENCE, *(name for name in catalogue() if name != REFERENCE)]
    rows = [measured(name, samples) for name in names]
    reference = rows[0][2]
    head = ("robot", "operations", "million/s", "ns/sample", "per operation", "forward, million/s")
    print("{:<24}{:>12}{:>12}{:>12}{:>15}{:>20}".format(*head))
    for name, operations, per_operation, rate, forward in rows:
        print(
            f"{name:<24}{operations:>12}{rate / 1e6:>12.2f}{1e9 / rate:>12.0f}"
            f"{per_operation / reference:>15.2f}{forward / 1e6:>20.2f}"
        )


def measured(name: str, samples: int) -> tuple[str, int, float, float, float]:
    """Operations of the graph, time an operation [s], samples a second of regressor and FK."""
    dynamics = Dynamics(load_robot(name))
    motion = random_motion(dynamics.kinematics, np.random.default_rng(0))
    z, zd, zdd = motion.evaluate(np.linspace(0, motion.period, samples))
    q, qd, qdd = dynamics.kinematics.drive_motion(z, zd, zdd)
    kernel, inputs = dynamics._regressor_kernel, np.hstack([z, qd, qdd]).T.copy()
    operations = kernel.function.n_instructions() - kernel.n_in - kernel.n_out
    seconds = measure(lambda: kernel(inputs, threads=1), repeats=15, clock=CPU)
    forward = measure(lambda: dynamics.kinematics.forward_unchecked(q), clock=CPU)
    return name, operations, seconds / samples / operations, samples / seconds, samples / forward


if __name__ == "__main__":
    main()
