"""A real axis from its MAT files, against the values of those who recorded it.

    python benchmarks/real_data.py DATA_EMPS.mat DATA_EMPS_PULSES.mat

Where the files come from stands in docs/real_data.md. The robot, its Python file and the mapping
are those of `examples/emps`; friction is as described there, for that is what the values are of.
"""

import sys
from pathlib import Path

from _table import leave

import deltaid

EMPS = Path(__file__).resolve().parents[1] / "examples" / "emps"
# By least squares of the authors (Janot, Gautier, Brunot 2019).
REFERENCE = {
    "sled.m": 95.11, "viscous.drive1": 203.5, "coulomb.drive1": 20.39, "offset.drive1": -3.16,
}  # fmt: skip


def main(logs: list[Path]) -> None:
    """Identify the axis from each log and compare."""
    deltaid.use_mechanism(EMPS / "mechanism.py")
    rows = [row for log in logs for row in compared(log)]
    head = ("recording", "parameter", "identified", "± (95 %)", "unit", "reference", "difference")
    leave(head, rows, "The EMPS axis, prior, mapping and friction law of `examples/emps`.")


def compared(log: Path) -> list[tuple[str, ...]]:
    """A row for each parameter that has a reference."""
    columns = deltaid.load_mapping(EMPS / "columns.yaml")
    settings = deltaid.Settings(friction="described")
    result = deltaid.identify(EMPS / "robot.yaml", log, columns=columns, settings=settings)
    found = {parameter.name: parameter for parameter in result.model.parameters}
    rows = []
    for name, reference in REFERENCE.items():
        estimate = found[name]
        half, off = 0.5 * (estimate.high - estimate.low), 100 * (estimate.value / reference - 1)
        numbers = f"{estimate.value:.4g}", f"{half:.2g}", estimate.unit, f"{reference:g}"
        rows.append((log.stem, name, *numbers, f"{off:+.2f} %"))
    return rows


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main([Path(argument) for argument in sys.argv[1:]])
