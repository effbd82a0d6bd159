"""Two versions of the package compared on the same recordings, case by case.

    python benchmarks/real_drives.py --keep before.json     (in a clone of the version before)
    python benchmarks/real_drives.py --keep after.json
    python benchmarks/paired.py before.json after.json

Prints for each row of the table the median of error after over error before, the largest of a
case, processor time after over before, and in how many cases something else is corrected; then
these cases.
Errors below `LEAST` count as that much, so that 0.002 % for 0.001 % is no doubling.
"""

import argparse
import json
from pathlib import Path

import numpy as np

# Errors below this share do not matter to anybody.
LEAST = 2e-4


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    given = parser.parse_args()
    before, after = (
        {result["case"]: result for result in json.loads(path.read_text())}
        for path in (given.before, given.after)
    )
    cases = [case for case in after if case in before]
    head = f"{'row':24} {'n':>3} {'M':>13} {'friction':>13} {'its shape':>13}"
    print(f"{head} {'time':>6} {'other words':>11}")
    for row in dict.fromkeys(after[case]["row"] for case in cases):
        own = [(before[case], after[case]) for case in cases if after[case]["row"] == row]
        times = [b["seconds"] / a["seconds"] for a, b in own if a["seconds"] and b["seconds"]]
        errors = [f"{ratio(own, kind)}" for kind in ("M", "friction", "friction_shape")]
        other = sum(is_other(*pair) for pair in own)
        print(f"{row:24} {len(own):3} {errors[0]:>13} {errors[1]:>13} {errors[2]:>13} "
              f"{np.median(times) if times else np.nan:6.2f} {other:11}")  # fmt: skip
    for case in cases:
        if is_other(before[case], after[case]):
            print(f"\n{case}: {before[case]['errors']} → {after[case]['errors']}")
            print(f"  before {said_of(before[case])}\n  after  {said_of(after[case])}")


def ratio(own: list[tuple[dict, dict]], kind: str) -> str:
    """Median and largest of error after over error before."""
    found = [
        max(b["errors"][kind], LEAST) / max(a["errors"][kind], LEAST)
        for a, b in own
        if kind in a["errors"] and kind in b["errors"]
    ]
    return f"{np.median(found):.3f}, {max(found):.2f}" if found else "–"


def said_of(outcome: dict) -> str:
    return outcome["refused"] or ", ".join(outcome["said"]) or "nothing"


def is_other(before: dict, after: dict) -> bool:
    return said_of(before) != said_of(after)


if __name__ == "__main__":
    main()
