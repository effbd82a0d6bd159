"""Torques that come late or early are put beside their motion, and their lags into the fit."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.lag_columns import LagColumns, LagGroup, UnknownLag, subjects
from deltaid.errors import IdentificationError, RecordingError
from deltaid.estimation.additions import Addition
from deltaid.estimation.traces import Trace, trace
from deltaid.identification.lag_groups import chosen_groups, common_lag
from deltaid.identification.lags import Lags, estimate_lags
from deltaid.identification.setup import Progress, Setup
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import WINDOW

# Lags known to no better than this (half a 95 % interval) are none that can be put right [s].
_UNKNOWN = 1e-3
# Windows of a recording that are looked at, and seconds; more hardly say more.
_WINDOWS, _SECONDS = 8, 12.0
# Standard deviation beyond which intervals allow for a lag that may be none [s]: twice as much does
# harm. It is 5 to 20 µs in good recordings of 15 s, and up to 0.1 ms in those of a few seconds.
_HARDLY = 1.5e-4


def lags_put_right(setup: Setup, progress: Progress) -> Setup:
    """Torques of every recording beside their motion, with columns for what is left of a lag.

    What stands in the setup of lags is replaced, so it can be done again after other stages.
    """
    asked = setup.settings.lag
    setup = setup.changed(additions=without_lags(setup.additions)).told((), "lag")
    if asked == "none":
        return setup
    if not isinstance(asked, str):
        return _fixed(setup, asked)
    progress("looking for lags")
    seen = [
        (one, found)
        for k, one in enumerate(setup.recordings)
        if not setup.is_disturbed(k) and (found := _traced(setup, one)) is not None
    ]
    traced = [one for one, _ in seen]
    for one in setup.recordings:
        if one not in traced:  # what other stages took for a beginning is no estimate
            setup = setup.repaired(one, delay=())
    if not seen:
        return setup
    lags = estimate_lags(
        [found for _, found in seen],
        setup.additions,
        spread=setup.settings.prior_spread,
        start=np.array([one.repairs.delay or np.zeros(setup.dynamics.dof) for one, _ in seen]),
    )
    beside, several = setup.additions, len(setup.recordings) > 1
    for k, (one, _) in enumerate(seen):
        groups = _groups(lags, k)
        delay = np.zeros(setup.dynamics.dof)
        for group in groups:
            delay[list(group.drives)] = group.delay
        setup = setup.repaired(one, delay=tuple(delay.tolist()) if groups else ())
        kind = LagColumns
        if not groups and common_lag(lags.values[k], lags.covariance[k])[1] > _HARDLY:
            kind, groups = UnknownLag, (LagGroup(tuple(range(setup.dynamics.dof)), 0.0),)
        if groups:
            columns = kind(setup.dynamics, beside, lags.p, one, groups, several)
            setup = setup.changed(additions=(*setup.additions, columns))
    return setup


def doubtful_lags_left(setup: Setup, judged: Sequence[Judged]) -> Setup:
    """The same without lags that the fit itself does not confirm: their intervals all hold zero, or
    are as wide as lags are. Something else that nobody declared then looks like one.

    Args:
        judged: the parameters of all additions, as fitted.
    """
    rest = iter(judged)
    for one in setup.additions:
        own = tuple(islice(rest, len(one.parameters)))
        if not isinstance(one, LagColumns) or not _doubtful(one.told(own)):
            continue
        setup = setup.changed(additions=tuple(x for x in setup.additions if x is not one))
        for recording in setup.recordings:
            if one.is_of(recording):
                setup = setup.repaired(recording, delay=())
    return setup


def _doubtful(lags: Sequence[Correction]) -> bool:
    """Of drives with lags of their own, some may have none that shows."""
    ends = [(one.low, one.high) for one in lags if one.low is not None and one.high is not None]
    zero = [low <= 0.0 <= high for low, high in ends]
    return bool(ends) and (all(zero) or any(high - low > 2 * _UNKNOWN for low, high in ends))


def without_lags(additions: Sequence[Addition]) -> tuple[Addition, ...]:
    """Additions that are none of lags."""
    return tuple(one for one in additions if not isinstance(one, LagColumns))


def _traced(setup: Setup, recording: Recording) -> Trace | None:
    """A recording in memory, with torques as they came; None where it cannot be differentiated."""
    repairs = replace(recording.repairs, delay=())
    windows = max(_WINDOWS, round(_SECONDS * recording.log.rate / WINDOW))
    try:
        return trace(
            setup.dynamics,
            replace(recording, repairs=repairs),
            prior_parameters(setup.robot),
            cutoff=recording.cutoff,
            windows=windows,
        )
    except RecordingError:
        return None  # with recorded velocities and accelerations it can still be fitted


def _groups(lags: Lags, k: int) -> tuple[LagGroup, ...]:
    """Which drives of a recording lag, by how much."""
    choice = chosen_groups(lags.values[k], lags.covariance[k])
    groups: list[LagGroup] = []
    for members in choice.groups:
        drives, delay = list(members), choice.delay[members[0]]
        weights = lags.told[k, drives] ** -2.0
        if not weights.any():
            groups.append(LagGroup(members, delay))
            continue
        known = float(weights @ lags.steps[k, drives] / weights.sum())
        deviation, free = float(weights.sum() ** -0.5), bool(np.all(lags.agrees[k, drives]))
        if free:
            groups.append(LagGroup(members, delay, known - delay, deviation))
        else:
            groups.append(LagGroup(members, known, 0.0, deviation, free=False))
    return tuple(groups)


def _fixed(setup: Setup, lag: tuple[float, ...]) -> Setup:
    """Lags that are given, for all drives or one a drive [s]."""
    dof, drives = setup.dynamics.dof, setup.robot.drives
    if len(lag) not in (1, dof):
        raise IdentificationError(
            f"has {len(lag)} values, and the robot has {dof} drives",
            where="--lag",
            cure=f"give one value for all drives, or {dof}",
        )
    delay = lag * dof if len(lag) == 1 else lag
    alike = len(set(delay)) == 1
    groups = (tuple(range(dof)),) if alike else tuple((i,) for i in range(dof))
    for one in setup.recordings:
        setup = setup.repaired(one, delay=delay if any(delay) else ())
    told = tuple(
        Correction(
            kind="lag",
            subject=name,
            value=delay[group[0]],
            unit="s",
            text="torques are read so much later, as was asked for",
        )
        for group in groups
        for name in subjects(group, drives)
        if delay[group[0]]
    )
    return setup.told(told)
