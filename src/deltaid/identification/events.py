"""Stage that detects, classifies and excludes events: contacts, pushes, spikes and stops.

Outliers of a recording (`outliers.py`) are excluded, except where a drive turns round: there they
may come from friction that the description lacks, and friction laws are chosen later. Gears with
play cause outliers where their torque changes its sign; all such changes are excluded, as backlash.
Outliers that last, or fill much of a recording, are no events but a load or a wrong model, which
other stages report.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from deltaid.identification.expectation import Expectation, expect
from deltaid.identification.expectation_source import ExplainedRecording
from deltaid.identification.outliers import (
    JoinedStretches,
    OutlierStretch,
    at_changes,
    detected_outliers,
    without_recurring,
)
from deltaid.identification.setup import Progress, Setup
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.corrections import Correction
from deltaid.recording.masks.masks import joined_times
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.repairs import BACKLASH, CHANGE, CONTACT, JOLT, SPIKE, STOP, LeftSpan, Push

# Messages by the reasons to exclude events.
_TEXT = {
    CONTACT: "{times} torques exceed what the motion requires, as if something pushed the "
    "platform, {largest}",
    STOP: "{times} the robot was stopped by more than its drives, {largest}",
    SPIKE: "{times} the torque of one drive jumps for one to three samples, as in errors of a "
    "fieldbus",
    CHANGE: "{times} torques exceed what the motion requires where a joint reverses or the "
    "torque of a gear changes its sign: by play or winding of gears, by friction, by torques that "
    "saturate, or by pushes that come there, as at a pick; {largest}",
    JOLT: "{times} torque and motion change faster than the low-pass of the positions follows",
    BACKLASH: "its gear has play: torques do not follow from the motion where its torque changes "
    "its sign, {spans} times. All drives' are excluded there",
}
# Time excluded before and after an outlier [s]; longest gap within a contact [s].
_BESIDE, LONGEST_GAP = 4e-3, 0.02
# Longest contact or other event [s]; events that fill half of a window of this length are none
# either.
LONGEST_EVENT = 1.0
# Share of a recording from which outliers are no events.
_MOST = 0.2
# Share of a jolt's outlier that motion above the low-pass explains, at least; and the share of a
# recording from which jolts are its usual motion.
_SHARP, _JOLTS = 0.25, 0.05
# A drive below this share of its usual speed hardly moves; it is alone if the outliers of others
# are below this share of its own.
_SLOW, _ALONE = 0.15, 0.4
# Lags that do no harm [s], range of lags that are corrected here [s], and rounds of correction.
_ON_TIME, _LAGS, _ROUNDS = 1e-3, (-0.012, 0.022), 3
# A model fits where the residual's scatter is below this multiple of noise.
_MISFIT = 4.0
# Longest time between a stop and standing still [s].
_STANDS = 0.1


def without_events(setup: Setup, progress: Progress) -> Setup:
    if setup.settings.keep_all or not setup.settings.events:
        return setup
    corrections = list[Correction]()
    for k, recording in enumerate(setup.recordings):
        progress(f"looking for contacts in {recording.path}")
        bare, spans = with_events(recording), ()
        recording = recording.repaired(left_out=bare.repairs.left_out)
        expected = on_time(ExplainedRecording(setup.dynamics, setup.additions, bare))
        if expected:
            spans = events(expected)
            recording = recording.repaired(left_out=(*bare.repairs.left_out, *spans))
        if expected and setup.settings.lag == "estimate":  # to begin with
            recording = recording.repaired(delay=expected.source.recording.repairs.delay)
        setup = setup.with_recording(k, recording)
        corrections += _corrections(spans, recording, setup.robot.drives)
    return setup.reported(corrections, "contact", "backlash")


def with_events(
    recording: PreparedRecording, reasons: Collection[str] = _TEXT.keys()
) -> PreparedRecording:
    """A recording with its excluded events restored, all or those of some reasons."""
    kept = tuple(span for span in recording.repairs.left_out if span.reason not in reasons)
    return recording.repaired(left_out=kept)


def is_play(recording: PreparedRecording) -> bool:
    """Whether rows of a recording are excluded because gears have play."""
    return any(span.reason == BACKLASH for span in recording.repairs.left_out)


def without_play(setup: Setup) -> Setup:
    """The setup with rows restored that are excluded because gears have play."""
    whole = tuple(with_events(recording, [BACKLASH]) for recording in setup.recordings)
    return setup.changed(recordings=whole).reported((), "backlash")


def _corrections(
    spans: Sequence[LeftSpan], recording: PreparedRecording, drives: Sequence[str]
) -> list[Correction]:
    """One correction for each kind of event of a recording, and for each gear with play."""
    corrections, kinds = list[Correction](), list(_TEXT)
    pairs = {(span.reason, span.gear) for span in spans}
    for reason, gear in sorted(pairs, key=lambda pair: (kinds.index(pair[0]), pair[1] or 0)):
        group = [span for span in spans if (span.reason, span.gear) == (reason, gear)]
        times = joined_times(np.array([(span.first, span.last) for span in group]))
        pushes = [span.push for span in group if span.push]
        forces = [(float(np.linalg.norm(push.force)), push.time) for push in pushes]
        force, when = max(forces, key=lambda force: force[0], default=(0.0, 0.0))
        text = _TEXT[reason].format(
            times="once" if len(group) == 1 else f"{len(group)} times",
            largest=f"the largest {force:.3g} N at {when:.3f} s",
            spans=len(times),
        )
        corrections.append(
            Correction(
                kind="contact" if gear is None else "backlash",
                subject=reason if gear is None else drives[gear],
                log=recording.path.name,
                value=float(np.diff(times).sum()),
                unit="s",
                text=text,
            )
        )
    return corrections


def events(expected: Expectation) -> tuple[LeftSpan, ...]:
    outliers, recording = detected_outliers(expected), expected.source.recording
    log, low_pass, delay = recording.log, recording.filter, recording.repairs.delay
    duration, margin = log.samples / log.rate, max(_BESIDE, 1.0 / log.rate)
    spread = 0.5 / low_pass.motion_cutoff  # half a period to either side of a jump
    lasting = [run for run in outliers.stretches if not _is_friction(run, expected)]
    remaining, spoilt = without_recurring(outliers, lasting, low_pass, margin + spread)
    course = JoinedStretches(LONGEST_GAP)
    course.join(remaining)
    pushes = _brief(course.reaching, duration)
    jolts = [push for push in pushes if push.sharp > _SHARP]
    if sum(jolt.end - jolt.start for jolt in jolts) > _JOLTS * duration:
        pushes, jolts = [push for push in pushes if push not in jolts], []
    still = [m.start for m in log.masks if m.reason in ("standing still", "on brakes")]
    excluded = [*outliers.spikes, *spoilt]
    recur = at_changes(outliers, pushes, low_pass).tolist()
    for stretch, recurs in zip(pushes, recur, strict=True):
        stops = any(-_STANDS <= start - stretch.end <= _STANDS for start in still)
        reason, push = STOP if stops else CHANGE if recurs else CONTACT, None
        if stretch in jolts:
            reason = JOLT
        else:
            push = _push(stretch, expected.source.dynamics.kinematics)
        excluded.append(LeftSpan(stretch.start - margin, stretch.end + margin, reason, push=push))
    spans = list[LeftSpan]()
    for span in sorted(excluded, key=lambda span: span.first):
        # From times of the motion to stamps of torques, which are late.
        delays = [delay[i] for i in span.drives or range(len(delay))] if delay else [0.0]
        first, last = span.first + min(delays), span.last + max(delays)
        spans.append(replace(span, first=first, last=last))
    return tuple(spans)


def on_time(source: ExplainedRecording) -> Expectation | None:
    """The expectation after rough correction of unknown lags, or the first one if that does not
    fit; None without enough data."""
    expected = first = expect(source)
    for _ in range(_ROUNDS):
        if expected is None or np.all(np.abs(expected.lags) < _ON_TIME):
            break
        recording = source.recording
        delay = np.array(recording.repairs.delay or (0.0,) * source.dynamics.dof)
        delay = np.clip(delay + expected.lags, *_LAGS)
        source = replace(source, recording=recording.repaired(delay=tuple(delay.tolist())))
        expected = expect(source)
    return expected if expected and np.all(expected.misfit < _MISFIT) else first


def _is_friction(stretch: OutlierStretch, expected: Expectation) -> bool:
    """Whether friction of one drive that hardly moves explains a stretch."""
    i = int(np.argmax(stretch.sizes))
    alone = np.all(np.delete(stretch.sizes, i) < _ALONE * stretch.sizes[i])
    within = abs(stretch.left[i]) <= expected.coulomb[i]
    return bool(alone and stretch.speed[i] < _SLOW and within)


def _brief(stretches: Sequence[OutlierStretch], duration: float) -> list[OutlierStretch]:
    """Short and uncrowded stretches; none where stretches fill much of a recording."""
    start, end = (np.array([getattr(x, name) for x in stretches]) for name in ("start", "end"))
    length, middle = end - start, 0.5 * (end + start)
    sums = np.append(0.0, np.cumsum(length))
    if sums[-1] > _MOST * duration:
        return []
    about = sums[np.searchsorted(middle, middle + 0.5 * LONGEST_EVENT, side="right")]
    about -= sums[np.searchsorted(middle, middle - 0.5 * LONGEST_EVENT, side="left")]
    kept = (length <= LONGEST_EVENT) & (about <= np.maximum(0.5 * LONGEST_EVENT, length))
    return [stretch for stretch, good in zip(stretches, kept, strict=True) if good]


def _push(stretch: OutlierStretch, kinematics: Kinematics) -> Push:
    """The force on the platform that explains residual torques r, F = −Jᵀ r with J = ∂q/∂z.

    Drives that hold against it do the work rᵀ δq = rᵀ J δz = −Fᵀ δz.
    """
    task = kinematics.robot.task
    force = -(kinematics.jacobian(stretch.z[None])[0].T @ stretch.left)
    point = np.zeros(3)
    point[list(task.axes)] = force[task.moves]
    x, y, z = task.point(stretch.z).tolist()
    along_x, along_y, along_z = point.tolist()
    moment = None if task.turn is None else float(force[task.turn])
    return Push(stretch.peak, (x, y, z), (along_x, along_y, along_z), moment)
