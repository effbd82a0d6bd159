"""Gears that wind up: links' positions from motors', by estimated or stated compliances."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.effects.compliance import compliances
from deltaid.effects.lag_columns import TimingColumns
from deltaid.effects.windings import motors_of
from deltaid.estimation.trace_rows import TraceRows
from deltaid.identification.gains import gains
from deltaid.identification.lag_stage import lags_corrected, traced
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.study import LOAD_CHANGE, Study

# Windows of a recording at least that are used.
_WINDOWS = 2
# The low-pass over rows, as a share of that which a fit has.
_BAND = 0.5


def gears_turned_back(setup: Setup, progress: Progress) -> Setup:
    """Positions of links in place of those of motors, where their gears wind up; gears that a
    contest of causes has found stiff are not searched again."""
    turned = _turned_back(setup, progress, search=setup.outcome is None or setup.outcome.winds_up)
    gears = [recording.repairs.gears for recording in (*setup.recordings, *turned.recordings)]
    return turned if any(gears) else setup  # with its lags


def estimated_anew(setup: Setup, progress: Progress) -> Setup:
    """Gains, lags and gears, which other effects hide or look like, once these are known."""
    return gears_turned_back(lags_corrected(gains(setup, progress), progress), progress)


def _turned_back(setup: Setup, progress: Progress, *, search: bool = True) -> Setup:
    """With stated gears and, if searched, those that are detected."""
    setup = setup.all_repaired(gears=None)
    # Lags are separate columns here.
    bare = setup.reported((), "compliance").without(TimingColumns)
    # In the band of the motion and in that of a fit, of all that have a filter.
    cutoffs = [(r, r.low_pass.cutoff) for r in bare.recordings if r.low_pass is not None]
    pairs = [
        [traced(bare, recording, share * cutoff, _WINDOWS) for recording, cutoff in cutoffs]
        for share in (_BAND, 1.0)
    ]
    traces = [(a, b) for a, b in zip(*pairs, strict=True) if a is not None and b is not None]
    stated = np.array([1 / setup.robot.stiffness(drive) for drive in setup.robot.drives])
    searched = (stated == 0) & (search and setup.settings.compliance == "estimate")
    if not traces or not (stated.any() or searched.any()):
        return setup
    progress("looking for gears that wind up")
    narrow, wide = zip(*traces, strict=True)
    rows = TraceRows.of(bare.dynamics, bare.additions, bare.settings.prior_spread)
    gears = compliances(narrow, wide, rows, np.where(searched, np.nan, stated))
    if not gears.values.any():
        return setup
    for recording, cutoff in cutoffs:
        motors = motors_of(bare.robot, gears.p, cutoff, recording.log.rate)
        motors = replace(motors, compliance=tuple(gears.values.tolist()))
        bare = bare.repaired(recording, gears=motors)
    bare = bare.studied()
    if searched.any() and not _better_than_loads(setup, bare.studies):
        return _turned_back(setup, progress, search=False)
    bare = bare.reported(gears.corrections(bare.robot))
    return lags_corrected(bare, progress)


def _better_than_loads(setup: Setup, turned: Sequence[Study | None]) -> bool:
    """Whether gears turned back leave less than a load would that seems to come and go, where one
    does."""
    for k, after in enumerate(turned):
        before = setup.studies[k] if setup.is_disturbed(k) else None
        if before is None or after is None:
            continue
        parts, residual = before.account.found, before.account.left
        of_loads = sum(part.gain for part in parts if part.candidate.kind == LOAD_CHANGE)
        total = float(residual @ residual) + sum(part.gain for part in parts)
        by_gears = np.mean((after.fit.rows.scale / before.fit.rows.scale) ** 2)
        if by_gears > 1.0 - of_loads / total:
            return False
    return True
