"""Study of a recording: its lags, the causes in its residual, the largest first, and unexplained
torque.

Stages and verdicts on the residual use studies. The residual of a drive's torque beside all causes
is white noise and the rest; the rest is compared with smooth functions of speed, position and the
like. No conclusion is drawn about its cause.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.polynomial.chebyshev import chebvander
from threadpoolctl import threadpool_limits

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.account import DETECTED, Account, account
from deltaid.effects.all import EFFECTS, effect_of
from deltaid.effects.effect import SHARE, causes_of
from deltaid.effects.lag_columns import APART, slopes
from deltaid.effects.lag_groups import SMALL
from deltaid.effects.lags import Lag, estimate_lags
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.effects.windings import free_friction
from deltaid.errors import RecordingError
from deltaid.estimation.additions import Addition
from deltaid.estimation.drive_rows import (
    MISFIT_FLOOR,
    POSITION_ERROR,
    ColumnsOfDrives,
    DriveRows,
    parameters_of,
)
from deltaid.estimation.information import active_columns
from deltaid.estimation.problem import Explanation, Rows, Span, independent, lengths
from deltaid.estimation.scatter import surprise
from deltaid.estimation.spectra import white_noise
from deltaid.estimation.traces import Trace, trace
from deltaid.recording.log import SECONDS
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import WINDOW, SampleBlock
from deltaid.robot.parameter import PRIOR_SPREAD

# Largest cut-off of rows [Hz]; a higher one hardly helps.
HIGHEST_CUTOFF = 30.0
LOAD_CHANGE = "load-change"  # kind of the effect that hides others
# Ratio from which an error is far above another, such as noise, or half an interval.
FAR = 3.0
# Degree of the smooth functions of one quantity.
_SMOOTH = 8
# Share of a drive's torque from which a residual shows that the wrong causes were corrected.
ADEQUATE = 0.01


@dataclass(frozen=True, eq=False)
class Study:
    """A recording searched for all effects."""

    fit: RigidFit  # with lags corrected if they are significant
    account: Account  # the effects, with these lags corrected
    common: Lag  # of all drives
    each: Lag  # of each drive
    late: float  # surprise of a significant lag; else 0
    alike: bool  # whether all drives have the same lag
    plain: Float[np.ndarray, " dof"]  # M_ii at home by least squares without lags and effects
    on_time: Float[np.ndarray, " dof"]  # the same with a significant lag corrected
    hidden: bool = False  # whether other causes explain better what looks like a lag

    @property
    def is_disturbed(self) -> bool:
        """Whether a load that comes and goes explains more than all other causes together.

        Then estimates of lags, friction laws and gears are meaningless, for they absorb some of it.
        """
        gains = [(part.candidate.kind == LOAD_CHANGE, part.gain) for part in self.account.detected]
        return sum(gain for load, gain in gains if load) > 0.5 * sum(gain for _, gain in gains)


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def studied(
    dynamics: Dynamics,
    recording: PreparedRecording,
    p: Parameters | None = None,
    beside: Sequence[Addition] = (),
    seconds: float = SECONDS,
) -> Study | None:
    """Study some seconds of a recording beside additions; None where it cannot be differentiated.

    Load friction uses the torques of gears by p, or by the prior.
    """
    load = prior_parameters(dynamics.robot) if p is None else p
    record = studied_trace(dynamics, recording, load, seconds)
    if record is None:
        return None
    lags = estimate_lags([record], beside, spread=PRIOR_SPREAD)
    if blur := lags.blurred(0):  # rows with blurred steps look like friction before slip
        record = studied_trace(dynamics, recording.repaired(blur=blur), load, seconds) or record
    common, each = lags.common(0), lags.each(0)
    Y, p_robot = record.regressor(beside), lags.p[: len(dynamics.layout.names)]
    explained = np.concatenate([Y, slopes(record, p_robot)[:, :, None]], axis=2)
    tau = record.torques()
    rows = DriveRows(recording.log.torque_max, tau.shape[1]).by_misfit(explained, tau)
    fit = rigid_fit(record, Y, rows)
    causes = _account(fit, lag=False)
    apart = np.abs(each.values - common.values)
    alike = _surprise(apart, each) < DETECTED or float(apart.max()) < APART
    plain = _inertia(fit)
    study = Study(fit, causes, common, each, 0.0, alike, plain, on_time=plain)
    off = (common.values[0] / max(common.deviation[0], 1e-12)) ** 2
    late = max(surprise(off, 1), _surprise(each.values, each)) - 1.0
    if late < DETECTED or (alike and abs(common.values[0]) < SMALL):
        return study
    others = [trial.surprise for trial in causes.first if trial.candidate.kind != "torque-lag"]
    first = causes.detected[0].candidate.kind if causes.detected else ""
    record = record.shifted((common if alike else each).values)
    Y = record.regressor(beside)
    fit = rigid_fit(record, Y, DriveRows(rows.scale, Y.shape[1]))
    if first != "torque-lag" and late < max(others, default=0.0):
        return replace(study, hidden=True, on_time=_inertia(fit))
    causes = _account(fit, lag=True)
    return replace(study, fit=fit, account=causes, late=late, on_time=_inertia(fit))


def _surprise(values: Float[np.ndarray, " dof"], lag: Lag) -> float:
    """Surprise of these lags by their deviations [decades]."""
    return surprise(float(np.sum((values / np.maximum(lag.deviation, 1e-12)) ** 2)), len(values))


def studied_trace(
    dynamics: Dynamics, recording: PreparedRecording, load: Parameters, seconds: float = SECONDS
) -> Trace | None:
    """Some seconds of a recording, `load` as of `Trace`; None where it cannot be differentiated."""
    log, repairs = recording.log, recording.repairs
    cutoff = recording.motion_cutoff or log.motion_cutoff
    if cutoff is None:
        return None
    cutoff = min(cutoff, HIGHEST_CUTOFF)
    if repairs.gears is not None and recording.cutoff is not None:
        # Motion behind compliant gears has noise of torques, which grows with frequency.
        cutoff = min(cutoff, recording.cutoff)
    windows = max(1, -(-round(seconds * log.rate) // WINDOW))
    try:
        return trace(dynamics, recording, load, cutoff=cutoff, windows=windows)
    except RecordingError:
        return None


def _account(fit: RigidFit, *, lag: bool) -> Account:
    """The effects of a recording beside parameters and additions; a corrected `lag` is none."""
    effects = [effect for effect in EFFECTS if not lag or effect.kind != "torque-lag"]
    known = [candidate for effect in effects for candidate in effect.candidates(fit)]
    searches = [effect.search(fit) for effect in effects]

    def searched(residual: Rows) -> chain[EffectCandidate]:
        return chain.from_iterable(search(residual) for search in searches)

    return account(known, searched, fit.rows.groups, fit.span, fit.span.without(fit.tau))


def rigid_fit(record: Trace, Y: ColumnsOfDrives, rows: DriveRows) -> RigidFit:
    """Least squares of a recording's parameters; in Y additions follow the robot."""
    Y_robot, Y_extra = np.split(Y, [len(active_columns(record.dynamics))], axis=2)
    span, tau = Span.of_columns(rows.stack(Y_robot)), rows.stack(record.torques())
    if Y_extra.size:
        span = span.with_columns(rows.stack(Y_extra))
    return RigidFit(record, parameters_of(record.dynamics, span, tau), Y_robot, rows, span, tau)


def _inertia(fit: RigidFit) -> Float[np.ndarray, " dof"]:
    dynamics = fit.trace.dynamics
    dof, home = dynamics.dof, dynamics.kinematics.home
    z, still = np.tile(home, (dof + 1, 1)), np.zeros((dof + 1, dof))
    tau = dynamics.torque(z, still, np.vstack([np.eye(dof), np.zeros(dof)]), fit.p)
    return np.diag(tau[:-1] - tau[-1])


def spoilt(study: Study) -> Float[np.ndarray, " dof"]:
    """Share by which an uncorrected significant lag makes M_ii at home too large."""
    return study.plain / np.where(study.on_time == 0, 1.0, study.on_time) - 1.0


class Trend(NamedTuple):
    """A smooth function of some quantity that explains a part of a drive's residual."""

    words: str
    share: float  # of the residual's power that it explains
    surprise: float  # [decades]


class Rest(NamedTuple):
    """The residual of a drive's torque beside parameters and effects."""

    drive: int
    times: float  # rms in units of the noise
    systematic: float  # rms beyond the noise, as a share of the largest torque
    part: float  # the same as a share of the standard deviation of the torque
    follows: Trend | None  # None if it may be chance or a remainder of a linearised effect
    is_far: bool  # whether it is far above noise

    @property
    def is_unexplained(self) -> bool:
        """Whether it is more than noise and remainders of linearised effects."""
        return self.is_far or self.follows is not None


def rest_of_each_drive(study: Study) -> tuple[Rest, ...]:
    """The rest of each drive."""
    low_pass, causes = study.fit.trace.low_pass, causes_of(study.fit, study.account)
    noise = white_noise(unexplained(study)) * low_pass.noise_gain
    residual = study.fit.rows.of_drives(study.account.left)
    largest = np.maximum(np.abs(study.fit.model).max(axis=1), 1e-300)
    first_order = SHARE * np.sum([np.zeros(len(largest)), *(c.rms**2 for c in causes)], axis=0)
    rests = list[Rest]()
    for drive, power in enumerate(np.mean(residual**2, axis=1).tolist()):
        if not study.fit.model[drive].any():  # it rests all the time
            rests.append(Rest(drive, 0.0, 0.0, 0.0, None, False))
            continue
        trend = max(
            _trends(study, drive), key=lambda trend: trend.share, default=Trend("", 0.0, 0.0)
        )
        explained = trend.share * power
        least = max(first_order[drive], (POSITION_ERROR * largest[drive]) ** 2)
        follows = trend.surprise > DETECTED and explained > least
        beyond = max(power - noise[drive] ** 2, explained if follows else 0.0)
        times = np.sqrt(power) / max(noise[drive], MISFIT_FLOOR * largest[drive])
        is_far = times > FAR and power > max(first_order[drive], (ADEQUATE * largest[drive]) ** 2)
        part = np.sqrt(beyond) / max(float(study.fit.model[drive].std()), 1e-300)
        size = np.sqrt(beyond) / largest[drive]
        cause = trend if follows else None
        rests.append(Rest(drive, float(times), float(size), float(part), cause, bool(is_far)))
    return tuple(rests)


def beside_any_friction(study: Study) -> Study:
    """The study beside free friction, for use before laws are chosen."""
    columns = study.fit.rows.stack(free_friction(study.fit.trace, study.fit.p))
    fit = replace(study.fit, span=study.fit.span.with_columns(columns))
    return replace(study, fit=fit, account=_account(fit, lag=study.late > 0))


def left_of_a_drive(study: Study) -> float:
    """The largest share of a drive's torque that nothing explains, or an effect that the contest
    would have corrected; smaller effects of this kind may be remainders of those that later stages
    correct."""
    causes = [
        (effect_of(cause).is_contested, float(cause.shares.max()))
        for cause in causes_of(study.fit, study.account)
    ]
    later = max((share for is_contested, share in causes if not is_contested), default=0.0)
    contested = [share for is_contested, share in causes if is_contested and share > later]
    unknown = (rest.part for rest in rest_of_each_drive(study) if rest.is_unexplained)
    return max([*contested, *unknown], default=0.0)


def unexplained(study: Study) -> Float[np.ndarray, "samples dof"]:
    """Torques less those of the model over the longest stretch, unfiltered."""
    w, dynamics = longest(study), study.fit.trace.dynamics
    return np.where(w.weights > 0, w.tau - dynamics.torque(w.z, w.qd, w.qdd, study.fit.p), 0.0)


def longest(study: Study) -> SampleBlock:
    return max(study.fit.trace.stretches, key=lambda stretch: len(stretch.time))


def _trends(study: Study, drive: int) -> Iterator[Trend]:
    """Smooth functions of a drive's motion and torque, and of time, that explain its residual."""
    fit, left, span = study.fit, study.account.left, study.account.span
    name = fit.drives[drive]
    quantities = {
        f"the speed of {name}": fit.motion.qd[:, drive],
        f"the position of {name}": fit.q[:, drive],
        f"the acceleration of {name}": fit.motion.qdd[:, drive],
        f"the torque of {name}": fit.model[drive],
        "time": fit.motion.time,
    }
    rows = slice(drive * fit.rows.samples, (drive + 1) * fit.rows.samples)
    total = float(left[rows] @ left[rows])
    for words, values in quantities.items():
        low, high = values.min(), values.max()
        between = 2.0 * (values - low) / max(high - low, np.finfo(float).tiny) - 1.0
        A = np.zeros((len(left), _SMOOTH))
        A[rows] = chebvander(between, _SMOOTH)[:, 1:]
        A = span.without(A / lengths(A))
        U = A @ independent(A)
        if U.shape[1] and total:
            own = Explanation.by_columns(U, left, fit.rows.groups, span.rank)
            rare = surprise(own.gain / own.level, own.rank) - np.log10(len(quantities))
            yield Trend(words, own.gain / total, float(rare))
