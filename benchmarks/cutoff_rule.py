"""The rule for the cut-off against fixed ones, where play, elasticity and motion pull it about.

    pip install -e '.[test]'
    python benchmarks/cutoff_rule.py [--kinds KIND,…] [--seeds N]

Recordings come from `tests/drives`: a motion of `deltaid excite` and pick and place in 0.9 s, with
gears that are rigid, have play, or wind up. Each is identified by the rule and with fixed cut-offs,
all else alike. Leaves `tables/cutoff_rule.md`.
"""

from collections.abc import Iterator
from dataclasses import replace

import _alone  # noqa: F401
import numpy as np
from _table import leave
from _timing import options

from deltaid.model.record import Settings
from drives import Case, case
from drives.errors import friction_error, mass_matrix_error
from drives.identify import identified
from drives.rows import lever

# Play [°] and stiffness [N m/rad] of the gears.
GEARS = ((0.0, np.inf), (0.05, np.inf), (0.1, np.inf), (0.0, 5e3))
FIXED = (8.0, 15.0, 30.0)  # Hz
# What is asked: this many times the best fixed one's error and this much more.
TIMES, MORE = 1.5, 0.002
# Torque of the drives that stiffnesses are written for [N m].
TORQUE = 75.0
HEAD = ("motion", "play, stiffness", "rule: cut-off", "rule: M, friction", "best: cut-off, M",
        "best: cut-off, friction", "within")  # fmt: skip


def cases(kind: str, seed: int) -> Iterator[tuple[str, str, Case]]:
    """Each motion with each gear."""
    for motion, row in (("excite", "clean"), ("pick and place", "production")):
        plain = case(row, kind, seed)
        machine = plain.machine
        for play, stiffness in GEARS:
            happening = replace(
                plain.happenings[0],
                law=None,
                load=None,
                held=(),
                backlash=np.deg2rad(play) * lever(machine),
                stiffness=stiffness * machine.largest_torque / TORQUE / lever(machine),
            )
            sensors = case("clean", kind, seed).sensors[0]
            logs = (sensors.recorded(happening),)
            made = replace(plain, happenings=(happening,), sensors=(sensors,), logs=logs, tells=())
            yield motion, f"{play:g}°, {stiffness:g}", made


def errors(made: Case, cutoff: float | None) -> tuple[float, float, float]:
    found = identified(made, Settings(cutoff=cutoff))
    happening = made.happenings[0]
    friction = friction_error(happening, found.model, happening.carried, 1.0, 0.0)
    chosen = found.model.sources[0].cutoff_hz or np.inf
    return chosen, mass_matrix_error(made, found), friction


def line(motion: str, gear: str, made: Case) -> tuple[tuple[str, ...], bool]:
    """A row of the table, and whether the rule is as good as is asked."""
    rule = errors(made, None)
    fixed = np.array([errors(made, cutoff)[1:] for cutoff in FIXED])
    best, at = fixed.min(axis=0), fixed.argmin(axis=0)
    within = all(error <= TIMES * least + MORE for error, least in zip(rule[1:], best, strict=True))
    cells = [f"{FIXED[k]:g} Hz, {100 * x:.2g}" for k, x in zip(at, best, strict=True)]
    mine = f"{100 * rule[1]:.2g}, {100 * rule[2]:.2g}"
    row = (motion, gear, f"{rule[0]:.3g} Hz", mine, *cells, "yes" if within else "no")
    print(*row, sep="; ", flush=True)
    return row, within


def main() -> None:
    given = options(__doc__, kinds="delta3", seeds=1)
    rows, held = list[tuple[str, ...]](), list[bool]()
    for kind in given.kinds.split(","):
        for seed in range(given.seeds):
            for motion, gear, variant in cases(kind, seed):
                row, within = line(motion, gear, variant)
                rows.append((kind, *row))
                held.append(within)
    note = (
        f"Errors in %; the rule is within {TIMES:g} times the best fixed cut-off's error and "
        f"{100 * MORE:g} % in {sum(held)} of {len(held)} cases, for M and for friction."
    )
    leave(("kind", *HEAD), rows, note)


if __name__ == "__main__":
    main()
