"""How large a drive's torque is that its recording calls 1 N m, where a known load tells it.

A drive records what it believes its torque to be; with a torque constant that is off, the joint
gets c_i times that. The noise is on what was recorded, so what is minimised is

    Σ_i w_i ‖τ_meas,i − Y_i p / c_i‖²

over p and c together (variable projection: p is the conic fit's for every c). About gains c that
are known so far, c_i τ_meas,i = Y_i p − ε_i Y_i p₀ with the torques Y_i p₀ of the *model*: measured
ones would put the noise on both sides. So gains are further columns of the fit, found by turns, and
certificate and intervals are the fit's own. Without anything known in N m by itself the common
scale of all c and p is free, and nothing is corrected.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, Parameters
from deltaid.identification.additions import Addition, Own, Values
from deltaid.identification.fit import FittedProblem, fit
from deltaid.identification.setup import Progress, Setup
from deltaid.model.corrections import Correction
from deltaid.model.record import Parameter as Judged
from deltaid.recording.recording import Recording
from deltaid.recording.windows import Samples
from deltaid.robot.parameter import Parameter

# Relative standard deviation of torque constants before any recording, and the share of it below
# which a gain counts as told.
SPREAD, _TOLD = 0.1, 0.5
# Rounds at most, and the step below which gains have settled.
_ROUNDS, _SETTLED = 8, 1e-5


@dataclass(frozen=True, eq=False)
class Gains(Addition):
    """What is left of the gains' logarithms, ε, with the columns −Y_i p₀.

    Attributes:
        dynamics: of the robot.
        gain: c that torques of the recordings have been multiplied by.
        values: p₀, and what goes with the other additions.
        others: the other additions, whose torques drives bear as well.
        prior_spread: of the fit, which all scales of parameters are relative to.
    """

    dynamics: Dynamics
    gain: Float[np.ndarray, " dof"]
    values: Parameters
    others: tuple[Addition, ...]
    prior_spread: float

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        scale = SPREAD / self.prior_spread
        return tuple(
            Parameter("gain", drive, "gain", "", -np.inf, np.inf, -float(np.log(c)), scale)
            for drive, c in zip(self.dynamics.robot.drives, self.gain, strict=True)
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        each = np.arange(self.dynamics.dof)
        return each, each

    def entries(self, w: Samples, own: Own, recording: Recording) -> Values:
        # What known loads take is no column, and goes through the drives like the rest.
        torque, first = w.carried.T.copy(), len(self.dynamics.layout.names)
        drives, columns = self.dynamics.regressor_pattern
        np.add.at(torque, drives, own * self.values[columns][:, None])
        for one in self.others:
            drives, columns = one.pattern
            part = one.entries(w, own, recording) * self.values[first + columns][:, None]
            np.add.at(torque, drives, part)
            first += len(one.parameters)
        return -torque

    def told(self, judged: Sequence[Judged]) -> tuple[Correction, ...]:
        return tuple(_told(c, one) for c, one in zip(self.gain, judged, strict=True))


def _told(c: float, judged: Judged) -> Correction:
    drive, value = judged.name.removeprefix("gain."), c * np.exp(judged.value)
    low, high = (c * np.exp(np.nan if x is None else x) for x in (judged.low, judged.high))
    if judged.std < _TOLD * SPREAD:
        text = (
            f"the joint gets {value:.4g} times the torque that {drive} records: what the known "
            "load weighs and how it resists say so"
        )
    else:
        text = (
            f"the known load hardly shows in {drive}, so its gain rests on torque constants being "
            f"right within {100 * SPREAD:.0f} % (one sigma); a load of known inertia about this "
            "drive's axis, off the tool's axis where this is the tool's drive, would tell it"
        )
    return Correction(
        kind="gain", subject=drive, value=float(value), low=float(low), high=float(high), text=text
    )


def gains(setup: Setup, progress: Progress) -> Setup:
    """Torque constants, where something among the additions is known in N m by itself."""
    others = tuple(one for one in setup.additions if not isinstance(one, Gains))
    setup = setup.changed(additions=others)
    if not any(one.is_absolute for one in others):
        return setup
    progress("comparing drives with the known load")
    dynamics, settings = setup.dynamics, setup.settings
    c = np.ones(dynamics.dof)
    problem = fit(dynamics, _with(setup, c), settings, additions=others)
    for _ in range(_ROUNDS):
        found = Gains(dynamics, c, _values(problem, others), others, settings.prior_spread)
        problem = fit(dynamics, _with(setup, c), settings, additions=(*others, found))
        step = problem.values[-dynamics.dof :]
        if np.abs(step).max() < _SETTLED:
            break
        c = c * np.exp(step)
    found = Gains(dynamics, c, _values(problem, others), others, settings.prior_spread)
    return setup.changed(recordings=_with(setup, c), additions=(*others, found))


def _values(problem: FittedProblem, others: Sequence[Addition]) -> Parameters:
    """Those of the robot and of all additions but the gains."""
    return problem.values[: len(problem.p) + sum(len(one.parameters) for one in others)]


def _with(setup: Setup, c: Float[np.ndarray, " dof"]) -> tuple[Recording, ...]:
    """Recordings whose torques have been multiplied by gains c."""
    factors = tuple(c.tolist())
    return tuple(
        replace(one, repairs=replace(one.repairs, gain=factors)) for one in setup.recordings
    )
