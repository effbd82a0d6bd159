"""The test of exported structured text: torques at some states beside those of Python."""

import numpy as np
from jaxtyping import Float

from deltaid.exports.st_statements import literal
from deltaid.exports.st_units import Unit, Variable, array_types, comments
from deltaid.exports.st_writer import TABLE, Writer, each
from deltaid.exports.text import SINGLE, Precision
from deltaid.model.model import Model


def st_test(
    subject: Model,
    prefix: str,
    precision: Precision,
    vectors: tuple[Float[np.ndarray, "states dof"], ...],
) -> str:
    """PREFIX_test, which calls PREFIX_inverse_dynamics_at once for each vector.

    Args:
        vectors: z, q̇, q̈ and τ, one state a row.
    """
    writer, numbers = Writer(subject, prefix, precision), np.hstack(vectors)
    count, dof = vectors[0].shape
    table = writer.table(
        "test_vectors", "z, qd, qdd, tau of each state.", numbers.ravel().tolist(), ()
    )
    units = (table, _block(writer, prefix, count, dof))
    types = [array.text() for array in array_types(units) if array.size != dof]  # as PREFIX.st has
    head = comments([f"Checks {prefix}.st, which it needs; call {prefix}_test once."])
    return "\n".join([*head, "", *types, *(unit.text() for unit in units)])


def _block(writer: Writer, prefix: str, count: int, dof: int) -> Unit:
    share = literal(writer.precision, 1e-5 if writer.precision is SINGLE else 1e-12)
    width = 4 * dof
    read = [
        f"{name}[i] := numbers[first + i + {k * dof}];"
        if k
        else f"{name}[i] := numbers[first + i];"
        for k, name in enumerate(("z", "qd", "qdd", "wanted"))
    ]
    inner = [
        f"first := {width} * k;",
        *each(dof, " ".join(read)),
        f"status := {prefix}_inverse_dynamics_at(z := z, qd := qd, qdd := qdd, tau => tau);",
        "scale := 0.0;",
        *each(dof, "IF ABS(wanted[i]) > scale THEN scale := ABS(wanted[i]); END_IF;"),
        "gap := 0.0;",
        *each(dof, "off := ABS(tau[i] - wanted[i]); IF off > gap THEN gap := off; END_IF;"),
        f"IF (status = {writer.status('OK')}) AND (gap <= {share} * scale) THEN",
        "    passed := passed + 1;",
        "ELSE",
        "    failed := failed + 1;",
        "END_IF;",
        "IF gap > largest * scale THEN largest := gap / scale; END_IF;",
    ]
    real = writer.precision.st_type
    return Unit(
        "FUNCTION_BLOCK",
        f"{prefix}_test",
        "",
        (f"Compares torques at {count} states with those of Python.",),
        (),
        (Variable("passed", "INT"), Variable("failed", "INT"), Variable("largest", real)),
        (
            writer.array("numbers", width * count),
            *(writer.array(name, dof) for name in ("z", "qd", "qdd", "wanted", "tau")),
            *(Variable(name, real) for name in ("scale", "gap", "off")),
            *(Variable(name, "INT") for name in ("i", "k", "first", "status")),
        ),
        (),
        real,
        (
            f"i := {prefix}_test_vectors({TABLE} => numbers);",
            "passed := 0;",
            "failed := 0;",
            "largest := 0.0;",
            f"FOR k := 0 TO {count - 1} DO",
            *(f"    {line}" for line in inner),
            "END_FOR;",
        ),
    )
