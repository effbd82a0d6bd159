"""Background jobs: the command line in a separate process, observable and cancellable."""

import asyncio
import contextlib
import os
import signal
import sys
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Literal

from deltaid.errors import DeltaidError, visible
from deltaid.studio.folder import Folder
from deltaid.studio.runs import FinishedRun, keep_inputs, write_record
from deltaid.studio.steps import Step

State = Literal["running", "done", "failed", "cancelled"]

# Environment variable that makes a command report its stages on standard error, one per line.
PROGRESS = "DELTAID_PROGRESS"
_MARK = "progress: "
# Commands that print JSON for the studio.
_WITH_JSON = ("check", "fit", "validate", "excite", "simulate", "forces")
# Runs under the name of the displayed command, which pages print.
_ENTRY = "import sys; sys.argv[0] = 'deltaid'; from deltaid.cli import main; main()"
# Time for a command or an open page to end before it is killed [s].
GRACE = 2
_WINDOWS = sys.platform == "win32"


@dataclass
class Job:
    """A step that runs, or has run.

    Attributes:
        stages: reported stages, the newest last.
        said: its warnings and errors.
        run: its record, once it has ended.
    """

    step: Step
    folder: Folder
    place: str
    of: str = ""
    robot: str = ""
    state: State = "running"
    stages: list[str] = field(default_factory=list[str])
    said: str = ""
    began: datetime = field(default_factory=lambda: datetime.now(UTC))
    run: FinishedRun | None = None
    _process: asyncio.subprocess.Process | None = None

    @property
    def seconds(self) -> float:
        """Seconds since it began."""
        return (datetime.now(UTC) - self.began).total_seconds()

    @property
    def error(self) -> str:
        """Its message if it failed or was cancelled: what, where and the fix."""
        if self.state == "failed":
            return error_in(self.said)
        return "cancelled" if self.state == "cancelled" else ""

    def fail(self, error: DeltaidError) -> None:
        """Fail with an error of the studio itself."""
        if self.state != "cancelled":
            self.state = "failed"
        self.said += f"error: {error}\n"

    async def go(self) -> None:
        """Run it to its end.

        Raises:
            DeltaidError: its files cannot be copied into its folder.
        """
        inputs = await asyncio.to_thread(keep_inputs, self.folder, self.place, self.step)
        more = ("--json",) if self.step.kind in _WITH_JSON else ()
        # Absolute paths, because the command runs in another folder.
        places = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
        modules = {"PYTHONPATH": os.pathsep.join(map(os.path.abspath, places))}
        self._process = await asyncio.create_subprocess_exec(
            sys.executable, "-P", "-c", _ENTRY, *self.step.arguments, *more,
            cwd=self.folder.root,
            env=os.environ | {PROGRESS: "lines", "PYTHONIOENCODING": "utf-8"} | modules,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=not _WINDOWS,
            limit=1 << 24,
        )  # fmt: skip
        if self.state == "cancelled":
            self._tell(signal.SIGTERM)
        assert self._process.stdout is not None
        assert self._process.stderr is not None
        reading = asyncio.create_task(self._process.stdout.read())
        async for line in self._process.stderr:
            text = visible(line.decode("utf-8", "replace").rstrip("\r\n"))
            if text.startswith(_MARK):
                self.stages.append(text.removeprefix(_MARK))
            else:
                self.said += text + "\n"
        out = (await reading).decode("utf-8", "replace")
        run = FinishedRun(
            folder=self.place,
            kind=self.step.kind,
            command=self.step.command,
            python=self.step.python,
            version=version("deltaid"),
            began=self.began.isoformat(timespec="seconds"),
            seconds=round(self.seconds, 1),
            exit=await self._process.wait(),
            inputs=inputs,
            of=self.of,
            robot=self.robot,
        )
        if self.state != "cancelled":
            self.state = "done" if run.succeeded else "failed"
        await asyncio.to_thread(write_record, self.folder, run, out, self.said)
        self.run = run

    async def cancel(self) -> None:
        """End the command and its children; files in progress do not appear."""
        if self.state != "running":
            return
        self.state = "cancelled"
        if self._process is None:  # `go` cancels it once its process has begun
            return
        self._tell(signal.SIGTERM)
        try:
            await asyncio.wait_for(self._process.wait(), GRACE)
        except TimeoutError:
            self._tell(signal.SIGTERM if _WINDOWS else signal.SIGKILL)

    def _tell(self, number: signal.Signals) -> None:
        assert self._process is not None
        with contextlib.suppress(ProcessLookupError):
            if _WINDOWS:
                self._process.kill()
            else:
                os.killpg(self._process.pid, number)


def error_in(said: str) -> str:
    """The error among a command's messages; for a defect of the program, one sentence."""
    start = said.rfind("error: ")
    if start >= 0 and (start == 0 or said[start - 1] == "\n"):
        return said[start + len("error: ") :].strip()
    if "Traceback" in said:
        last = said.strip().splitlines()[-1]
        return f"a defect of deltaid ({last})\n  → please report it, with messages.txt of this run"
    return said.strip() or "it was ended from outside"
