"""Gears that wind up: their motors are turned back to the links, by what shows or is stated."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.effects.compliance import compliances
from deltaid.effects.windings import motors_of
from deltaid.estimation.trace_rows import TraceRows
from deltaid.estimation.traces import Trace
from deltaid.identification.lag_stage import lags_put_right, traced, without_lags
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.study import Study, studied
from deltaid.recording.recording import Recording

# Windows of a recording at least that are used.
_WINDOWS = 2
# The low-pass over rows, as a share of that which a fit has.
_BAND = 0.5


def gears_turned_back(setup: Setup, progress: Progress) -> Setup:
    """Positions of links in the place of those of motors, where their gears wind up."""
    turned = _turned_back(setup, progress)
    gears = [one.repairs.gears for one in (*setup.recordings, *turned.recordings)]
    return turned if any(gears) else setup  # with its lags


def _turned_back(setup: Setup, progress: Progress, *, search: bool = True) -> Setup:
    """With gears that are stated, and if asked to search for them those that show."""
    for recording in setup.recordings:
        setup = setup.repaired(recording, gears=None)
    # Lags stand here as columns of their own.
    bare = setup.told((), "compliance").changed(additions=without_lags(setup.additions))
    traces = [both for one in bare.recordings if (both := _traced(bare, one)) is not None]
    stated = np.array([1 / setup.robot.stiffness(drive) for drive in setup.robot.drives])
    searched = (stated == 0) & (search and setup.settings.compliance == "estimate")
    if not traces or not (stated.any() or searched.any()):
        return setup
    progress("looking for gears that wind up")
    narrow, wide = zip(*traces, strict=True)
    rows = TraceRows.of(bare.dynamics, bare.additions, bare.settings.prior_spread)
    found = compliances(narrow, wide, rows, np.where(searched, np.nan, stated))
    if not found.values.any():
        return setup
    for recording in bare.recordings:
        if recording.low_pass is not None:
            rate = recording.log.rate
            motors = motors_of(bare.robot, found.p, recording.low_pass.cutoff, rate)
            motors = replace(motors, compliance=tuple(found.values.tolist()))
            bare = bare.repaired(recording, gears=motors)
    # Loads and lags that gears imitated are none.
    studies = tuple(studied(bare.dynamics, one) for one in bare.recordings)
    if searched.any() and not _better_than_loads(setup, studies):
        return _turned_back(setup, progress, search=False)
    bare = bare.changed(studies=studies).told(found.corrections(bare.robot))
    return lags_put_right(bare, progress)


def _better_than_loads(setup: Setup, turned: Sequence[Study | None]) -> bool:
    """Whether gears leave less than a load would that seems to come and go, where one does.

    Args:
        turned: studies of the recordings with their gears turned back.
    """
    for k, after in enumerate(turned):
        before = setup.studies[k] if setup.is_disturbed(k) else None
        if before is None or after is None:
            continue
        found, left = before.account.found, before.account.left
        of_loads = sum(one.gain for one in found if one.candidate.kind == "load-change")
        whole = float(left @ left) + sum(one.gain for one in found)
        by_gears = np.mean((after.fit.rows.scale / before.fit.rows.scale) ** 2)
        if by_gears > 1.0 - of_loads / whole:
            return False
    return True


def _traced(setup: Setup, recording: Recording) -> tuple[Trace, Trace] | None:
    """A recording in memory, in the band of the motion and in that of a fit; None where it has no
    filter or nothing can be differentiated."""
    if recording.low_pass is None:
        return None
    cutoff = recording.low_pass.cutoff
    narrow, wide = (traced(setup, recording, by * cutoff, _WINDOWS) for by in (_BAND, 1.0))
    return None if narrow is None or wide is None else (narrow, wide)
