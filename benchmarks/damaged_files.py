"""Damages files of every kind and gives them to every command: python benchmarks/damaged_files.py.

Rows are of three sorts: recordings of each kind, opened; a command line with one of its files
damaged; and single bits of files that carry a checksum. Cases run in other processes, so
that one that crashes or takes no end is found and passed over (a case that computes for 30 s ends
its process). `--row TEXT` runs rows with this text in their names, `--seed` other damage;
`--inputs FOLDER` holds good files, which are made where there are none.

A full run takes hours. With `--results FILE` it goes on behind the cases in that file, and a run
that is killed loses none; so `--count 50` may run a tenth of each row first. `--table` makes the
table of the cases that there are.
"""

import faulthandler
import random
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import groupby, product
from operator import itemgetter
from pathlib import Path

from _table import STATED, leave
from _timing import options

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))
_SIZE = STATED["damaged_files"]
_LONGEST = 30  # s of processor time, of a case
# Ended: a message, but the process with it, where a library aborts.
_ENDS = ("refused", "read", "warned", "altered", "ended", "crash", "hang", "else")
# Of a full run; to read a model takes a hundred times as long as to refuse another file.
_BITS = {
    "factor file": 3000, "fleet table": 3000, "fleet member": 1750, "drawn models": 1750,
    "model file": 500,
}  # fmt: skip
Rows = Mapping[str, int]
_NOTE = """Damaged files of each kind, as recordings, in command lines, and with one bit changed.

Refused: by one message with place and cure, exit code 2, nothing left behind. Read: every number
is as it was. Warned: something else comes out, with a word about it. Altered: something else comes
out, and the file may say it: what people write, and recordings, have no checksum. Ended: refused by
the same message, but the process with it, since a library aborts. Else: anything that is none of
these, a traceback, a message without place or cure, files left, more than 30 s (10 s to open a
recording) or 1 GB; what each was is below the table. A command is in the row of the file that is
damaged. In rows of one bit nothing may be altered."""


def main() -> None:
    given = options(
        __doc__, count=_SIZE["files"], seed=1, row="", workers=2, inputs=Path, results=Path,
        table=False, worker=int,
    )  # fmt: skip
    rows = {name: cases for name, cases in _rows(given.count).items() if given.row in name}
    if given.worker is not None:
        own = dict(list(rows.items())[given.worker :: given.workers])
        _run(own, given.results, given.inputs, given.seed)
        return
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(given.workers) as pool:
        inputs = given.inputs or Path(folder) / "inputs"
        results = given.results or Path(folder) / "results"
        if not given.table:
            if not (inputs / "drawn.npz").exists():
                _make(inputs)
            command = [sys.executable, __file__, *sys.argv[1:], "--inputs", str(inputs)]
            command += ["--results", str(results), "--workers", str(given.workers)]
            workers = range(given.workers)
            shares = [dict(list(rows.items())[worker :: given.workers]) for worker in workers]
            list(pool.map(partial(_supervise, command, results), workers, shares))
        _leave_table(rows, _ended(results))


def _rows(count: int) -> Rows:
    """Names of all rows, and how many cases each has."""
    from damaged_commands import LINES
    from kinds_of_files import KINDS

    share = count / _SIZE["files"]
    opened = {f"opened: {kind}": count for kind in KINDS}
    lines = {line.name: max(1, round(share * line.cases)) for line in LINES}
    bits = {f"one bit: {kind}": round(share * cases) for kind, cases in _BITS.items()}
    return lines | opened | bits


def _make(inputs: Path) -> None:
    """Good files, with those models that were drawn."""
    from command import run
    from damaged_commands import make_inputs

    make_inputs(inputs)
    drawn = run("sample", inputs / "model.yaml", "-n", "10", "-o", inputs / "drawn.npz")
    assert drawn.code == 0, drawn


@dataclass(frozen=True)
class Case:
    """A case that has ended: refused, read … (`_ENDS`), and what is wrong with that."""

    row: str
    number: int
    end: str
    why: str = ""

    def leave(self, results: Path) -> None:
        with results.open("a", encoding="utf-8") as file:
            file.write("\t".join((self.row, str(self.number), self.end, self.why)) + "\n")
        if self.why:
            print(self.row, self.number, self.end, self.why, file=sys.stderr, flush=True)


def _ended(results: Path) -> list[Case]:
    """Cases that have ended; of those that were run again, the last."""
    if not results.exists():
        return []
    lines = (line.split("\t") for line in results.read_text(encoding="utf-8").splitlines())
    cases = (Case(row, int(number), end, why) for row, number, end, why in lines)
    return list({(case.row, case.number): case for case in cases}.values())


def _to_run(rows: Rows, results: Path) -> Iterator[tuple[str, int]]:
    ended = {(case.row, case.number) for case in _ended(results)}
    return (case for row in rows for case in product([row], range(rows[row])) if case not in ended)


def _supervise(command: list[str], results: Path, worker: int, rows: Rows) -> None:
    """Have rows run by a process; one that dies is replaced, and the case that it died of noted."""
    while next(_to_run(rows, results), None):
        with tempfile.TemporaryFile() as said:
            started = [*command, "--worker", str(worker)]
            code = subprocess.run(started, stderr=said, check=False).returncode
            case = next(_to_run(rows, results), None)
            if case is None:
                return
            said.seek(0)
            words = said.read().decode(errors="replace")
        is_said = code == 2 and "error: " in words
        end = "ended" if is_said else "hang" if code == -signal.SIGPROF else "crash"
        Case(*case, end, f"{end} with {code}: {words[-300:]!r}").leave(results)


def _run(rows: Rows, results: Path, inputs: Path, seed: int) -> None:
    """Run the cases of rows that have not ended."""
    if hasattr(signal, "SIGPROF"):
        faulthandler.register(signal.SIGPROF, chain=True)
    for name, cases in groupby(_to_run(rows, results), key=itemgetter(0)):
        with tempfile.TemporaryDirectory() as folder:
            judge = _judge(name, inputs, Path(folder))
            for _, number in cases:
                with _no_longer_than(_LONGEST):
                    end, why = judge(random.Random(f"{seed}/{name}/{number}"))
                Case(name, number, end, repr(why) if why else "").leave(results)


def _leave_table(rows: Rows, cases: list[Case]) -> None:
    ends, of_rows = {name: Counter[str]() for name in rows}, [c for c in cases if c.row in rows]
    for case in of_rows:
        ends[case.row][case.end] += 1
    table = [[name, *(counted[end] for end in _ENDS)] for name, counted in ends.items()]
    total = [sum(counted[end] for counted in ends.values()) for end in _ENDS]
    bits = sum(case.row.startswith("one bit") for case in of_rows)
    files = [ends[name].total() for name in rows if name.startswith("opened")]
    complaints = "".join(f"\n- {c.row}: case {c.number}: {c.why}" for c in of_rows if c.why)
    note = _NOTE + "\n" * bool(complaints) + complaints
    size = {"files": min(files, default=0), "cases": len(of_rows) - bits, "bits": bits}
    leave(["row", *_ENDS], [*table, ["all", *total]], note, **size)


@contextmanager
def _no_longer_than(seconds: float) -> Generator[None]:
    """The process ends where more processor time is taken; other systems have no such clock."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_PROF, 0)


Judge = Callable[[random.Random], tuple[str, str]]


def _judge(name: str, inputs: Path, folder: Path) -> Judge:
    """What runs a case of a row and says how it ended, and what is wrong with that."""
    if name.startswith("opened: "):
        return _opening(name.removeprefix("opened: "), folder)
    if name.startswith("one bit: "):
        return _changing(name.removeprefix("one bit: "), inputs, folder)
    from damaged_commands import NAMED, judged

    def run(rng: random.Random) -> tuple[str, str]:
        ended = judged(NAMED[name], inputs, folder / "case", rng)
        return ended.end, ended.why

    return run


def _opening(kind: str, folder: Path) -> Judge:
    from damage import complaint, damaged, outcome
    from deltaid.dynamics.dynamics import compiled
    from deltaid.robot.load import load_robot
    from kinds_of_files import KINDS, ROWS

    kinematics = compiled(load_robot("clavel-delta3")).kinematics
    path = folder / KINDS[kind].name
    KINDS[kind].save(path)
    data = path.read_bytes()

    def run(rng: random.Random) -> tuple[str, str]:
        path.write_bytes(damaged(data, rng))
        try:
            found = outcome(path, KINDS[kind].columns, ROWS, kinematics)
        except Exception as error:  # what it counts: whatever comes out beside a refusal
            return "else", f"{type(error).__name__}: {error}"
        wrong = complaint(found, path)
        return "else" if wrong else found.end, wrong

    return run


def _changing(kind: str, inputs: Path, folder: Path) -> Judge:
    """One bit of a file that carries a checksum, read by what reads it."""
    from damage import changed_bit, unclear
    from deltaid.errors import DeltaidError
    from sealed_files import SEALED

    pattern, read = SEALED[kind]
    (path, *_) = sorted(inputs.glob(pattern))
    good, copy = read(path), folder / path.name

    def run(rng: random.Random) -> tuple[str, str]:
        copy.write_bytes(changed_bit(path.read_bytes(), rng))
        try:
            found = read(copy)
        except DeltaidError as error:
            wrong = unclear(str(error), str(copy))
            return "else" if wrong else "refused", wrong
        except Exception as error:  # what it counts: whatever comes out beside a refusal
            return "else", f"{type(error).__name__}: {error}"
        if found.words != good.words:
            return "warned", ""
        return ("read" if found == good else "altered"), ""

    return run


if __name__ == "__main__":
    main()
