"""A recording run through cycle by cycle, and what came of it."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import DescriptionError, Doubt
from deltaid.model.model import Model
from deltaid.online.contact import least_force, threshold
from deltaid.online.doubts import doubts
from deltaid.online.events import Loads, Touch, Touches, WeighedLoad
from deltaid.online.instant import waits
from deltaid.online.online import Online, OnlineEstimate
from deltaid.online.replay import Replay
from deltaid.online.settings import OnlineSettings
from deltaid.online.suspicion import Suspicion, measured_of
from deltaid.robot.description import RobotDescription

# What a mass weighs [m/s²].
_GRAVITY = 9.81
# Rows of a series at most.
_SERIES = 200_000


@dataclass(frozen=True)
class FollowedFriction:
    """A coefficient of friction that was followed.

    Attributes:
        name: of the parameter.
        before: in the model.
        value, std: at the end of the recording.
    """

    name: str
    unit: str
    before: float
    value: float
    std: float


@dataclass(frozen=True, eq=False)
class Watched:
    """A recording that was run through, cycle by cycle.

    Attributes:
        robot: its description.
        log: name of the recording.
        cycles: how many, of them
        bad: that could not be used.
        rate: [Hz].
        told: whether a gripper's signal said when something is held.
        false_alarms: accepted in an hour.
        loads, touches, friction: what was found.
        best, worst: smallest force on the platform that is told in 95 % of cases [N], the median
            over all cycles, along the best and along the worst direction; None without any cycle.
        seconds: processor time of a cycle, as run here [s].
        series: one row a cycle, or every so many cycles of a long recording: t [s]; held, whether
            something is; mass, mass_low, mass_high of it [kg], 0 where nothing is; contact_size of
            the residual, in thresholds, the largest since the row before; contact_limb as the cycle
            gives it; force_… on the platform, while it is pushed [N]; effort… from outside, on each
            drive [N m or N]; least_force_best and least_force_worst that is told [N].
        doubts: what speaks against it, one cause each.
    """

    robot: RobotDescription
    log: str
    cycles: int
    bad: int
    rate: float
    told: bool
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
    progress: Callable[[str], None] = lambda _: None,
) -> Watched:
    """Run a recording through.

    Args:
        settings: those of rate and noise of speeds follow from the recording, and lags where they
            are left open.

    Raises:
        DescriptionError: the model has no intervals, so nothing says what is a contact.
        DeltaidError: settings and robot do not fit each other.
    """
    if model.identified is None:
        raise DescriptionError(
            "is a robot at its prior: without an identification nothing says how far its torques "
            "may be off, and so what is a contact",
            where=model.source,
            cure="identify a model from a recording first, `deltaid identify`",
        )
    settings, told = replay.settings(settings), replay.is_told
    online = Online(model, settings, more=(measured_of,))
    late = waits(model, settings).whole * settings.period
    loads, touches = Loads(online, told), Touches(model.robot)
    suspicion = Suspicion(settings.period, replay.ends, online.known.unmodelled)
    every = max(1, -(-replay.log.samples // _SERIES))
    parts, cycles, bad, seconds = list[pl.DataFrame](), 0, 0, 0.0
    q = np.zeros((1, model.dynamics.dof))  # compiles
    online.run(q, q if replay.has_velocity else None, q)
    for rows in replay.rows():
        progress(f"{rows.time[0]:.0f} s of {replay.log.path.name}")
        if rows.begins:
            online.reset()
            loads.close()
            touches.close()
        begin = time.process_time()
        found = online.run(rows.q, rows.qd, rows.tau, rows.gripper)
        seconds += time.process_time() - begin
        cycles += len(rows.time)
        bad += int(np.sum(~found.good))
        at = rows.time - late
        events = np.maximum(at, rows.time[0]) if rows.begins else at  # what was held before
        for part in (loads, touches):
            part.add(events, found)
        suspicion.add(rows, found)
        parts.append(_thinned(online, at, found, every, told))
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
        told=told,
        false_alarms=settings.false_alarms,
        loads=held,
        touches=pushes,
        friction=_friction(online),
        best=float(np.median(best[finite])),
        worst=float(np.median(worst[finite])),
        seconds=seconds / max(cycles, 1),
        series=series,
        doubts=doubts(model, replay, settings, suspicion.seen, held, pushes),
    )


def _thinned(
    online: Online, at: Float[np.ndarray, " rows"], found: OnlineEstimate, every: int, told: bool
) -> pl.DataFrame:
    """Every so-manieth cycle; of the residual the one of largest size since."""
    out, size = found.outputs, found.outputs["contact_size"][:, 0]
    ends = np.minimum(np.arange(every - 1, max(len(at), every), every), len(at) - 1)
    spans = zip([0, *(ends[:-1] + 1)], ends, strict=True)
    peak = np.array([a + size[a : b + 1].argmax() for a, b in spans])
    force, interval = out["contact_force"][peak], found.mass_interval[ends]
    A = out["contact_information"][ends].reshape(len(ends), *2 * force.shape[1:])
    settings, dof = online.settings, found.residual.shape[1]
    best, worst = least_force(A, threshold(settings.false_alarms, settings.corner, dof))
    if not told:  # straight up or down, a load may hide its weight of a push
        worst = worst + _GRAVITY * online.known.load_scales[0]
    columns = {
        "t": at[ends],
        "held": found.held[ends].astype(float),
        "mass": found.mass[ends],
        "mass_low": interval[:, 0],
        "mass_high": interval[:, 1],
        "contact_size": size[peak],
        "contact_limb": out["contact_limb"][peak, 0],
    }
    names = online.model.robot.task.names
    columns |= {f"force_{name}": x for name, x in zip(names, force.T, strict=False)}
    columns |= {f"effort{i + 1}": x for i, x in enumerate(out["contact_effort"][peak].T)}
    return pl.DataFrame(columns | {"least_force_best": best, "least_force_worst": worst})


def _friction(online: Online) -> tuple[FollowedFriction, ...]:
    known, layout, state = online.known, online.model.layout, online.graph.state.split(online.state)
    n, first = state["x"].size, len(known.entries.shown) + known.directions.shape[1]
    rows, columns = np.triu_indices(n)  # of the upper triangle are columns of the lower one
    deviations = np.sqrt(np.maximum(state["P"][rows == columns], 0.0))
    found = []
    for i, (k, std) in enumerate(zip(known.followed, known.friction_std, strict=True), first):
        before, name, unit = float(online.model.p[k]), layout.names[k], layout.units[k]
        value = before + std * float(state["x"][i])
        found.append(FollowedFriction(name, unit, before, value, std * float(deviations[i])))
    return tuple(found)
