"""Microseconds a call of the exported C code, beside MuJoCo and Pinocchio on the same robot.

    pip install '.[test,benchmark]'
    python benchmarks/c_code.py

One thread, processor time. Every function is called with states of a motion through the workspace,
1 ms apart, forward kinematics from the pose of the call before. The first figure is the mean over
all states in the best of many rounds, the one in brackets the slowest state at the best of many
calls. `--native` compiles for this machine's instructions, `--single` takes single precision.

Beside it, forward dynamics of the MJCF and URDF exports with loops closed, without friction:
MuJoCo's mj_forward (soft constraints), and Pinocchio's constraintDynamics (proximal, only for
robots without couplings of joints), the call from Python counted off.
"""

import json
import time
from collections.abc import Iterable
from xml.etree import ElementTree as ET

import _alone  # noqa: F401
import mujoco
import numpy as np
import pinocchio as pin
from _c_program import printed
from _timing import machine, options

from deltaid.dynamics.parameters import prior_parameters
from deltaid.exports.c_code import c_code
from deltaid.exports.mjcf import mjcf
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.exports.urdf import urdf
from deltaid.model.model import Model
from deltaid.robot.load import catalogue, load_robot
from exports import configuration, tree_motion
from support import along

STATES, ROUNDS = 1000, 200
FUNCTIONS = (
    ("FK", "status |= r_forward_kinematics(q + i * D, z);"),
    ("ID from z", "r_inverse_dynamics_at(zs + i * D, qd + i * D, qdd + i * D, out);"),
    ("ID from q", "status |= r_inverse_dynamics(q + i * D, qd + i * D, qdd + i * D, z, out);"),
    ("M", "r_mass_matrix(zs + i * D, out);"),
    ("bias", "r_bias(zs + i * D, qd + i * D, out);"),
    ("FD from z", "status |= r_forward_dynamics(zs + i * D, qd + i * D, tau + i * D, out);"),
)
MAIN = """
#define D R_DOF
int main(void)
{{
    static {real} x[5][{states} * D], out[D * D], z[D];
    {real} *zs = x[0], *q = x[1], *qd = x[2], *qdd = x[3], *tau = x[4];
    const double clock = clock_cost();
    volatile double sum = 0;
    int i, k, status = 0;
    FILE *file = fopen("data", "rb");
    if (!file || fread(x, sizeof x, 1, file) != 1)
        return 1;
{parts}
    (void)qdd; (void)tau; (void)sum;
    return status;
}}
"""
PART = """
    {{
        double best = 1e9, worst = 0;
        for (k = 0; k < {rounds}; ++k) {{
            double t;
            for (i = 0; i < D; ++i)
                z[i] = zs[i];
            t = -now();
            for (i = 0; i < {states}; ++i) {{
                {call}
                sum += out[0] + z[0];
            }}
            t += now();
            if (t < best)
                best = t;
        }}
        for (i = 0; i < D; ++i)
            z[i] = zs[i];
        for (i = 0; i < {states}; ++i) {{
            {real} kept[D];
            double least = 1e9, t;
            for (k = 0; k < D; ++k)
                kept[k] = z[k];
            for (k = 0; k < {rounds} / 10; ++k) {{
                int j, times;
                t = -now();
                for (times = 0; times < 10; ++times) {{
                    for (j = 0; j < D; ++j)
                        z[j] = kept[j];
                    {call}
                    sum += out[0] + z[0];
                }}
                t = (t + now() - clock) / 10;
                if (t < least)
                    least = t;
            }}
            if (least > worst)
                worst = least;
        }}
        printf("%g %g\\n", best / {states}, worst);
    }}
"""


def main() -> None:
    given = options(__doc__, robots=list(catalogue()), single=False, native=False)
    flags = ["-O2", *(["-march=native"] if given.native else [])]
    precision = SINGLE if given.single else DOUBLE
    print(machine(), "\n")
    head = [f"{name:>15}" for name, _ in FUNCTIONS]
    print(f"{'mean (slowest), us':<18}{''.join(head)}{'mj_forward':>12}{'Pinocchio':>11}")
    for name in given.robots:
        robot = load_robot(name)
        subject = Model(robot, prior_parameters(robot), name)
        states = along_a_motion(subject)
        times = in_c(subject, states, flags, precision)
        cells = "".join(f"{f'{mean:.2f} ({worst:.2f})':>15}" for mean, worst in times)
        pinocchio = pinocchio_forward(subject, states)
        shown = f"{pinocchio:.1f}" if pinocchio else "–"
        print(f"{name:<18}{cells}{mujoco_forward(subject, states):>12.1f}{shown:>11}")


def along_a_motion(subject: Model) -> tuple[np.ndarray, ...]:
    """z, q, q̇, q̈, τ of a random motion at 1 kHz, a controller's rate."""
    dynamics = subject.dynamics
    z, q, qd, qdd = along(dynamics.kinematics, np.random.default_rng(0), 1e-3 * np.arange(STATES))
    return z, q, qd, qdd, dynamics.torque(z, qd, qdd, subject.p)


def in_c(
    subject: Model, states: tuple[np.ndarray, ...], flags: list[str], precision: Precision
) -> list[list[float]]:
    """Best mean and slowest state's time [µs] of every function."""
    code, real = c_code(subject, "r", precision), precision.c_type
    numbers = {"states": STATES, "real": real}
    parts = [PART.format(call=call, rounds=ROUNDS, **numbers) for _, call in FUNCTIONS]
    flat = np.concatenate([part.ravel() for part in states])
    main = MAIN.format(parts="".join(parts), **numbers)
    return printed(code, main, flat, precision, *flags)


def tree_states(
    subject: Model, states: tuple[np.ndarray, ...], names: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and rates of the tree's joints."""
    z, _, qd, *_ = states
    motions = [tree_motion(subject, names, (*row, 0 * row[1])) for row in zip(z, qd, strict=True)]
    return np.array([motion.x for motion in motions]), np.array([motion.v for motion in motions])


def bare(mjcf: str) -> str:
    """The same model without tendons, which draw the struts, and without sensors."""
    root = ET.fromstring(mjcf)
    for name in ("tendon", "sensor"):
        for element in root.findall(name):
            root.remove(element)
    return ET.tostring(root, encoding="unicode")


def mujoco_forward(subject: Model, states: tuple[np.ndarray, ...]) -> float:
    """Best mean time [µs] of mj_forward."""
    model = mujoco.MjModel.from_xml_string(bare(mjcf(subject.without_friction())))
    data = mujoco.MjData(model)
    names = [model.joint(j).name for j in range(model.njnt)]
    positions, rates = tree_states(subject, states, names)
    drives = [names.index(drive) for drive in subject.robot.drives]

    def rounds(step: bool) -> float:
        start = time.process_time()
        for x, v, tau in zip(positions, rates, states[4], strict=True):
            data.qpos, data.qvel, data.qfrc_applied[drives] = x, v, tau
            if step:
                mujoco.mj_forward(model, data)
        return time.process_time() - start

    empty = min(rounds(False) for _ in range(5))
    return 1e6 * (min(rounds(True) for _ in range(10)) - empty) / len(positions)


def closed(
    model: "pin.Model", pairs: Iterable[tuple["pin.Frame", "pin.Frame"]]
) -> tuple["pin.Data", "pin.StdVec_RigidConstraintModel", "pin.StdVec_RigidConstraintData"]:
    """A tree whose pairs of frames coincide, ready for constraintDynamics."""
    contacts, found = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for a, b in pairs:
        contact = pin.RigidConstraintModel(
            pin.ContactType.CONTACT_3D, model, a.parentJoint, a.placement, b.parentJoint,
            b.placement, pin.ReferenceFrame.LOCAL,
        )  # fmt: skip
        contacts.append(contact)
        found.append(contact.createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, contacts, found)
    return data, contacts, found


def pinocchio_forward(subject: Model, states: tuple[np.ndarray, ...]) -> float | None:
    """Best mean time [µs] of constraintDynamics; None where joints follow others."""
    export = urdf(subject.without_friction())
    loops = json.loads(export.text(".loops.json"))
    if any(pair["joint"] != "tool" for pair in loops["following_joints"]):
        return None
    model = pin.buildModelFromXML(export.text(".urdf"))
    kept = loops["drawn_joints"]  # and a tool that turns with a drive, at rest
    kept = [*kept, *(pair["joint"] for pair in loops["following_joints"])]
    locked = [model.getJointId(name) for name in kept]
    model = pin.buildReducedModel(model, locked, pin.neutral(model))
    for name, inertia in loops["armature"].items():
        model.armature[model.joints[model.getJointId(name)].idx_v] = inertia
    frames = ([model.frames[model.getFrameId(name)] for name in pair["frames"]]
              for pair in loops["coincident_frames"])  # fmt: skip
    data, contacts, found = closed(model, frames)
    settings = pin.ProximalSettings(1e-10, 1e-10, 10)
    names = sorted(list(model.names)[1:], key=lambda n: model.joints[model.getJointId(n)].idx_v)
    positions, rates = tree_states(subject, states, names)
    q = np.array([configuration(model, dict(zip(names, x, strict=True))) for x in positions])
    drives = [names.index(drive) for drive in subject.robot.drives]
    forces = np.zeros((STATES, model.nv))
    forces[:, drives] = states[4]

    def rounds() -> float:
        start = time.process_time()
        for x, v, tau in zip(q, rates, forces, strict=True):
            pin.constraintDynamics(model, data, x, v, tau, contacts, found, settings)
        return time.process_time() - start

    def empty() -> float:
        start = time.process_time()
        for x, v, _ in zip(q, rates, forces, strict=True):
            pin.normalize(model, x)
            v.sum()
        return time.process_time() - start

    return 1e6 * (min(rounds() for _ in range(10)) - min(empty() for _ in range(5))) / STATES


if __name__ == "__main__":
    main()
