"""How many semantic mutants of the package the tests find: changed signs, factors, terms, axes.

    pip install -e '.[test]'
    python benchmarks/mutants.py [--count N] [--seed N] [--only ROOM,…] [--pytest OPTIONS] [--list]

Needs Python 3.12 or later. Draws mutants over all rooms of `src/deltaid`, each one expression of a
line. First the whole suite runs once and notes which tests reach these lines. Then each mutant gets
a copy of the repository of its own, in which these tests run until one fails; what survives them
meets the other tests of the same files, and all files that start other processes, in which nobody
sees what is reached. Tests that fail without a mutant count for none. Prints every survivor and
leaves `tables/mutants.md`. `--list` only says what is drawn; `--reach FILE` keeps which tests reach
which lines.
"""

import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

from _mutation import Mutant, drawn
from _table import STATED, leave
from _timing import options

ROOT = Path(__file__).resolve().parents[1]
# A mutant that loops for ever is found by that, as a person would [s].
_LONGEST = 1200.0
# Tests that are run before all others that reach a mutant [s].
_PORTION = 20.0
# What a file that starts other processes has in it.
_PROCESSES = re.compile(r"\bsubprocess\b|\bPopen\b|\bStudio\(")
_COMMON = {"deltaid", "test", "src", "py"}
# Mutants that no test can find, by file and replaced expression, and why.
EQUIVALENT = {
    ("deltaid/fleets/store.py", "range(_TRIES)"): "the loop returns or raises at k = _TRIES − 1, "
    "so that one more round is never begun",
    ("deltaid/sensors/robot_sensors.py", "parameter.prior + parameter.std * size"): "size is drawn "
    "from N(0, 1) or from −a to a, both symmetric, so that prior ± std · size have the same "
    "distribution",
}  # fmt: skip
NOTE = """\
Mutants are drawn by `benchmarks/_mutation.py`: one a room, the rest by the number of places. *Found
by* is the first test that failed, of those that reach the changed line."""


@dataclass(frozen=True)
class Reach:
    """Tests that reach a line, the seconds they take, and those that fail without any mutant."""

    tests: dict[str, list[str]]
    seconds: dict[str, float]
    failed: list[str]

    def portions(self, mutant: Mutant) -> Iterator[list[str]]:
        """Tests that reach a mutant, in portions: those named like its module, then quick ones."""
        lines = range(mutant.line, mutant.last + 1)
        found = {test for line in lines for test in self.tests.get(f"{mutant.path}:{line}", [])}
        own = _words(mutant.path)

        def order(test: str) -> tuple[int, float]:
            return -len(own & _words(test.split("::")[0])), self.seconds[test]

        portion, left = list[str](), _PORTION
        for test in sorted(found - set(self.failed), key=order):
            portion.append(test)
            left -= self.seconds[test]
            if left < 0:
                yield portion
                portion, left = list[str](), math.inf
        if portion:
            yield portion


def _words(path: str) -> set[str]:
    """Of a path, without the ends that grammar gives them."""
    return {word.removesuffix("s") for word in re.split(r"\W|_", path) if len(word) > 2} - _COMMON


def reach(mutants: list[Mutant], work: Path, options: list[str]) -> Reach:
    """One run of the suite, with the lines of all mutants watched."""
    asked, out = work / "lines", work / "reached"
    out.mkdir()
    lines = {f"{m.path}:{line}" for m in mutants for line in range(m.line, m.last + 1)}
    asked.write_text("\n".join(sorted(lines)))
    more = {"REACHED_LINES": str(asked), "REACHED_OUT": str(out)}
    done = _pytest(ROOT, ["-n", "auto", "-p", "_reached", *options], None, more)
    print(done.stdout[-3000:], flush=True)
    tests, seconds, failed = dict[str, list[str]](), dict[str, float](), list[str]()
    for path in out.glob("*.json"):
        part = json.loads(path.read_text())
        seconds |= part["seconds"]
        failed += part["failed"]
        for line, reached in part["tests"].items():
            tests.setdefault(line, []).extend(reached)
    return Reach(tests, seconds, sorted(set(failed)))


def verdict(mutant: Mutant, portions: Iterable[list[str]], copy: Path, options: list[str]) -> str:
    """The test that fails for a mutant, empty where it survives."""
    path = copy / "src" / mutant.path
    original = path.read_bytes()
    path.write_bytes(mutant.applied(original))
    files = set[str]()
    try:
        for portion in portions:
            if found := _first_failure(portion, copy, options):
                return found
            files |= {test.split("::")[0] for test in portion}
        files |= {f"tests/{path.name}" for path in (copy / "tests").glob("test_*.py")
                  if _PROCESSES.search(path.read_text(encoding="utf-8"))}  # fmt: skip
        return _first_failure(sorted(files), copy, options)
    finally:
        path.write_bytes(original)


def _first_failure(tests: list[str], copy: Path, options: list[str]) -> str:
    # Ids of parametrised tests can be long: they go by a file of arguments.
    arguments = copy / "tests-of-mutant"
    arguments.write_text("\n".join(tests))
    command = ["-n", "0", "-x", "-p", "no:cacheprovider", *options, f"@{arguments}"]
    try:
        done = _pytest(copy, command, _LONGEST, {})
    except subprocess.TimeoutExpired:
        return "a test that does not end"
    if done.returncode == 0:
        return ""
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failed[0].split(" ", 1)[1].split(" - ")[0] if failed else done.stdout[-300:]


def _pytest(
    folder: Path, options: list[str], limit: float | None, more: dict[str, str]
) -> subprocess.CompletedProcess[str]:
    """Tests of a copy of the repository, with its own package."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(folder / "src"), str(folder / "benchmarks")]),
        "PYTHONDONTWRITEBYTECODE": "1",
        **more,
    }
    command = [sys.executable, "-m", "pytest", "-q", *options]
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, timeout=limit
    )


def main() -> None:
    asked = options(
        __doc__, count=STATED["mutants"]["rows"], seed=2711, only="", pytest="",
        jobs=os.cpu_count() or 1, reach=Path, list=False, name="mutants",
    )  # fmt: skip
    rooms, further = set(filter(None, asked.only.split(","))), shlex.split(asked.pytest)
    mutants = drawn(ROOT / "src", asked.count, asked.seed)
    mutants = [mutant for mutant in mutants if not rooms or mutant.room in rooms]
    if asked.list:
        print(*mutants, sep="\n")
        return
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        found = _known(asked.reach) or reach(mutants, work, further)
        if asked.reach:
            asked.reach.write_text(json.dumps(asdict(found)))
        further += [word for test in found.failed for word in ("--deselect", test)]
        copies = [_copy(work / f"copy{k}") for k in range(asked.jobs)]

        def answered(mutant: Mutant) -> str:
            copy = copies.pop()
            try:
                answer = verdict(mutant, found.portions(mutant), copy, further)
            finally:
                copies.append(copy)
            print(f"{'killed' if answer else 'SURVIVES'} {mutant}  [{answer}]", flush=True)
            return answer

        with ThreadPoolExecutor(asked.jobs) as pool:
            answers = list(pool.map(answered, mutants))
    rows = [
        (mutant.room, f"`{mutant}`".replace("|", "\\|"), _found_by(mutant, answer))
        for mutant, answer in zip(mutants, answers, strict=True)
    ]
    killed = sum(map(bool, answers))
    kinds = Counter(mutant.operator for mutant in mutants)
    counts = ", ".join(f"{number} {kind}" for kind, number in kinds.most_common())
    text = f"{NOTE} **{killed} of {len(mutants)} are found** ({counts}; seed {asked.seed})."
    leave(("room", "mutant", "found by"), rows, text, asked.name)


def _found_by(mutant: Mutant, answer: str) -> str:
    why = EQUIVALENT.get((mutant.path, mutant.before), "")
    return f"`{answer}`" if answer else f"nothing can: {why}" if why else "**nothing**"


def _known(path: Path | None) -> Reach | None:
    """What an earlier run of the suite left."""
    return Reach(**json.loads(path.read_text())) if path and path.exists() else None


def _copy(folder: Path) -> Path:
    skip = shutil.ignore_patterns(".git", ".venv", "__pycache__", ".pytest_cache", "*.egg-info")
    return shutil.copytree(ROOT, folder, ignore=skip)


if __name__ == "__main__":
    main()
