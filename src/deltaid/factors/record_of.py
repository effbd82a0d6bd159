"""The record that goes with a recording's factors."""

from importlib.metadata import version

import numpy as np

from deltaid.check.identified import Judged
from deltaid.effects.lag_columns import LagColumns
from deltaid.factors.condensed import Condensed
from deltaid.factors.record import (
    FactorRecord,
    GatheredLoad,
    KnownLag,
    SeenVerdict,
    Temperature,
)
from deltaid.identification.assembled import doubts_of_fit
from deltaid.identification.warmth import temperature
from deltaid.mechanism.kinematics import Kinematics
from deltaid.recording.recording import Recording
from deltaid.robot.description import RobotDescription


def record_of(
    robot: RobotDescription, result: Judged, found: Condensed, quantities: tuple[str, ...]
) -> FactorRecord:
    """What was seen, put right and found as a recording was gathered.

    Args:
        robot: as described.
        result: of the recording by itself.
        found: its factors.
        quantities: names of tolerances among these.
    """
    log, repairs = result.recordings[0].log, result.recordings[0].repairs
    low, high = log.reach.tolist()
    return FactorRecord(
        deltaid=version("deltaid"),
        robot=robot,
        model=result.model,
        names=found.names,
        felt=tuple(tuple(own.tolist()) for own in found.felt),
        quantities=quantities,
        noise=tuple(result.model.fit.rms),
        fastest=tuple(_fastest(result)),
        first=float(log.clock.first),
        last=float(log.clock.last),
        reach=(tuple(low), tuple(high)),
        lags=_lags(result),
        loads=tuple(
            GatheredLoad(load=load, taken=taken)
            for load, taken in zip(log.columns.loads, repairs.loads, strict=True)
        ),
        temperature=_temperature(result.recordings[0], result.problem.dynamics.kinematics),
        verdicts=tuple(
            SeenVerdict(
                key=one.key, grade=str(one.grade), subject=one.subject, seen=one.seen,
                cause=one.cause, cure=one.cure, number=one.number, unit=one.unit,
            )
            for one in result.verdicts
        ),
        warnings=_warnings(result),
    )  # fmt: skip


def _warnings(result: Judged) -> tuple[str, ...]:
    """Warnings of the survey: what neither a verdict says nor the fit."""
    others = {one.sentence for one in result.verdicts} | set(doubts_of_fit(result.problem))
    return tuple(text for text in result.model.warnings if text not in others)


def _temperature(recording: Recording, kinematics: Kinematics) -> Temperature | None:
    """Along the recording, where it has a column of it."""
    if recording.log.columns.temperature is None:
        return None
    each = [temperature(recording, w.own) for w in recording.spread(kinematics, _LOOKS)]
    known = np.concatenate(each)
    known = known[np.isfinite(known)]
    if not known.size:
        return None
    return Temperature(mean=float(known.mean()), low=float(known.min()), high=float(known.max()))


def _fastest(result: Judged) -> list[float]:
    """Largest speed of each drive, by the friction curves; zero where it has none."""
    top = {one.joint: max(one.speed) for one in result.model.friction_curves}
    return [float(top.get(drive, 0.0)) for drive in result.model.robot.drives]


def _lags(result: Judged) -> tuple[KnownLag, ...]:
    """What is known of each drive's lag."""
    drives = result.model.robot.drives
    delay = result.recordings[0].repairs.delay or (0.0,) * len(drives)
    known = {
        i: KnownLag(drive=drives[i], delay=delay[i], beside=0.0, deviation=_EXACT)
        for i in range(len(drives))
    }
    for one in result.problem.additions:
        if isinstance(one, LagColumns):
            for group in one.groups:
                if not group.free:
                    continue
                sure = group.deviation if np.isfinite(group.deviation) else None
                for i in group.drives:
                    known[i] = KnownLag(
                        drive=drives[i], delay=delay[i], beside=group.beside, deviation=sure
                    )
    return tuple(known[i] for i in range(len(drives)))


# A lag that the fit has no column for is taken to be what has been put right [s].
_EXACT = 1e-7
# So many windows tell a recording's temperature.
_LOOKS = 12
