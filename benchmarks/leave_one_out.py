"""What identifications say of causes that no effect is of: each effect is left out in turn.

    pip install -e '.[test]'
    python benchmarks/leave_one_out.py [--kinds KIND,…] [--seeds N] [--processes N]

A recording of `tests/drives/causes.py` is identified without the effect that it has. It ends well
where its cause is said to be unexplained, or is a doubt, and where nothing else is corrected in its
place. Leaves `tables/leave_one_out.md`.
"""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import _alone  # noqa: F401
import numpy as np
from _table import STATED, leave
from _timing import options

from deltaid.errors import DeltaidError
from drives import KINDS, case
from drives.absent import CAUSES_OF, without
from drives.identify import identified
from drives.judge import judge

HEAD = (
    "left out", "recordings", "said to be unexplained or in doubt", "another cause corrected",
    "M: median, worst (%)", "intervals of base parameters hold", "corrected instead",
)  # fmt: skip
# What is corrected or excluded beside causes, or where friction laws are chosen.
NO_CAUSE = {"contact", "friction", "lag", "prior", "temperature", "backlash", "hold", "velocity"}


@dataclass(frozen=True)
class Outcome:
    """Of one recording; `wrong` are kinds of what was corrected in place of its cause."""

    row: str
    doubted: bool
    wrong: tuple[str, ...]
    M: float
    held: tuple[bool, ...]


def outcome(row: str, kind: str, seed: int) -> Outcome | None:
    """Identify a recording without the effect that it has; None where it is refused."""
    made = case(row, kind, seed)
    with without(CAUSES_OF[row]):
        try:
            result = identified(made)
        except DeltaidError:
            return None
    judged = judge(made, result)
    unexplained = any("no known effect" in text for text in judged.texts)
    wrong = tuple(kind for kind, _ in judged.said if kind not in NO_CAUSE)
    return Outcome(row, unexplained or bool(judged.verdicts), wrong, judged.M, judged.base)


def line(row: str, outcomes: Sequence[Outcome | None]) -> tuple[object, ...]:
    """A row of the table; a refusal is a doubt."""
    known = [outcome for outcome in outcomes if outcome is not None]
    M = 100 * np.array([outcome.M for outcome in known])
    held = [is_so for outcome in known for is_so in outcome.held]
    instead = Counter(kind for outcome in known for kind in outcome.wrong)
    doubted = np.mean([outcome is None or outcome.doubted for outcome in outcomes])
    return (
        ", ".join(sorted(CAUSES_OF[row])),
        len(outcomes),
        f"{doubted:.0%}",
        f"{np.mean([outcome is not None and bool(outcome.wrong) for outcome in outcomes]):.0%}",
        f"{np.median(M):.2g}, {M.max():.2g}" if known else "–",
        f"{np.mean(held):.0%}" if held else "–",
        ", ".join(f"{kind} {count}" for kind, count in instead.most_common()) or "–",
    )


def main() -> None:
    seeds = STATED["leave_one_out"]["seeds"]
    given = options(__doc__, kinds=",".join(KINDS), seeds=seeds, processes=2)
    kinds = given.kinds.split(",")
    jobs = [(row, kind, seed) for row in CAUSES_OF for kind in kinds for seed in range(given.seeds)]
    with ProcessPoolExecutor(given.processes) as pool:
        found = list(pool.map(outcome, *zip(*jobs, strict=True)))
    of_rows = {row: [o for job, o in zip(jobs, found, strict=True) if job[0] == row]
               for row in CAUSES_OF}  # fmt: skip
    table = [line(row, outcomes) for row, outcomes in of_rows.items()]
    note = f"{given.seeds} seeds of {', '.join(kinds)}, each identified without the effect it has."
    leave(HEAD, table, note, kinds=len(kinds), seeds=given.seeds)


if __name__ == "__main__":
    main()
