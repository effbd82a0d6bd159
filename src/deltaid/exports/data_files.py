"""Python files of a model: numpy arrays in one .npz file, and a CasADi function.

`numpy.load` opens the arrays without pickle. All quantities are in SI units: rad or m, N m or N.
Equal rows of `bodies`, `mass`, `com` and the tensors belong to one body, or to several that share
its parameters.

The function is for optimisation and control in CasADi:

    f = casadi.Function.load("delta.casadi")
    tau = f(z=z, qd=qd, qdd=qdd)["tau"]

A call with SX symbols expands it, and only what is used stays in the graph. Inputs are task
coordinates z, drive velocities and accelerations, so no loop has to be closed and derivatives of
any order exist.
"""

import io
import tempfile
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from deltaid.dynamics.limits import effort_limits
from deltaid.model.model import Model
from deltaid.robot.inertia import RigidBody


def model_arrays(subject: Model) -> dict[str, np.ndarray]:
    """Arrays by name; docs/export.md describes each one.

    Limits that the description does not set are infinite.
    """
    robot, layout = subject.robot, subject.dynamics.layout
    bodies = [RigidBody(subject.body(name)) for name in layout.bodies]
    # Bodies of the robot, some of which share parameters.
    moved = subject.dynamics.kinematics.mechanism.bodies
    limits = [robot.limits_of(drive) for drive in robot.drives]
    terms = robot.friction_terms
    return {
        "robot": np.array(robot.name),
        "provenance": np.array(subject.provenance),
        "p": subject.p,
        "names": np.array(layout.names),
        "units": np.array(layout.units),
        "bodies": np.array(layout.bodies),
        "count": np.array(
            [sum(body.count for body in moved if body.name == name) for name in layout.bodies]
        ),
        "mass": np.array([body.mass for body in bodies]),
        "com": np.array([body.com for body in bodies]),
        "inertia_about_link": np.array([body.about_link for body in bodies]),
        "inertia_about_com": np.array([body.about_com for body in bodies]),
        "friction_kind": np.array([term.kind for term in terms], dtype=np.str_),
        "friction_joint": np.array([term.joint for term in terms], dtype=np.str_),
        "friction_coefficient": subject.p[layout.friction],
        "friction_exponent": np.array([term.exponent for term in terms]),
        "friction_speed": np.array([term.speed for term in terms]),
        "spring_joint": np.array(robot.spring_joints, dtype=np.str_),
        "spring_stiffness": subject.p[layout.spring],
        "spring_rest": np.array([robot.spring_rest(joint) for joint in robot.spring_joints]),
        "rotor_inertia": np.array([subject.value(f"rotor.{drive}") for drive in robot.drives]),
        "drives": np.array(robot.drives),
        "drive_is_linear": np.array(robot.linear_drives),
        "drive_range": np.array([l.range or (-np.inf, np.inf) for l in limits]),
        "drive_speed": np.array([l.top_speed or np.inf for l in limits]),
        "drive_effort": effort_limits(robot),
        "gravity": np.array(robot.gravity),
        "home": subject.home,
    }


def npz_file(subject: Model) -> bytes:
    """The same arrays as the bytes of an .npz file."""
    file, arrays = io.BytesIO(), dict[str, Any](model_arrays(subject))
    np.savez(file, **arrays)
    return file.getvalue()


_INPUTS = ["z", "qd", "qdd"]
_OUTPUTS = ["q", "tau", "M", "C", "g", "f", "J"]


def casadi_file(subject: Model) -> bytes:
    """The bytes of a file for `casadi.Function.load`: a function of z, q̇ and q̈ that returns q, τ,
    the terms of M q̈ + C q̇ + g + f = τ, and J = ∂q/∂z; SI units.

    The parameters are numbers in the graph. Load-dependent friction is in τ but not in f.
    """
    e, q = subject.dynamics.equations, subject.dynamics.kinematics.mechanism.q
    terms = [ca.densify(term) for term in (q, e.torque, e.M, e.C, e.g, e.f, e.J)]
    outputs = ca.cse(ca.substitute(terms, [e.p], [ca.SX(ca.DM(subject.p))]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "function.casadi"
        ca.Function("deltaid", [e.z, e.qd, e.qdd], outputs, _INPUTS, _OUTPUTS).save(str(path))
        return path.read_bytes()
