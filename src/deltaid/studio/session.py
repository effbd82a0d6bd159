"""State that all tabs of a studio share: the folder, its plan, the running job, cached previews."""

import asyncio
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import lru_cache, partial
from importlib import import_module
from typing import Any, TypeVar

from deltaid.errors import DeltaidError
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, load_robot
from deltaid.studio.edits import incomplete, read
from deltaid.studio.folder import Folder, stamp
from deltaid.studio.jobs import Job
from deltaid.studio.look import REMEMBERED, preview
from deltaid.studio.plan import Plan, Store, Used, digest
from deltaid.studio.runs import FinishedRun, new_run, output, runs
from deltaid.studio.steps import Kind, Step

_Result = TypeVar("_Result")

STAGES: tuple[str, ...] = ("robot", "recording", "check", "fit", "result", "use")


@dataclass(frozen=True)
class FileEdit:
    """A file in an editor: its content when the edit began, and the edited text."""

    before: str
    after: Any


class Session:
    """A studio at work in a folder.

    Attributes:
        job: the step that runs now, or ran last.
        dark: whether pages are dark; None follows the system.
        drafts: edits that are not saved yet, by the name of their file.
        choices: the user's last choices for steps, by the name of the field.
        poses: requested poses of displayed robots.
    """

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.store = Store(folder)
        self.job: Job | None = None
        self.dark: bool | None = None
        self.drafts: dict[str, FileEdit] = {}
        self.choices: dict[str, Any] = {}
        self.poses: dict[tuple[str, str], tuple[float, ...]] = {}
        self._results: dict[tuple[Any, ...], Any] = {}
        self._task: asyncio.Task[None] | None = None
        self._pool: ProcessPoolExecutor | None = None

    @property
    def plan(self) -> Plan:
        """Content of the folder's studio.yaml."""
        return self.store.plan

    @property
    def busy(self) -> bool:
        """Whether a step runs."""
        return self.job is not None and self.job.state == "running"

    def robot(self) -> RobotDescription | DeltaidError | None:
        """The chosen robot, or its error; None if no robot is chosen."""
        name = self.plan.robot
        if name is None:
            return None
        try:
            with self.folder.called_by_name():
                return _described(self.place(name), self.stamped(name))
        except DeltaidError as error:
            return error

    def place(self, robot: str) -> str:
        """Argument for functions from a robot's or model's name: catalogue names stay, files get
        paths."""
        return robot if robot in catalogue() else str(self.folder.path(robot))

    def begin(self, kind: Kind, make: Callable[[str], Step]) -> Job:
        """Start a step in a new folder.

        Raises:
            DeltaidError: another step runs.
        """
        if self.busy:
            raise DeltaidError(
                "a step is still running", where=kind, cure="wait for its end, or cancel it"
            )
        place = new_run(self.folder, kind)
        robot, of = self.plan.robot or "", ""
        if kind in ("check", "fit"):
            of = digest(self.folder, self.plan)
        elif kind == "show":
            of = self.stamped(robot)
        self.job = Job(make(place), self.folder, place, of=of, robot=robot)
        self._task = asyncio.get_running_loop().create_task(self._run(self.job))
        self.store.redraw()
        return self.job

    def last(self, kind: Kind) -> FinishedRun | None:
        """The last successful run of a kind."""
        return next((run for run in runs(self.folder) if run.kind == kind and run.succeeded), None)

    def grade(self) -> str:
        """Grade of the last check if it applies to the present plan, else empty."""
        last = self.last("check")
        if last is None or last.of != digest(self.folder, self.plan):
            return ""
        return str(output(self.folder, last).get("grade", ""))

    async def read_cached(self, function: Callable[..., _Result], *given: Any) -> _Result:
        """Call a function on files in a separate process; the result is cached until they change.

        Raises:
            DeltaidError: as the function, or the process was killed.
        """
        key = (
            function.__name__,
            *map(repr, given),
            *(self.stamped(name) for name in given if isinstance(name, str)),
        )
        if key not in self._results:
            self._results[key] = await self.read(function, *given)
            for oldest in list(self._results)[:-REMEMBERED]:
                del self._results[oldest]
        return self._results[key]

    async def read(self, function: Callable[..., _Result], *given: Any) -> _Result:
        """Call a function in the separate process without the cache."""
        pool, loop = self.warm(), asyncio.get_running_loop()
        try:
            with self.folder.called_by_name():
                return await loop.run_in_executor(pool, partial(function, *given))
        except BrokenProcessPool:  # killed from outside, for example for lack of memory
            if self._pool is pool:
                self._pool = None
            what = "the process that reads files was ended, perhaps for want of memory"
            raise DeltaidError(what, where="studio", cure="load the page again") from None

    def warm(self) -> ProcessPoolExecutor:
        """The pool with the process that reads files, started if it does not run."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
            # Loads the modules of previews in advance, so that the first preview is fast.
            self._pool.submit(import_module, preview.__module__)
        return self._pool

    async def close(self) -> None:
        """End everything that runs."""
        if self.job is not None and self._task is not None:
            await self.job.cancel()
            await asyncio.wait([self._task], timeout=5)
        if self._pool is not None:
            for child in multiprocessing.active_children():  # only the pool's
                child.terminate()
            self._pool.shutdown(cancel_futures=True)

    async def _run(self, job: Job) -> None:
        """Run a job to its end in any case, and put the model of a fit to use."""
        try:
            await job.go()
        except DeltaidError as error:
            job.fail(error)
        finally:
            if job.state == "running":
                what = "was ended by a defect of deltaid"
                job.fail(DeltaidError(what, where=job.step.kind, cure="please report it"))
                self.store.redraw()
        if job.step.kind == "fit" and job.state == "done" and (run := job.run) is not None:
            self.store.change(lambda plan: plan.changed(model=run.file("model.yaml")))
        self.store.redraw()

    def stamped(self, name: str) -> str:
        """Stamp of a file in the folder; empty for anything else."""
        if name in catalogue() or not self.folder.has(name):
            return ""
        return f"{name} {stamp(self.folder.path(name))}"


@lru_cache(1)
def _described(robot: str, _changed: str) -> RobotDescription:
    return load_robot(robot)


def stage_states(session: Session) -> dict[str, str]:
    """State of each stage by name: 'done', 'open', 'wrong' or 'later'."""
    plan, robot = session.plan, session.robot()
    stages: dict[str, str] = dict.fromkeys(STAGES, "later")
    if not isinstance(robot, RobotDescription):
        return stages | {"robot": "open" if robot is None else "wrong"}
    mapped = bool(plan.fitted) and not unmapped(session)
    stages |= {"robot": "done", "recording": "done" if mapped else "open"}
    has_model = plan.model is not None and session.folder.has(plan.model)
    if mapped:
        grade = session.grade()
        stages["check"] = "wrong" if grade == "wrong" else "done" if grade else "open"
        stages["fit"] = "later" if not grade else "done" if has_model else "open"
    if has_model:
        stages |= {"result": "done", "use": "open"}
    return stages


def unmapped(session: Session) -> list[str]:
    """Recordings in use that are missing, or have no complete mapping."""
    return [
        recording.file
        for recording in session.plan.recordings
        if recording.use != "aside" and not _is_mapped(session, recording)
    ]


def _is_mapped(session: Session, used: Used) -> bool:
    robot, folder, name = session.robot(), session.folder, used.mapping
    if name is None or not (folder.has(used.file) and folder.has(name)):
        return False
    if not isinstance(robot, RobotDescription) or draft_key(used) in session.drafts:
        return False
    try:
        return not incomplete(read(folder.text(name), name), tuple(robot.drives))
    except DeltaidError:  # the page of recordings shows the error
        return False


def draft_key(used: Used) -> str:
    """Key of the edited mapping of a recording."""
    return used.mapping or f"{used.file}: new mapping"


def mapping_name(session: Session, file: str) -> str:
    """Name of a new mapping file of a recording."""
    if not session.folder.has("mapping.yaml"):
        return "mapping.yaml"
    return session.folder.free_name(f"mapping-{file.partition('.')[0]}.yaml")


def mapping_of(session: Session, used: Used) -> str | None:
    """Path of a recording's mapping file."""
    return str(session.folder.path(used.mapping)) if used.mapping else None
