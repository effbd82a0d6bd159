"""What a recording tells about the parameters, and which motion would tell what it does not.

In the base parameters b of any generic motion, rows weighted by each drive's noise σ_i,

    std_k² = ((G + I)⁻¹)_kk,   G = Σ_i F_iᵀ F_i / σ_i²,

in units of the prior's standard deviation is what the recording leaves open of it: 1 where it says
nothing. The same holds for a motion within the robot's limits (as many samples, same noise), and
for both together: G adds up. The motion that leaves least open is the one to record.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.check.evidence import Evidence
from deltaid.check.motions import Candidate, candidates
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DeltaidError, IdentificationError, KinematicsError
from deltaid.estimation.base_parameters import BaseParameters, base_parameters
from deltaid.estimation.drive_rows import NOISE_FLOOR
from deltaid.estimation.information import Information, merge
from deltaid.identification.fit import FittedProblem
from deltaid.identification.gathering import gather_all
from deltaid.model.verdict import Grade, Verdict
from deltaid.model.words import listed

# A base parameter is identifiable when the recording leaves less than this share of the prior's
# standard deviation open, and not identifiable when it leaves more than the other.
_WELL, _NOT = 0.3, 0.9
# An excitation is poor when a quarter of the parameters are so many times less certain than after
# a motion within the robot's limits of the same length.
_POOR = 6.0
_SHOWN = 4
# A drive rests that moves less than this share of its usual range.
_RESTING = 0.01
# Noise of torques as a share of their largest.
_USUAL_NOISE = 0.02


@dataclass(frozen=True, eq=False)
class Told:
    """Standard deviations of the base parameters, as shares of what the prior leaves open.

    Attributes:
        base: the base parameters of a generic motion.
        recorded: after the recording alone.
        usual: after a usual motion within limits, of as many samples and the same noise.
        together: after the recording and each candidate, of as many samples again.
        motions: the candidates, in that order.
    """

    base: BaseParameters
    recorded: Float[np.ndarray, " base"]
    usual: Float[np.ndarray, " base"]
    together: Float[np.ndarray, "candidates base"]
    motions: tuple[Candidate, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that stand for the groups."""
        layout = self.base.layout
        return tuple(layout.names[group.representative] for group in self.base.groups)

    def best(self, k: int) -> Candidate:
        """The motion that narrows base parameter k most."""
        return self.motions[int(np.argmin(self.together[:, k]))]


def checked_information(evidence: Evidence) -> tuple[Verdict, ...]:
    """Verdicts on what one recording tells."""
    information = information_of(evidence)
    if information is None:
        return ()
    return judged_information(evidence.dynamics, information, [evidence.moved])


def information_of(evidence: Evidence) -> Information | None:
    """What a recording tells, whether it can be fitted or not; None if it cannot be used."""
    if isinstance(evidence.surveyed, DeltaidError):
        return None
    fitted = evidence.fitted
    if isinstance(fitted, FittedProblem):
        return fitted.information
    try:
        return merge(gather_all(evidence.dynamics, [evidence.surveyed]).blocks)
    except IdentificationError:
        return None


def judged_information(
    dynamics: Dynamics, information: Information, moved: Sequence[Float[np.ndarray, " drives"]]
) -> tuple[Verdict, ...]:
    """Verdicts on what recordings tell together.

    Args:
        moved: how far each drive goes in each of them [rad or m].
    """
    try:
        told, still = told_by(dynamics, information), _still(dynamics, np.max(moved, axis=0))
    except KinematicsError as error:
        cannot = Verdict(
            "base-parameters",
            Grade.CANNOT_TELL,
            f"no motion within the limits was found to compare with: {error.what}",
            cause="the workspace or the limits of the description leave no room",
            cure=error.cure,
        )
        return (cannot,)
    return _parameters(told), _excitation(told, still)


def told_by(dynamics: Dynamics, information: Information) -> Told:
    """How certain the base parameters are after a recording, and would be after other motions, by
    torques alone.

    Raises:
        KinematicsError: the description's limits leave no room for a motion.
    """
    motions, information = candidates(dynamics), information.of_drives
    usual = motions[0].information
    base = base_parameters(merge([one.information for one in motions]), dynamics.layout)
    representatives = [group.representative for group in base.groups]
    scale = _left_open(base)
    weights = _weights(information, motions[0].largest)
    samples = np.where(information.samples > 0, information.samples, information.mean_samples)

    def factor(of: Information) -> Float[np.ndarray, "rows base"]:
        share = samples / np.where(of.samples > 0, of.samples, samples)
        at = np.searchsorted(of.columns, representatives)
        return of.weighted(weights * share)[:, at] * scale

    own = factor(information)
    return Told(
        base,
        _stds(own),
        _stds(factor(usual)),
        np.array([_stds(np.vstack([own, factor(one.information)])) for one in motions]),
        motions,
    )


def _parameters(told: Told) -> Verdict:
    """Which base parameters the recording tells, and which motion would show the others."""
    share = told.recorded
    weak = np.flatnonzero((share > _WELL) & (share <= _NOT))
    hidden = np.flatnonzero(share > _NOT)
    missed = [k for k in np.flatnonzero(share > _WELL) if told.usual[k] < 0.5 * _WELL]
    well = len(share) - len(weak) - len(hidden)
    seen = f"{well} of {len(share)} are identifiable"
    for words, which in (("weak", weak), ("not identifiable", hidden)):
        if which.size:
            seen += f"; {words}: {_named(told, which)}"
    lost = [k for k in missed if share[k] > _NOT]
    if not lost:
        if not missed and len(share) > well:
            seen += "; no motion within the limits shows them much better"
        number = float(well)
        return Verdict("base-parameters", Grade.GOOD, seen, number=number, unit="base parameters")
    return Verdict(
        "base-parameters",
        Grade.DOUBTFUL,
        seen,
        subject=told.names[lost[0]],
        cause="the recorded motion does not move what they act on, or not fast enough",
        cure=_cure(told, np.array(lost)),
        number=float(well),
        unit="base parameters",
    )


def _excitation(told: Told, still: tuple[str, ...]) -> Verdict:
    """Whether the motion is as informative as the robot's limits allow."""
    ratio = told.recorded / told.usual
    poor = float(np.quantile(ratio, 0.75, method="higher"))
    typical = float(np.median(ratio))
    if still:
        moves = "moves" if len(still) == 1 else "move"
        return Verdict(
            "excitation",
            Grade.DOUBTFUL,
            f"{listed(still)} hardly {moves} in what is recorded",
            subject=listed(still),
            cause="a motion of single drives, or none",
            cure="record a motion of all drives, such as `deltaid excite` plans",
            number=float(len(still)),
            unit="drives",
        )
    if poor <= _POOR:
        return Verdict(
            "excitation",
            Grade.GOOD,
            f"standard deviations are {typical:.2g} times those of a usual motion within limits",
            number=poor,
            unit="times less certain",
        )
    k = np.flatnonzero(ratio >= poor)
    return Verdict(
        "excitation",
        Grade.DOUBTFUL,
        f"a quarter of the base parameters are at least {poor:.2g} times less certain than after a "
        f"motion of the same length that uses the limits",
        subject=_named(told, k),
        cause="the motion is slow, or uses little of the workspace",
        cure=_cure(told, k),
        number=poor,
        unit="times less certain",
    )


def _cure(told: Told, which: np.ndarray) -> str:
    """What to record, most asked for first."""
    asked = [told.best(int(k)).words for k in which]
    order = sorted(dict.fromkeys(asked), key=lambda words: -asked.count(words))
    texts = []
    for words in order[:2]:
        own = [told.names[k] for k, one in zip(which, asked, strict=True) if one == words]
        more = f" and {len(own) - _SHOWN} more" if len(own) > _SHOWN else ""
        texts.append(f"{words} (shows {', '.join(own[:_SHOWN])}{more})")
    return "also record " + "; and ".join(texts)


def _named(told: Told, which: np.ndarray) -> str:
    names = [told.names[int(k)] for k in which]
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


def _left_open(base: BaseParameters) -> Float[np.ndarray, " base"]:
    """Standard deviation of each base parameter by the prior alone."""
    prior = np.array([parameter.std for parameter in base.layout.parameters])
    return np.linalg.norm(base.combination() * prior, axis=1)


def _weights(
    information: Information, usual: Float[np.ndarray, " dof"]
) -> Float[np.ndarray, " dof"]:
    """1/σ_i² by what no parameters explain of each drive's torque.

    Of a drive that rests nothing is known; it gets a usual share of its usual torque.
    """
    found = []
    for i in range(len(information.factors)):
        samples, largest = information.samples[i], information.torque_max[i]
        if not samples or not largest:
            found.append((_USUAL_NOISE * max(float(usual[i]), np.finfo(float).tiny)) ** -2.0)
            continue
        rms = np.linalg.norm(information.problem_of(i).residual) / np.sqrt(samples)
        found.append(max(float(rms), NOISE_FLOOR * largest) ** -2.0)
    return np.array(found)


def _stds(F: Float[np.ndarray, "rows base"]) -> Float[np.ndarray, " base"]:
    """√ of the diagonal of (FᵀF + I)⁻¹: what data and a prior of unit size leave open."""
    s, Vt = np.linalg.svd(np.vstack([F, np.eye(F.shape[1])]), full_matrices=False)[1:]
    return np.linalg.norm(Vt.T / s, axis=1)


def _still(dynamics: Dynamics, moved: Float[np.ndarray, " drives"]) -> tuple[str, ...]:
    """Drives that hardly move, beside what a usual motion does."""
    usual = np.ptp(candidates(dynamics)[0].q, axis=0)
    near = (moved < _RESTING * usual).tolist()
    return tuple(drive for drive, still in zip(dynamics.robot.drives, near, strict=True) if still)
