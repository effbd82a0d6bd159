"""Verdicts as a tuple that knows its robot and recordings, and applies its cures."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from deltaid.check.mended import Data, changes, files_of, mended, to_paste, written_out
from deltaid.dynamics.dynamics import compiled
from deltaid.effects.all import EFFECTS
from deltaid.effects.effect import DescribedEffect
from deltaid.errors import DeltaidError
from deltaid.model.verdict import Grade, Verdict, worst
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording
from deltaid.recording.opening import resolved_table
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import described_in, parse, yaml_text
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
            proposed = changes(self, file)
            data = self._robot() if file == "robot" else self._mapping()
            title = "the robot file" if file == "robot" else "the mapping of columns"
            lines = yaml_text(to_paste(mended(data, proposed), proposed)).rstrip()
            parts.append(f"# into {title}\n{lines}")
        return "\n".join(parts)

    def cured_columns(self) -> ColumnMapping:
        """The mapping of columns with all that is proposed, to be given as `columns=`.

        Nothing is cured unasked: look at `cures` first.

        Raises:
            DeltaidError: there is not one recording, whose mapping could be meant.
        """
        text = yaml_text(mended(self._mapping(), changes(self, "mapping")))
        return parse(text, ColumnMapping, where="cured mapping").of("cured mapping")

    def cured_robot(self) -> RobotDescription:
        """The description with all that is proposed.

        Raises:
            DeltaidError: the file does not describe a robot, or what is proposed does not fit.
        """
        text = yaml_text(mended(self._robot(), changes(self, "robot")))
        return described_in(text, "cured robot")

    def _robot(self) -> Data:
        if self.robot is None:
            raise DeltaidError(
                "there is no robot to be cured: its file does not describe one",
                where="verdicts",
                cure="`deltaid check ROBOT --write FILE` writes a cured file",
            )
        return self.robot.model_dump(mode="json", exclude_none=True)

    def _mapping(self) -> Data:
        if self.robot is None or len(self.sources) != 1:
            raise DeltaidError(
                f"a mapping is cured with one recording, and there are {len(self.sources)}",
                where="verdicts",
                cure="ask for the verdicts on each recording by itself",
            )
        kinematics = compiled(self.robot).kinematics
        table, columns, mapping = resolved_table(self.sources[0], kinematics, self.mappings[0])
        linear = tuple(self.robot.is_linear(drive) for drive in self.robot.drives)
        return written_out(mapping, table, columns, linear)
