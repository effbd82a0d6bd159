"""How well intervals of single bodies hold with scales, a base plate and strut gauges.

    pip install -e '.[test,benchmark]'
    python benchmarks/bodies_weighed.py [SEEDS]

The table is of the intervals of the fit alone, before models drawn from posteriors had rows.

Robots are drawn from their own prior (spread 0.2, consistent), and recorded with 1 % torque noise;
each leaves `tables/bodies_weighed.md`: predicted standard deviations over the scatter of errors,
and the share of 95 % intervals that hold, of all entries that data or measured values decide; by
the intervals of the fit, and by models drawn from its posterior, whose mean is the estimate that
goes with them. Tests run some seeds (`tests/test_sensors_in_fit.py`, `tests/test_weighings.py`).
"""

import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import NamedTuple

import _alone  # noqa: F401
import numpy as np
from _table import STATED, leave

from deltaid.dynamics.parameters import parameter_layout
from deltaid.errors import IdentificationError
from deltaid.estimation.posterior_draws import draw
from deltaid.identification.identify import identify
from deltaid.model.model import load
from deltaid.model.record import Settings
from deltaid.parallel import cores
from sensed import CASES, drawn, recorded, sensed, weighed

SPREAD, MODELS = 0.2, 4000
ROBOTS = ("clavel-delta3", "irb360-6-1600")
HEAD = (
    "robot", "with", "intervals", "seeds", "entries", "std over scatter, rms", "least", "largest",
    "held", "worst entry",
)  # fmt: skip
# Entries that data decides in fewer of the robots than this are left out.
_MOSTLY = 0.9


class Told(NamedTuple):
    """What a fit says of each entry: by its intervals, or by models drawn from its posterior."""

    error: np.ndarray
    std: np.ndarray
    held: np.ndarray


def robot_results(name: str, case: str, seed: int) -> tuple[np.ndarray, dict[str, Told]]:
    """Whether data decides each entry of one drawn robot, and what is told of it, by the kind of
    interval; without the second where drawing models is refused."""
    rng, of = np.random.default_rng(1000 + seed), sensed(name, case, SPREAD)
    p = drawn(of.reduction, SPREAD, rng)
    robot, log = weighed(of, p, rng), recorded(name, of, p, rng)
    model = identify(robot, log, settings=Settings(prior_spread=SPREAD)).model
    # Of one recording in some hundred a further term of friction is seen; it is no entry of p.
    own = [model.layout.names.index(name) for name in parameter_layout(robot).names]
    found = [model.parameters[k] for k in own]
    low, high, value, std = np.array([(x.low, x.high, x.value, x.std) for x in found]).T
    decided = np.array([x.determined_by in ("data", "measured") for x in found])
    estimates = {"linear": Told(value - p, std, (low <= p) & (p <= high))}
    try:
        draws = draw(load(model), MODELS, seed).p[:, own]
    except IdentificationError:
        return decided, estimates
    ends = np.quantile(draws, (0.025, 0.975), axis=0)
    by_draws = Told(draws.mean(0) - p, draws.std(0), (ends[0] <= p) & (p <= ends[1]))
    return decided, estimates | {"posterior": by_draws}


def rows(name: str, case: str, seeds: int, pool: ProcessPoolExecutor) -> list[tuple[object, ...]]:
    """Rows of the table, one for each kind of interval."""
    results = list(pool.map(robot_results, [name] * seeds, [case] * seeds, range(seeds)))
    some = np.mean([decided for decided, _ in results], axis=0) >= _MOSTLY
    return [
        row(name, case, kind, [by_kind[kind] for _, by_kind in results if kind in by_kind], some)
        for kind in ("linear", "posterior")
    ]


def row(
    name: str, case: str, kind: str, estimates: Sequence[Told], some: np.ndarray
) -> tuple[object, ...]:
    """Deviations over the scatter of errors, and how often intervals hold, of some entries."""
    error, std, held = (np.array(each)[:, some] for each in zip(*estimates, strict=True))
    ratio = np.sqrt(np.mean(std**2, axis=0) / np.mean(error**2, axis=0))
    share = held.mean(axis=0)
    return (
        name, case, kind, len(estimates), int(some.sum()), f"{np.sqrt(np.mean(ratio**2)):.3f}",
        f"{ratio.min():.2f}", f"{ratio.max():.2f}", f"{share.mean():.1%}", f"{share.min():.0%}",
    )  # fmt: skip


def main() -> None:
    seeds = int(sys.argv[1]) if sys.argv[1:] else STATED["bodies_weighed"]["seeds"]
    with ProcessPoolExecutor(cores()) as pool:
        found = (rows(name, case, seeds, pool) for name in ROBOTS for case in CASES)
        table = [line for lines in found for line in lines]
    note = "Robots drawn from their priors; entries that data or a scale decides."
    leave(HEAD, table, note, seeds=seeds)


if __name__ == "__main__":
    main()
