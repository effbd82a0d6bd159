"""What happens to plants, at random, and what their fleets keep: python benchmarks/fleet_walk.py.

Shares that are away and come back, other options, another version, `--regather`, calls that are
killed at any time, two calls at once. After each the rows of all recordings that were gathered
before are there, or the call was refused and changed no byte.
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path

from _table import STATED, leave
from _timing import options

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
_NOTE = """What happened to fleets with two recordings a robot, and how the call after it ended.

Kept: each row that was there before is there. Refused: exit code 2, and no byte is changed. Else:
a row is lost, a refusal changed something, or another exit code."""


def main() -> None:
    stated = STATED["fleet_walk"]
    given = options(__doc__, robots=stated["robots"], steps=stated["steps"], seed=1)
    from walked import ACTS, WalkedFleet

    ends = Counter[tuple[str, str]]()
    with tempfile.TemporaryDirectory() as folder:
        fleet = WalkedFleet.drawn(Path(folder) / "plant", given.robots, given.seed)
        for _ in range(given.steps):
            end = fleet.step()
            ends[end] += 1
            print(*end, sep="\t", file=sys.stderr, flush=True)
    rows: list[list[object]] = []
    for act in ACTS:
        of_act = {end: count for (other, end), count in ends.items() if other == act}
        kept, refused = of_act.pop("kept", 0), of_act.pop("refused", 0)
        rows.append([act, kept, refused, sum(of_act.values())])
    head = ["what happened", "kept", "refused", "else"]
    leave(head, rows, _NOTE, robots=given.robots, steps=given.steps)


if __name__ == "__main__":
    main()
