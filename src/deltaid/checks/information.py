"""Parameters that a recording determines, and the motion that would determine the others.

In the base parameters b of any generic motion, rows weighted by each drive's noise σ_i,

    std_k² = ((G + I)⁻¹)_kk,   G = Σ_i F_iᵀ F_i / σ_i²,

is the standard deviation after the recording in units of the prior's: 1 without information. The
same holds for a motion within the robot's limits (as many samples, same noise), and for both
together: G adds up. The motion with the least std is the one to record.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float

from deltaid.checks.evidence import Evidence
from deltaid.dynamics.dynamics import Dynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError, KinematicsError, few
from deltaid.estimation.base_parameters import base_parameters
from deltaid.estimation.information import Information, gather_samples, merge
from deltaid.identification.fit import FittedProblem
from deltaid.identification.gathering import gather_all
from deltaid.levels import FAINT
from deltaid.model.verdict import FEW, Fault, Grade, Verdict, listed
from deltaid.motion.random_motion import INSTANTS, random_motion
from deltaid.motion.surrogate import SensorNoise
from deltaid.recording.masks.masks import RESTS

# Shares of the prior's standard deviation below which a base parameter is identifiable, and above
# which it is not.
_WELL, _NOT = 0.3, 0.9
# Ratio of standard deviations to those after a motion of the same length within the robot's limits
# from which, in a quarter of the parameters, an excitation is poor.
_POOR = 6.0
# Factor by which the slow motion of comparison is slower; number of motions in the usual one.
_SLOWER, _USUAL = 20.0, 3
_HIDDEN = Fault(
    "base-parameters",
    "base parameters",
    "the recorded motion does not move what they act on, or not fast enough",
)
_WEAK = Fault(
    "excitation", "times less certain", "the motion is slow, or uses little of the workspace"
)


@dataclass(frozen=True, eq=False)
class _Certainty:
    """Standard deviations of the base parameters of a generic motion, as shares of the prior's."""

    names: tuple[str, ...]  # of each group's representative parameter
    recorded: Float[np.ndarray, " base"]  # after the recording alone
    usual: Float[np.ndarray, " base"]  # after a usual motion of as many samples and the same noise
    best: np.ndarray  # words of the motion that narrows each most in addition to the recording

    def named(self, chosen: Bool[np.ndarray, " base"]) -> str:
        names = [name for name, named in zip(self.names, chosen, strict=True) if named]
        return few(names, FEW)

    def cure(self, chosen: Bool[np.ndarray, " base"]) -> str:
        """Motions to record, the most useful first."""
        return "also record " + "; and ".join(
            f"{words} (shows {self.named(chosen & (self.best == words))})"
            for words, _ in Counter(self.best[chosen].tolist()).most_common(2)
        )


def checked_information(evidence: Evidence) -> tuple[Verdict, ...]:
    """Verdicts on the information in one recording."""
    information = information_of(evidence)
    if information is None:
        return ()
    return judged_information(evidence.dynamics, information, [evidence.moved])


def information_of(evidence: Evidence) -> Information | None:
    """Information of a recording, fitted or not; None if it cannot be used."""
    if evidence.surveyed is None:
        return None
    if isinstance(evidence.fitted, FittedProblem):
        return evidence.fitted.information
    try:
        return gather_all(evidence.dynamics, [evidence.surveyed]).information
    except IdentificationError:
        return None


def judged_information(
    dynamics: Dynamics, information: Information, moved: Sequence[Float[np.ndarray, " drives"]]
) -> tuple[Verdict, ...]:
    """Verdicts on the information in recordings together.

    Args:
        moved: range of each drive in each of them [rad or m].
    """
    try:
        motions, ranges = _motions(dynamics)
    except KinematicsError as error:
        seen = f"no motion within the limits was found to compare with: {error.what}"
        cause = "the workspace or the limits of the description leave no room"
        return (_HIDDEN.judged(seen, grade=Grade.CANNOT_TELL, cause=cause, cure=error.cure),)
    certainty = _assess(dynamics, information.of_drives, motions)
    still = np.array(dynamics.robot.drives)[np.max(moved, axis=0) < RESTS * ranges].tolist()
    return _parameters(certainty), _excitation(certainty, still)


def _assess(
    dynamics: Dynamics, recorded: Information, motions: dict[str, Information]
) -> _Certainty:
    """Certainty of the base parameters after a recording and after other motions, torques alone."""
    usual = next(iter(motions.values()))
    base = base_parameters(merge(motions.values()), dynamics.layout)
    prior = np.array([parameter.std for parameter in base.layout.parameters])
    scale = np.linalg.norm(base.combination() * prior, axis=1)
    # The residual of each drive's torque; a usual share of the torque for one that rests.
    noise = SensorNoise().torque * np.maximum(usual.torque_max, np.finfo(float).tiny)
    for i, (samples, largest) in enumerate(zip(recorded.samples, recorded.torque_max, strict=True)):
        if samples and largest:
            rms = np.linalg.norm(recorded.problem_of(i).residual) / np.sqrt(samples)
            noise[i] = max(float(rms), FAINT * largest)
    samples = np.where(recorded.samples > 0, recorded.samples, recorded.mean_samples)

    def factor(gathered: Information) -> Float[np.ndarray, "rows base"]:
        share = samples / np.where(gathered.samples > 0, gathered.samples, samples)
        columns = np.searchsorted(gathered.columns, base.representatives)
        return gathered.weighted(share / noise**2)[:, columns] * scale

    alone, others = factor(recorded), [factor(motion) for motion in motions.values()]
    best = np.argmin([_stds(np.vstack([alone, added])) for added in others], axis=0)
    names = tuple(base.layout.names[k] for k in base.representatives)
    return _Certainty(names, _stds(alone), _stds(others[0]), np.array([*motions])[best])


def _stds(F: Float[np.ndarray, "rows base"]) -> Float[np.ndarray, " base"]:
    """√ of the diagonal of (FᵀF + I)⁻¹: standard deviations after data and a unit prior."""
    s, Vt = np.linalg.svd(np.vstack([F, np.eye(F.shape[1])]), full_matrices=False)[1:]
    return np.linalg.norm(Vt.T / s, axis=1)


def _parameters(certainty: _Certainty) -> Verdict:
    share, names = certainty.recorded, np.array(certainty.names)
    well, hidden = share <= _WELL, share > _NOT
    seen = f"{well.sum()} of {len(share)} are identifiable"
    for grade, chosen in (("weak", ~well & ~hidden), ("not identifiable", hidden)):
        seen += f"; {grade}: {certainty.named(chosen)}" if chosen.any() else ""
    missed = ~well & (certainty.usual < 0.5 * _WELL)
    lost = missed & hidden
    if lost.any():
        cure, number = certainty.cure(lost), float(well.sum())
        return _HIDDEN.judged(seen, str(names[lost][0]), number, cure=cure)
    if not missed.any() and not well.all():
        seen += "; no motion within the limits shows them much better"
    return _HIDDEN.good(seen, float(well.sum()))


def _excitation(certainty: _Certainty, still: Sequence[str]) -> Verdict:
    if still:
        move = "moves" if len(still) == 1 else "move"
        return Fault("excitation", "drives").judged(
            f"{listed(still)} hardly {move} in what is recorded",
            listed(still),
            float(len(still)),
            cause="a motion of single drives, or none",
            cure="record a motion of all drives, such as `deltaid excite` plans",
        )
    ratio = certainty.recorded / certainty.usual
    number = float(np.quantile(ratio, 0.75, method="higher"))
    if number <= _POOR:
        seen = f"standard deviations are {np.median(ratio):.2g} times those of a usual motion "
        return _WEAK.good(f"{seen}within limits", number)
    return _WEAK.judged(
        f"a quarter of the base parameters are at least {number:.2g} times less certain than after "
        "a motion of the same length that uses the limits",
        certainty.named(ratio >= number),
        number,
        cure=certainty.cure(ratio >= number),
    )


@lru_cache(maxsize=8)
def _motions(dynamics: Dynamics) -> tuple[dict[str, Information], Float[np.ndarray, " dof"]]:
    """The usual motion of all coordinates, as fast as limits allow, then special ones, by the words
    of a cure that asks for them; and the range of each drive in the usual one [rad or m].

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    task, kinematics, every = dynamics.robot.task, dynamics.kinematics, range(dynamics.dof)
    rng = np.random.default_rng(0)
    usual = (random_motion(kinematics, rng) for _ in range(_USUAL))
    states = [motion.evaluate(np.linspace(0.0, motion.period, INSTANTS)) for motion in usual]
    z, zd, zdd = (np.concatenate(parts) for parts in zip(*states, strict=True))
    # Which coordinates move, and how fast; the others rest in the middle.
    moving: dict[str, tuple[Sequence[int], float]] = {
        "motions of all drives as fast as the limits allow": (every, 1.0),
        "a slow motion through poses all over the workspace": (every, 1 / _SLOWER),
    }
    if len(task.axes) > 1:
        names = "fast strokes along x", "fast strokes along y", "fast strokes up and down"
        moving |= {names[axis]: ([k], 1.0) for k, axis in enumerate(task.axes)}
    if task.turn is not None and task.axes:
        moving["fast turns of the tool while the platform rests"] = [task.turn], 1.0
    motions = dict[str, Information]()
    for words, (chosen, pace) in moving.items():
        moves = np.isin(every, chosen)
        place = np.where(moves, z, kinematics.home)
        _, qd, qdd = kinematics.drive_motion(place, zd * moves * pace, zdd * moves * pace**2)
        tau = dynamics.torque(place, qd, qdd, prior_parameters(dynamics.robot))
        motions[words] = gather_samples(dynamics, place, qd, qdd, tau)
    return motions, np.ptp(kinematics.inverse(z), axis=0)
