"""Whether an encoder's steps are fine enough for a motion's accelerations."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float

from deltaid.check.evidence import Evidence
from deltaid.check.spectra import bandwidth, step_of
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import listed, percent
from deltaid.recording.filter import LowPass, design_low_pass
from deltaid.recording.recording import Recording

# What the encoder's steps add to the accelerations, as a share of these.
_ROUGH, _USELESS = 0.1, 1.0
# Steps of the encoder over a stroke that are too few whatever the filter makes of them.
_FEW = 250.0
# A drive that goes less far than this share of the others' way rests.
_AT_LEAST = 0.01


def checked_encoder(evidence: Evidence) -> Iterator[Verdict]:
    """What the steps of the positions add to the accelerations."""
    rows, robot = evidence.rows, evidence.robot
    if evidence.columns.velocity:
        return  # positions are not differentiated
    low_pass = _low_pass(evidence)
    if low_pass is None:
        return
    second = np.convolve(low_pass.second, low_pass.smooth)
    response = np.convolve(_spread(second, low_pass.stride), low_pass.lead)
    if len(rows.q) < 2 * len(response):
        return
    shares = np.zeros(evidence.kinematics.dof)
    steps = np.array([step_of(q) for q in rows.q.T])
    for i, step in enumerate(steps):
        rough = step / np.sqrt(12) * np.linalg.norm(response)
        size = np.std(_convolved(rows.q[:, i], response, low_pass.thinned))
        shares[i] = rough / np.sqrt(max(size**2 - rough**2, (0.1 * size) ** 2, 1e-300))
    moves = moving(evidence)
    shares[~moves] = 0.0
    counts = np.ptp(rows.q, axis=0) / np.maximum(steps, 1e-300)
    bad = np.flatnonzero(moves & ((shares > _ROUGH) | ((counts < _FEW) & (counts > 0))))
    worst = int(np.argmax(shares))
    drive = robot.drives[worst]
    unit = robot.units(drive).coordinate
    seen = (
        f"steps of {steps[worst]:.2g} {unit} make {percent(shares[worst])} of {drive}'s "
        f"acceleration below {low_pass.cutoff:.3g} Hz"
        if steps[worst] > 0
        else "positions show no steps"
    )
    if not bad.size:
        number = 100 * float(shares[worst])
        yield Verdict("encoder-step", Grade.GOOD, seen, number=number, unit="%")
        return
    yield Verdict(
        "encoder-step",
        Grade.WRONG if shares[worst] > _USELESS else Grade.DOUBTFUL,
        seen,
        subject=listed([robot.drives[i] for i in bad]),
        cause="the encoder, or the number format of the log, resolves too little for this motion",
        cure="record the motor's encoder with all its digits, move faster, or take a lower "
        "--cutoff",
        number=100 * float(shares[worst]),
        unit="%",
    )


def moving(evidence: Evidence) -> Bool[np.ndarray, " drives"]:
    """Drives that do not rest while others of their kind move: encoder and torque of one at rest
    hold nothing but steps and noise, and nothing is wrong with that."""
    robot, span = evidence.robot, np.ptp(evidence.rows.q, axis=0)
    slides = np.array([robot.is_linear(drive) for drive in robot.drives])
    largest = np.where(slides, span[slides].max(initial=0.0), span[~slides].max(initial=0.0))
    return span > _AT_LEAST * largest


def _low_pass(evidence: Evidence) -> LowPass | None:
    """The filter of the recording, or one for its motion where it has none."""
    recording = evidence.surveyed
    if isinstance(recording, Recording):
        return recording.low_pass
    rate = 1.0 / evidence.rows.step
    fastest = bandwidth(evidence.rows.q, rate)
    if fastest == 0:
        return None
    return design_low_pass(min(max(2 * fastest, 2e-6 * rate), 0.1 * rate), rate)


def _spread(taps: Float[np.ndarray, " taps"], stride: int) -> Float[np.ndarray, " longer"]:
    spread = np.zeros((len(taps) - 1) * stride + 1)
    spread[::stride] = taps
    return spread


def _convolved(
    x: Float[np.ndarray, " rows"], response: Float[np.ndarray, " taps"], every: int
) -> Float[np.ndarray, " kept"]:
    around = np.lib.stride_tricks.sliding_window_view(x - x.mean(), len(response))[::every]
    return around @ response[::-1]
