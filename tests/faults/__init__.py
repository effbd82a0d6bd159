"""Recordings with one fault each, and clean ones, of random robots, motions and sensors.

`clean(seed)` is a recording of a careful lab; `faulty(kind, seed)` has one fault and the verdicts
that are right. Every kind draws its size from a wide range. A fault that parameters and noise could
hide is drawn again until it is at least three intervals in size (`shown.py`). Torques come from the
oracle (`plants.py`).
"""

from dataclasses import replace
from zlib import crc32

import numpy as np

from faults import behaviour, descriptions, signals, wiring
from faults.case import Case, clean
from faults.shown import shown
from faults.tools import ImpossibleError, Kind

__all__ = ["KINDS", "LEAST", "Case", "clean", "fault", "faulty"]

# All kinds, by the names of their functions.
KINDS = {
    name.replace("_", "-"): member
    for module in (behaviour, descriptions, signals, wiring)
    for name, member in vars(module).items()
    if isinstance(member, Kind)
}
# Least size of a fault that must be detected: three half widths of a 95 % interval, in standard
# deviations of white noise; intervals of the package, by scatter, are up to half as wide again.
LEAST = 3 * 1.96 * 1.5


def fault(case: Case, kind: str, rng: np.random.Generator) -> Case:
    """The case with a fault of a kind, of random size.

    Raises:
        ImpossibleError: this robot or recording cannot have it, or only too small to be detected.
    """
    fault_kind = KINDS[kind]
    for _ in range(6 if fault_kind.hides else 1):
        seed = rng.integers(1 << 32)
        spoilt = fault_kind.change(case, np.random.default_rng(seed))
        if not fault_kind.hides:
            break
        exact = fault_kind.change(case.exact, np.random.default_rng(seed))
        size = shown(exact, spoilt)
        spoilt = replace(spoilt, size=f"{spoilt.size} ({size:.0f} σ)")
        if size >= LEAST:
            break
    else:
        raise ImpossibleError(f"{kind} does not show")
    return replace(spoilt, kind=kind, keys=fault_kind.keys, related=fault_kind.related)


def faulty(kind: str, seed: int) -> Case:
    """A case with a fault: clean recordings of the seed are drawn until one can have it."""
    for attempt in range(30):
        rng = np.random.default_rng([seed, attempt, crc32(kind.encode())])
        try:
            return fault(clean(seed + 1_000_003 * attempt), kind, rng)
        except ImpossibleError:
            continue
    raise ImpossibleError(f"no robot for {kind}")
