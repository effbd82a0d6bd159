"""Validation of a model on another recording (`deltaid validate`), and prediction of torques along
a planned motion (`deltaid torque`)."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.errors import Doubt
from deltaid.files import write_csv
from deltaid.identification.loads import as_identified
from deltaid.identification.sources import repeated
from deltaid.identification.study import FAR
from deltaid.identification.torque_error import TorqueError, predicted_torques, torque_error
from deltaid.model.model import Model, ModelLike, load
from deltaid.model.record import IdentifiedModel, Verification
from deltaid.progress import Watch, watched
from deltaid.recording.log import Log
from deltaid.recording.mapping import MappingLike, as_mapping
from deltaid.recording.memory import RecordingLike, as_source
from deltaid.recording.opening import open_log
from deltaid.recording.plan_doubts import smoothed_away, unknown_ends
from deltaid.recording.planned import planned, stilled
from deltaid.recording.recording import PreparedRecording
from deltaid.recording.windows import Window
from deltaid.shown import Plotted, Reported, Shown, Tabled

# Least error of a badly predicted drive as a share of its torque: friction that changes with
# temperature and speed stays below.
_SHARE = 0.1
# Least error as a share of the torque, and the words for it: size, cause and next step.
_LIKELIEST = (
    (
        1.2,
        "worse than no model at all",
        "sign, unit or order of its columns are not those of the identification",
        "deltaid check finds which",
    ),
    (
        0.5,
        "most of it",
        "it is another robot, or its gear or torque constant is another one",
        "deltaid check compares them",
    ),
    (
        0.0,
        "a part of it",
        "load, temperature or speeds are not those of the identification",
        "identify from both recordings, or record under the same conditions",
    ),
)
# Cause and next step for a drive without rows in the identification.
_RESTED = (
    "it did not move in the identification, whose model has its prior",
    "identify from a motion of all drives",
)
# Speed below which a drive stands still [rad/s or m/s].
_SLOW = 0.01
_STANDS = (
    "the robot stands still, where friction balances whatever there is",
    "compare with a recording of a motion",
)
# Next step for rows without torques.
_CURE = "begin and end the motion at rest, or say --periodic if it goes on as it begins"


class _Pair(NamedTuple):
    error: TorqueError
    log: Log


class Validation(Shown, Plotted, Tabled, Reported, _Pair):
    """How well a model predicts a recording: a pair of torque errors and the surveyed recording.

    Attributes:
        error: torque errors, drive by drive.
        log: the recording.
        model: the model.
    """

    model: Model

    def __new__(cls, error: TorqueError, log: Log, model: Model) -> "Validation":
        pair = super().__new__(cls, error, log)
        pair.model = model
        return pair

    def noted(self, model: IdentifiedModel) -> IdentifiedModel:
        """A model that keeps how well it predicts this recording, if it is not one of its own."""
        return noted(model, self.log, self.error, self.log.path.name)

    @property
    def remarks(self) -> tuple[str, ...]:
        return remarks(self.model, self.log, self.error)


def validate(
    model: ModelLike,
    log: RecordingLike,
    *,
    columns: MappingLike | None = None,
    keep_all: bool = False,
) -> Validation:
    """Torque errors of a model on another recording, and the surveyed recording.

    The result unpacks as a pair, `error, log = validate(…)`, and has more attributes.

    The recording is given as to `identify`. One without derivatives is filtered with the cut-off
    of the model's identification, or, for a robot at its prior, as for an identification.

    Raises:
        RecordingError: the log cannot be used.
    """
    model = load(model)
    mapping, dynamics = as_mapping(columns), model.dynamics
    surveyed = open_log(log, dynamics.kinematics, mapping, keep_all=keep_all)
    recording = as_identified(model, surveyed)
    return Validation(torque_error(dynamics, model.p, recording), recording.log, model)


def noted(
    model: IdentifiedModel, log: "Compared", error: TorqueError, name: str
) -> IdentifiedModel:
    """A model that keeps how well it predicts a recording, if it is not one of its own."""
    if repeated(model.sources, log.sha256, log.rows):
        return model
    errors = {"rms": tuple(error.rms.tolist()), "nrmse": tuple(error.nrmse.tolist())}
    verification = Verification(
        log=name, sha256=log.sha256, **errors, remarks=tuple(map(str, remarks(model, log, error)))
    )
    return model.changed(verification=verification)


@runtime_checkable
class Compared(Protocol):
    """A recording that a model was compared with: surveyed, or in a factor file."""

    @property
    def sha256(self) -> str: ...

    @property
    def rows(self) -> str: ...

    @property
    def warnings(self) -> tuple[str, ...]: ...


def remarks(model: ModelLike, log: Compared, error: TorqueError) -> tuple[str, ...]:
    """Warnings about comparing a model with a recording, one sentence each."""
    identified = load(model).identified
    source = repeated(identified.sources if identified else (), log.sha256, log.rows)
    if source is None:
        return (*log.warnings, *misfit(model, error))
    is_same = source.sha256 == log.sha256
    what = f"this recording ({source.log})" if is_same else f"rows of this recording ({source.log})"
    twice = Doubt(
        f"the model was identified from {what}, so it verifies nothing",
        cause="the file was given twice" if is_same else "one file is a copy or part of the other",
        cure="take a recording of another motion",
    )
    return (*log.warnings, twice, *misfit(model, error))


def misfit(model: ModelLike, error: TorqueError | Verification) -> tuple[str, ...]:
    """A warning when a recording does not look like one of the identified robot; else nothing."""
    model = load(model)
    if model.identified is None:
        return ()
    fit = model.identified.fit
    rms, nrmse = np.asarray(error.rms), np.asarray(error.nrmse)
    bad = np.flatnonzero((rms > FAR * np.asarray(fit.rms)) & (nrmse > _SHARE))
    if not bad.size:
        return ()
    drives = ", ".join(model.robot.drives[i] for i in bad)
    worst = int(bad[np.argmax(nrmse[bad])])
    drive, now, then = model.robot.drives[worst], nrmse[worst], fit.nrmse[worst]
    how_much, cause, cure = next(texts for least, *texts in _LIKELIEST if now > least)
    if not fit.rms[worst]:
        cause, cure = _RESTED
    if isinstance(error, TorqueError) and not np.any(error.fastest > _SLOW):
        cause, cure = _STANDS
    text = (
        f"the model does not predict {drives}: the error of {drive} is {100 * now:.0f} % of its "
        f"{model.robot.units(drive).effort}, {how_much}, and was {100 * then:.2g} % in the "
        "identification"
    )
    return (Doubt(text, cause=cause, cure=cure),)


@dataclass(frozen=True, repr=False)
class FeedForward(Shown, Tabled):
    """Torques along a motion: columns t, tau1, tau2, … in s and N m (N).

    Where the identification found gains of the drives, these are the torques that the drives must
    be commanded.

    Attributes:
        model: what they are computed by.
        recording: the motion, with its filter.
        without: rows at the beginning and at the end without torques.
        warnings: what is doubtful.
    """

    model: Model
    recording: PreparedRecording
    without: tuple[int, int]
    warnings: tuple[str, ...]

    @property
    def rows(self) -> int:
        return self.samples - sum(self.without)

    @property
    def samples(self) -> int:
        """Number of rows: that of the motion, where its rows are evenly spaced."""
        if self.recording.log.laid.steady:
            return self.recording.log.samples
        return sum(len(part) for part in self._computed())

    def tables(self) -> Iterator[pl.DataFrame]:
        """Consecutive rows, in constant memory; torques that are not known are null."""
        first, last = self.without
        times = self._times if first or last else None
        if first and times is not None:
            yield self._empty(times[:first])
        yield from self._computed()
        if last and times is not None:
            yield self._empty(times[-last:])

    def table(self) -> pl.DataFrame:
        return pl.concat(self.tables())

    def save(self, path: str | Path) -> None:
        """Write all rows as CSV, whole or not at all; cells without a torque are empty.

        Raises:
            DeltaidError: the file cannot be written.
        """
        write_csv(Path(path), self.tables())

    @property
    def _times(self) -> Float[np.ndarray, " rows"]:
        return np.concatenate([batch[:, 0] for batch in self.recording.log.batches()])

    def _computed(self) -> Iterator[pl.DataFrame]:
        dynamics, p, gains = self.model.dynamics, self.model.p, self.model.gains
        samples = stilled(self.recording)

        def torques(window: Window) -> tuple[np.ndarray, np.ndarray]:
            own = samples(window)
            return own.time, (predicted_torques(dynamics, p, own) + own.carried) / gains

        log, done = self.recording.log, self.without[0]
        steady = log.laid.steady
        most = log.samples - self.without[1]
        for time, tau in self.recording.evaluate(dynamics.kinematics, torques):
            kept = slice(0, max(0, most - done) if steady else None)
            done += len(time)
            yield _frame(time[kept], tau[kept])

    def _empty(self, time: Float[np.ndarray, " rows"]) -> pl.DataFrame:
        tau = np.full((len(time), len(self.model.robot.drives)), np.nan)
        return _frame(time, tau).with_columns(pl.exclude("t").fill_nan(None))


def torque(
    model: ModelLike,
    motion: RecordingLike,
    *,
    columns: MappingLike | None = None,
    periodic: bool = False,
    progress: Watch = None,
) -> FeedForward:
    """The torques that a model predicts along a planned motion or a recording.

    Without velocities and accelerations, positions are filtered and differentiated. An end at rest
    goes on at rest, and a periodic motion as it begins, so that every row has torques; at an end
    that moves, as many rows as the filter is long have none.

    Args:
        model: a model or a robot, by value, name or file.
        motion: positions, and velocities and accelerations if they are known.
        columns: names and units of its columns, if not the default ones.
        periodic: whether the motion goes on as it begins.
        progress: as of `identify`.

    Raises:
        RecordingError: the motion cannot be used, or is not periodic.
    """
    known = load(model)
    with watched(progress, "torque") as say:
        source = as_source(motion)
        say(f"checking {source}")
        log = open_log(source, known.dynamics.kinematics, as_mapping(columns), need_torque=False)
        recording = as_identified(known, log, partial(planned, periodic=periodic))
    warnings = [f"{source}: {text}" for text in recording.log.warnings]
    warnings += unknown_ends(recording, "torque", _CURE)
    warnings += smoothed_away(recording, known.dynamics.kinematics)
    return FeedForward(known, recording, recording.without, tuple(warnings))


def _frame(time: Float[np.ndarray, " rows"], tau: Float[np.ndarray, "rows dof"]) -> pl.DataFrame:
    return pl.DataFrame({"t": time} | {f"tau{i + 1}": x for i, x in enumerate(tau.T)})
