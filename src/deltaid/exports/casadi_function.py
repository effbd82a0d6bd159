"""A model as one CasADi function in a file, for optimisation and control in CasADi.

    f = casadi.Function.load("delta.casadi")
    tau = f(z=z, qd=qd, qdd=qdd)["tau"]

Called with SX symbols, it is expanded and only what is used stays in the graph. Inputs are task
coordinates z, drive velocities and accelerations, so it has no loops to close and derivatives of
any order.
"""

import tempfile
from pathlib import Path

import casadi as ca

from deltaid.model.model import Model

INPUTS = ("z", "qd", "qdd")
OUTPUTS = ("q", "tau", "M", "C", "g", "f", "J")


def casadi_function(subject: Model) -> ca.Function:
    """(z, q̇, q̈) to q, τ and the terms of M q̈ + C q̇ + g + f = τ, and J = ∂q/∂z; SI units.

    The parameters are numbers in the graph. Friction that depends on load is in τ and not in f.
    """
    e, q = subject.dynamics.equations, subject.dynamics.kinematics.mechanism.q
    terms = [ca.densify(term) for term in (q, e.torque, e.M, e.C, e.g, e.f, e.J)]
    outputs = ca.cse(ca.substitute(terms, [e.p], [ca.SX(ca.DM(subject.p))]))
    return ca.Function("deltaid", [e.z, e.qd, e.qdd], outputs, list(INPUTS), list(OUTPUTS))


def casadi_file(subject: Model) -> bytes:
    """The same as the bytes of a file for `casadi.Function.load`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "function.casadi"
        casadi_function(subject).save(str(path))
        return path.read_bytes()
