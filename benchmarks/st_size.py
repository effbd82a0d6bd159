"""How large the structured text of a model is: units, lines, bytes, and what its variables take.

    python benchmarks/st_size.py [MODEL …]

Once as it is written without choices, then with each further function, in LREAL and REAL. Local
variables of a function are on the stack while it runs, those of a function block are kept.
"""

import sys

from deltaid.exports.options import FURTHER
from deltaid.exports.st_units import Unit, Variable
from deltaid.exports.structured_text import plc_program
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.model.model import load


def main() -> None:
    for name in sys.argv[1:] or ["irb360-6-1600"]:
        model = load(name)
        for precision in (DOUBLE, SINGLE):
            for further in ((), *((function,) for function in FURTHER)):
                program = plc_program(model, "rob", precision, further)
                chosen = f"--with {further[0]}" if further else ""
                print(f"\n{name} {precision.st_type} {chosen}")
                lines, size = program.text.count("\n"), len(program.text)
                print(f"  {len(program.units)} units, {lines:,} lines, {size / 1e3:.0f} kB")
                kinds = {"FUNCTION": "local variables", "FUNCTION_BLOCK": "an instance"}
                for kind, words in kinds.items():
                    sizes = {u.name: taken(u, precision) for u in program.units if u.kind == kind}
                    for largest in sorted(sizes, key=lambda name: -sizes[name])[:2]:
                        print(f"  {largest}: {sizes[largest] / 1e3:.1f} kB of {words}")


def taken(unit: Unit, precision: Precision) -> int:
    real = 8 if precision is DOUBLE else 4
    each = {"INT": 2, "BOOL": 1, precision.st_type: real}

    def bytes_of(variable: Variable) -> int:
        return real * variable.size if variable.size else each[variable.type]

    own = sum(map(bytes_of, unit.local_variables)) + real * len(unit.scratch)
    return own + sum(map(bytes_of, (*unit.inputs, *unit.outputs)))


if __name__ == "__main__":
    main()
