"""One recording condensed to triangular factors of its rows, whole and in groups, and the record of
a factor file on it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from pydantic import Field

from deltaid.checks.identify import Judged
from deltaid.effects.lag_columns import LagColumns
from deltaid.identification.assembly import doubts_of_fit
from deltaid.identification.warmth import temperature
from deltaid.mechanism.kinematics import Kinematics
from deltaid.model.record import IdentifiedModel
from deltaid.model.verdict import Grade
from deltaid.recording.carried import Load
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.description import RobotDescription
from deltaid.robot.part import Part

# Version of the file. It counts up with anything that older programs would misread.
FORMAT = 1
# Deviation of a lag without a column in the fit: exactly as corrected [s].
_EXACT = 1e-7
# So many windows of a recording show its temperature.
_WINDOWS = 12

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class FactorGroup:
    """Some samples: for each drive R with RᵀR = [G_i, τ_i]ᵀ[G_i, τ_i] over the columns it feels."""

    name: str  # which samples: 'whole', 'geometry', 'time 3', 'place 2 0 1'
    factors: tuple[Float[np.ndarray, "_ _"], ...]  # upper triangular; τ is the last column
    samples: Float[np.ndarray, " drives"]  # number of samples behind each
    torque_max: Float[np.ndarray, " drives"]  # largest |τ| of each


@dataclass(frozen=True, eq=False)
class FactorGroups:
    """Many groups, packed as a file holds them, unpacked on access: all of a name at once, as
    there are thousands in a year of recordings."""

    names: tuple[str, ...]
    sizes: tuple[int, ...]  # of each drive's triangles
    # upper triangles row by row, one drive after the other
    packed: Float[np.ndarray, "groups packed"]
    samples: Float[np.ndarray, "groups drives"]
    torque_max: Float[np.ndarray, "groups drives"]

    @classmethod
    def pack(cls, groups: Iterable[FactorGroup]) -> "FactorGroups":
        """Groups as a file holds them."""
        groups = tuple(groups)
        return cls(
            tuple(group.name for group in groups),
            tuple(R.shape[1] for R in groups[0].factors),
            np.stack([np.concatenate([packed(R) for R in group.factors]) for group in groups]),
            np.stack([group.samples for group in groups]),
            np.stack([group.torque_max for group in groups]),
        )

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[FactorGroup]:
        beside = (self.samples, self.torque_max)
        for name, factors, *numbers in zip(
            self.names, zip(*self.factors, strict=True), *beside, strict=True
        ):
            yield FactorGroup(name, factors, *numbers)

    def named(self, first: str) -> "FactorGroups":
        """Those whose names begin so."""
        kept = [k for k, name in enumerate(self.names) if name.startswith(first)]
        beside = (array[kept] for array in (self.packed, self.samples, self.torque_max))
        return FactorGroups(tuple(self.names[k] for k in kept), self.sizes, *beside)

    @property
    def factors(self) -> tuple[Float[np.ndarray, "groups _ _"], ...]:
        """Triangles of each drive."""
        ends = np.cumsum([n * (n + 1) // 2 for n in self.sizes])[:-1]
        factors = tuple(np.zeros((len(self), n, n)) for n in self.sizes)
        for R, numbers in zip(factors, np.split(self.packed, ends, axis=1), strict=True):
            rows, columns = np.triu_indices(R.shape[1])
            R[:, rows, columns] = numbers
        return factors


def packed(R: Float[np.ndarray, "rank n"]) -> Float[np.ndarray, " packed"]:
    """An upper triangle row by row; rows beyond the rank are zero."""
    return np.pad(R, ((0, R.shape[1] - len(R)), (0, 0)))[np.triu_indices(R.shape[1])]


@dataclass(frozen=True, eq=False)
class RecordingFactors:
    """Triangular factors of one recording."""

    names: tuple[str, ...]  # of the columns that were gathered
    felt: tuple[Int[np.ndarray, " _"], ...]  # places of those that each drive feels among them
    whole: FactorGroup  # all samples
    groups: FactorGroups  # the same in stretches of time, then by place
    # some samples, with what tolerances of the description do to them before τ, if there are any
    geometry: FactorGroup | None = None


class KnownLag(Part):
    """A drive's lag [s]: corrected already, and known beside that from rows that no fit has, with
    its standard deviation."""

    drive: str
    delay: float
    beside: float = 0.0
    deviation: float | None = None


class GatheredLoad(Part):
    """A load that is held, and its parameters that have been taken out of the torques."""

    load: Load
    taken: tuple[float, ...]


class SeenVerdict(Part):
    """A verdict of the checks, without its proposals."""

    key: str
    grade: Grade
    subject: str = ""
    seen: str
    cause: str = ""
    cure: str = ""
    number: float | None = None
    unit: str = ""


class Temperature(Part):
    """A recorded temperature [°C]."""

    mean: float
    low: float
    high: float


class FactorRecord(Part):
    """Inputs of a recording's factors, and its own identification.

    Attributes:
        robot, model: as described when the recording was gathered, and what this says by itself.
        names: of the gathered columns.
        felt: places of those that each drive feels.
        quantities: that may be off, with what they do to the rows.
        noise: level of each drive's filtered torque that its own fit leaves [N m or N].
        fastest: largest speed of each drive [rad/s or m/s].
        first, last: stamps of the first and last row [s].
        warnings: of its survey, beside verdicts.
    """

    format: Annotated[int, Field(ge=1, le=FORMAT)] = FORMAT
    deltaid: str
    robot: RobotDescription
    model: IdentifiedModel
    names: tuple[str, ...]
    felt: tuple[tuple[int, ...], ...]
    quantities: tuple[str, ...] = ()
    noise: tuple[float, ...]
    fastest: tuple[float, ...]
    first: float
    last: float
    reach: Box
    lags: tuple[KnownLag, ...] = ()
    loads: tuple[GatheredLoad, ...] = ()
    temperature: Temperature | None = None
    verdicts: tuple[SeenVerdict, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def log(self) -> str:
        """Name of the recording."""
        return self.model.sources[0].log

    @property
    def sha256(self) -> str:
        """Checksum of the recording."""
        return self.model.sources[0].sha256


def record_of(
    robot: RobotDescription,
    result: Judged,
    condensed: RecordingFactors,
    quantities: tuple[str, ...],
) -> FactorRecord:
    """The record of a recording that has been gathered: the robot as described, its result by
    itself, its factors, and names of tolerances among these."""
    recording, model = result.recordings[0], result.model
    log, (low, high) = recording.log, recording.log.reach.tolist()
    fastest = {curve.joint: max(curve.speed) for curve in model.friction_curves}
    judged = {verdict.sentence for verdict in result.verdicts} | {*doubts_of_fit(result.problem)}
    loads = zip(log.columns.loads, recording.repairs.loads, strict=True)
    return FactorRecord(
        deltaid=version("deltaid"),
        robot=robot,
        model=model,
        names=condensed.names,
        felt=tuple(tuple(places.tolist()) for places in condensed.felt),
        quantities=quantities,
        noise=tuple(model.fit.rms),
        fastest=tuple(float(fastest.get(drive, 0.0)) for drive in model.robot.drives),
        first=float(log.clock.first),
        last=float(log.clock.last),
        reach=(tuple(low), tuple(high)),
        lags=_lags(result),
        loads=tuple(GatheredLoad(load=load, taken=taken) for load, taken in loads),
        temperature=_temperature(recording, result.problem.dynamics.kinematics),
        verdicts=tuple(
            SeenVerdict(**{key: getattr(verdict, key) for key in SeenVerdict.model_fields})
            for verdict in result.verdicts
        ),
        warnings=tuple(text for text in model.warnings if text not in judged),
    )


def _temperature(recording: PreparedRecording, kinematics: Kinematics) -> Temperature | None:
    if recording.log.columns.temperature is None:
        return None
    windows = recording.spread(kinematics, _WINDOWS)
    T = np.concatenate([temperature(recording, window.own) for window in windows])
    T = T[np.isfinite(T)]
    if not T.size:
        return None
    return Temperature(mean=float(T.mean()), low=float(T.min()), high=float(T.max()))


def _lags(result: Judged) -> tuple[KnownLag, ...]:
    drives = result.model.robot.drives
    delays = result.recordings[0].repairs.lag or (0.0,) * len(drives)
    known = [
        KnownLag(drive=drive, delay=delay, deviation=_EXACT)
        for drive, delay in zip(drives, delays, strict=True)
    ]
    columns = [lags for lags in result.problem.additions if isinstance(lags, LagColumns)]
    for group in (group for lags in columns for group in lags.groups if group.free):
        deviation = group.deviation if np.isfinite(group.deviation) else None
        for i in group.drives:
            known[i] = known[i].changed(beside=group.beside, deviation=deviation)
    return tuple(known)
