"""The few words of a factor file that a fit of many recordings needs of each: no numbers that add
up, and not the recording's own model."""

from deltaid.fleets.factor_record import FactorRecord, GatheredLoad, SeenVerdict
from deltaid.model.corrections import Correction, Source
from deltaid.robot.friction import Friction
from deltaid.robot.part import Part


class RecordingBrief(Part):
    """What is said of a recording beside its factors.

    Attributes:
        path: of its factor file; empty for what has been gathered just now.
        friction: laws that it asks for by itself, by joint.
        rms, rms_unfiltered: residual torques of its own fit [N m or N].
        samples: filtered samples, in the mean over the drives.
        sensors: of which factors hold nothing.
        masses: of its loads as it identifies them by itself [kg].
        noise, fastest, first, loads, verdicts, warnings: as of `FactorRecord`.
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
    noise: tuple[float, ...]
    fastest: tuple[float, ...]
    first: float
    loads: tuple[GatheredLoad, ...] = ()
    degrees: float | None = None
    verdicts: tuple[SeenVerdict, ...] = ()
    warnings: tuple[str, ...] = ()

    @classmethod
    def of_record(cls, record: FactorRecord, path: str, samples: float) -> "RecordingBrief":
        """That of a factor file's record."""
        model = record.model
        temperature = record.temperature
        return cls.model_construct(
            source=model.sources[0],
            path=path,
            friction=dict(model.robot.friction),
            rms=tuple(model.fit.rms),
            rms_unfiltered=tuple(model.fit.rms_unfiltered),
            samples=samples,
            sensors=tuple(sensor.name for sensor in model.sensors),
            masses={load.name: load.parameters[0].value for load in model.loads},
            corrections=tuple(model.corrections),
            noise=record.noise,
            fastest=record.fastest,
            first=record.first,
            loads=record.loads,
            degrees=None if temperature is None else temperature.mean,
            verdicts=record.verdicts,
            warnings=record.warnings,
        )

    @property
    def log(self) -> str:
        """Name of the recording."""
        return self.source.log

    @property
    def sha256(self) -> str:
        """Checksum of the recording."""
        return self.source.sha256

    @property
    def where(self) -> str:
        """The factor file, or the recording, for messages."""
        return self.path or self.log

    @property
    def held(self) -> float:
        """Largest mass held [kg]; the identified one of a load without a declared mass."""
        masses = [self.masses.get(load.load.name, load.load.mass or 0.0) for load in self.loads]
        return max(masses, default=0.0)
