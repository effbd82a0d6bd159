"""Triangular factors of a recording's rows, whole and in groups; the record of a factor file, and
its brief for fits of many recordings."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from deltaid.estimation.information import triangle
from deltaid.model.corrections import Correction, Source
from deltaid.model.record import IdentifiedModel
from deltaid.model.verdict import Verdict
from deltaid.recording.carried import Load
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.part import Part

# Version of the file; increases with any change that older programs would misread.
FORMAT = 1

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True, eq=False)
class FactorGroups:
    """Groups of samples: for each drive an upper triangular R with RᵀR = [G_i, τ_i]ᵀ[G_i, τ_i] over
    its columns."""

    names: tuple[str, ...]  # 'whole', 'geometry', 'time 3', 'place 2 0 1'
    factors: tuple[Float[np.ndarray, "groups _ _"], ...]  # of each drive; τ is the last column
    samples: Float[np.ndarray, "groups drives"]  # number of samples of each
    torque_max: Float[np.ndarray, "groups drives"]  # largest |τ| of each

    @classmethod
    def of_rows(
        cls,
        names: Sequence[str],
        rows: Sequence[Float[np.ndarray, "groups _ _"]],
        samples: Float[np.ndarray, "groups drives"],
        torque_max: Float[np.ndarray, "groups drives"],
    ) -> "FactorGroups":
        padded = (np.pad(A, ((0, 0), (0, max(A.shape[2] - A.shape[1], 0)), (0, 0))) for A in rows)
        return cls(tuple(names), tuple(map(triangle, padded)), samples, torque_max)

    def __len__(self) -> int:
        return len(self.names)

    def named(self, first: str) -> "FactorGroups":
        """Groups whose names begin with a word."""
        kept = [k for k, name in enumerate(self.names) if name.startswith(first)]
        return FactorGroups(
            tuple(self.names[k] for k in kept),
            tuple(R[kept] for R in self.factors),
            self.samples[kept],
            self.torque_max[kept],
        )

    def joined(self, other: "FactorGroups") -> "FactorGroups":
        """Append the groups of the other."""
        return FactorGroups(
            self.names + other.names,
            tuple(map(np.concatenate, zip(self.factors, other.factors, strict=True))),
            np.concatenate([self.samples, other.samples]),
            np.concatenate([self.torque_max, other.torque_max]),
        )

    def summed(self, members: Mapping[str, Sequence[int]]) -> "FactorGroups":
        """Merge groups under new names; a group that stays alone keeps every bit."""
        each = [list(places) for places in members.values()]
        factors = (
            [R[k[0]] if len(k) == 1 else triangle(R[k].reshape(-1, R.shape[2])) for k in each]
            for R in self.factors
        )
        return FactorGroups(
            tuple(members),
            tuple(map(np.stack, factors)),
            samples=np.stack([self.samples[places].sum(axis=0) for places in each]),
            torque_max=np.stack([self.torque_max[places].max(axis=0) for places in each]),
        )

    @property
    def rounded(self) -> "FactorGroups":
        """The groups with factors rounded to seven digits."""
        return replace(
            self, factors=tuple(R.astype(np.float32).astype(float) for R in self.factors)
        )


def entries_of(R: Float[np.ndarray, "groups n n"]) -> Float[np.ndarray, "groups entries"]:
    """Entries of upper triangles, row by row."""
    return R[:, *np.triu_indices(R.shape[1])]


def triangles_of(entries: Float[np.ndarray, "groups entries"]) -> Float[np.ndarray, "groups n n"]:
    """Upper triangles of n(n + 1)/2 entries each."""
    n = math.isqrt(2 * entries.shape[1])
    R = np.zeros((len(entries), n, n))
    R[:, *np.triu_indices(n)] = entries
    return R


class KnownLag(Part):
    """A drive's lag [s]: the corrected delay, and the estimate of the remaining lag from other
    rows, with its standard deviation."""

    drive: str
    delay: float
    beside: float = 0.0
    deviation: float | None = None


class GatheredLoad(Part):
    """A held load, and its parameters that were subtracted from the torques."""

    load: Load
    taken: tuple[float, ...]


class Temperature(Part):
    """A recorded temperature [°C]."""

    mean: float
    low: float
    high: float


class RecordingFacts(Part):
    """Facts of a recording that its factor file and its brief hold.

    Attributes:
        noise: residual of each drive's filtered torque in its own fit [N m or N].
        fastest: largest speed of each drive [rad/s or m/s].
        first: stamp of the first row [s].
        warnings: of its survey, in addition to verdicts.
    """

    noise: tuple[float, ...]
    fastest: tuple[float, ...]
    first: float
    loads: tuple[GatheredLoad, ...] = ()
    verdicts: tuple[Verdict, ...] = ()
    warnings: tuple[str, ...] = ()


class FactorRecord(RecordingFacts):
    """Inputs of a recording's factors, and its own identification.

    Attributes:
        robot, model: the description when the recording was gathered, and its own identification,
            without friction curves and posterior.
        names: of the gathered columns.
        felt: indices of each drive's columns.
        quantities: with tolerances, whose effects are in the rows.
        last: stamp of the last row [s].
    """

    format: Annotated[int, Field(ge=1, le=FORMAT)] = FORMAT
    deltaid: str
    robot: RobotDescription
    model: IdentifiedModel
    names: tuple[str, ...]
    felt: tuple[tuple[int, ...], ...]
    quantities: tuple[str, ...] = ()
    last: float
    reach: Box
    lags: tuple[KnownLag, ...] = ()
    temperature: Temperature | None = None

    @property
    def log(self) -> str:
        return self.model.sources[0].log

    @property
    def sha256(self) -> str:
        return self.model.sources[0].sha256

    @property
    def rows(self) -> str:
        return self.model.sources[0].rows


class RecordingBrief(RecordingFacts):
    """Data of a recording in addition to its factors.

    Attributes:
        path: of its factor file; empty if it is not written yet.
        friction: laws of its own identification, by joint.
        rms, rms_unfiltered: residual torques of its own fit [N m or N].
        samples: filtered samples, mean over the drives.
        sensors: recorded sensors, which factors do not contain.
        masses: of its loads by its own identification [kg].
        degrees: mean recorded temperature [°C].
    """

    source: Source
    path: str = ""
    friction: dict[str, Friction]
    rms: tuple[float, ...]
    rms_unfiltered: tuple[float, ...]
    samples: float
    masses: dict[str, float]
    sensors: tuple[str, ...] = ()
    corrections: tuple[Correction, ...] = ()
    degrees: float | None = None

    @property
    def log(self) -> str:
        return self.source.log

    @property
    def sha256(self) -> str:
        return self.source.sha256

    @property
    def where(self) -> str:
        """The factor file, or the recording, for messages."""
        return self.path or self.log

    @property
    def held(self) -> float:
        """Largest held mass [kg]; for a load without a declared mass, the identified one."""
        return max(
            (self.masses.get(load.load.name, load.load.mass or 0.0) for load in self.loads),
            default=0.0,
        )
