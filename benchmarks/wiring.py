"""Whether wrong wiring is named, and whether what is proposed restores the recording.

    python benchmarks/wiring.py [--seeds N] [--first N] [--kinds A,B] [--motions A,B] [--faults A,B]

Robots and torques are those of the tests' oracle. A fix is applied to the mapping and the mapped
columns are compared with the true ones. Writes `tables/wiring.md`.
"""

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations

import _alone  # noqa: F401
import numpy as np
from _table import STATED, leave
from _timing import options

from deltaid.checks.evidence import evidence
from deltaid.checks.verdicts import changes, with_changes
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.errors import RecordingError
from deltaid.model.verdict import Grade, Verdict
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from drives.cycles import MOTIONS, cycling
from drives.happening import Happening
from drives.robots import machine
from drives.sensors import Sensors
from logs import tabled
from oracle.tree import Array

KINDS = ("delta3", "delta4", "h4", "par4")
HEAD = ("fault", "motion", "recordings", "named right", "wrong, not the right name",
        "not called wrong", "wrong fix", "s")  # fmt: skip
_SAME = 0.05
Columns = tuple[Array, Array]


@dataclass(frozen=True)
class Fault:
    """What wiring does to positions and torques of two of the drives i, j.

    Attributes:
        change: of (q, tau).
        keys: verdicts that are right.
        both: whether it is of both drives, or of i alone.
        hidden: whether a robot with three equal limbs does not show it.
    """

    change: Callable[[Array, Array, int, int], Columns]
    keys: tuple[str, ...]
    both: bool = False
    hidden: bool = False


def _turned(x: Array, *drives: int) -> Array:
    return x * np.where(np.isin(np.arange(x.shape[1]), drives), -1.0, 1.0)


def _exchanged(x: Array, i: int, j: int) -> Array:
    order = np.arange(x.shape[1])
    order[[i, j]] = j, i
    return x[:, order]


def _times(x: Array, i: int, factor: float) -> Array:
    return x * np.where(np.arange(x.shape[1]) == i, factor, 1.0)


def _copied(x: Array, i: int, j: int) -> Array:
    out = x.copy()
    out[:, i] = x[:, j]
    return out


_SIGNS, _UNITS = ("angle-sign", "torque-sign"), ("angle-unit", "gear", "torque-unit")
FAULTS = {
    "none": Fault(lambda q, tau, i, j: (q, tau), ()),
    "angle and torque": Fault(
        lambda q, tau, i, j: (_turned(q, i), _turned(tau, i)), _SIGNS),
    "angle": Fault(lambda q, tau, i, j: (_turned(q, i), tau), _SIGNS),
    "torque": Fault(lambda q, tau, i, j: (q, _turned(tau, i)), _SIGNS),
    "two angles and torques": Fault(
        lambda q, tau, i, j: (_turned(q, i, j), _turned(tau, i, j)), _SIGNS, both=True),
    "two angles": Fault(lambda q, tau, i, j: (_turned(q, i, j), tau), _SIGNS, both=True),
    "two torques": Fault(lambda q, tau, i, j: (q, _turned(tau, i, j)), _SIGNS, both=True),
    "exchanged angles": Fault(
        lambda q, tau, i, j: (_exchanged(q, i, j), tau), ("drive-order",), both=True),
    "exchanged torques": Fault(
        lambda q, tau, i, j: (q, _exchanged(tau, i, j)), ("drive-order",), both=True),
    "exchanged": Fault(lambda q, tau, i, j: (_exchanged(q, i, j), _exchanged(tau, i, j)),
                       ("drive-order",), both=True, hidden=True),
    "copied torque": Fault(
        lambda q, tau, i, j: (q, _copied(tau, i, j)), ("refused",), both=True),
    "degrees": Fault(lambda q, tau, i, j: (q * (180 / np.pi), tau), _UNITS),
    "gear": Fault(lambda q, tau, i, j: (_times(q, i, 12.0), tau), _UNITS),
}  # fmt: skip


@dataclass(frozen=True)
class Result:
    """Of one check; `words` are what was said."""

    named: bool
    called: bool
    wrong_fix: bool
    seconds: float
    words: str


def recording(kind: str, motion: str, seed: int) -> tuple[RobotDescription, Array, Array, Array]:
    """A robot, and t, q, tau of it."""
    m = machine(kind, seed)
    if motion != "fourier":
        m = cycling(m.robot, m.plant.p, motion, seed)
    log = Sensors().recorded(Happening(m, 12.0, seed))
    columns = (log.select(f"{x}{i + 1}" for i in range(m.dof)).to_numpy() for x in ("q", "tau"))
    return m.robot, log["t"].to_numpy(), *columns


def judged(
    robot: RobotDescription, t: Array, true: Columns, fault: Fault, i: int, j: int
) -> Result:
    """The verdicts on a recording with a fault, and whether their fix restores it."""
    q, tau = fault.change(*true, i, j)
    record = evidence(robot, tabled(t=t, q=q, tau=tau))
    _, start = record.rows, time.process_time()
    try:
        verdicts = checked_wiring(record)
    except RecordingError as error:
        verdicts = (Verdict("refused", Grade.WRONG, error.what, cause=error.what),)
    found = [v for v in verdicts if v.grade in (Grade.WRONG, Grade.DOUBTFUL)]
    seconds, proposed = time.process_time() - start, changes(found, "mapping")
    restored = False
    if proposed:
        data = with_changes(record.written_mapping, proposed)
        rows = evidence(robot, record.source, ColumnMapping.model_validate(data)).rows
        # Limbs that are alike have no names where all columns moved together.
        orders = permutations(range(len(robot.drives))) if fault.hidden else [range(len(true[0].T))]
        restored = any(_same(rows.q, true[0][:, order]) and _same(rows.tau, true[1][:, order])
                       for order in map(list, orders))  # fmt: skip
    drives = {robot.drives[k] for k in ((i, j) if fault.both else (i,))}
    named = restored if proposed else _names(found, fault, drives)
    words = "; ".join(f"{v.key} ({v.grade}) {v.subject}" for v in found)
    return Result(named, bool(found), bool(proposed) and not restored, seconds, words)


def _same(x: Array, y: Array) -> bool:
    return bool(np.ptp(x - y) < _SAME * np.ptp(y))


def _names(found: list[Verdict], fault: Fault, drives: set[str]) -> bool:
    """Whether verdicts without a fix name the fault's drives and kind."""
    keyed = [v for v in found if v.key in fault.keys]
    said = " ".join(f"{v.subject} {v.cause}" for v in keyed)
    return bool(keyed) and all(drive in said for drive in drives)


def rows(results: dict[tuple[str, str], list[Result]]) -> list[tuple[object, ...]]:
    out = list[tuple[object, ...]]()
    for (fault, motion), outcomes in results.items():
        good = [not r.called if fault == "none" else r.named for r in outcomes]
        wrong = sum(r.called and not ok for r, ok in zip(outcomes, good, strict=True))
        missed = 0 if fault == "none" else sum(not r.called for r in outcomes)
        fixes, seconds = (
            sum(r.wrong_fix for r in outcomes),
            np.median([r.seconds for r in outcomes]),
        )
        out.append(
            (fault, motion, len(outcomes), sum(good), wrong, missed, fixes, f"{seconds:.1f}")
        )
    return out


def main() -> None:
    seeds, kinds, faults = STATED["wiring"]["seeds"], ",".join(KINDS), ",".join(FAULTS)
    every = ",".join(("fourier", *MOTIONS))
    given = options(__doc__, seeds=seeds, first=0, kinds=kinds, motions=every, faults=faults)
    results = dict[tuple[str, str], list[Result]]()
    names, motions = given.faults.split(","), given.motions.split(",")
    for seed in range(given.first, given.first + given.seeds):
        for kind in given.kinds.split(","):
            for motion in motions:
                robot, t, *true = recording(kind, motion, seed)
                equal = robot.platform.kind == "rigid"
                limbs = 3 if robot.telescope is not None else len(robot.drives)
                i, j = np.random.default_rng([seed, 9]).permutation(limbs)[:2].tolist()
                for name in names:
                    if equal and FAULTS[name].hidden:
                        continue
                    result = judged(robot, t, (true[0], true[1]), FAULTS[name], i, j)
                    results.setdefault((name, motion), []).append(result)
                    if not result.named and (name != "none" or result.called):
                        print(f"{name}, {kind} {motion} {seed}, drives {i + 1}, {j + 1}: "
                              f"{result.words or 'nothing'}"
                              f"{' WRONG FIX' * result.wrong_fix}", flush=True)  # fmt: skip
    sums = Counter[str]()
    for outcomes in results.values():
        sums.update(recordings=len(outcomes), wrong_fixes=sum(r.wrong_fix for r in outcomes))
    order = {key: results[key] for key in sorted(results, key=lambda k: names.index(k[0]))}
    note = f"{sums['recordings']} recordings, {sums['wrong_fixes']} wrong fixes."
    kinds = len(given.kinds.split(","))
    leave(HEAD, rows(order), note, kinds=kinds, seeds=given.seeds)


if __name__ == "__main__":
    main()
