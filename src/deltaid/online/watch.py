"""Run a recording through online estimation, cycle by cycle."""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import DescriptionError, Doubt
from deltaid.levels import GRAVITY
from deltaid.mechanism.one_or_many import numbered
from deltaid.model.model import Model
from deltaid.online.contact import least_force, threshold
from deltaid.online.doubts import doubts
from deltaid.online.events import Loads, Touch, Touches, WeighedLoad
from deltaid.online.instant import waits
from deltaid.online.online import Online, OnlineEstimate
from deltaid.online.replay import Cycles, Replay
from deltaid.online.settings import IDENTIFY_FIRST, OnlineSettings
from deltaid.online.suspicion import Suspicion, measured_of
from deltaid.progress import Progress
from deltaid.robot.description import RobotDescription

# Largest number of rows of a series; longer recordings are thinned out.
_SERIES = 200_000


@dataclass(frozen=True)
class FollowedFriction:
    """A followed coefficient of friction.

    Attributes:
        name: of the parameter.
        before: value in the model.
        value, std: at the end of the recording.
    """

    name: str
    unit: str
    before: float
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Watched:
    """Results of a recording that was run through online estimation.

    Attributes:
        robot: its description.
        log: name of the recording.
        cycles: number of cycles.
        bad: number of cycles that were not used.
        rate: of cycles [Hz].
        has_gripper: whether the gripper's signal is known.
        false_alarms: accepted rate [1/h].
        loads, touches, friction: detected loads and contacts, followed friction.
        best, worst: smallest force on the platform that is detected in 95 % of cases [N], the
            median over all cycles, along the best and the worst direction; None without any cycle.
        seconds: processor time per cycle [s].
        series: one row per cycle, or per several cycles of a long recording: t [s]; held; mass,
            mass_low, mass_high [kg], 0 where nothing is held; contact_size of the residual, in
            thresholds, the largest since the previous row; contact_limb; force_… on the platform
            while it is pushed [N]; effort…, external torque on each drive [N m or N];
            least_force_best and least_force_worst that are detected [N].
        doubts: about the results, one cause each.
    """

    robot: RobotDescription
    log: str
    cycles: int
    bad: int
    rate: float
    has_gripper: bool
    false_alarms: float
    loads: tuple[WeighedLoad, ...]
    touches: tuple[Touch, ...]
    friction: tuple[FollowedFriction, ...]
    best: float
    worst: float
    seconds: float
    series: pl.DataFrame
    doubts: tuple[Doubt, ...]


def watch(
    model: Model,
    replay: Replay,
    settings: OnlineSettings,
    progress: Progress = lambda _: None,
) -> Watched:
    """Run a recording through online estimation.

    Args:
        settings: rate and noise of speeds follow from the recording, and lags unless they are
            given.

    Raises:
        DescriptionError: the model has no intervals, which contact detection needs.
        DeltaidError: settings and robot do not fit each other.
    """
    if model.identified is None:
        raise DescriptionError(
            "is a robot at its prior: without an identification nothing says how far its torques "
            "may be off, and so what is a contact",
            where=model.source,
            cure=IDENTIFY_FIRST,
        )
    settings, has_gripper = replay.settings(settings), replay.has_gripper
    online = Online(model, settings, more=(measured_of,))
    late = waits(model, settings).whole * settings.period
    loads, touches = Loads(online, has_gripper), Touches(model.robot)
    suspicion = Suspicion(settings.period, replay.ends, online.known.unmodelled)
    every = max(1, -(-replay.log.samples // _SERIES))
    parts, cycles, bad, seconds = list[pl.DataFrame](), 0, 0, 0.0
    for rows, estimate, spent in _estimates(online, replay, progress):
        if rows.begins:
            loads.close()
            touches.close()
        seconds += spent
        cycles += len(rows.time)
        bad += int(np.sum(~estimate.good))
        time_ = rows.time - late
        events = np.maximum(time_, rows.time[0]) if rows.begins else time_  # loads held before
        for part in (loads, touches):
            part.add(events, estimate)
        suspicion.add(rows, estimate)
        parts.append(_thinned(online, time_, estimate, every, has_gripper=has_gripper))
    progress("judging what speaks against it")
    series, held, pushes = pl.concat(parts), loads.finished(), touches.finished()
    best, worst = series.select("least_force_best", "least_force_worst").to_numpy().T
    finite = np.isfinite(worst)
    return Watched(
        robot=model.robot,
        log=replay.log.path.name,
        cycles=cycles,
        bad=bad,
        rate=replay.log.rate,
        has_gripper=has_gripper,
        false_alarms=settings.false_alarms,
        loads=held,
        touches=pushes,
        friction=_friction(online),
        best=float(np.median(best[finite])),
        worst=float(np.median(worst[finite])),
        seconds=seconds / max(cycles, 1),
        series=series,
        doubts=doubts(model, replay, settings, suspicion.evidence, held, pushes),
    )


def _estimates(
    online: Online, replay: Replay, progress: Progress
) -> Iterator[tuple[Cycles, OnlineEstimate, float]]:
    """Blocks of cycles with their estimates, and the processor time that each took [s]."""
    q = np.zeros((1, online.model.dynamics.dof))  # compiles
    online.run(q, q if replay.has_velocity else None, q)
    for rows in replay.rows():
        progress(f"{rows.time[0]:.0f} s of {replay.log.path.name}")
        if rows.begins:
            online.reset()
        begin = time.process_time()
        estimate = online.run(rows.q, rows.qd, rows.tau, rows.gripper, rows.elapsed)
        yield rows, estimate, time.process_time() - begin


def _thinned(
    online: Online,
    time: Float[np.ndarray, " rows"],
    estimate: OnlineEstimate,
    every: int,
    has_gripper: bool,
) -> pl.DataFrame:
    """Every n-th cycle; contacts are taken at the largest residual since the previous row."""
    out, size, count = estimate.outputs, estimate.outputs["contact_size"][:, 0], len(time)
    ends = np.minimum(np.arange(every - 1, max(count, every), every), count - 1)
    spans = zip([0, *(ends[:-1] + 1)], ends, strict=True)
    peak = np.array([a + size[a : b + 1].argmax() for a, b in spans])
    force, interval = out["contact_force"][peak], estimate.mass_interval[ends]
    A = out["contact_information"][ends].reshape(len(ends), *2 * force.shape[1:])
    settings, dof = online.settings, estimate.residual.shape[1]
    best, worst = least_force(A, threshold(settings.false_alarms, settings.corner, dof))
    if not has_gripper:  # an unsignalled load may hide a vertical push of its weight
        worst = worst + GRAVITY * online.known.load_scales[0]
    columns = {
        "t": time[ends],
        "held": estimate.held[ends].astype(float),
        "mass": estimate.mass[ends],
        "mass_low": interval[:, 0],
        "mass_high": interval[:, 1],
        "contact_size": size[peak],
        "contact_limb": out["contact_limb"][peak, 0],
    }
    names = online.model.robot.task.names
    columns |= {f"force_{name}": x for name, x in zip(names, force.T, strict=False)}
    columns |= numbered(effort=out["contact_effort"][peak])
    return pl.DataFrame(columns | {"least_force_best": best, "least_force_worst": worst})


def _friction(online: Online) -> tuple[FollowedFriction, ...]:
    known, layout, state = online.known, online.model.layout, online.graph.state.split(online.state)
    n, first = state["x"].size, len(known.entries.shown) + known.directions.shape[1]
    rows, columns = np.triu_indices(n)  # rows of the upper triangle are columns of the lower one
    deviations = np.sqrt(np.maximum(state["P"][rows == columns], 0.0))
    followed = []
    for i, (k, std) in enumerate(zip(known.followed, known.friction_std, strict=True), first):
        before, name, unit = float(online.model.p[k]), layout.names[k], layout.units[k]
        value = before + std * float(state["x"][i])
        followed.append(FollowedFriction(name, unit, before, value, std * float(deviations[i])))
    return tuple(followed)
