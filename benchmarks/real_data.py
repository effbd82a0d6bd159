"""A real axis from its MAT file, against the values of those who recorded it.

    python benchmarks/real_data.py DATA_EMPS.mat

Where the file comes from stands in docs/real_data.md. The robot, its Python file and the mapping
are those of `examples/emps`.
"""

import sys
from pathlib import Path

from _table import leave

import deltaid

EMPS = Path(__file__).resolve().parents[1] / "examples" / "emps"
# By least squares of the authors (Janot, Gautier, Brunot 2019).
REFERENCE = {
    "sled.m": 95.11,
    "viscous.drive1": 203.5,
    "coulomb.drive1": 20.39,
    "offset.drive1": -3.16,
}


def main(log: Path) -> None:
    """Identify the axis and compare."""
    deltaid.use_mechanism(EMPS / "mechanism.py")
    columns = deltaid.load_mapping(EMPS / "columns.yaml")
    result = deltaid.identify(EMPS / "robot.yaml", log, columns=columns)
    found = {parameter.name: parameter for parameter in result.model.parameters}
    rows = []
    for name, reference in REFERENCE.items():
        one = found[name]
        rows.append(
            (
                name,
                f"{one.value:.4g}",
                f"{0.5 * (one.high - one.low):.2g}",
                one.unit,
                f"{reference:g}",
                f"{100 * (one.value / reference - 1):+.2f} %",
            )
        )
    samples = result.recordings[0].log.samples
    leave(
        ("parameter", "identified", "± (95 %)", "unit", "reference", "difference"),
        rows,
        f"The EMPS axis from {samples} samples, prior and mapping of `examples/emps`.",
    )


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
