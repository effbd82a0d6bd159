"""From a robot to a motion that makes its parameters visible: the whole of Sec. IV."""

from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.limits import torque_limits
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DeltaidError, with_options
from deltaid.estimation.base_parameters import BaseParameters
from deltaid.estimation.objective import parameter_scale
from deltaid.identification.generic_motion import random_motion_base
from deltaid.model.model import ModelLike, load
from deltaid.motion.excitation.graph import ExcitationGraph, torques_without_friction
from deltaid.motion.excitation.optimize import (
    Judge,
    Optimum,
    Progress,
    conflict,
    optimise,
    random_start,
)
from deltaid.motion.excitation.problem import ExcitationProblem, by_bodies, criterion
from deltaid.motion.excitation.run import Run, plan_run, run_use, write_run
from deltaid.motion.excitation.settings import ExcitationSettings
from deltaid.motion.fourier import Series
from deltaid.progress import watched
from deltaid.recording.filter import LOWEST_RATE
from deltaid.recording.spectrum import HIGHEST
from deltaid.shown import Plotted, Reported, Shown, Tabled

# Grid points for each harmonic of the series; random motions that columns are scaled with; range of
# the turning coordinate about its middle [rad]; how much shorter than asked a period may become.
_POINTS, _REFERENCES, _TURN, _SHORTER = 20, 20, np.pi, 4.0


@dataclass(frozen=True)
class LimitUse:
    """How much of one limit a run uses, as a share."""

    name: str
    share: float


@dataclass(frozen=True)
class Prediction:
    """What the run will tell about one base parameter, before moving.

    Attributes:
        formula: the base parameter.
        value: at the prior.
        std: standard deviation that least squares will have with the given torque noise.
        prior_std: standard deviation of the prior.
        unit: of all three.
    """

    formula: str
    value: float
    std: float
    prior_std: float
    unit: str


@dataclass(frozen=True, repr=False)
class Excitation(Shown, Plotted, Tabled, Reported):
    """An optimised motion, ready to run.

    Attributes:
        exciter: the robot and the settings that it was made with.
        run: the motion from rest to rest.
        optimum: how it was found.
        criterion_before, criterion_after: the criterion, with true signs of friction, of the best
            start's random motion and of the result.
        limits: use of every limit over the whole run.
        predictions: for each base parameter.
        torque_max: largest torque of each drive over the run, at the prior [N m].
    """

    exciter: "Exciter"
    run: Run
    optimum: Optimum
    criterion_before: float
    criterion_after: float
    limits: tuple[LimitUse, ...]
    predictions: tuple[Prediction, ...]
    torque_max: Float[np.ndarray, " dof"]

    def save(self, path: str | Path, rate: float | None = None) -> None:
        """Write the run as CSV, as a controller replays it: t, q1…, qd1…, qdd1…, x, y, z.

        Args:
            rate: samples a second; that of the settings without.

        Raises:
            DeltaidError: the file cannot be written.
        """
        kinematics = self.exciter.dynamics.kinematics
        write_run(kinematics, self.run, rate or self.exciter.settings.rate, Path(path))


def excite(
    robot: Dynamics | ModelLike,
    *,
    settings: ExcitationSettings | None = None,
    stop: Event | None = None,
    progress: Progress | bool | None = None,
    **options: Any,
) -> Excitation:
    """The best motion for an identification: at rest at both ends, within all limits.

    Args:
        robot: as of `Exciter`, which makes further motions for the same robot.
        settings: what to optimise.
        stop: as of `Exciter.optimise`.
        progress: as of `Exciter.optimise`.
        options: single settings by name, such as `duration=5`.

    Raises:
        DeltaidError: there is no such setting, or the limits leave no room.
    """
    asked = with_options(settings or ExcitationSettings(), options, "excite")
    return Exciter(robot, asked).optimise(stop, progress)


class Exciter(Shown, Plotted):
    """A robot prepared for excitation: kernels, base parameters, reference motions, scaling.

    Args:
        robot: its dynamics, for the prior; or a model or a robot, by value, name or file. An
            identified model has its masses and friction in place of the prior.
        settings: what to optimise.
    """

    def __init__(
        self, robot: Dynamics | ModelLike, settings: ExcitationSettings | None = None
    ) -> None:
        settings = settings or ExcitationSettings()
        dynamics = robot if isinstance(robot, Dynamics) else compiled(load(robot).as_description())
        self.dynamics, self.settings = dynamics, settings
        self.base: BaseParameters = random_motion_base(dynamics)
        heads = np.array([group.representative for group in self.base.groups])
        self._graph = ExcitationGraph(dynamics, heads)
        self._p = prior_parameters(dynamics.robot)
        self._values = self.base.values(self._p)
        spread = settings.prior_spread * parameter_scale(self.base.layout, self._p)
        self._prior_std = np.linalg.norm(self.base.combination() * spread, axis=1)
        dof, n, turn = dynamics.dof, len(heads), dynamics.robot.turn
        slowest, reach = 2 * np.pi / settings.duration, min(_TURN, 0.5 * (turn.high - turn.low))
        centre, half = dynamics.robot.within(0.5 * (turn.low + turn.high), reach)
        fastest = settings.harmonics * _SHORTER / settings.duration
        # The cut-off of a recording's filter is twice the bandwidth of its motion.
        least = max(LOWEST_RATE, 2 * fastest / HIGHEST)
        if settings.rate < least:
            raise DeltaidError(
                f"{settings.rate:g} Hz does not show a motion of up to {fastest:.3g} Hz",
                where="rate",
                cure=f"give {least:.3g} Hz or more, or a longer duration",
            )
        series = Series(settings.harmonics, slowest, _SHORTER * slowest, centre, half)
        shape = ExcitationProblem(
            self._graph, series, settings.criterion, np.ones(dof), np.ones(n),
            np.eye(n), self._values, torques_without_friction(dynamics), settings.velocity_weight,
            np.ones(dof), _POINTS * settings.harmonics,
        )  # fmt: skip
        self.torque_reference, speed, rms = self._references(shape)
        noise, samples = (
            settings.torque_noise * self.torque_reference,
            settings.duration * settings.rate,
        )
        # scaled columns and normalised torques, or prior and noise as units of both
        weights, scales, prior = self.torque_reference**-2.0, 1 / rms, np.zeros((n, n))
        if settings.weigh_prior:
            scales, weights, prior = self._prior_std, noise**-2.0, np.eye(n) / samples
        self.problem = replace(shape, row_weights=weights, scales=scales, prior=prior, speed=speed)
        self._judge: Judge | None = None
        if settings.by == "sensors":
            self._judge = by_bodies(dynamics, noise, samples * settings.repeats)

    def optimise(
        self, stop: Event | None = None, progress: Progress | bool | None = None, *, offset: int = 0
    ) -> Excitation:
        """The best motion from all starts; another `offset` gives other start values.

        Args:
            stop: when set, the search ends with the best motion so far.
            progress: called with the account of each start as it ends; or whether to show how many
                have, None for where someone is watching.

        Raises:
            DeltaidError: the limits leave no room.
        """
        if callable(progress):
            return self._optimised(stop, progress, offset)
        with watched(progress, "excite") as say:
            ended, starts = count(1), self.settings.starts
            say(f"start 0 of {starts}")
            return self._optimised(stop, lambda _: say(f"start {next(ended)} of {starts}"), offset)

    def _optimised(self, stop: Event | None, progress: Progress, offset: int) -> Excitation:
        first, fine = self.settings.seed + offset, 10 * self.problem.samples
        seeds = range(first, first + self.settings.starts)
        optimum = optimise(self.problem, seeds, stop=stop, progress=progress, judge=self._judge)
        periods = max(1, round(self.settings.duration / optimum.motion.period))
        run = plan_run(self.problem, optimum.motion, periods * self.settings.repeats)
        torque_max = np.abs(self.preview(run)).max(axis=0)
        use = run_use(self.problem, run, np.linspace(0.0, run.duration, 4000))
        for k, (i, largest) in enumerate(torque_limits(self.dynamics.robot).items()):
            use[len(use) - len(self.problem.largest) + k] = torque_max[i] / largest
        limits = zip(self.problem.limit_names, use.tolist(), strict=True)
        before, after = (
            criterion(self.settings.criterion, self.problem.information(x, fine))[0]
            for x in (random_start(self.problem, optimum.best.seed), optimum.x)
        )
        return Excitation(
            exciter=self,
            run=run,
            optimum=optimum,
            criterion_before=before,
            criterion_after=after,
            limits=tuple(LimitUse(*pair) for pair in limits),
            predictions=self.predict(run),
            torque_max=torque_max,
        )

    def preview(self, run: Run, samples: int = 2000) -> Float[np.ndarray, "samples dof"]:
        """Torques of a run at the prior."""
        z, zd, zdd = run.evaluate(np.linspace(0, run.duration, samples))
        _, qd, qdd = self.dynamics.kinematics.drive_motion(z, zd, zdd)
        return self.dynamics.torque(z, qd, qdd, self._p)

    def predict(self, run: Run) -> tuple[Prediction, ...]:
        """Standard deviations of the base parameters for white torque noise on a run.

        Cov = (Σ_t Y_BᵀΣ⁻¹Y_B)⁻¹ over the samples of the recording.
        """
        samples = 2000
        z, zd, zdd = run.evaluate(np.linspace(0, run.duration, samples))
        Y = self._graph.dense(self._graph.exact_regressor(np.hstack([z, zd, zdd]).T))
        Y = Y / (self.settings.torque_noise * self.torque_reference)[None, :, None]
        A = Y.reshape(-1, Y.shape[2]) * np.sqrt(run.duration * self.settings.rate / samples)
        norms = np.linalg.norm(A, axis=0)
        R = np.linalg.qr(A / norms, mode="r")
        std = np.linalg.norm(np.linalg.solve(R, np.eye(len(norms))), axis=1) / norms
        units = [self.dynamics.layout.units[group.representative] for group in self.base.groups]
        columns = (column.tolist() for column in (self._values, std, self._prior_std))
        rows = zip(self.base.formulas, *columns, units, strict=True)
        return tuple(Prediction(*row) for row in rows)

    def _references(self, shape: ExcitationProblem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Largest torques and speeds, and column sizes, over random motions within the limits."""
        starts, robot, dof = range(_REFERENCES), self.dynamics.robot, self.dynamics.dof
        states = [shape.series.state(random_start(shape, seed), shape.grid()) for seed in starts]
        states = [s for s in states if np.any(s[dof:])]
        if not states:
            raise conflict(shape, random_start(shape, 0))
        s = np.hstack(states)
        Y = self._graph.dense(self._graph.exact_regressor(s))
        torque = np.abs(Y @ self._values).max(axis=0)
        speed = np.abs(self._graph.regressor(s)[-dof:]).max(axis=1)
        speed = [
            robot.limits_of(d).top_speed or v for d, v in zip(robot.drives, speed, strict=True)
        ]
        rms = np.sqrt(np.mean(np.sum((Y / torque[None, :, None]) ** 2, axis=1), axis=0))
        return torque, np.array(speed), rms
