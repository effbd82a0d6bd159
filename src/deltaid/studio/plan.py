"""The studio's notes on its folder: `studio.yaml`, small and readable."""

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Literal

from pydantic import Field

from deltaid.errors import DeltaidError
from deltaid.model.record import Settings
from deltaid.robot.load import catalogue, parse, yaml_text
from deltaid.robot.part import Part
from deltaid.studio.folder import Folder, stamp

FILE = "studio.yaml"


class Used(Part):
    """A recording and its purpose."""

    file: str
    mapping: str | None = Field(default=None, description="file that maps the columns")
    use: Literal["fit", "verify", "aside"] = "fit"


class Plan(Part):
    """The studio's notes on the files of its folder."""

    robot: str | None = Field(default=None, description="catalogue name, or a file of the folder")
    recordings: tuple[Used, ...] = ()
    settings: Settings = Settings()
    force: bool = False
    checked: object = Field(default=None, exclude=True, description="key of earlier versions")
    model: str | None = Field(default=None, description="model file in use")
    names: dict[str, str] = Field(
        default_factory=dict[str, str], description="names of runs, by their folder"
    )

    @property
    def fitted(self) -> tuple[Used, ...]:
        """Recordings that the fit uses."""
        return tuple(recording for recording in self.recordings if recording.use == "fit")

    @property
    def verified(self) -> Used | None:
        """The recording that verifies the model."""
        return next((recording for recording in self.recordings if recording.use == "verify"), None)

    @property
    def used(self) -> tuple[Used, ...]:
        """Recordings of the fit, then the one that verifies."""
        return (*self.fitted, *((self.verified,) if self.verified else ()))

    def with_recording(self, used: Used) -> "Plan":
        """The plan with a recording added or replaced; at most one verifies."""
        others = {
            recording.file: recording.changed(use="fit")
            if used.use == recording.use == "verify"
            else recording
            for recording in self.recordings
        }
        return self.changed(recordings=tuple((others | {used.file: used}).values()))


class Store:
    """The plan of a folder on disk, read before each change so that no change is lost.

    All tabs of a server share one store. `look` detects changes by other programs.

    Attributes:
        plan: as last read.
        changes: of plan, files or jobs so far; each by the page that already shows it, or empty.
            Pages redraw when there are more.

    Raises:
        DeltaidError: studio.yaml is no valid plan.
    """

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.changes: list[str] = []
        self._seen = self._stamp()
        self.plan = self._read()

    def change(self, edit: Callable[[Plan], Plan]) -> None:
        """Change the plan on disk, and redraw all pages.

        Raises:
            DeltaidError: the change is not valid, or cannot be written.
        """
        text = self.folder.text(FILE) if self.folder.has(FILE) else None
        before = _parsed(text or "")
        after = edit(before)
        if after != before or text is None:
            data = after.model_dump(mode="json", exclude_defaults=True)
            self.folder.write(FILE, _HEADER + (yaml_text(data) if data else ""), instead_of=text)
        self.plan = after
        self.redraw()

    def redraw(self, shown_by: str = "") -> None:
        """Redraw all pages, except the one that already shows the change."""
        self._seen = self._stamp()
        self.changes.append(shown_by)

    def look(self) -> None:
        """Redraw all pages if another program has changed a file."""
        if (stamps := self._stamp()) != self._seen:
            self._seen = stamps
            with suppress(DeltaidError):  # while it is edited by hand: the last valid plan holds
                self.plan = self._read()
                self.redraw()

    def _read(self) -> Plan:
        return _parsed(self.folder.text(FILE) if self.folder.has(FILE) else "")

    def _stamp(self) -> tuple[object, ...]:
        return self.folder.root.is_dir(), *(
            (path.name, stamp(path)) for path in self.folder.files()
        )


_HEADER = "# What `deltaid studio` remembers of this folder. It may be edited, or deleted.\n"


def _parsed(text: str) -> Plan:
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return parse(text, Plan, where=FILE) if lines else Plan()


def digest(folder: Folder, plan: Plan) -> str:
    """Digest of all inputs of `deltaid check`."""
    used = [(recording.file, recording.mapping) for recording in plan.used]
    inputs: list[Any] = [plan.robot, plan.settings.cutoff, plan.settings.keep_all, used]
    robot = [plan.robot] if plan.robot and plan.robot not in catalogue() else []
    texts = (*robot, *(mapping for _, mapping in used if mapping))
    inputs += [folder.text(name) if folder.has(name) else None for name in texts]
    inputs += [stamp(folder.path(file)) if folder.has(file) else None for file, _ in used]
    return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()[:16]
