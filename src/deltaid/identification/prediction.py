"""How well a model predicts the torques of another recording: `deltaid validate`."""

from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from deltaid.errors import Doubt
from deltaid.identification.loads import as_known
from deltaid.identification.sources import model_filtered
from deltaid.identification.torque_error import TorqueError, torque_error
from deltaid.model.model import Model, ModelLike, load
from deltaid.model.record import IdentifiedModel, Verification
from deltaid.recording.log import Log
from deltaid.recording.mapping import MappingLike, as_mapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.opening import open_log
from deltaid.shown import Plotted, Reported, Shown, Tabled

# A drive is badly predicted when its error is so many times that of the identification, and more
# than this share of its torque: friction that changes with temperature and speed stays below.
_WORSE, _SHARE = 3.0, 0.1
# Share of the torque beyond which the error is, how much is missed, cause and next step.
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
    """Torque errors of a model on a recording it has not seen, and the surveyed recording.

    What is returned unpacks as a pair, `error, log = validate(…)`, and knows more by name.

    The recording is given as to `identify`. One without derivatives is filtered with the cut-off
    that the model was identified with, and for a robot at its prior as for an identification.

    Raises:
        RecordingError: the log cannot be used.
    """
    model = load(model)
    mapping, dynamics = as_mapping(columns), model.dynamics
    surveyed = open_log(log, dynamics.kinematics, mapping, keep_all=keep_all)
    recording = as_known(model_filtered(model, surveyed), model)
    return Validation(torque_error(dynamics, model.p, recording), recording.log, model)


def noted(
    model: IdentifiedModel, log: "Compared", error: TorqueError, name: str
) -> IdentifiedModel:
    """A model that keeps how well it predicts a recording, if it is not one of its own."""
    if log.sha256 in {source.sha256 for source in model.sources}:
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
    def warnings(self) -> tuple[str, ...]: ...


def remarks(model: ModelLike, log: Compared, error: TorqueError) -> tuple[str, ...]:
    """Warnings about comparing a model with a recording, one sentence each."""
    identified = load(model).identified
    sources = identified.sources if identified else ()
    twice = [
        Doubt(
            f"the model was identified from this recording ({source.log}), so it verifies nothing",
            cause="the file was given twice",
            cure="take a recording of another motion",
        )
        for source in sources
        if source.sha256 == log.sha256
    ]
    return (*log.warnings, *twice[:1], *misfit(model, error))


def misfit(model: ModelLike, error: TorqueError | Verification) -> tuple[str, ...]:
    """A warning when a recording does not look like one of the model's robot; else nothing.

    Of a robot at its prior nothing better can be expected.
    """
    model = load(model)
    if model.identified is None:
        return ()
    fit = model.identified.fit
    rms, nrmse = np.asarray(error.rms), np.asarray(error.nrmse)
    times = rms / np.maximum(fit.rms, np.finfo(float).tiny)
    bad = np.flatnonzero((times > _WORSE) & (nrmse > _SHARE))
    if not bad.size:
        return ()
    drives = ", ".join(model.robot.drives[i] for i in bad)
    worst = int(bad[np.argmax(nrmse[bad])])
    drive, now, then = model.robot.drives[worst], nrmse[worst], fit.nrmse[worst]
    how_much, cause, cure = next(texts for least, *texts in _LIKELIEST if now > least)
    text = (
        f"the model does not predict {drives}: the error of {drive} is {100 * now:.0f} % of its "
        f"{model.robot.units(drive).effort}, {how_much}, and was {100 * then:.2g} % in the "
        "identification"
    )
    return (Doubt(text, cause=cause, cure=cure),)
