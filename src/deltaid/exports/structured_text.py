"""IEC 61131-3 structured text of a model: the functions of the C export, as one file.

Functions return a status and have their results as outputs, which are valid only if it is OK.
Functions that keep the pose z or a state between cycles are function blocks. No floating-point
exception occurs, because some controllers would stop (`st_statements`): inputs that are too large
for any robot are refused, and divisors and radicands are checked.
"""

import re
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from deltaid.errors import DeltaidError
from deltaid.exports.model_functions import DEFAULT, code_parts
from deltaid.exports.st_units import (
    PlcProgram,
    Unit,
    Variable,
)
from deltaid.exports.st_writer import STATUSES, Writer
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.model.model import Model
from deltaid.online.settings import OnlineSettings


def plc_program(
    subject: Model,
    prefix: str,
    precision: Precision = DOUBLE,
    further: tuple[str, ...] = (),
    online: OnlineSettings = DEFAULT,
) -> PlcProgram:
    """The units of a model; their names begin with PREFIX_.

    Args:
        further: names of additional functions (`options.FURTHER`).
        online: settings of the function of that name.

    Raises:
        DeltaidError: the prefix is no identifier, or the robot lacks what an additional function
            needs.
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", prefix) or len(prefix) > 20:
        raise DeltaidError(
            f"'{prefix[:60]}' cannot begin the names of functions of structured text",
            where="name of the output",
            cure="use at most 20 letters, digits and single _ between them, a letter first",
        )
    table, functions, cycles, care = code_parts(subject, "p", precision, further, online)
    writer, real = Writer(subject, prefix, precision, care), precision.st_type
    what = "The parameters of the model that are not 0: change a mass here."
    notes = [f"{name}, {unit}" for name, unit, _ in table.rows]
    units = [
        *writer.helpers(),
        writer.table("parameters", what, subject.p[subject.p != 0].tolist(), notes),
        writer.table("home", "A pose z in the middle of the workspace.", subject.home.tolist()),
        *(writer.pairs() if precision is SINGLE else ()),
        *(writer.block(f) if f.after else writer.function(f) for f in functions),
        *(unit for cycle in cycles for unit in writer.cycle(cycle)),
    ]
    conventions = (
        f"IEC 61131-3 structured text, {real}. Functions return a status; their outputs mean "
        "something only where that is 0:"
    )
    codes = (
        f"  {code} {name}{f': {text}' if text else ''}" for name, (code, text) in STATUSES.items()
    )
    head = (subject.provenance, conventions, *codes, *quantities(subject))
    return PlcProgram(prefix, head, units, real)


def quantities(subject: Model) -> list[str]:
    """Coordinates of drives and task in words, with their units."""
    units = subject.robot.drive_units
    turn = ", turn psi of the tool [rad]" if subject.dynamics.dof > 3 else ""
    return [
        "Drive coordinates q, rates qd, qdd, torques tau, in the order of the drives:",
        *(
            f"  [{k}] {drive}: {u.coordinate}, {u.coordinate}/s, {u.coordinate}/s^2, {u.force}"
            for k, (drive, u) in enumerate(units.items())
        ),
        "at the joint, behind the gear; positive as in docs/conventions.md of deltaid.",
        f"Task coordinates z: x, y, z of the platform point in the world [m]{turn}.",
        "Equation of motion: M(q) qdd + C(q, qd) qd + g(q) + f(qd) = tau.",
    ]


def st_test(
    subject: Model,
    prefix: str,
    precision: Precision,
    states: Mapping[str, Float[np.ndarray, "states dof"]],
) -> str:
    """PREFIX_test, which calls PREFIX_inverse_dynamics_at once for each vector.

    It compares its torques with those of Python.

    Args:
        states: z, qd, qdd and tau, one state per row.
    """
    writer, names = Writer(subject, prefix, precision), ("z", "qd", "qdd", "tau")
    numbers, note = np.hstack([states[x] for x in names]), f"{', '.join(names)} of each state."
    (count, dof), share = states["z"].shape, 1e-5 if precision is SINGLE else 1e-12
    name = f"{prefix}_test"
    block = Unit(
        name,
        "",
        [f"Compares torques at {count} states with those of Python."],
        (),
        [Variable("passed", "INT"), Variable("failed", "INT"), *writer.reals("largest")],
        [
            writer.array("numbers", numbers.size),
            *(writer.array(array, dof) for array in ("z", "qd", "qdd", "wanted", "tau")),
            *writer.reals("scale gap off"),
            *(Variable(number, "INT") for number in ("i", "k", "first", "status")),
        ],
        writer.body("test", name, count=count, share=share),
    )
    head = [f"Checks {prefix}.st, which it needs; call {prefix}_test once."]
    units = [writer.table("test_vectors", note, numbers.ravel().tolist()), block]
    # Array types that PREFIX.st declares.
    return PlcProgram(prefix, head, units, precision.st_type, declared=(dof,)).text
