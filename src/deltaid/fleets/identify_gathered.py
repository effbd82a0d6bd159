"""`identify` and `validate` from factor files, without their recordings; verdicts, remarks and
corrections come from the recordings' own identifications."""

from collections import Counter
from collections.abc import Sequence
from statistics import median

import numpy as np

from deltaid.checks.run import Judged
from deltaid.checks.verdicts import KEYS, Verdicts
from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.load_columns import LoadColumns
from deltaid.errors import RecordingError
from deltaid.estimation.information import Information
from deltaid.fleets.factor_file import FactorFile, require_alike
from deltaid.fleets.merged import fitted, holding, merged, merging_of, ordered
from deltaid.identification.assembly import assembled
from deltaid.identification.friction_constants import freed
from deltaid.identification.judgement import judged_parameters
from deltaid.identification.loads import found_loads, known_load
from deltaid.identification.torque_error import TorqueError
from deltaid.model.corrections import Correction
from deltaid.model.model import ModelLike, load
from deltaid.model.record import Settings
from deltaid.model.verdict import Grade, Verdict
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.friction_terms import law_in_words
from deltaid.robot.load import RobotLike, described

# Corrections that the common fit or `_torque_constants` report.
_OF_FIT = ("friction", "prior", "load", "gain")
# Terms with constants of their own beside the coefficient.
_CURVED = {"power": ("exponent",), "stribeck": ("speed", "exponent"), "hess_soom": ("speed",)}


def identify_gathered(
    robot: RobotLike, files: Sequence[FactorFile], settings: Settings | None = None
) -> Judged:
    """Identify a robot, with priors, reductions and measured values of its own, from the factors of
    its recordings, by settings of method, regulariser, γ, prior's spread and friction.

    What was corrected in each recording stays so. Friction laws are those of the description, or
    what most of the recordings asked for.

    Raises:
        RecordingError: files do not go together, or not with the robot.
        IdentificationError: the fit cannot be posed or did not converge.
    """
    settings, description = settings or Settings(), described(robot)
    files, chosen = prepared(files, description, settings)
    gains = _torque_constants(files)
    problem = fitted(files, chosen, settings)
    judged = judged_parameters(freed(problem))
    model = assembled(
        problem,
        settings,
        _torque_errors(problem.information, problem.values, files),
        judged,
        loads=found_loads(problem.additions, judged[len(problem.p) :], holding(files)),
        corrections=[*_corrections(description, chosen, files), *gains],
        sources=tuple(file.record.model.sources[0] for file in files),
        remarks=_remarks(files, gains),
    )
    verdicts = Verdicts(_verdicts(files))
    return Judged(verdicts.noted(model), problem, (), verdicts=verdicts)


def validate_gathered(model: ModelLike, file: FactorFile) -> TorqueError:
    """Torque errors of a model on a recording by its factors, as of `deltaid.validate`.

    The recording's lags are corrected as they were found in it by itself.

    Raises:
        RecordingError: the file is of another mechanism than the model, or holds a load that the
            model does not know.
    """
    identified = load(model)
    require_alike([file], identified.robot)
    merging = merging_of([file], identified.robot, Settings())
    loads = {
        columns.load.name: known_load(columns, identified, file.where)
        for columns in merging.additions
        if isinstance(columns, LoadColumns) and columns.parameters
    }
    information = merged(merging, [file]).information
    return _torque_errors(information, np.append(identified.p, merging.of_loads(loads)), [file])


def _torque_errors(
    information: Information, values: Parameters, files: Sequence[FactorFile]
) -> TorqueError:
    """Residual torques of all recordings; unfiltered noise is that of the recordings' own fits."""
    rms, torque = information.rms(values), information.torque_rms()
    fits = [file.record.model.fit for file in files]
    samples = [file.condensed.whole.samples.mean() for file in files]
    beyond = [np.square(fit.rms_unfiltered) - np.square(fit.rms) for fit in fits]
    noise = np.average(beyond, axis=0, weights=samples)
    return TorqueError(
        rms=rms,
        nrmse=rms / np.where(torque > 0, torque, 1.0),
        rms_unfiltered=np.sqrt(np.maximum(rms**2 + noise, 0.0)),
        covariance=np.diag(rms**2),
        turning=np.zeros(len(rms)),
        cutoff=files[0].record.model.sources[0].cutoff_hz,
        fastest=np.max([file.record.fastest for file in files], axis=0),
    )


def prepared(
    files: Sequence[FactorFile], robot: RobotDescription, settings: Settings
) -> tuple[list[FactorFile], RobotDescription]:
    """Files of a robot in an order of their own, and the robot with the friction laws to fit: those
    of the description, or joint by joint what most of its recordings asked for, of as many the
    simpler law. Constants of its terms, such as Stribeck's speed, are the medians over the
    recordings that asked for it. Errors as of `require_alike`."""
    require_alike(files, robot)
    files = ordered(files)
    if settings.friction != "choose":
        return files, robot
    chosen = [file.record.model.robot.friction for file in files]
    laws = {
        joint: _usual([laws[joint] for laws in chosen])
        for joint in robot.friction
        if all(joint in laws for laws in chosen)
    }
    return files, robot.changed(friction=dict(robot.friction) | laws)


def _usual(laws: Sequence[Friction]) -> Friction:
    """The most frequent law."""
    kinds = Counter(_terms(law) for law in laws)
    terms = min(kinds, key=lambda kind: (-kinds[kind], len(kind), kind))
    same = [law for law in laws if _terms(law) == terms]
    law = min(same, key=lambda law: law.model_dump_json())
    for term in set(_CURVED).intersection(terms):
        own = [getattr(law, term) for law in same]
        values = {name: median(getattr(part, name) for part in own) for name in _CURVED[term]}
        law = law.changed(**{term: getattr(law, term).changed(**values)})
    return law


def _terms(law: Friction) -> tuple[str, ...]:
    return tuple(name for name, value in law if value is not None)


def _verdicts(files: Sequence[FactorFile]) -> list[Verdict]:
    """Verdicts on recordings, each with its subject; of several without those on information,
    which recordings determine together."""
    several, verdicts = len(files) > 1, list[Verdict]()
    for file in files:
        for record in file.record.verdicts:
            if not several or record.key not in KEYS["the information"]:
                parts = (file.record.log if several else "", record.subject)
                subject = ": ".join(filter(None, parts))
                verdicts.append(Verdict(**record.changed(subject=subject).model_dump()))
    return verdicts


def _remarks(files: Sequence[FactorFile], gains: Sequence[Correction]) -> list[str]:
    """Verdicts that are not good, warnings of the survey, and what factor files do not hold."""
    remarks = [verdict.sentence for verdict in _verdicts(files) if verdict.grade is not Grade.GOOD]
    for file in files:
        remarks += file.record.warnings
        if file.record.model.sensors:
            names = ", ".join(sensor.name for sensor in file.record.model.sensors)
            remarks.append(
                f"{file.record.log}: factor files hold torques alone, so what {names} showed is "
                "not in this fit; identify the recording itself to have it"
            )
    remarks += [
        f"the torque constant of {gain.subject} was corrected as recordings were gathered and "
        "counts as known here: intervals leave its own out"
        for gain in gains
    ]
    return remarks


def _corrections(
    described: RobotDescription, chosen: RobotDescription, files: Sequence[FactorFile]
) -> list[Correction]:
    """Corrections of each recording, and the most frequent friction laws."""
    corrections = [
        correction if correction.log else correction.changed(log=file.record.log)
        for file in files
        for correction in file.record.model.corrections
        if correction.kind not in _OF_FIT
    ]
    for joint, law in chosen.friction.items():
        if law != described.friction[joint]:
            terms = [_terms(file.record.model.robot.friction[joint]) for file in files]
            text = (
                f"the law is now {law_in_words(law)}, no longer "
                f"{law_in_words(described.friction[joint])}: "
                f"{terms.count(_terms(law))} of {len(files)} recordings ask for its terms by "
                "themselves"
            )
            corrections.append(Correction(kind="friction", subject=joint, text=text))
    return corrections


def _torque_constants(files: Sequence[FactorFile]) -> list[Correction]:
    """Torque constants that were corrected consistently in all recordings, of each the surest; a
    RecordingError where one was in some only, or by factors that exclude each other."""
    gains: dict[str, list[tuple[FactorFile, Correction]]] = {}
    for file in files:
        for correction in file.record.model.corrections:
            if correction.kind == "gain":
                gains.setdefault(correction.subject, []).append((file, correction))
    surest = list[Correction]()
    for drive, corrections in sorted(gains.items()):
        (first, gain), *others = corrections
        how = [
            f"by {gain.value:.4g}, and in {file.where} by {correction.value:.4g}"
            for file, correction in others
            if _exclude(gain, correction)
        ]
        corrected = [file for file, _ in corrections]
        how += [f"and in {file.where} it was not" for file in files if file not in corrected]
        if how:
            raise RecordingError(
                f"the torque constant of {drive} was corrected in this recording, {how[-1]}",
                where=first.where,
                cure="identify the recordings themselves together, or write the constant into the "
                "description and gather them again",
            )
        surest.append(
            min(
                (fix for _, fix in corrections),
                key=lambda fix: (fix.high or 0.0) - (fix.low or 0.0),
            )
        )
    return surest


def _exclude(first: Correction, second: Correction) -> bool:
    """Whether their intervals have nothing in common."""
    if None in (first.low, first.high, second.low, second.high):
        return first.value != second.value
    return (first.high or 0.0) < (second.low or 0.0) or (second.high or 0.0) < (first.low or 0.0)
