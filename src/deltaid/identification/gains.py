"""Gains of drives: the joint's torque over the recorded one, where a known load determines it.

With a torque constant that is off, the joint gets c_i times the recorded torque. The noise is on
the recorded torque, so the fit minimises

    Σ_i w_i ‖τ_meas,i − Y_i p / c_i‖²

over p and c. About present gains c, c_i τ_meas,i = Y_i p − ε_i Y_i p₀ with the torques Y_i p₀ of
the *model*: measured ones would have noise on both sides. So ε are additional columns of the fit,
repeated until they vanish, and certificate and intervals are the fit's own. Without a quantity
known in N m, the common scale of all c and p is free, but identical limbs determine the ratios of
their drives' gains. Where the rows need these ratios, Σ log c_i = 0 over these drives, or over the
others where a single drive differs.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import null_space
from scipy.stats import gmean

from deltaid.dynamics.geometry import CONSTANT_OF, CONSTANTS
from deltaid.estimation.additions import Addition, Own, TorqueColumns, Values
from deltaid.estimation.problem import Span
from deltaid.estimation.reduction import Free
from deltaid.estimation.scatter import quantile
from deltaid.identification.fit import FittedProblem, fit
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.uncertainty import uncertainty
from deltaid.levels import ROUNDS, SETTLED
from deltaid.model.corrections import Correction
from deltaid.model.parameter_record import Parameter
from deltaid.model.verdict import FEW, percent
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import SampleBlock
from deltaid.robot.parameter import PriorParameter

# Prior standard deviation of torque constants, relative.
SPREAD = 0.1
# Change of a parameter, in its standard deviations, by torque constants that are 1 % off, from
# which it is reported.
_MOVED = 0.5


@dataclass(frozen=True, eq=False)
class Gains(TorqueColumns):
    """Remaining logarithms of gains, ε, with the columns −Y_i p₀."""

    gain: Float[np.ndarray, " dof"]  # c, by which torques of the recordings have been multiplied
    prior_spread: float  # of the fit; scales of parameters are relative to it
    # drives of which only ratios of gains are identifiable; empty if all gains are
    ratio_drives: tuple[int, ...] = ()
    # drives whose mean gain is taken to be right; empty for all `ratio_drives`
    reference: tuple[int, ...] = ()

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return self._coefficients(self.dynamics.robot.drives, -np.log(self.gain))

    def _coefficients(self, names: Iterable[str], priors: np.ndarray) -> tuple[PriorParameter, ...]:
        scale = SPREAD / self.prior_spread
        return tuple(
            PriorParameter("gain", name, "gain", "", -np.inf, np.inf, prior, scale)
            for name, prior in zip(names, priors.tolist(), strict=True)
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        drives = np.arange(self.dynamics.dof)
        return drives, drives

    @property
    def free(self) -> Free:
        if not self.ratio_drives:
            return super().free
        mean = np.isin(self.ratio_drives, self.reference or self.ratio_drives)
        ratios = null_space(mean[None].astype(float))
        A = np.zeros((self.dynamics.dof, ratios.shape[1]))
        A[list(self.ratio_drives)] = ratios
        names = [f"ratio{k + 1}" for k in range(ratios.shape[1])]
        return Free(self._coefficients(names, -A.T @ np.log(self.gain)), A, np.zeros(len(A)), ())

    @property
    def common_spread(self) -> float:
        """Standard deviation of the common gain of n drives, s/√n by the scatter s of their
        logarithms, widened to Student's interval with n − 1 degrees of freedom."""
        logarithms = np.log(self.gain[list(self.ratio_drives)])
        count = len(logarithms)
        wider = quantile(np.array([count - 1.0])) / quantile(np.array([np.inf]))
        return float(wider[0] * logarithms.std(ddof=1) / np.sqrt(count))

    @property
    def determines(self) -> tuple[str, ...]:
        return (CONSTANT_OF,) if self.ratio_drives else (CONSTANT_OF, CONSTANTS)

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        return -self.torques(w, own, recording)

    def to_corrections(self, judged: Sequence[Parameter]) -> tuple[Correction, ...]:
        drives, corrections = self.dynamics.robot.drives, list[Correction]()
        absolute = [other.scale_reference for other in self.others if other.scale_reference]
        silent = " and ".join(drive for i, drive in enumerate(drives) if i not in self.ratio_drives)
        assumed = f"; {silent} is assumed correct" if silent else ""
        against = "the other limbs' drives, which agree" if self.reference else (
            "the mean of the limbs' drives"
        )  # fmt: skip
        for i, (drive, c, gain) in enumerate(zip(drives, self.gain.tolist(), judged, strict=True)):
            if self.ratio_drives and i not in self.ratio_drives:
                continue
            ends = (gain.value, gain.low, gain.high)
            value, low, high = (float(c * np.exp(np.nan if end is None else end)) for end in ends)
            torque = f"the joint torque is {value:.4g} times the torque that {drive} records"
            if self.ratio_drives:
                text = (
                    f"{torque}, relative to {against}, because limbs are identical. A common gain "
                    "is not identifiable; it is assumed correct within "
                    f"{percent(self.common_spread)}, by the scatter of these{assumed}. A second "
                    "recording with a known load determines it"
                )
            elif gain.std < 0.5 * SPREAD:
                exact = ", which is 1 as far as this shows" if low <= 1.0 <= high else ""
                text = f"{torque}, determined by {' and by '.join(absolute)}{exact}"
            else:
                text = (
                    f"what is known in N m by itself hardly shows in {drive}, so its gain rests on "
                    f"torque constants being right within {100 * SPREAD:.0f} % (one sigma); a load "
                    "of known inertia about this drive's axis, off the tool's axis where this is "
                    "the tool's drive, or a torque sensor at its gear would determine it"
                )
            corrections.append(
                Correction(kind="gain", subject=drive, value=value, low=low, high=high, text=text)
            )
        return tuple(corrections)


def gains(setup: Setup, progress: Progress) -> Setup:
    """Stage for gains, where an addition is known in N m, or for their ratios between the drives of
    limbs, where the contest kept these."""
    setup = setup.without(Gains).all_repaired(gain=())
    dynamics, settings, others = setup.dynamics, setup.settings, setup.additions
    absolute = any(addition.scale_reference for addition in others)
    is_uneven = setup.outcome is not None and "gain" in setup.outcome.kept
    count = len(setup.robot.identical_drives) if is_uneven and not absolute else 0
    ratio_drives = tuple(range(count))
    if not (absolute or ratio_drives):
        return setup
    progress("comparing drives with what is known in N m" if absolute else "comparing drives")
    c = np.ones(dynamics.dof)
    problem = fit(dynamics, setup.recordings, settings, additions=others)
    count = len(problem.values)  # of the robot's parameters and of all additions but the gains

    def corrected(reference: tuple[int, ...] = ()) -> Setup:
        p = problem.values[:count]
        columns = Gains(dynamics, others, p, c, settings.prior_spread, ratio_drives, reference)
        return setup.all_repaired(gain=tuple(c.tolist())).changed(additions=(*others, columns))

    for _ in range(ROUNDS):
        now = corrected()
        problem = fit(dynamics, now.recordings, settings, additions=now.additions)
        step = problem.values[-dynamics.dof :]
        if np.abs(step).max() < SETTLED:
            break
        c = c * np.exp(step)
    reference = _agreeing(problem, np.log(c), ratio_drives)
    if reference:
        scale = gmean(c[list(reference)])
        c = np.array([c_i / scale if i in ratio_drives else c_i for i, c_i in enumerate(c)])
    return corrected(reference)


def _agreeing(
    problem: FittedProblem, logarithms: Float[np.ndarray, " dof"], ratio_drives: tuple[int, ...]
) -> tuple[int, ...]:
    """The other drives where one gain differs and theirs agree: a single wrong torque constant is
    likelier than several. Empty where there is no such drive."""
    if len(ratio_drives) < 3:
        return ()
    dof, middle = len(logarithms), np.median(logarithms[list(ratio_drives)])
    odd = max(ratio_drives, key=lambda i: abs(logarithms[i] - middle))
    reference = [i for i in ratio_drives if i != odd]
    apart = np.eye(dof)[reference] - np.isin(np.arange(dof), reference) / len(reference)
    combinations = np.zeros((len(apart), len(problem.values)))
    combinations[:, -dof:] = apart
    agree = np.abs(apart @ logarithms) <= uncertainty(problem, combinations).interval
    return tuple(reference) if np.all(agree) else ()


def moves_of_scale(problem: FittedProblem) -> tuple[dict[str, float], ...]:
    """Changes of parameters, by name, by one standard deviation of an undetermined common gain: in
    proportion to themselves."""
    if problem.dynamics.robot.tolerances.torque_constants:
        return ()  # intervals count what is stated
    return tuple(
        problem.dynamics.layout.named(addition.common_spread * problem.p)
        for addition in problem.additions if isinstance(addition, Gains) and addition.ratio_drives
    )  # fmt: skip


def shown_by_torques(additions: Sequence[Addition]) -> tuple[Addition, ...]:
    """Additions without gains that only sensors determine and no load: with these, friction has
    no scale."""
    by_load = any(addition.scale_reference and len(addition.pattern[0]) for addition in additions)
    return tuple(
        addition
        for addition in additions
        if not isinstance(addition, Gains) or addition.ratio_drives or by_load
    )


def torque_scale(problem: FittedProblem) -> tuple[str, ...]:
    """A sentence where measured values in kg meet torques of unknown scale.

    Torque constants that are all off by a share ε scale all base parameters. Without measured
    values this does no harm, as commanded torques have the same scale; but a weighing is in kg, and
    other bodies absorb the difference, by more than ε.
    """
    known = any(CONSTANTS in addition.determines for addition in problem.additions)
    stated = problem.dynamics.robot.tolerances.torque_constants
    if problem.information.facts is None or known or stated:
        return ()
    errors, count = uncertainty(problem), len(problem.p)
    # Slopes of least-squares base parameters by ε; sensors and measured values stay.
    information = problem.information
    places = np.searchsorted(information.columns, problem.base.representatives)
    torques = information.of_drives.weighted()
    inverse = Span.of_columns(information.weighted()[:, places]).inverse
    slopes = inverse @ (inverse.T @ (torques[:, places].T @ torques[:, -1]))
    more = 0.01 * slopes @ errors.follows[:, :count]
    moved = np.abs(more) / np.where(errors.std[:count] > 0, errors.std[:count], np.inf)
    inertial = np.array([entry.kind == "inertia" for entry in problem.layout.parameters[:count]])
    order = [k for k in np.argsort(-moved) if inertial[k] and moved[k] > _MOVED][:FEW]
    if not order:
        return ()
    names = ", ".join(
        f"{problem.layout.names[k]} by {100 * abs(more[k] / problem.p[k]):.2g} %" for k in order
    )
    return (
        "values measured in kg stand beside torques whose scale nothing determines: for each per "
        f"cent that all torque constants are off, {names}, and intervals take them for exact. "
        "State how good they are (`tolerances: {torque_constants: 0.03}` for 3 %), or record a "
        "known load, a plate or a torque sensor, which determine them",
    )
