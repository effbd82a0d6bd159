"""Whether faulty recordings get the right verdict, and clean ones none.

    pip install -e '.[test]'
    python benchmarks/verdicts.py [--clean N] [--faulty N] [--seed N] [--kinds KIND,KIND]
    python benchmarks/verdicts.py --only KIND --seed N --show

Recordings come from `tests/faults`. The first leaves `tables/verdicts.md`, with what was missed and
how to see it again; the second prints all verdicts on one case (KIND `clean` for a clean one). The
tests run a few (`tests/test_verdicts.py`).
"""

import os
import time
from collections import Counter
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import _alone  # noqa: F401
from _table import STATED, leave
from _timing import options

from deltaid.model.verdict import Grade
from faults import KINDS, Case, clean, faulty
from faults.score import Score, said_of, score

HEAD = ("recordings", "cases", "right", "verdicts worse than good")


@dataclass(frozen=True)
class Result:
    """Of one case; `error` where something was raised."""

    kind: str
    seed: int
    words: str
    score: Score
    seconds: float
    error: str = ""


def case_of(kind: str, seed: int) -> Case:
    return clean(seed) if kind == "clean" else faulty(kind, seed)


def result(kind: str, seed: int) -> Result:
    """Make a case and judge the verdicts on it."""
    case = case_of(kind, seed)
    words = f"{case.robot.name}, {case.size or f'{case.setting.noise:.1%} noise'}"
    start = time.process_time()
    try:
        found = said_of(case)
    except Exception as error:  # whatever it is, it is a miss, and the rest goes on
        what = f"{type(error).__name__}: {error}".split("\n")[0]
        return Result(kind, seed, words, Score(False, ((what[:80], "raised"),), True), 0.0, what)
    return Result(kind, seed, words, score(case, found), time.process_time() - start)


def rows(results: list[Result]) -> Iterable[tuple[object, ...]]:
    for kind in dict.fromkeys(result.kind for result in results):
        scores = [result.score for result in results if result.kind == kind]
        counts = Counter(key for score in scores for key in {f"{k} ({g})" for k, g in score.said})
        counts["none"] = sum(not score.said for score in scores)
        said = ", ".join(f"{key} {n}" for key, n in counts.most_common() if n)
        yield kind, len(scores), f"{sum(score.right for score in scores) / len(scores):.0%}", said


def summary(results: list[Result]) -> str:
    ok = [result for result in results if result.kind == "clean"]
    bad = [result for result in results if result.kind != "clean"]
    lines = []
    if bad:
        right = sum(result.score.right for result in bad)
        lines.append(f"{right} of {len(bad)} faulty recordings get the right verdict "
                     f"({right / len(bad):.1%}).")  # fmt: skip
    if ok:
        wrong = sum(result.score.graver for result in ok)
        doubtful = len(ok) - sum(result.score.right for result in ok) - wrong
        lines.append(f"Of {len(ok)} clean ones {wrong} are called wrong and "
                     f"{doubtful} doubtful.")  # fmt: skip
    seconds = sorted(result.seconds for result in results)[len(results) // 2]
    return " ".join(lines) + f" A check takes {seconds:.1f} s of processor time (median)."


def missed(results: list[Result]) -> str:
    """What was not right, with the command that shows it."""
    lines = [
        f"- `--only {result.kind} --seed {result.seed} --show` {result.words}: "
        + (", ".join(f"{key} ({grade})" for key, grade in result.score.said) or "nothing said")
        for result in results
        if not result.score.right
    ]
    return "Not right:\n\n" + "\n".join(lines) if lines else "All are right."


def show(kind: str, seed: int) -> None:
    case = case_of(kind, seed)
    s = case.setting
    print(f"{case.robot.name}: {case.kind}, {case.size}; expected {case.keys} {case.subject}")
    print(
        f"{s.rate:g} Hz, {s.duration:.1f} s, period {s.period:.2f} s of {s.harmonics} harmonics, "
        f"noise {s.noise:.2%}, encoder step {s.step.max():.2g}, velocity {s.velocity}, "
        f"rest {s.rest}"
    )
    found = said_of(case)
    for verdict in found:
        number = "" if verdict.number is None else f" [{verdict.number:.4g} {verdict.unit}]"
        print(f"{verdict.grade:12} {verdict.key} {verdict.subject}{number}: {verdict.seen}")
        if verdict.grade is not Grade.GOOD:
            print(f"             cause: {verdict.cause}\n             cure: {verdict.cure}")
    print(score(case, found))


def main() -> None:
    stated = STATED["verdicts"]
    given = options(
        __doc__, clean=stated["clean"], faulty=stated["faulty"], seed=1, kinds=",".join(KINDS),
        only=str, show=False, processes=os.cpu_count() or 1,
    )  # fmt: skip
    if given.only and given.show:
        show(given.only, given.seed)
        return
    kinds = [given.only] if given.only else given.kinds.split(",")
    asked = [(kinds[i % len(kinds)], given.seed + i) for i in range(given.faulty)]
    asked += [("clean", given.seed + 10_000 + i) for i in range(given.clean)]
    with ProcessPoolExecutor(given.processes) as pool:
        results = list(pool.map(result, *zip(*asked, strict=True), chunksize=1))
    results.sort(key=lambda result: (result.kind != "clean", result.kind))
    note = summary(results) + "\n\n" + missed(results)
    leave(HEAD, list(rows(results)), note, clean=given.clean, faulty=given.faulty)


if __name__ == "__main__":
    main()
