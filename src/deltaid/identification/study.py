"""A recording searched for lags and effects: which causes its residual has, the largest first.

Corrections ask it which they may trust, and verdicts on a residual rest on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.all import EFFECTS
from deltaid.effects.contest import SEEN, Account, account
from deltaid.effects.lag_columns import slopes
from deltaid.effects.lags import Lag, estimate_lags
from deltaid.effects.point import Candidate, RigidFit
from deltaid.errors import RecordingError
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import ColumnsOfDrives, DriveRows
from deltaid.estimation.information import active_columns
from deltaid.estimation.scatter import surprise
from deltaid.estimation.span import Rows, Span
from deltaid.estimation.trace_rows import parameters_of
from deltaid.estimation.traces import Trace, trace
from deltaid.recording.recording import Recording
from deltaid.recording.windows import WINDOW
from deltaid.robot.parameter import PRIOR_SPREAD

# Seconds of a log that are studied, and the cut-off of rows [Hz]; more hardly help.
_SECONDS, _CUTOFF = 24.0, 30.0
LOAD_CHANGE = "load-change"  # the kind of an effect that hides others
# Lags smaller than this [s] do nothing; drives that differ do so by twice as much.
_SMALL, _AT_ONCE = 1.5e-4, 2.0


@dataclass(frozen=True, eq=False)
class Study:
    """A recording searched for all effects.

    Attributes:
        fit: the recording, with lags corrected if they are significant.
        account: the effects, at these lags.
        common, each: lags.
        late: surprise of a significant lag; else 0.
        alike: whether all drives have the same lag.
        plain: M_ii at home of least squares without any of this.
        hidden: whether other causes explain better what looks like a lag.
    """

    fit: RigidFit
    account: Account
    common: Lag
    each: Lag
    late: float
    alike: bool
    plain: Float[np.ndarray, " dof"]
    hidden: bool = False

    @property
    def is_disturbed(self) -> bool:
        """Whether a load that comes and goes explains more than all else together.

        Lags, friction laws and gears then take what they can of it, and mean nothing. Gears that
        wind up may look like a load, and like other things as much.
        """
        gains = [(part.candidate.kind == LOAD_CHANGE, part.gain) for part in self.account.found]
        return sum(gain for load, gain in gains if load) > 0.5 * sum(gain for _, gain in gains)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def studied(
    dynamics: Dynamics,
    recording: Recording,
    p: Parameters | None = None,
    beside: Sequence[Addition] = (),
    seconds: float = _SECONDS,
) -> Study | None:
    """Study a recording; None where nothing can be differentiated.

    Args:
        p: parameters by which friction that depends on load knows what gears carry; the prior's
            where nothing better is known.
        beside: additions that the recording has been fitted with.
        seconds: of it that are studied.
    """
    load = prior_parameters(dynamics.robot) if p is None else p
    record = studied_trace(dynamics, recording, load, seconds)
    if record is None:
        return None
    lags = estimate_lags([record], beside, spread=PRIOR_SPREAD)
    common, each = lags.common(0), lags.each(0)
    Y, p_robot = record.regressor(beside), lags.p[: len(dynamics.layout.names)]
    explained = np.concatenate([Y, slopes(record, p_robot)[:, :, None]], axis=2)
    tau = record.torques()
    rows = DriveRows(recording.log.torque_max, tau.shape[1]).by_misfit(explained, tau)
    fit, causes = _accounted(record, Y, rows)
    apart = np.abs(each.values - common.values)
    apart_by = float(apart.max()) / _AT_ONCE
    alike = _surprise(apart, each) < SEEN or apart_by < _SMALL
    study = Study(fit, causes, common, each, 0.0, alike, _inertia(fit))
    off = (common.values[0] / max(common.deviation[0], 1e-12)) ** 2
    late = max(surprise(off, 1), _surprise(each.values, each)) - 1.0
    if late < SEEN or max(abs(common.values[0]), 0.0 if alike else apart_by) < _SMALL:
        return study
    others = [trial.surprise for trial in causes.first if trial.candidate.kind != "torque-lag"]
    first = causes.found[0].candidate.kind if causes.found else ""
    if first != "torque-lag" and late < max(others, default=0.0):
        return replace(study, hidden=True)
    record = record.shifted((common if alike else each).values)
    Y = record.regressor(beside)
    fit, causes = _accounted(record, Y, DriveRows(rows.scale, Y.shape[1]), lag=True)
    return replace(study, fit=fit, account=causes, late=late)


def _surprise(values: Float[np.ndarray, " dof"], lag: Lag) -> float:
    """How surprising it is that drives are off by so much, by the deviations of their lags."""
    return surprise(float(np.sum((values / np.maximum(lag.deviation, 1e-12)) ** 2)), len(values))


def studied_trace(
    dynamics: Dynamics, recording: Recording, load: Parameters, seconds: float = _SECONDS
) -> Trace | None:
    """The part of a recording that is studied, in memory; None where nothing can be differentiated.

    Args:
        load: as of `Trace`.
        seconds: how much of it.
    """
    log, repairs = recording.log, recording.repairs
    cutoff = recording.motion_cutoff or log.motion_cutoff
    if cutoff is None:
        return None
    cutoff = min(cutoff, _CUTOFF)
    if repairs.gears is not None and recording.cutoff is not None:
        # Links behind gears that wind up are known from torques, whose noise they have, the more
        # of it the faster.
        cutoff = min(cutoff, recording.cutoff)
    windows = max(1, -(-round(seconds * log.rate) // WINDOW))
    try:
        return trace(dynamics, recording, load, cutoff=cutoff, windows=windows)
    except RecordingError:
        return None


def _accounted(
    record: Trace, Y: ColumnsOfDrives, rows: DriveRows, *, lag: bool = False
) -> tuple[RigidFit, Account]:
    """The effects of a recording, by what parameters and additions behind them explain; with a lag
    that has been corrected, that is no effect."""
    Y_robot, Y_extra = np.split(Y, [len(active_columns(record.dynamics))], axis=2)
    span, tau = Span.of(rows.stack(Y_robot)), rows.stack(record.torques())
    if Y_extra.size:
        span = span.with_columns(rows.stack(Y_extra))
    p = parameters_of(record.dynamics, span, tau)
    fit = RigidFit(record, p, Y_robot, rows, span, tau)
    effects = [effect for effect in EFFECTS if not lag or effect.kind != "torque-lag"]
    known = [candidate for effect in effects for candidate in effect.candidates(fit)]
    searches = [effect.search(fit) for effect in effects]

    def searched(residual: Rows) -> chain[Candidate]:
        return chain.from_iterable(search(residual) for search in searches)

    return fit, account(known, searched, rows.groups, span, span.without(tau))


def _inertia(fit: RigidFit) -> Float[np.ndarray, " dof"]:
    """M_ii at home."""
    dynamics = fit.trace.dynamics
    dof, home = dynamics.dof, dynamics.kinematics.home
    z, still = np.tile(home, (dof + 1, 1)), np.zeros((dof + 1, dof))
    tau = dynamics.torque(z, still, np.vstack([np.eye(dof), np.zeros(dof)]), fit.p)
    return np.diag(tau[:-1] - tau[-1])


def spoilt(study: Study) -> Float[np.ndarray, " dof"]:
    """By which share M_ii at home changes when causes are not corrected."""
    right = _inertia(study.fit)
    return study.plain / np.where(right == 0, 1.0, right) - 1.0
