"""Damages files of every kind and opens them: python benchmarks/damaged_files.py --count 500.

Files are opened in processes of their own, so that one that crashes or hangs is counted.
"""

import argparse
import random
import subprocess
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from _table import STATED, leave

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))
_AT_ONCE, _LONGEST = 100, 300
# Ended: a message, but the process with it, where a library aborts.
_ENDS = ("refused", "read", "altered", "ended", "crash", "hang", "else")
_NOTE = """Damaged files of each kind, opened and read as recordings.

Refused: one message says where and how to fix it. Read: every number is as it was. Altered: numbers
differ, and the recording is still possible. Ended: the same message, but the process ends with it,
since a library aborts. Else: anything that is none of these, a traceback, a message without place
or fix, more than 10 s or 1 GB."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--count", type=int, default=STATED["damaged_files"]["files"], help="files of each kind"
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", help="only this kind of file")
    parser.add_argument("--open", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.open:
        _open(given.kind, Path(given.open[0]), range(*map(int, given.open[1].split(":"))))
        return
    from kinds_of_files import KINDS

    def ends(kind: str) -> Counter[str]:
        with tempfile.TemporaryDirectory() as folder:
            return _opened(kind, Path(folder), given.count, given.seed)

    rows: list[list[object]] = []
    kinds = [given.kind] if given.kind else list(KINDS)
    with ThreadPoolExecutor(2) as pool:
        for kind, found in zip(kinds, pool.map(ends, kinds), strict=True):
            rows.append([kind, *(found[end] for end in _ENDS)])
            print(*rows[-1], sep="\t", file=sys.stderr, flush=True)
    if given.kind:
        return
    total = [sum(int(str(row[1 + k])) for row in rows) for k in range(len(_ENDS))]
    leave(["kind of file", *_ENDS], [*rows, ["all", *total]], _NOTE, files=given.count)


def _opened(kind: str, folder: Path, count: int, seed: int) -> Counter[str]:
    """How often opening damaged files of a kind came to what."""
    from damage import damaged
    from kinds_of_files import KINDS

    name, rng = KINDS[kind].name, random.Random(seed)
    KINDS[kind].save(folder / name)
    data = (folder / name).read_bytes()
    for i in range(count):
        (folder / str(i)).mkdir()
        (folder / str(i) / name).write_bytes(damaged(data, rng))
    ends, start = Counter[str](), 0
    while start < count:
        part = f"{start}:{min(start + _AT_ONCE, count)}"
        command = [sys.executable, __file__, "--kind", kind, "--open", str(folder), part]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST)
            text, reason = done.stdout, done.stderr[-500:]
            ended = done.returncode == 2 and "error: " in reason
            end = "" if done.returncode == 0 else "ended" if ended else "crash"
        except subprocess.TimeoutExpired as late:
            text, end, reason = (late.stdout or b"").decode(), "hang", ""
        lines = text.splitlines()
        for line in lines:
            ends[line.split("\t")[0]] += 1
            if line.startswith("else"):
                print(f"{kind}: {line}", file=sys.stderr)
        start += len(lines)
        if end:
            ends[end] += 1
            kept = Path(tempfile.gettempdir()) / f"damaged-{end}-{start}-{name}"
            kept.write_bytes((folder / str(start) / name).read_bytes())
            print(f"{kind}: {end}, kept as {kept}\n{reason}", file=sys.stderr)
            start += 1
    return ends


def _open(kind: str, folder: Path, numbers: range) -> None:
    """Open some of the files; one line each."""
    from damage import complaint, outcome
    from deltaid.dynamics.dynamics import compiled
    from deltaid.robot.load import load_robot
    from kinds_of_files import KINDS, ROWS

    kinematics = compiled(load_robot("clavel-delta3")).kinematics
    for i in numbers:
        path = folder / str(i) / KINDS[kind].name
        try:
            found = outcome(path, KINDS[kind].columns, ROWS, kinematics)
            wrong, end = complaint(found, path), found.end
        except Exception as error:  # what it counts: whatever comes out beside a refusal
            wrong, end = f"{type(error).__name__}: {error}", "else"
        print(f"else\t{i}\t{wrong!r}" if wrong else end, flush=True)


if __name__ == "__main__":
    main()
