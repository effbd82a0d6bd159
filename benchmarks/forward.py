"""µs a forward dynamics: deltaid, MuJoCo's constrained simulation, Pinocchio's constraintDynamics.

    pip install '.[test,benchmark]'
    python benchmarks/forward.py

CPU times on one core, the median of several repeats, for one 4-DOF Delta with telescope bar. Tool
and rotor have (almost) no inertia and joints no friction, so that all three solve the same
equations; the run fails if Pinocchio's accelerations differ. Counted is:

deltaid    `ForwardDynamics.acceleration` for a batch, a state at a time, and its machine code alone
           for one state; `ForwardDynamics.step`, a time step with friction at rest.
MuJoCo     `mj_forward` of the MJCF export (equality constraints, which are soft; the tool has its
           weight) at the same states, the call from Python counted off, and `mj_step` in C.
Pinocchio  `constraintDynamics` of the tree of `_pinocchio_delta.py` with its twelve closures as
           rigid contacts, called from Python; without the tool that turns with the bar.

MuJoCo and Pinocchio are given coordinates that close the loops.
"""

import ctypes
import sys
import time
from collections.abc import Callable

import _alone  # noqa: F401
import mujoco
import numpy as np
import pinocchio as pin
from _pinocchio_delta import DRIVES, Array, PinocchioDelta
from _timing import machine, measure
from c_code import bare, closed, mujoco_forward
from regressor import random_motion

from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.parameters import parameter_layout, prior_parameters
from deltaid.exports.mjcf import mjcf
from deltaid.kernel.batch import BatchKernel
from deltaid.model.model import Model
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody
from deltaid.robot.load import load_robot

ROBOT, SAMPLES, REPEATS = "irb360-6-1600", 4000, 9
CPU = time.process_time
TOLERANCE = 1e-6
# The tree's joints: what body each carries, and how often.
_LIMB, _REST = ("U", "S"), ("P", "EE", "TU", "TL")


def main() -> int:
    """Measure, check, print; 1 if the accelerations disagree."""
    robot = load_robot(ROBOT)
    forward, dynamics = ForwardDynamics(robot), Dynamics(robot)
    p = without_tool(robot)
    z, qd, _ = random_motion(dynamics, SAMPLES, np.random.default_rng(0))
    zd = forward.task_velocity(z, qd)
    tau = np.random.default_rng(1).uniform(-20, 20, z.shape) * [1, 1, 1, 0.05]
    times = _deltaid(forward, p, z, zd, qd, tau) | _mujoco(robot, z, qd, tau)
    pinocchio, theirs = _pinocchio(robot, p, z, qd, tau)
    times |= pinocchio
    print(f"{machine()}, mujoco {mujoco.__version__}\n{ROBOT}, {SAMPLES} states\n")
    fastest = times["deltaid, acceleration, batch"]
    for name, seconds in times.items():
        print(f"{name:44}{1e6 * seconds:10.3f} µs{seconds / fastest:10.1f}")
    ours = forward.drive_acceleration(forward.drive_coordinates(z), qd, tau, p)
    error = float(np.abs(theirs - ours).max() / np.abs(ours).max())
    print(f"\nlargest relative difference from Pinocchio: {error:.1e}")
    return 0 if error < TOLERANCE else 1


def without_tool(robot: RobotDescription) -> Array:
    """The prior, with a tool and a rotor that hardly weigh, and no friction."""
    p, layout = prior_parameters(robot), parameter_layout(robot)
    p[layout.friction] = 0.0
    p[layout.body("EE")] *= 1e-9
    p[layout.rotor] = 0.0
    return p


def _deltaid(
    forward: ForwardDynamics, p: Array, z: Array, zd: Array, qd: Array, tau: Array
) -> dict[str, float]:
    step = np.append(prior_parameters(forward.robot), 2.5e-4)
    moving, stepping = (np.hstack([z, rate, tau]).T.copy() for rate in (zd, qd))
    return _kernel_times(
        "deltaid, acceleration", forward._acceleration_kernel, moving, p
    ) | _kernel_times("deltaid, step with friction", forward._step_kernel, stepping, step)


def _kernel_times(name: str, kernel: BatchKernel, x: Array, uniform: Array) -> dict[str, float]:
    state = x[:, :1].copy()
    together = measure(lambda: kernel(x, uniform, threads=1), REPEATS, CPU)
    return {
        f"{name}, batch": together / x.shape[1],
        f"{name}, a state at a time": _often(lambda: kernel(state, uniform)),
        f"{name}, kernel alone": _often(_bare(kernel, state, uniform)),
    }


def _bare(kernel: BatchKernel, state: Array, uniform: Array) -> Callable[[], None]:
    """The machine code for one vector of equal states, buffers ready."""
    width = kernel._width
    x, out = np.repeat(state, width, axis=1), np.empty((kernel.n_out, width))
    shared = np.ascontiguousarray(uniform)
    pointers = [ctypes.c_void_p(a.ctypes.data) for a in (out, x, shared)]
    call, length = kernel._kernel.call, ctypes.c_int64(width)

    def run(_keep: tuple = (x, out, shared)) -> None:
        call(pointers[0], length, pointers[1], length, pointers[2], length)

    return run


def _mujoco(robot: RobotDescription, z: Array, qd: Array, tau: Array) -> dict[str, float]:
    """Times over the same states as ours; steps of its own from the home pose."""
    p = prior_parameters(robot)
    p[parameter_layout(robot).friction] = 0.0
    subject = Model(robot, p, ROBOT)
    model = mujoco.MjModel.from_xml_string(bare(mjcf(subject)))
    data = mujoco.MjData(model)
    rows = {"MuJoCo, mj_forward": 1e-6 * mujoco_forward(subject, (z, z, qd, z, tau))}

    def steps() -> None:
        mujoco.mj_resetDataKeyframe(model, data, 0)
        mujoco.mj_step(model, data, nstep=200)

    rows["MuJoCo, mj_step in C from rest"] = measure(steps, REPEATS, CPU) / 200
    return rows


def _pinocchio(
    robot: RobotDescription, p: Array, z: Array, qd: Array, tau: Array
) -> tuple[dict[str, float], Array]:
    """Time of a call, and the drives' accelerations."""
    tree, layout = PinocchioDelta(robot), parameter_layout(robot)
    model = tree.model
    bodies = [name for _ in range(3) for name in _LIMB] + list(_REST)
    for joint, name in enumerate(bodies, start=1):
        count = robot.limbs.struts_per_limb if name == "S" else 1
        body = RigidBody(count * p[layout.body(name)])
        model.inertias[joint] = pin.Inertia(body.mass, body.com, body.about_com)
    frames = ((model.frames[tip], model.frames[seat]) for tip, seat in tree._cuts)
    data, contacts, cache = closed(model, frames)
    motion = tree.motion(z, qd, np.zeros_like(qd))
    forces = np.zeros((len(z), model.nv))
    forces[:, DRIVES] = tau
    found = np.empty((len(z), len(DRIVES)))
    settings = pin.ProximalSettings(1e-12, 0.0, 1)

    def all_states() -> None:
        for i in range(len(z)):
            a = pin.constraintDynamics(
                model, data, motion.q[i], motion.v[i], forces[i], contacts, cache, settings
            )
            found[i] = a[DRIVES]

    return {"Pinocchio, constraintDynamics": measure(all_states, 3, CPU) / len(z)}, found


def _often(function: Callable[[], object], calls: int = 2000) -> float:
    def loop() -> None:
        for _ in range(calls):
            function()

    return measure(loop, REPEATS, CPU) / calls


if __name__ == "__main__":
    sys.exit(main())
