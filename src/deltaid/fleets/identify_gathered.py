"""`identify` and `validate` from factor files, without the recordings; verdicts, remarks and
corrections come from the recordings' own identifications."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deltaid.checks.identify import Judged
from deltaid.checks.verdicts import KEYS, Verdicts
from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.load_columns import LoadColumns
from deltaid.errors import RecordingError
from deltaid.estimation.information import Information
from deltaid.fleets.factor_file import FactorFile, require_alike
from deltaid.fleets.factor_record import RecordingBrief
from deltaid.fleets.merged import holding, merging_of, ordered, terms_of
from deltaid.fleets.robot_recordings import RobotRecordings, fitted, merged_files
from deltaid.grouping import grouped
from deltaid.identification.assembly import assembled
from deltaid.identification.friction_constants import freed
from deltaid.identification.judgement import judged_parameters
from deltaid.identification.loads import identified_loads, known_load
from deltaid.identification.torque_error import TorqueError
from deltaid.model.corrections import Correction
from deltaid.model.model import ModelLike, load
from deltaid.model.record import Settings
from deltaid.model.verdict import Grade, Verdict
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction_terms import law_in_words
from deltaid.robot.load import RobotLike, load_robot

# Corrections that the joint fit or `_torque_constants` report.
_OF_FIT = ("friction", "prior", "load", "gain")


def identify_gathered(
    robot: RobotLike, files: Sequence[FactorFile], settings: Settings | None = None
) -> Judged:
    """Identify a robot, with its priors, reductions and measured values, from the factors of its
    recordings, by settings of method, regulariser, γ, prior's spread and friction.

    Corrections of each recording are kept. Friction laws are those of the description, or those
    that most of the recordings chose.

    Raises:
        RecordingError: files do not match each other or the robot.
        IdentificationError: the fit cannot be posed or did not converge.
    """
    settings, description = settings or Settings(), load_robot(robot)
    return identify_merged(merged_files(files, description, settings), description, settings)


def identify_merged(
    recordings: RobotRecordings, description: RobotDescription, settings: Settings
) -> Judged:
    """Identify a robot as `identify_gathered` does, from recordings merged for this description."""
    briefs = ordered(recordings.block.briefs)
    chosen = recordings.merging.dynamics.robot
    gains = _torque_constants(briefs)
    problem = fitted(recordings, chosen, settings)
    judged = judged_parameters(freed(problem))
    model = assembled(
        problem,
        _torque_errors(problem.information, problem.values, briefs),
        judged,
        loads=identified_loads(problem.additions, judged[len(problem.p) :], holding(briefs)),
        corrections=[*_corrections(description, chosen, briefs), *gains],
        sources=tuple(brief.source for brief in briefs),
        remarks=_remarks(briefs, gains),
    )
    verdicts = Verdicts(_verdicts(briefs))
    return Judged(verdicts.noted(model), problem, (), verdicts=verdicts)


def validate_gathered(model: ModelLike, file: FactorFile) -> TorqueError:
    """Torque errors of a model on a recording from its factors, as in `deltaid.validate`.

    The recording's lags are corrected as in its own identification.

    Raises:
        RecordingError: the file is of another mechanism than the model, or holds a load that the
            model lacks.
    """
    identified = load(model)
    require_alike([file], identified.robot)
    merging = merging_of([file.brief], identified.robot, Settings())
    loads = {
        columns.load.name: known_load(columns, identified, file.brief.where)
        for columns in merging.additions
        if isinstance(columns, LoadColumns) and columns.parameters
    }
    return _torque_errors(
        merging.part(file).information,
        np.append(identified.p, merging.of_loads(loads)),
        [file.brief],
    )


def _torque_errors(
    information: Information, values: Parameters, briefs: Sequence[RecordingBrief]
) -> TorqueError:
    """Residual torques of all recordings, with the unfiltered noise of their own fits."""
    rms, torque = information.rms(values), information.torque_rms()
    beyond = [np.square(brief.rms_unfiltered) - np.square(brief.rms) for brief in briefs]
    noise = np.average(beyond, axis=0, weights=[brief.samples for brief in briefs])
    return TorqueError(
        rms=rms,
        nrmse=rms / np.where(torque > 0, torque, 1.0),
        rms_unfiltered=np.sqrt(np.maximum(rms**2 + noise, 0.0)),
        covariance=np.diag(rms**2),
        turning=np.zeros(len(rms)),
        cutoff=briefs[0].source.cutoff_hz,
        fastest=np.max([brief.fastest for brief in briefs], axis=0),
    )


def _verdicts(briefs: Sequence[RecordingBrief]) -> list[Verdict]:
    """Verdicts on recordings, each with its subject; for several recordings without verdicts on
    information, which they determine together."""
    if len(briefs) == 1:
        return list(briefs[0].verdicts)
    return [
        replace(verdict, subject=": ".join(filter(None, (brief.log, verdict.subject))))
        for brief in briefs
        for verdict in brief.verdicts
        if verdict.key not in KEYS["the information"]
    ]


def _remarks(briefs: Sequence[RecordingBrief], gains: Sequence[Correction]) -> list[str]:
    remarks = [verdict.sentence for verdict in _verdicts(briefs) if verdict.grade is not Grade.GOOD]
    for brief in briefs:
        remarks += brief.warnings
        if brief.sensors:
            remarks.append(
                f"{brief.log}: factor files hold torques alone, so what "
                f"{', '.join(brief.sensors)} showed is not in this fit; identify the recording "
                "itself to have it"
            )
    remarks += [
        f"the torque constant of {gain.subject} was corrected as recordings were gathered and "
        "counts as known here: intervals leave its own out"
        for gain in gains
    ]
    return remarks


def _corrections(
    described: RobotDescription, chosen: RobotDescription, briefs: Sequence[RecordingBrief]
) -> list[Correction]:
    corrections = [
        correction if correction.log else correction.changed(log=brief.log)
        for brief in briefs
        for correction in brief.corrections
        if correction.kind not in _OF_FIT
    ]
    corrections += [
        Correction(
            kind="friction",
            subject=joint,
            text=f"the law is now {law_in_words(law)}, no longer "
            f"{law_in_words(described.friction[joint])}: "
            f"{sum(terms_of(brief.friction[joint]) == terms_of(law) for brief in briefs)} of "
            f"{len(briefs)} recordings ask for its terms by themselves",
        )
        for joint, law in chosen.friction.items()
        if law != described.friction[joint]
    ]
    return corrections


def _torque_constants(briefs: Sequence[RecordingBrief]) -> list[Correction]:
    """Torque constants that were corrected consistently in all recordings, each from the most
    certain one. Raises a RecordingError if one was corrected in some only, or by incompatible
    factors."""
    gains = grouped(
        (correction.subject, (brief, correction))
        for brief in briefs
        for correction in brief.corrections
        if correction.kind == "gain"
    )
    surest = list[Correction]()
    for drive, corrections in sorted(gains.items()):
        (first, gain), *others = corrections
        how = [
            f"by {gain.value:.4g}, and in {brief.where} by {correction.value:.4g}"
            for brief, correction in others
            if _exclude(gain, correction)
        ]
        corrected = {brief.sha256 for brief, _ in corrections}
        how += [
            f"and in {brief.where} it was not" for brief in briefs if brief.sha256 not in corrected
        ]
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
    if None in (first.low, first.high, second.low, second.high):
        return first.value != second.value
    return (first.high or 0.0) < (second.low or 0.0) or (second.high or 0.0) < (first.low or 0.0)
