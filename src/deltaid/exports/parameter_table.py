"""The parameters of a model as a table of named numbers, and graphs that read it."""

from dataclasses import dataclass

import casadi as ca
import numpy as np

from deltaid.exports.precision import DOUBLE, Precision
from deltaid.exports.straight_line import Array
from deltaid.exports.text import c_comment
from deltaid.model.model import Model


@dataclass(frozen=True)
class ParameterTable:
    """Parameters that are not zero: their names, units and values, and p with symbols for them."""

    rows: list[tuple[str, str, str]]
    array: Array
    p: ca.SX


def parameter_table(subject: Model, name: str, precision: Precision = DOUBLE) -> ParameterTable:
    """The parameters of a model as a C table, without those that are zero."""
    layout, kept = subject.dynamics.layout, np.flatnonzero(subject.p)
    symbols, p = ca.SX.sym("p", len(kept)), ca.SX.zeros(subject.p.size)
    rows = []
    for k, i in enumerate(kept):
        p[int(i)] = symbols[k]
        value = precision.c_number(subject.p[i])
        rows.append((c_comment(layout.names[i]), layout.units[i], value))
    return ParameterTable(rows, Array(name, symbols, is_table=True), p)
