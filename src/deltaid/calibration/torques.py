"""Recorded torques as rows of a calibration.

A robot with deviations θ has torques τ = Y p + D θ, D = dτ/dθ at measured drive positions. D joins
the contest of causes with bodies, friction, lags and all other effects of `identify` except those
of geometry, and all of these are profiled out:

    A θ = b,    AᵀA = S,   S = K_θθ − K_θo K_oo⁻¹ K_oθ

with K the normal equations at the residual noise of the contest. The direction of gravity is
unknown too, within the description's tolerance `mounting`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from deltaid.calibration.fit import LITTLE
from deltaid.calibration.unknowns import Number, TorqueRows, Unknowns
from deltaid.checks.evidence import evidence
from deltaid.checks.signal import checked_signals
from deltaid.checks.wiring.wiring import checked_wirings
from deltaid.dynamics.geometry import TorqueSlopes, across, grown_torques
from deltaid.effects.geometry import GearRatios, Lengths, Tilt, Zeros
from deltaid.effects.mounting import Mounting, direction
from deltaid.effects.point import Deviations, TracePoint, UnknownEffect
from deltaid.errors import IdentificationError, RecordingError
from deltaid.estimation.drive_rows import ColumnsOfDrives
from deltaid.identification.contest_stage import contested
from deltaid.identification.contest_sweeps import swept_beside
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.stages import run_stages
from deltaid.model.settings import Settings
from deltaid.model.verdict import Grade, percent
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike
from deltaid.recording.recording import open_recordings
from deltaid.robot.description import RobotDescription


class GeometryNumbers(UnknownEffect):
    """Numbers of a calibration, followed by turns of gravity."""

    name = "calibration"
    is_candidate = False

    def __init__(self, known: Unknowns, mounting: float = Tilt.deviation) -> None:
        self.known, self.mounting = known, mounting

    def columns(self, point: TracePoint) -> ColumnsOfDrives:
        slopes = replace(point.slopes, grown=grown_torques(point.dynamics.robot, mounted=True))
        return point.weighted([
            *(_slope(number, slopes, point) for number in self.known.numbers),
            *(slopes.of_gravity(axis) for axis in across(slopes.gravity)),
        ])  # fmt: skip

    def deviations(self, point: TracePoint, columns: ColumnsOfDrives) -> Deviations:
        spreads = [number.spread for number in self.known.numbers]
        mounting = [self.mounting] * (columns.shape[2] - len(spreads))
        return np.maximum([*spreads, *mounting], np.finfo(float).eps)


def _slope(number: Number, slopes: TorqueSlopes, point: TracePoint) -> np.ndarray:
    if number.kind == "zero":
        return slopes.of_zero(number.limb)
    if number.kind == "scale":
        own, w = np.eye(point.dof)[number.limb], point.motion
        return slopes.of_motion(point.q * own, w.qd * own, w.qdd * own)
    limbs, symbols = point.dynamics.robot.limb_geometry, slopes.grown.symbols
    growth = np.zeros(symbols)
    if number.kind == "half":
        growth[3 * len(limbs)] = 1.0
    elif number.limb >= 0:
        growth = direction(number.kind, number.limb, limbs, symbols)
        growth[3 * number.limb + 1] = number.kind == "upper_arm"
        growth[3 * number.limb + 2] = number.kind == "strut"
    return slopes.of_growth(growth)


def torque_rows(
    robot: RobotDescription, logs: Sequence[RecordingLike], columns: ColumnMapping | None,
    known: Unknowns, progress: Progress,
) -> TorqueRows:  # fmt: skip
    """Rows of recorded torques on a robot's numbers. Raises a RecordingError where a log cannot be
    used or its columns are wrong, an IdentificationError where torques are another robot's."""
    progress("checking the columns of torques")
    doubts = _doubts(robot, logs, columns)
    fields = robot.tolerances.model_fields_set if "tolerances" in robot.model_fields_set else ()
    tilt = robot.tolerances.mounting if "mounting" in fields else Tilt.deviation
    numbers = GeometryNumbers(known, tilt)
    kinematics = Setup(robot, (), Settings()).dynamics.kinematics
    recordings = open_recordings(logs, kinematics, columns, None, progress)
    setup = Setup(robot, tuple(recording.excerpted() for recording in recordings), Settings())
    source = ", ".join(str(recording.path) for recording in recordings)
    refused = partial(
        IdentificationError, where=source, cure="run deltaid check on this recording first"
    )
    rails = (GearRatios.name,) if "scale" in known.kinds else ()
    instead = (Zeros.name, Lengths.name, Mounting.name, Tilt.name, *rails)
    try:
        with np.errstate(divide="ignore", invalid="ignore"):  # drives at rest
            corrected = run_stages(setup, progress, before=contested)
            contest = swept_beside(corrected, numbers, instead)
    except np.linalg.LinAlgError:
        raise refused("no model fits these torques, as where drives stand still") from None
    if contest is None:
        raise refused(
            "no torques are left to calibrate with",
            cure="record longer, without loads that come and go",
        )
    for noise, drive in zip(contest.shrunk.sigma, contest.shrunk.blocks, strict=True):
        if not noise <= LITTLE * drive.largest:  # true for NaN too
            raise refused(f"{percent(noise / drive.largest)} of a drive's torque is unmodelled")
    A, b = contest.shrunk.rows_of(contest.group(numbers.name), len(known.numbers))
    return TorqueRows(source, A, b, doubts=doubts)


def _doubts(
    robot: RobotDescription, logs: Sequence[RecordingLike], columns: ColumnMapping | None
) -> tuple[str, ...]:
    """Doubts of the checks of columns and signals. Raises a RecordingError for a fault.

    Zeros and tilts that leave the loops closed are no fault here: calibration estimates them.
    """
    records = [evidence(robot, log, columns) for log in logs]
    places = [str(record.table.path) for record in records]
    if min(len(record.rows.time) for record in records) < 2:  # `open_recordings` refuses it
        return ()
    for record, where in zip(records, places, strict=True):
        if not record.moved.any():
            raise RecordingError(
                "no drive moves", where=where, cure="record a motion of all drives"
            )
    common, each = checked_wirings(records)
    doubts = dict[str, None]()
    for record, where, wiring in zip(records, places, each, strict=True):
        verdicts = (*common, *wiring, *checked_signals(record))
        wrong = [verdict for verdict in verdicts if verdict.grade is Grade.WRONG]
        if wrong:
            raise RecordingError(
                "; ".join(verdict.finding for verdict in wrong),
                where=where,
                cure="; ".join(dict.fromkeys(verdict.cure for verdict in wrong)),
            )
        doubts |= {
            f"{where}: {verdict.sentence}": None
            for verdict in verdicts
            if verdict.grade is Grade.DOUBTFUL and verdict.key != "homing-or-tilt"
        }
    return tuple(doubts)
