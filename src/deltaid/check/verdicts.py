"""Verdicts as a tuple that knows its robot and recordings, and applies its cures."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from deltaid.check.evidence import Evidence, evidence
from deltaid.check.mended import as_written, changes, cured_mapping, cured_robot, files_of, pasted
from deltaid.effects.all import EFFECTS
from deltaid.effects.effect import DescribedEffect
from deltaid.errors import DeltaidError
from deltaid.model.verdict import Grade, Verdict, worst
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording
from deltaid.robot.description import RobotDescription
from deltaid.shown import Reported, Shown, Tabled

# Every key that a verdict may have, in the order of docs/check.md, by what it is about; those of
# effects are theirs.
KEYS = {
    "the description": (
        "millimetres", "friction-missing", "limits-missing", "prior-scale", "measured-scale",
        "workspace-cut", "torque-limit",
    ),
    "units and wiring": (
        "angle-unit", "torque-unit", "velocity-unit", "gear", "angle-sign", "torque-sign",
        "drive-order", "homing-or-tilt", "velocity",
    ),
    "the signals": (
        "rate", "encoder-step", "clock", "saturation", "standing", "torque-noise", "torque-step",
        "resonance", "torque-lag", "closed-loop",
    ),
    "the sensors": (
        "sensor-unit", "sensor-sign", "sensor-order", "sensor-frame", "sensor-gain", "sensor-dead",
        "sensor-clipped", "sensor-lag", "sensor-noise", "sensor-residual",
    ),
    "the information": ("base-parameters", "excitation"),
    "the fit": (
        *dict.fromkeys(effect.key for effect in EFFECTS if isinstance(effect, DescribedEffect)),
        "residual",
    ),
    "what cannot be used": ("refused",),
}  # fmt: skip


class Verdicts(Shown, Tabled, Reported, tuple[Verdict, ...]):
    """Verdicts on a robot and its recordings, in the order of what they look at.

    Attributes:
        robot: the description; None where the file does not describe a robot.
        sources: the recordings.
        mappings: of their columns, as they were given.
    """

    robot: RobotDescription | None
    sources: tuple[Path | Recording, ...]
    mappings: tuple[ColumnMapping | None, ...]

    def __new__(
        cls,
        verdicts: Iterable[Verdict] = (),
        robot: RobotDescription | None = None,
        sources: Sequence[Path | Recording] = (),
        mappings: Sequence[ColumnMapping | None] = (),
    ) -> "Verdicts":
        """Verdicts and what they are on."""
        new = super().__new__(cls, verdicts)
        new.robot, new.sources, new.mappings = robot, tuple(sources), tuple(mappings)
        return new

    @property
    def grade(self) -> Grade:
        """The most severe one."""
        return worst(self)

    @property
    def poor(self) -> tuple[Verdict, ...]:
        """Those that are not good, the most severe first."""
        order = list(Grade)
        poor = [verdict for verdict in self if verdict.grade is not Grade.GOOD]
        return tuple(sorted(poor, key=lambda verdict: -order.index(verdict.grade)))

    @property
    def cures(self) -> str:
        """Lines that are proposed for the mapping and for the robot file, to read or to paste."""
        parts = list[str]()
        for file in files_of(self):
            if file == "robot":
                title, data = "the robot file", as_written(self._described)
            else:
                title, data = "the mapping of columns", self._recorded.written_mapping
            parts.append(f"# into {title}\n{pasted(data, changes(self, file))}")
        return "\n".join(parts)

    def cured_columns(self) -> ColumnMapping:
        """The mapping of columns with all that is proposed, to be given as `columns=`.

        Nothing is cured unasked: look at `cures` first.

        Raises:
            DeltaidError: there is not one recording, whose mapping could be meant.
        """
        return cured_mapping(self._recorded, self)

    def cured_robot(self) -> RobotDescription:
        """The description with all that is proposed.

        Raises:
            DeltaidError: the file does not describe a robot, or what is proposed does not fit.
        """
        return cured_robot(self._described, self)

    @property
    def _described(self) -> RobotDescription:
        if self.robot is None:
            raise DeltaidError(
                "there is no robot to be cured: its file does not describe one",
                where="verdicts",
                cure="`deltaid check ROBOT --write FILE` writes a cured file",
            )
        return self.robot

    @property
    def _recorded(self) -> Evidence:
        if self.robot is None or len(self.sources) != 1:
            raise DeltaidError(
                f"a mapping is cured with one recording, and there are {len(self.sources)}",
                where="verdicts",
                cure="ask for the verdicts on each recording by itself",
            )
        return evidence(self.robot, self.sources[0], self.mappings[0])
