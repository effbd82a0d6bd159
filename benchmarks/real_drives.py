"""How far identified models are from the truth on recordings as real drives write them.

    pip install -e '.[test]'
    python benchmarks/real_drives.py [--rows ROW,…] [--kinds KIND,…] [--seeds N] [--processes N]
                                     [--keep FILE]

Recordings come from `tests/drives`: robots of six kinds, each row of the table with one fault or
several (`rows.py`), or with faults that nobody named or drew together (`causes.py`). Leaves
`tables/real_drives.md`, which `docs/real_drives.md` explains: so far of one seed, where five are
stated. With `--keep` it leaves no table but every case in a file, for `paired.py`; with `--each`
it prints every case and the faults drawn for it.
"""

import json
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import _alone  # noqa: F401
import numpy as np
from _table import STATED, leave
from _timing import options

from deltaid.errors import DeltaidError
from drives import CAUSES, KINDS, ROWS, TIMING, case
from drives.identify import identified
from drives.judge import Judged, judge
from drives.noise import noise_limit

HEAD = (
    "recording", "asked: M, friction", "M: median, 90 %, worst", "friction: median, 90 %, worst",
    "without its constant", "within, n", "noise alone: M, friction, without its constant", "and",
    "said",
)  # fmt: skip
# Asked of M and of friction (%), for nine in ten recordings; three times as much at most.
_ASKED: dict[tuple[float, float | None], str] = {
    (0.1, 0.3): "clean",
    (0.2, 0.5): "lag one-lag current-loop velocity standing brakes stops contacts",
    (0.2, 1.0): "stribeck direction",
    (0.3, 0.5): "load-cycles load-half",
    (0.3, 0.7): "clipped",
    (0.3, 1.0): "filter-5ms second-order average-8ms hold-2ms noisy-hold clocks late-gear "
    "held-delays backlash",
    (0.3, 1.5): "load-friction three-laws",
    (0.5, None): "gear-20000",
    (1.0, None): "gains gear-5000",
    (2.0, None): "poor-priors",
}
# Asked of M and of friction without its constant, where a constant of friction and what nobody
# described may be the same to a recording.
_ASKED_SHAPE: dict[tuple[float, float | None], str] = {
    (0.2, 0.5): "ripple homing-0.3 homing-0.5",
    (0.3, 1.0): "gear-ratio long-limb mounting heavy-limb tilt presliding ball-joints",
    (0.3, 1.5): "production",
    (0.3, 2.0): "hose force spring hose-tilted",
    (0.3, 3.0): "balancer",
    (0.5, 2.0): "mixture",
    (0.6, 1.5): "realistic",
    (0.7, None): "asymmetric askew",
    (1.0, 4.0): "falling-gain saturation",
}
ASKED, ASKED_SHAPE = (
    {row: bounds for bounds, rows in asked.items() for row in rows.split()}
    for asked in (_ASKED, _ASKED_SHAPE)
)
# Rows of the first table of which intervals are judged.
OF_INTERVALS = ("clean", "homing", "poor-priors", "closed-loop", "unlogged", "realistic")
# Asked of the median of these, where it is asked for (%).
ASKED_MEDIAN = {"mixture": (0.15, 0.6)}


@dataclass(frozen=True)
class Result:
    """Of one case; `error` where it was refused, `drawn` the faults drawn for it."""

    row: str
    kind: str
    seed: int
    judged: Judged | None
    limit: tuple[float, float, float]
    seconds: float
    error: str = ""
    drawn: tuple[str, ...] = ()


def results(kind: str, seed: int, rows: Sequence[str]) -> list[Result]:
    return [result(row, kind, seed) for row in rows]


def result(row: str, kind: str, seed: int) -> Result:
    made = case(row, kind, seed)
    limit, start = noise_limit(made), time.process_time()
    try:
        found = identified(made)
    except DeltaidError as error:
        return Result(row, kind, seed, None, limit, 0.0, str(error).split("\n")[0], made.drawn)
    seconds = time.process_time() - start
    return Result(row, kind, seed, judge(made, found), limit, seconds, drawn=made.drawn)


def line(row: str, outcomes: Sequence[Result]) -> tuple[object, ...]:
    judgements = [outcome.judged for outcome in outcomes if outcome.judged is not None]
    inside = [within(outcome) for outcome in outcomes]
    limits = 100 * np.array([outcome.limit for outcome in outcomes])
    bounds = ", ".join("–" if a is None else f"{a:g}" for a in asked(row)[:2])
    if asked(row)[2] is not None:
        bounds += f"; {asked(row)[2]:g} without its constant"
    if row in ASKED_MEDIAN:
        bounds += "; medians {:g}, {:g}".format(*ASKED_MEDIAN[row])
    return (
        row,
        bounds,
        spread([100 * judgement.M for judgement in judgements]),
        spread([100 * judgement.friction for judgement in judgements]),
        spread([100 * judgement.friction_shape for judgement in judgements]),
        f"{np.mean(inside):.0%}, {len(outcomes)}",
        ", ".join(f"{x:.2g}" for x in np.quantile(limits, 0.9, axis=0)),
        "; ".join(more(row, outcomes, judgements)),
        said(outcomes),
    )


def asked(row: str) -> tuple[float | None, float | None, float | None]:
    """Of M, of friction and of friction without its constant (%)."""
    if row in ASKED_SHAPE:
        M, shape = ASKED_SHAPE[row]
        return M, None, shape
    M, friction = ASKED.get(row, (None, None))
    return M, friction, None


def within(outcome: Result) -> bool:
    """Whether errors are within what is asked, or within what the noise alone leaves."""
    if outcome.judged is None:
        return False
    errors = (outcome.judged.M, outcome.judged.friction, outcome.judged.friction_shape)
    return all(
        bound is None or error <= max(bound / 100, limit)
        for error, bound, limit in zip(errors, asked(outcome.row), outcome.limit, strict=True)
    )


def spread(values: Sequence[float]) -> str:
    """Median, 90 % quantile and worst."""
    if not values:
        return "–"
    return ", ".join(f"{x:.2g}" for x in (*np.quantile(values, [0.5, 0.9]), max(values)))


def more(row: str, outcomes: Sequence[Result], judgements: Sequence[Judged]) -> Iterable[str]:
    """What else is asked of a row."""
    lags = [1e3 * judgement.lag for judgement in judgements if judgement.lag is not None]
    if lags:
        yield f"lag within {np.quantile(lags, 0.9):.2g} ms in 90 %, worst {max(lags):.2g}"
    loads = [100 * judgement.load for judgement in judgements if judgement.load is not None]
    if loads:
        yield f"load within {np.quantile(loads, 0.9):.2g} % in 90 %, worst {max(loads):.2g}"
    yield from _contacts(judgements)
    yield from _gains(judgements)
    if row.endswith("undeclared"):
        yield from _undeclared(row, judgements)
    if row == "realistic":
        measured = [100 * judgement.friction_as_measured for judgement in judgements]
        yield f"friction as measured {spread(measured)}"
        shapes = [100 * judgement.M_shape for judgement in judgements]
        yield f"M but for the torques' scale {spread(shapes)}"
    curves = [share for judgement in judgements for share in judgement.curves]
    if curves:
        yield f"friction curves' intervals hold {np.mean(curves):.0%}"
    if row in OF_INTERVALS or row in CAUSES:
        yield f"intervals of bodies hold {share(judgement.bodies for judgement in judgements)}"
        yield f"of base parameters {share(judgement.base for judgement in judgements)}"
    refused = Counter(outcome.error for outcome in outcomes if outcome.error)
    yield from (f"refused {n} times: {error[:120]}" for error, n in refused.items())


def _contacts(judgements: Sequence[Judged]) -> Iterable[str]:
    contacts = [judgement.contacts for judgement in judgements if judgement.contacts]
    if contacts:
        yield f"found {share(known.strong for known in contacts)} above 100 N"
        yield f"{share(known.weak for known in contacts)} below"
        elsewhere = np.quantile([known.elsewhere for known in contacts], 0.9)
        yield f"elsewhere {elsewhere:.1%} in 90 %"


def _undeclared(row: str, judgements: Sequence[Judged]) -> Iterable[str]:
    yield f"reported in {share([[judgement.changes is not None for judgement in judgements]])}"
    changes = [judgement.changes for judgement in judgements if judgement.changes]
    late = [1e3 * change.late for change in changes if change.late is not None]
    if late and row == "load-half-undeclared":
        yield f"its time within {np.quantile(late, 0.9):.2g} ms in 90 %"
    right = [change.right for change in changes if change.right is not None]
    if right:
        yield f"state right for {np.quantile(right, 0.1):.0%} of the time in 90 %"


def _gains(judgements: Sequence[Judged]) -> Iterable[str]:
    first = [100 * gain for judgement in judgements for gain in judgement.gains[:3]]
    if first:
        rms = np.sqrt(np.mean(np.square(first)))
        yield f"gains 1–3 {rms:.2g} % rms, worst {np.abs(first).max():.2g} %"
        held = share(judgement.gains_held for judgement in judgements)
        yield f"all gains' intervals hold {held}"


def share(groups: Iterable[Sequence[bool]]) -> str:
    """Of all that is counted."""
    counted = [is_so for group in groups for is_so in group]
    return f"{np.mean(counted):.0%}" if counted else "–"


def said(outcomes: Sequence[Result]) -> str:
    """In how many cases each kind of correction was made, and each verdict is not good."""
    judgements = [outcome.judged for outcome in outcomes if outcome.judged]
    kinds = Counter(kind for judgement in judgements for kind, _ in judgement.said)
    keys = Counter(key for judgement in judgements for key in judgement.verdicts)
    done = ", ".join(f"{kind} {n}" for kind, n in kinds.most_common())
    words = ", ".join(f"{key} {n}" for key, n in keys.most_common())
    return "; ".join(filter(None, (done, words and f"verdicts: {words}"))) or "nothing"


def note(seeds: int, kinds: str, seconds: float) -> str:
    return (
        f"Errors in %, {seeds} seeds of {kinds.replace(',', ', ')}. *Within* is the share of "
        "recordings whose errors are within what is asked or within what the noise alone leaves. "
        f"An identification takes {seconds:.1f} s of processor time (median)."
    )


def as_dictionary(outcome: Result) -> dict[str, object]:
    """A case as `paired.py` reads it."""
    found = outcome.judged
    errors = {} if found is None else {"M": found.M, "friction": found.friction,
                                       "friction_shape": found.friction_shape}  # fmt: skip
    said = [] if found is None else [f"{kind} {count}" for kind, count in found.said]
    return {"case": f"{outcome.row} {outcome.kind} {outcome.seed}", "row": outcome.row,
            "errors": errors, "seconds": outcome.seconds, "said": said, "refused": outcome.error,
            "drawn": list(outcome.drawn)}  # fmt: skip


def main() -> None:
    given = options(
        __doc__, rows=",".join((*ROWS, *TIMING, *CAUSES)), kinds=",".join(KINDS),
        seeds=STATED["real_drives"]["seeds"], first=0, processes=2, keep=Path, each=False,
    )  # fmt: skip
    rows = given.rows.split(",")
    jobs = [(kind, seed, rows) for seed in range(given.first, given.first + given.seeds)
            for kind in given.kinds.split(",")]  # fmt: skip
    with ProcessPoolExecutor(given.processes) as pool:
        found = list[Result]()
        for of_robot in pool.map(results, *zip(*jobs, strict=True)):
            found += of_robot
            if given.each:
                print(*of_robot, sep="\n", flush=True)
    if given.keep:
        given.keep.write_text(json.dumps([as_dictionary(outcome) for outcome in found], indent=1))
        return
    table = [line(row, [outcome for outcome in found if outcome.row == row]) for row in rows]
    seconds = float(np.median([outcome.seconds for outcome in found]))
    kinds = len(given.kinds.split(","))
    leave(HEAD, table, note(given.seeds, given.kinds, seconds), kinds=kinds, seeds=given.seeds)


if __name__ == "__main__":
    main()
