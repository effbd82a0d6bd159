"""Verdicts with their robot and recordings, and their proposals: applied to a description or a
mapping, or written as lines to paste."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from deltaid.checks.evidence import Evidence, evidence
from deltaid.effects.all import EFFECTS
from deltaid.effects.effect import DescribedEffect
from deltaid.errors import DeltaidError
from deltaid.model.record import IdentifiedModel
from deltaid.model.verdict import FILES, File, Grade, Verdict, worst
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import Recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import (
    RobotLike,
    catalogue,
    catalogue_text,
    described_in,
    holds_a_model,
    load_robot,
    parse,
    plain_data,
    read_text,
    yaml_text,
)
from deltaid.robot.yaml_edit import edited, steps_of, with_changes
from deltaid.shown import Reported, Shown, Tabled

Changes = dict[str, object]
Data = dict[str, Any]
# Files in words, for the comment above lines to paste.
_IN_WORDS: dict[File, str] = {"robot": "the robot file", "mapping": "the mapping of columns"}

# All keys of verdicts by subject, in the order of docs/check.md; effects have their own.
KEYS = {
    "the description": (
        "length-unit", "friction", "limits", "gravity", "prior-scale", "measured-scale",
        "workspace", "torque-limit", "friction-scale", "gear-stiffness",
    ),
    "units and wiring": (
        "drive-count", "time-unit", "angle-unit", "torque-unit", "velocity-unit", "gear",
        "angle-sign", "torque-sign", "drive-order", "homing-or-tilt", "velocity",
    ),
    "the signals": (
        "rate", "encoder-step", "clock", "saturation", "frozen-torque", "standing", "torque-noise",
        "torque-step", "resonance", "torque-lag", "closed-loop",
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
    """Verdicts on a robot and its recordings, in the order of the checks.

    Attributes:
        robot: the description; None where the file does not describe a robot.
        given: the robot as it was given, such as a file; None where nothing is known of it.
        sources: the recordings.
        mappings: of their columns, as they were given or found; None for default names.
        warnings: of reading the recordings, whose cause no verdict reports.
    """

    robot: RobotDescription | None
    given: RobotLike | None
    sources: tuple[Path | Recording, ...]
    mappings: tuple[ColumnMapping | None, ...]
    warnings: tuple[str, ...]

    def __new__(
        cls,
        verdicts: Iterable[Verdict] = (),
        robot: RobotDescription | None = None,
        sources: Sequence[Path | Recording] = (),
        mappings: Sequence[ColumnMapping | None] = (),
        given: RobotLike | None = None,
        warnings: Sequence[str] = (),
    ) -> "Verdicts":
        """Verdicts with their robot, recordings, mappings and warnings."""
        new = super().__new__(cls, verdicts)
        new.robot, new.sources, new.mappings = robot, tuple(sources), tuple(mappings)
        new.given, new.warnings = robot if given is None else given, tuple(warnings)
        return new

    @property
    def grade(self) -> Grade:
        """The most severe one."""
        return worst(self)

    @property
    def poor(self) -> tuple[Verdict, ...]:
        """Those that are not good, the most severe first."""
        grades = [grade for grade in reversed(Grade) if grade is not Grade.GOOD]
        return tuple(verdict for grade in grades for verdict in self if verdict.grade is grade)

    def noted(self, model: IdentifiedModel) -> IdentifiedModel:
        """The model with the keys of wrong verdicts, undecided ones, and the unexplained share."""
        wrong = dict.fromkeys(verdict.key for verdict in self if verdict.grade is Grade.WRONG)
        undecided = (verdict.sentence for verdict in self if verdict.grade is Grade.CANNOT_TELL)
        residuals = [verdict.number or 0.0 for verdict in self.poor if verdict.key == "residual"]
        share = max((0.01 * number for number in residuals), default=0.0)
        return model.changed(wrong=tuple(wrong), undecided=tuple(undecided), unexplained=share)

    @property
    def cures(self) -> str:
        """Proposed lines for the mapping and the robot file, to read or to paste."""
        return "\n".join(lines for lines, _ in self.cured_files().values())

    def cured_files(self) -> dict[File, tuple[str, str]]:
        """Lines to paste, and the whole text, of each file that the verdicts propose to change.

        Without the mapping if recordings have different ones.

        Raises:
            DeltaidError: a file cannot be read any more.
        """
        files = dict[File, tuple[str, str]]()
        for file in files_of(self):
            wanted = changes(self, file)
            if file == "robot" and self.given is not None:
                data, text = as_written(self.given), robot_text(self.given, wanted)
            elif file == "mapping" and self._share_a_mapping:
                record = self._recorded
                data, text = record.written_mapping, mapping_text(record, wanted)
            else:
                continue
            files[file] = f"# into {_IN_WORDS[file]}\n{pasted(data, wanted)}", text
        return files

    def cured_columns(self) -> ColumnMapping:
        """The mapping of columns with all proposals applied, to pass as `columns=`.

        Read `cures` first.

        Raises:
            DeltaidError: there is no recording, or recordings have different mappings.
        """
        text = yaml_text(with_changes(self._recorded.written_mapping, changes(self, "mapping")))
        return parse(text, ColumnMapping, where="cured mapping").known_as("cured mapping")

    def cured_robot(self) -> RobotDescription:
        """The description with all proposals applied.

        Raises:
            DeltaidError: the file does not describe a robot, or the proposals do not fit.
        """
        if not (proposed := changes(self, "robot")):
            return self._described
        corrected = with_changes(as_written(self._described), proposed)
        return described_in(yaml_text(corrected), "corrected robot")

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
    def _share_a_mapping(self) -> bool:
        return 0 < len(self.mappings) == self.mappings.count(self.mappings[0])

    @property
    def _recorded(self) -> Evidence:
        if not self._share_a_mapping:
            raise DeltaidError(
                f"a mapping is corrected that recordings share, and here are {len(self.sources)}",
                where="verdicts",
                cure="check each recording alone",
            )
        return evidence(self._described, self.sources[0], self.mappings[0])


def files_of(verdicts: Iterable[Verdict]) -> tuple[File, ...]:
    """The files that verdicts propose to change."""
    named = {proposal.file for verdict in verdicts for proposal in verdict.proposals}
    return tuple(file for file in FILES if file in named)


def changes(verdicts: Iterable[Verdict], file: File) -> Changes:
    """All proposals for one file; of two values for a key the first."""
    proposals = [p for verdict in verdicts for p in verdict.proposals if p.file == file]
    pairs = [pair for proposal in proposals for pair in proposal.changes]
    first = dict(reversed(pairs))
    return {key: first[key] for key, _ in pairs}


def as_written(robot: RobotLike) -> Data:
    """A description as the plain data of its file, even with impossible numbers.

    Raises:
        DescriptionError: the robot does not exist, or its file is no mapping of keys.
    """
    if isinstance(robot, str | Path) and str(robot) not in catalogue() and os.path.exists(robot):
        text = read_text(Path(robot))
        if not holds_a_model(text):
            return plain_data(text, str(robot))
    return load_robot(robot).model_dump(mode="json", exclude_none=True)


def robot_text(robot: RobotLike, proposed: Changes) -> str:
    """A description's file with proposals applied; all other lines stay.

    Raises:
        DescriptionError: the robot does not exist, or its file is no mapping of keys.
    """
    wanted = with_changes(as_written(robot), proposed)
    if isinstance(robot, str | Path):
        name = str(robot)
        text = catalogue_text(name) if name in catalogue() else read_text(Path(robot))
        if not holds_a_model(text):
            return edited(text, proposed, wanted, name)
    return yaml_text(wanted)


def mapping_text(record: Evidence, proposed: Changes) -> str:
    """A recording's mapping with proposals applied; all other lines of its file stay.

    Args:
        record: the recording with its mapping.
        proposed: values by path.

    Raises:
        DescriptionError: the file cannot be read, or is not YAML.
    """
    wanted, path = with_changes(record.written_mapping, proposed), Path(record.mapping.source)
    if not path.is_file():
        return yaml_text(wanted)
    return edited(read_text(path), proposed, wanted, str(path))


def pasted(data: Data, proposed: Changes) -> str:
    """Proposals for plain data, as YAML lines to paste into its file: only the changed keys, lists
    whole."""
    changed = with_changes(data, proposed)
    return yaml_text(_parts(changed, [steps_of(path) for path in proposed])).rstrip()


def _parts(value: Any, paths: Sequence[list[Any]]) -> Any:
    """Those parts of mappings in mappings that paths of keys lead to."""
    if not isinstance(value, dict) or [] in paths:
        return value
    return {
        key: _parts(value[key], [path[1:] for path in paths if path[0] == key])
        for key in dict.fromkeys(path[0] for path in paths)
        if key in value
    }
