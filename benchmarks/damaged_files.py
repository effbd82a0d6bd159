"""Damages files of every kind and gives them to every command: python benchmarks/damaged_files.py.

Rows are of three sorts: recordings of each kind, opened; a command line with one of its files
damaged; and single bits of files that carry a checksum. Cases run in other processes, so
that one that crashes or takes no end is found and passed over (a case that computes for 30 s ends
its process). `--row TEXT` runs rows with this text in their names, `--seed` other damage.
"""

import argparse
import faulthandler
import io
import random
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

from _table import STATED, leave

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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=_SIZE["files"], help="files of each kind")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--row", default="", help="only rows with this text in their names")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--inputs", type=Path, help="good files; made here if there are none")
    parser.add_argument("--from", dest="start", help=argparse.SUPPRESS)
    given = parser.parse_args()
    rows = {name: cases for name, cases in _rows(given.count).items() if given.row in name}
    if given.start:
        row, case, step = map(int, given.start.split(":"))
        _run(list(rows.items())[row::step], case, given.inputs, given.seed)
        return
    ends, complaints = {name: Counter[str]() for name in rows}, list[str]()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(given.workers) as pool:
        inputs = given.inputs or Path(folder) / "inputs"
        if not (inputs / "drawn.npz").exists():
            _make(inputs)
        command = [sys.executable, __file__, *sys.argv[1:], "--inputs", str(inputs)]
        lines = chain.from_iterable(
            pool.map(lambda k: _ended(rows, command, k, given.workers), range(given.workers))
        )
        for name, end, why in lines:
            ends[name][end] += 1
            complaints += [f"{name}: {why}"] if why else []
    table = [[name, *(counted[end] for end in _ENDS)] for name, counted in ends.items()]
    total = [sum(counted[end] for counted in ends.values()) for end in _ENDS]
    bits = sum(cases for name, cases in rows.items() if name.startswith("one bit"))
    note = _NOTE + "\n" * bool(complaints) + "".join(f"\n- {text}" for text in complaints)
    size = {"files": given.count, "cases": sum(total) - bits, "bits": bits}
    leave(["row", *_ENDS], [*table, ["all", *total]], note, **size)


def _rows(count: int) -> Rows:
    """Names of all rows, and how many cases each has."""
    from damaged_commands import LINES
    from kinds_of_files import KINDS

    share = count / _SIZE["files"]
    opened = {f"opened: {kind}": count for kind in KINDS}
    lines = {line.name: max(1, round(share * line.cases)) for line in LINES}
    bits = {f"one bit: {kind}": round(share * cases) for kind, cases in _BITS.items()}
    return opened | lines | bits


def _make(inputs: Path) -> None:
    """Good files, with those models that were drawn."""
    from command import run
    from damaged_commands import make_inputs

    make_inputs(inputs)
    drawn = run("sample", inputs / "model.yaml", "-n", "10", "-o", inputs / "drawn.npz")
    assert drawn.code == 0, drawn


def _ended(rows: Rows, command: list[str], first: int, step: int) -> list[tuple[str, ...]]:
    """Row, end and complaint of all cases of every so many rows; a process that dies is replaced
    by one that goes on behind the case that it died of."""
    own, row, case, lines = list(rows.items())[first::step], 0, 0, list[tuple[str, ...]]()
    while row < len(own):
        with tempfile.TemporaryFile() as said:
            started = [*command, "--from", f"{first + row * step}:{case}:{step}"]
            with subprocess.Popen(started, stdout=subprocess.PIPE, stderr=said) as process:
                for line in io.TextIOWrapper(process.stdout, encoding="utf-8"):
                    if line.startswith("ended\t"):
                        lines.append(tuple(line.rstrip("\n").split("\t")[1:]))
                        row, case = (row, case + 1) if case + 1 < own[row][1] else (row + 1, 0)
                        if lines[-1][-1] or case == 0:
                            print(*lines[-1], sep="\t", file=sys.stderr, flush=True)
            if row == len(own):
                break
            said.seek(0)
            words, code = said.read().decode(errors="replace"), process.returncode
        is_said = code == 2 and "error: " in words
        end = "ended" if is_said else "hang" if code == -signal.SIGPROF else "crash"
        why = f"case {case}: {end} with {code}: {words[-300:]!r}"
        lines.append((own[row][0], end, why))
        print(*lines[-1], sep="\t", file=sys.stderr, flush=True)
        row, case = (row, case + 1) if case + 1 < own[row][1] else (row + 1, 0)
    return lines


def _run(rows: list[tuple[str, int]], start: int, inputs: Path, seed: int) -> None:
    """Run the cases of rows, from one of the first row on; one line each."""
    if hasattr(signal, "SIGPROF"):
        faulthandler.register(signal.SIGPROF, chain=True)
    for name, cases in rows:
        with tempfile.TemporaryDirectory() as folder:
            case = _case(name, inputs, Path(folder))
            for i in range(start, cases):
                with _no_longer_than(_LONGEST):
                    end, why = case(random.Random(f"{seed}/{name}/{i}"))
                text = f"case {i}: {why!r}" if why else ""
                print("ended", name, end, text, sep="\t", flush=True)
        start = 0


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


Case = Callable[[random.Random], tuple[str, str]]


def _case(name: str, inputs: Path, folder: Path) -> Case:
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


def _opening(kind: str, folder: Path) -> Case:
    """A recording, damaged and opened."""
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


def _changing(kind: str, inputs: Path, folder: Path) -> Case:
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
