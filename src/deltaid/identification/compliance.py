"""Gears that wind up: links' positions from motors', by estimated or stated compliances."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.effects.compliance import compliances
from deltaid.effects.windings import motors_of
from deltaid.estimation.trace_rows import TraceRows
from deltaid.estimation.traces import Trace
from deltaid.identification.lag_stage import lags_corrected, traced, without_lags
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.study import LOAD_CHANGE, Study
from deltaid.recording.recording import Recording

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


def _turned_back(setup: Setup, progress: Progress, *, search: bool = True) -> Setup:
    """With stated gears and, if searched, those that are detected."""
    for recording in setup.recordings:
        setup = setup.repaired(recording, gears=None)
    # Lags are separate columns here.
    bare = setup.reported((), "compliance").changed(additions=without_lags(setup.additions))
    pairs = (_traced(bare, recording) for recording in bare.recordings)
    traces = [pair for pair in pairs if pair is not None]
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
    for recording in bare.recordings:
        if recording.low_pass is not None:
            rate = recording.log.rate
            motors = motors_of(bare.robot, gears.p, recording.low_pass.cutoff, rate)
            motors = replace(motors, compliance=tuple(gears.values.tolist()))
            bare = bare.repaired(recording, gears=motors)
    bare = bare.studied()
    if searched.any() and not _better_than_loads(setup, bare.studies):
        return _turned_back(setup, progress, search=False)
    bare = bare.reported(gears.corrections(bare.robot))
    return lags_corrected(bare, progress)


def _better_than_loads(setup: Setup, turned: Sequence[Study | None]) -> bool:
    """Whether gears leave less than a load would that seems to come and go, where one does.

    Args:
        turned: studies of the recordings with their gears turned back.
    """
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


def _traced(setup: Setup, recording: Recording) -> tuple[Trace, Trace] | None:
    """A recording in memory, in the band of the motion and in that of a fit; None where it has no
    filter or nothing can be differentiated."""
    if recording.low_pass is None:
        return None
    cutoff = recording.low_pass.cutoff
    narrow, wide = (traced(setup, recording, share * cutoff, _WINDOWS) for share in (_BAND, 1.0))
    return None if narrow is None or wide is None else (narrow, wide)
