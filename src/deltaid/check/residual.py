"""What the fit leaves of the torques: a lag, or a pattern with the cause that makes it.

The torques of a recording are compared with what any parameters could make of its motion, without
prior and consistency. What is left and is more than chance is given to the cause whose columns
explain it best; the next cause gets what that one leaves.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.check.evidence import Evidence
from deltaid.check.resonance import resonances
from deltaid.check.spectra import bandwidth, white_noise
from deltaid.check.verdict import Grade, Verdict
from deltaid.check.words import listed, percent
from deltaid.dynamics.dynamics import Parameters
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.identification.explained import SEEN, Account, Explained, account, surprise
from deltaid.identification.lag import (
    REACH,
    Basis,
    Lag,
    Rows,
    basis_of,
    coarse_lag,
    estimate_lag,
)
from deltaid.identification.patterns import Pattern, Scene, missing
from deltaid.identification.searches import load_steps, ripples
from deltaid.identification.traces import Delay, Trace, trace
from deltaid.recording.windows import Samples

# Above this [Hz] next to nothing of a Delta's motion is left, but rows grow in number.
_CUTOFF = 30.0
# A cause counts if it explains this share of all that is explained, and this share of the largest
# torque; what is smaller may be what the first-order columns of another one leave.
_SHARE, _LEAST = 0.15, 3e-4
# A lag is wrong, and not only doubtful, where it spoils an inertia by this share; another cause
# where it makes this share of a drive's torque.
_SPOILT, _MUCH = 0.05, 0.1
# What is left of a drive's torque at least, as a share of its largest, to be compared with; and the
# share that a single drive explains of what all do, where it is about this one.
_FLOOR, _MOSTLY = 1e-5, 0.7
# What is left is far above noise when it is so many times the noise and this share of the largest
# torque; it comes in bursts when a tenth of the time has so much of it.
_FAR, _SEEN, _BURSTS = 3.0, 0.01, 0.7
# Lags smaller than this [s] do nothing; drives that differ do so by twice as much.
_SMALL, _AT_ONCE = 1.5e-4, 2.0
# Nothing is said of a lag whose interval is wider [s].
_UNKNOWN = 1e-3


@dataclass(frozen=True, eq=False)
class _Study:
    """A recording looked at with all patterns.

    Attributes:
        scene: the recording, with lags put back if they show.
        tau: its torques as rows.
        account: the patterns, at these lags.
        common, each: lags.
        late: surprise of the lag that shows; 0 if none does.
        alike: whether all drives have the same lag.
        plain: M_ii at home of least squares without any of this.
        hidden: whether there is something like a lag that other causes explain better.
    """

    scene: Scene
    tau: Rows
    account: Account
    common: Lag
    each: Lag
    late: float
    alike: bool
    plain: Float[np.ndarray, " dof"]
    hidden: bool = False


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def checked_residual(evidence: Evidence) -> Iterator[Verdict]:
    """Lags, and the causes that what is left points at."""
    study = _studied(evidence)
    if study is None:
        return
    yield from _of_lag(study)
    ringing = tuple(_of_resonance(study))
    yield from ringing
    yield from _of_patterns(study, rings=any(v.grade is not Grade.GOOD for v in ringing))


def _studied(evidence: Evidence) -> _Study | None:
    """None where nothing can be differentiated; other checks say why."""
    recording, dynamics = evidence.surveyed, evidence.dynamics
    if isinstance(recording, RecordingError):
        return None
    log = recording.log
    cutoff = recording.cutoff or log.suggested_cutoff
    if cutoff is None:
        return None
    cutoff = min(cutoff, _CUTOFF)
    load, still = prior_parameters(dynamics.robot), np.zeros(dynamics.dof)
    try:
        record = trace(dynamics, log, load, cutoff=cutoff, reach=REACH)
    except RecordingError:
        return None
    rough = record.regressor(between=True)
    basis = basis_of(dynamics, rough, log.torque_max)
    left = basis.without(basis.stack(record.torques(still))).reshape(dynamics.dof, -1)
    share = np.sqrt(np.mean(left**2, axis=1))
    scale = np.maximum(share, _FLOOR) * log.torque_max
    between = basis_of(dynamics, rough, scale)
    start = np.full(dynamics.dof, coarse_lag(record, between))
    common = estimate_lag(record, between, start, common=True)
    each = estimate_lag(record, between, common.values, common=False)
    exact = record.regressor()
    basis = basis_of(dynamics, exact, scale)
    scene, tau, account = _accounted(record, exact, basis, still)
    late = _surprise_of_lag(common, each)
    others = [one.surprise for one in account.first if one.pattern.kind != "torque-lag"]
    first = account.found[0].pattern.kind if account.found else ""
    apart = np.abs(each.values - common.values) / np.maximum(each.deviation, 1e-12)
    alike = surprise(float(np.sum(apart**2)), dynamics.dof) < SEEN
    apart_by = float(np.abs(each.values - common.values).max()) / _AT_ONCE
    plain = _inertia(scene, scene.p)
    if late < SEEN or max(abs(common.values[0]), 0.0 if alike else apart_by) < _SMALL:
        return _Study(scene, tau, account, common, each, 0.0, alike, plain)
    if first != "torque-lag" and late < max(others, default=0.0):
        return _Study(scene, tau, account, common, each, 0.0, alike, plain, hidden=True)
    lag = common if alike else each
    reach = np.abs(lag.values).max() + 1.0 / log.rate
    record = trace(dynamics, log, load, cutoff=cutoff, reach=float(reach), reversals=False)
    exact = record.regressor()
    put_back = _accounted(record, exact, basis_of(dynamics, exact, scale), lag.values)
    return _Study(*put_back, common, each, late, alike, plain)


def _accounted(
    record: Trace, Y: Float[np.ndarray, "dof samples columns"], basis: Basis, delay: Delay
) -> tuple[Scene, Rows, Account]:
    """The patterns of a recording whose torques have been put back by some lags."""
    tau = basis.stack(record.torques(delay))
    scene = Scene(record, Y, basis, basis.parameters(tau))

    def searched(left: Rows) -> Iterator[Pattern]:
        yield from ripples(scene, left)
        yield from load_steps(scene, left)

    patterns = [*scene.patterns()]
    if np.any(delay):
        patterns = [one for one in patterns if one.kind != "torque-lag"]
    if (friction := missing(scene)) is not None:
        patterns.append(friction)
    return scene, tau, account(patterns, searched, basis, basis.without(tau))


def _surprise_of_lag(common: Lag, each: Lag) -> float:
    """How surprising lags are, by their own standard deviations."""
    tries = 1.0
    together = (common.values[0] / max(common.deviation[0], 1e-12)) ** 2
    apart = float(np.sum((each.values / np.maximum(each.deviation, 1e-12)) ** 2))
    return max(surprise(together, 1), surprise(apart, len(each.values))) - tries


def _inertia(scene: Scene, p: Parameters) -> Float[np.ndarray, " dof"]:
    """M_ii at home."""
    dynamics = scene.trace.dynamics
    dof, home = dynamics.dof, dynamics.kinematics.home
    z, rest = np.tile(home, (dof + 1, 1)), np.zeros((dof + 1, dof))
    tau = dynamics.torque(z, rest, np.vstack([np.eye(dof), np.zeros(dof)]), p)
    return np.diag(tau[:-1] - tau[-1])


def _of_lag(study: _Study) -> Iterator[Verdict]:
    common, each, drives = study.common, study.each, study.scene.drives
    lag, half = 1e3 * common.values[0], 1e3 * common.interval[0]
    if study.hidden:
        yield Verdict(
            "torque-lag",
            Grade.CANNOT_TELL,
            f"torques look {abs(lag):.2g} ± {half:.1g} ms {_late(lag)}, but another cause explains "
            "more of what that leaves",
            cause="a lag beside the causes below, or these alone, which imitate one",
            cure="mend the causes below first, and check again",
            number=lag,
            unit="ms",
        )
        return
    if not study.late:
        if half > 1e3 * _UNKNOWN:
            yield Verdict(
                "torque-lag",
                Grade.CANNOT_TELL,
                f"the lag of torques behind positions is known to ±{half:.2g} ms only",
                cause="the motion is too slow, or the torque too noisy, to see it",
                cure="record a faster motion with more reversals",
                number=half,
                unit="ms",
            )
            return
        seen = f"torques and positions agree in time: {lag:.2g} ± {half:.2g} ms"
        yield Verdict("torque-lag", Grade.GOOD, seen, number=lag, unit="ms")
        return
    spoilt = _spoilt(study, study.scene.p)
    grade = Grade.WRONG if np.abs(spoilt).max() > _SPOILT else Grade.DOUBTFUL
    worst = int(np.argmax(np.abs(spoilt)))
    harm = f"; left alone, it makes the inertia of {drives[worst]} {_changed(spoilt[worst])}"
    rate = study.scene.trace.low_pass.rate
    if study.alike:
        rows = 1e-3 * lag * rate
        yield Verdict(
            "torque-lag",
            grade,
            f"torques come {abs(lag):.3g} ± {half:.1g} ms {_late(lag)} against positions{harm}",
            cause="torque and position are not of the same instant: a filter in the torque's way, "
            "a bus cycle, or two clocks",
            cure="record both in the same cycle of the controller and without filter, or shift the "
            f"torque columns by {-rows:+.2g} rows ({-lag:+.3g} ms)",
            number=lag,
            unit="ms",
        )
        return
    values, halves = 1e3 * each.values, 1e3 * each.interval
    told = ", ".join(
        f"{drive} {abs(value):.2g} ± {half:.1g} ms {_late(value)}"
        for drive, value, half in zip(drives, values, halves, strict=True)
    )
    odd = [d for d, v, h in zip(drives, values, halves, strict=True) if abs(v - lag) > max(h, 0.3)]
    yield Verdict(
        "torque-lag",
        grade,
        f"torques and positions do not agree in time, and drives differ: {told}{harm}",
        subject=listed(odd) if len(odd) < len(drives) else "",
        cause="drives with filters or bus cycles of their own; otherwise a sign of a wrong "
        "friction law or torque constant, which a lag imitates",
        cure="set the torque filters of all drives alike and record in one cycle; check the "
        "friction law and torque constant of those that differ",
        number=float(values[int(np.argmax(np.abs(values)))]),
        unit="ms",
    )


def _late(value: float) -> str:
    return "late" if value > 0 else "early"


def _changed(share: float) -> str:
    return f"{percent(abs(share))} too {'large' if share > 0 else 'small'}"


def _spoilt(study: _Study, p: Parameters) -> Float[np.ndarray, " dof"]:
    """By which share M_ii at home changes when causes are left alone."""
    right = _inertia(study.scene, p)
    return study.plain / np.where(right == 0, 1.0, right) - 1.0


@dataclass(frozen=True, eq=False)
class _Cause:
    """A kind of cause with all that it explains.

    Attributes:
        kind: the key of its verdict.
        found: its patterns, the first found first.
        rms: of what it explains in each drive's torque [N m or N].
        coefficients: of each of its patterns' columns.
    """

    kind: str
    found: tuple[Explained, ...]
    rms: Float[np.ndarray, " dof"]
    coefficients: tuple[Float[np.ndarray, " columns"], ...]


def _causes(study: _Study) -> list[_Cause]:
    """The causes that count."""
    found, basis = study.account.found, study.scene.basis
    if not found:
        return []
    columns = np.hstack([one.pattern.columns for one in found])
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    bare = basis.without(columns / norms)
    theta = np.linalg.lstsq(bare, basis.without(study.tau), rcond=1e-4)[0] / norms
    ends = np.cumsum([one.pattern.columns.shape[1] for one in found])[:-1]
    parts = np.split(theta, ends)
    total = sum(one.gain for one in found)
    dof, largest = len(study.scene.drives), np.abs(study.scene.model).max(axis=1)
    causes = []
    for kind in dict.fromkeys(one.pattern.kind for one in found):
        own = [k for k, one in enumerate(found) if one.pattern.kind == kind]
        added = sum(found[k].directions @ (found[k].directions.T @ study.tau) for k in own)
        rms = np.sqrt(np.mean(np.reshape(added, (dof, -1)) ** 2, axis=1)) * basis.scale
        gain = sum(found[k].gain for k in own)
        if gain > _SHARE * total and np.any(rms > _LEAST * largest):
            mine = tuple(found[k] for k in own)
            causes.append(_Cause(kind, mine, rms, tuple(parts[k] for k in own)))
    return causes


def _of_resonance(study: _Study) -> Iterator[Verdict]:
    scene = study.scene
    stretch = max(scene.trace.stretches, key=lambda one: len(one.time))
    rate = scene.trace.low_pass.rate
    q = scene.trace.dynamics.kinematics.inverse(stretch.z)
    yield from resonances(
        _raw(study, stretch), rate, bandwidth(q, rate), _largest(study), scene.drives
    )


def _raw(study: _Study, stretch: Samples) -> Float[np.ndarray, "samples dof"]:
    """Torques less those of the model at the full rate, nothing put back or filtered."""
    w, dynamics = stretch, study.scene.trace.dynamics
    left = w.tau - dynamics.torque(w.z, w.qd, w.qdd, study.scene.p)
    return np.where(w.weights > 0, left, 0.0)


def _largest(study: _Study) -> Float[np.ndarray, " dof"]:
    return np.maximum(np.abs(study.scene.model).max(axis=1), 1e-300)


def _of_patterns(study: _Study, *, rings: bool) -> Iterator[Verdict]:
    """The causes that count; where there is none, whether more is left than noise.

    Args:
        rings: whether a resonance explains what is left.
    """
    causes = _causes(study)
    for cause in causes:
        if (words := _WORDS.get(cause.kind)) is not None:
            yield _verdict(study, cause, words)
    if causes:
        return
    left = (
        study.account.left.reshape(len(study.scene.drives), -1) * study.scene.basis.scale[:, None]
    )
    rms = np.sqrt(np.mean(left**2, axis=1))
    noise, largest = _noise(study), _largest(study)
    times = rms / np.maximum(noise, _FLOOR * largest)
    worst = int(np.argmax(np.where(rms > _SEEN * largest, times, 0.0)))
    number, drive = float(times[worst]), study.scene.drives[worst]
    if rings or number < _FAR or rms[worst] < _SEEN * largest[worst]:
        seen = "what the fit leaves of the torques follows neither speed, place, time nor load"
        yield Verdict("residual", Grade.GOOD, seen, number=number, unit="times the noise")
        return
    short = np.sort(left[worst] ** 2)[-max(len(left[worst]) // 10, 1) :].sum()
    bursts = short > _BURSTS * np.sum(left[worst] ** 2)
    yield Verdict(
        "residual",
        Grade.DOUBTFUL,
        f"the fit leaves {number:.3g} times the noise of {drive}'s torque, "
        f"{percent(rms[worst] / largest[worst])} of its largest, "
        + ("in short bursts" if bursts else "and it follows neither speed, place, time nor load"),
        subject=drive,
        cause="knocks: contact with something, backlash that closes, or stops"
        if bursts
        else "something that the model has no words for, such as compliance, backlash or cables",
        cure="look at the residual over time in the report, and leave out what was no free motion"
        if bursts
        else "look at the residual over time in the report; check play and stiffness of the gears",
        number=number,
        unit="times the noise",
    )


def _noise(study: _Study) -> Float[np.ndarray, " dof"]:
    """What white noise of the torques would leave after the filter."""
    stretch = max(study.scene.trace.stretches, key=lambda one: len(one.time))
    low_pass = study.scene.trace.low_pass
    return white_noise(_raw(study, stretch), low_pass.rate) * low_pass.noise_gain


def _verdict(study: _Study, cause: _Cause, words: "_Words") -> Verdict:
    scene = study.scene
    share = cause.rms / np.maximum(scene.model.std(axis=1), 1e-300)
    subject = _subject(study, cause)
    worst = int(np.argmax(share)) if subject not in scene.drives else scene.drives.index(subject)
    number, unit, seen = words.seen(study, cause, subject, share[worst])
    return Verdict(
        cause.kind,
        Grade.WRONG if share[worst] > _MUCH else Grade.DOUBTFUL,
        seen,
        subject=subject,
        cause=words.cause(cause),
        cure=words.cure(cause),
        number=number,
        unit=unit,
    )


def _subject(study: _Study, cause: _Cause) -> str:
    """The drive or joint that a cause is about, if it is one."""
    named = cause.found[0].pattern.subject
    if named and all(one.pattern.subject in ("", named) for one in cause.found):
        return named
    alone = [
        one for one in study.account.first if one.pattern.kind == cause.kind and one.pattern.subject
    ]
    if alone and alone[0].gain > _MOSTLY * cause.found[0].gain:
        return alone[0].pattern.subject
    return ""


@dataclass(frozen=True)
class _Words:
    """What is said of a cause: number, unit and what was seen; why; what to do."""

    seen: Callable[[_Study, _Cause, str, float], tuple[float, str, str]]
    cause: Callable[[_Cause], str]
    cure: Callable[[_Cause], str]


# Number, unit, and what was seen.
_Seen = tuple[float, str, str]


def _of(subject: str) -> str:
    return f"{subject}'s torque" if subject else "the torques"


def _friction_seen(
    study: _Study, cause: _Cause, subject: str, share: float
) -> tuple[float, str, str]:
    words = cause.found[0].pattern.words
    seen = f"{percent(share)} of {_of(subject)} follows the speed and is not explained: {words}"
    return 100 * share, "%", seen


def _place_seen(study: _Study, cause: _Cause, subject: str, share: float) -> _Seen:
    ripple = _ripple(cause)
    words = ripple.words if ripple else "it bends with the place of the platform"
    seen = f"{percent(share)} of {_of(subject)} follows the position and is not explained: {words}"
    return 100 * share, "%", seen


def _ripple(cause: _Cause) -> Pattern | None:
    """The ripple that a cause is; None where the place explains more."""
    ripples = [one for one in cause.found if one.pattern.detail]
    if sum(one.gain for one in ripples) > 0.5 * sum(one.gain for one in cause.found):
        return ripples[0].pattern
    return None


def _drift_seen(study: _Study, cause: _Cause, subject: str, share: float) -> _Seen:
    words = cause.found[0].pattern.words
    seen = f"{percent(share)} of {_of(subject)} changes with time, {words}, and is not explained"
    return 100 * share, "%", seen


def _load_seen(study: _Study, cause: _Cause, subject: str, share: float) -> _Seen:
    first = cause.found[0].pattern
    alone = study.scene.basis.without(first.columns[:, 0])
    mass = float(abs(alone @ study.tau) / (alone @ alone))
    times = first.detail
    told = ", ".join(f"{t:.1f}" for t in times[:4]) + (
        f" s and {len(times) - 4} times more" if len(times) > 4 else " s"
    )
    return mass, "kg", f"the mass of {first.words} changes by {mass:.2g} kg, at {told}"


def _gain_seen(study: _Study, cause: _Cause, subject: str, share: float) -> _Seen:
    gains, drives = np.zeros(len(study.scene.drives)), study.scene.drives
    for one, coefficients in zip(cause.found, cause.coefficients, strict=True):
        at = [drives.index(one.pattern.subject)] if one.pattern.subject else range(len(drives))
        gains[list(at)] += coefficients
    gains -= np.median(gains)
    worst = drives.index(subject) if subject else int(np.argmax(np.abs(gains)))
    told = f"{drives[worst]}'s torque is {_changed(gains[worst])} against the other drives'"
    return 100 * float(gains[worst]), "%", told


_WORDS = {
    "friction-law": _Words(
        _friction_seen,
        lambda cause: (
            "the described friction law has no term for it, or the torque channel has an offset"
            if "direction" in cause.found[0].pattern.words
            else "the described friction law has no term for it"
        ),
        lambda cause: "let the recording choose the law: --friction choose, or describe the term",
    ),
    "geometry-or-cogging": _Words(
        _place_seen,
        lambda cause: (
            "cogging of the motor, or teeth of the gear"
            if _ripple(cause)
            else "lengths, zeros or mounting are not as described, or a spring or cable pulls"
        ),
        lambda cause: (
            "let the drive compensate it, or take a lower --cutoff"
            if _ripple(cause)
            else "measure arms, struts and radii, and set the drives' zeros anew"
        ),
    ),
    "drift": _Words(
        _drift_seen,
        lambda cause: (
            "friction that falls while gears and grease warm up, or a torque channel that drifts"
        ),
        lambda cause: "move the robot until it is warm before recording, and record shorter",
    ),
    "load-change": _Words(
        _load_seen,
        lambda cause: "a load is picked up or put down while recording goes on",
        lambda cause: "record without load, or cut the recording at these times",
    ),
    "drive-gain": _Words(
        _gain_seen,
        lambda cause: "its torque constant, rated torque or gear is not what the mapping says",
        lambda cause: "check the torque constant and gear of that drive's torque column",
    ),
}
