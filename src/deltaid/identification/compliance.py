"""Gears that wind up: their motors are turned back to the links, by what shows or is stated."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.estimation.drive_rows import STRETCHES
from deltaid.estimation.scatter import quantile
from deltaid.estimation.traces import Trace, trace
from deltaid.identification.compliance_fit import compliances
from deltaid.identification.compliance_found import Found
from deltaid.identification.lag_stage import lags_put_right, without_lags
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.study import Study, studied
from deltaid.identification.windings import motors_of
from deltaid.model.corrections import Correction
from deltaid.recording.recording import Recording
from deltaid.recording.windows import WINDOW

# Windows of a recording that are looked at, and seconds.
_WINDOWS, _SECONDS = 2, 12.0
# The low-pass over rows, as a share of that which a fit has.
_BAND = 0.5
# Correlation from which a compliance is said to look like a lag.
_ALIKE = 0.9


def gears_turned_back(setup: Setup, progress: Progress) -> Setup:
    """Positions of links in the place of those of motors, where their gears wind up."""
    turned = _turned_back(setup, progress)
    gears = [one.repairs.gears for one in (*setup.recordings, *turned.recordings)]
    return turned if any(gears) else setup  # with its lags


def _turned_back(setup: Setup, progress: Progress, *, look: bool = True) -> Setup:
    """With gears that are stated, and if asked to look for them those that show."""
    for one in setup.recordings:
        setup = setup.repaired(one, gears=None)
    # Lags stand here as columns of their own.
    bare = setup.told((), "compliance").changed(additions=without_lags(setup.additions))
    seen = [both for one in bare.recordings if (both := _traced(bare, one)) is not None]
    stated = np.array([1 / setup.robot.stiffness(drive) for drive in setup.robot.drives])
    looked_for = (stated == 0) & (look and setup.settings.compliance == "estimate")
    if not seen or not (stated.any() or looked_for.any()):
        return setup
    progress("looking for gears that wind up")
    narrow, wide = zip(*seen, strict=True)
    found = compliances(narrow, wide, bare, np.where(looked_for, np.nan, stated))
    if not found.values.any():
        return setup
    for one in bare.recordings:
        if one.low_pass is not None:
            motors = motors_of(bare.robot, found.p, one.low_pass.cutoff, one.log.rate)
            motors = replace(motors, compliance=tuple(found.values.tolist()))
            bare = bare.repaired(one, gears=motors)
    # Loads and lags that gears imitated are none.
    studies = tuple(studied(bare.dynamics, one) for one in bare.recordings)
    if looked_for.any() and not _better_than_loads(setup, studies):
        return _turned_back(setup, progress, look=False)
    bare = bare.changed(studies=studies)
    return lags_put_right(bare.told(_told(bare, found)), progress)


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


def _told(setup: Setup, found: Found) -> list[Correction]:
    """One a drive whose gear winds up."""
    corrections = list[Correction]()
    wide = float(quantile(np.array([STRETCHES - 1.0]))[0])
    for i, drive in enumerate(setup.robot.drives):
        s, slides = float(found.values[i]), setup.robot.is_linear(drive)
        if s == 0:
            continue
        text = f"its gear winds up by what it carries over {1 / s:.3g} "
        text += "N/m" if slides else "N m/rad"
        half = None
        for k in np.flatnonzero(found.groups[i]):
            half = wide * float(found.deviation[k])
            text += _evidence(found, int(k))
        corrections.append(
            Correction(
                kind="compliance",
                subject=drive,
                value=s,
                low=None if half is None else s - half,
                high=None if half is None else s + half,
                unit="m/N" if slides else "rad/(N m)",
                text=f"{text}{', as stated' if half is None else ''}; positions are those of the "
                "link",
            )
        )
    return corrections


def _evidence(found: Found, k: int) -> str:
    """How the k-th size is known."""
    text = f", {found.sizes[k] / found.deviation[k]:.0f} standard deviations beside a free lag"
    if found.groups[:, k].sum() > 1:
        text += ", one for all limbs"
    if found.like_lag[k] > _ALIKE:
        text += (
            f"; this motion hardly tells it from a lag of the torques (correlation "
            f"{found.like_lag[k]:.2f})"
        )
    return text


def _traced(setup: Setup, recording: Recording) -> tuple[Trace, Trace] | None:
    """A recording in memory, in the band of the motion and in that of a fit; None where it has no
    filter or nothing can be differentiated."""
    if recording.low_pass is None:
        return None
    windows = max(_WINDOWS, round(_SECONDS * recording.log.rate / WINDOW))
    load, whole = prior_parameters(setup.robot), recording.low_pass.cutoff

    def within(cutoff: float) -> Trace:
        return trace(
            setup.dynamics,
            recording,
            load,
            cutoff=cutoff,
            windows=windows,
        )

    try:
        return within(_BAND * whole), within(whole)
    except RecordingError:
        return None
