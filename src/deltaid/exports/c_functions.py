"""What the templates of C ask of the entries of a function table."""

import textwrap

import casadi as ca

from deltaid.exports.digits import Care
from deltaid.exports.functions import ExportedCycle, ExportedFunction, Newton
from deltaid.exports.straight_line import Array, straight_line, wrapped
from deltaid.exports.text import Precision, c_comment, plain_letters
from deltaid.online.layout import Field, Layout


def function_texts(
    f: ExportedFunction, prefix: str, dof: int, precision: Precision, care: Care | None
) -> dict[str, object]:
    """What the templates ask of a function."""
    real, size = precision.c_type, sum(output.size for output in f.outputs)
    inputs = [(array.name, array.symbols.numel()) for array in f.arguments]
    outputs = [(output.name, output.size) for output in f.outputs]
    if f.after:  # its own arguments, the pose that it finds, and what it hands on
        outputs = [("z", dof), ("tau", dof)]
    signature = [f"const {real} {name}[{n}]" for name, n in inputs]
    signature += [f"{real} {name}[{n}]" for name, n in outputs]
    declaration = f"int {prefix}_{f.name}({', '.join(signature)})"
    offsets = [sum(n for _, n in outputs[:k]) for k in range(len(outputs))]
    handed = ["pose", *(name for name, _ in inputs if name != "q" or f.closing), "tau"]
    return {
        "declaration": "\n".join(wrapped(declaration)),
        "comment": _comment(f),
        "after": f.after,
        "passed": ", ".join(handed),
        "inner": f.name,
        "given": ", ".join(name for name, _ in inputs),
        "checked": [*inputs, *([(outputs[0])] if f.newton else [])],
        "newton": _newton(f, f.newton, precision) if f.newton else None,
        "texts": [] if f.after else _straight(f, precision, care),
        "size": f.everything.numel(),
        "results": size,
        "demands": _demands(f, size, precision),
        "unfit": f.unfit,
        "outputs": [(n, at, k) for (n, k), at in zip(outputs, offsets, strict=True)],
    }


def _newton(f: ExportedFunction, newton: Newton, precision: Precision) -> dict[str, object]:
    return {
        "name": f.outputs[0].name,
        "size": newton.x.numel(),
        "steps": newton.steps,
        "last": precision.c_number(newton.last),
        "closed": precision.c_number(newton.closed),
    }


def _straight(f: ExportedFunction, precision: Precision, care: Care | None) -> list[str]:
    """The static functions that compute outputs and demands, and the steps to them."""
    inputs, steps = list(f.inputs), []
    if f.newton:
        inputs = [Array("x", f.newton.x), *inputs]
        steps = [("step", f.newton.both, f.newton.parts)]
    return [
        straight_line(
            f"{f.name}_{name}",
            inputs,
            ("out", value),
            linkage="static ",
            precision=precision,
            care=care,
            parts=parts,
        )
        for name, value, parts in (*steps, ("at", f.everything, f.parts))
    ]


def _demands(
    f: ExportedFunction, first: int, precision: Precision
) -> list[tuple[int, int, str, str]]:
    """Where in all that is computed each demand stands, how many numbers, bound and status."""
    found = []
    for demand in f.demands:
        n = demand.value.numel()
        if n:
            found.append((first, n, precision.c_number(demand.bound), demand.status))
        first += n
    return found


def _comment(f: ExportedFunction) -> str:
    """What the header says of a function."""
    lines = textwrap.wrap(f.doc, 93)
    for output in f.outputs:
        width = f" in each of {output.size // len(output.entries)} rows" if output.entries else ""
        if output.entries:
            lines.append(f"{output.name}{width if output.size > len(output.entries) else ''}:")
        lines += [f"  [{k}] {name}, {unit}" for k, (name, unit) in enumerate(output.entries)]
    return _block(lines)


def _block(lines: list[str]) -> str:
    return (
        f"/* {c_comment(plain_letters(chr(10).join(lines))).replace(chr(10), chr(10) + ' * ')} */"
    )


def cycle_texts(c: ExportedCycle, precision: Precision) -> dict[str, object]:
    """The same of a cycle: three structs, where their fields stand, and its one function."""
    inputs = [Array("x", c.x), Array("u", c.u)]
    both = ca.vertcat(c.following, c.y)
    return {
        "name": c.name,
        "comment": _block(textwrap.wrap(c.doc, 93)),
        "text": straight_line(
            f"{c.name}_step", inputs, ("out", both), linkage="static ", precision=precision
        ),
        "structs": [
            ("state", "What the cycle keeps.", _fields(c.state)),
            ("inputs", "What it reads.", _fields(c.inputs)),
            ("outputs", "What it gives.", _fields(c.outputs)),
        ],
        "start": [precision.c_number(x) for x in c.state.initial],
        "sizes": {"state": c.state.size, "inputs": c.inputs.size, "outputs": c.outputs.size},
    }


def _fields(layout: Layout) -> list[tuple[str, int, int, str]]:
    """Name, size, place and comment."""
    return [(f.name, f.size, layout.places[f.name].start, _note(f)) for f in layout.fields]


def _note(field: Field) -> str:
    text = f"{field.doc} [{field.unit}]" if field.unit else field.doc
    return "\n     * ".join(textwrap.wrap(plain_letters(text), 88))
