"""What all tabs of a studio share: the folder, its plan, the work that runs, what was looked at."""

import asyncio
import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from deltaid.errors import DeltaidError
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import catalogue, described
from deltaid.studio.edits import incomplete, read
from deltaid.studio.folder import RUNS, Folder, refusing, stamp
from deltaid.studio.jobs import Job
from deltaid.studio.look import Problem, ready, try_look
from deltaid.studio.plan import Checked, Plan, Store, Used
from deltaid.studio.runs import new_run, output
from deltaid.studio.steps import Step, show_step

_Found = TypeVar("_Found")

STAGES = ("robot", "recording", "check", "fit", "result", "use")
# The robot's page, and where its record goes.
VIEW, _DRAWN = f"{RUNS}/robot.html", f"{RUNS}/robot"
# Looks that are remembered.
_REMEMBERED = 40


@dataclass(frozen=True)
class FileEdit:
    """A file as it is being edited: what it held when that began, and what it shall hold."""

    before: str
    after: Any


class Session:
    """A studio at work in a folder.

    Attributes:
        job: the step that runs now, or ran last.
        view: the same for the robot's page.
        dark: how pages look; as the system does where None.
        drafts: what is being edited and is not saved yet, by the name of its file.
        choices: what was chosen for a step last, by the name of the field.
        poses: where the robot that is shown has been moved to.
    """

    def __init__(self, folder: Folder) -> None:
        self.folder = folder
        self.store = Store(folder)
        self.job: Job | None = None
        self.view: Job | None = None
        self.dark: bool | None = None
        self.drafts: dict[str, FileEdit] = {}
        self.choices: dict[str, Any] = {}
        self.poses: dict[tuple[str, str], tuple[float, ...]] = {}
        self._robots: dict[tuple[str, str], RobotDescription | Problem] = {}
        self._seen: dict[tuple[Any, ...], Any] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._pool: ProcessPoolExecutor | None = None

    @property
    def plan(self) -> Plan:
        """What the folder's studio.yaml says."""
        return self.store.plan

    @property
    def busy(self) -> bool:
        """Whether a step runs."""
        return self.job is not None and self.job.state == "running"

    def robot(self) -> RobotDescription | Problem | None:
        """The robot that is picked; what is wrong with it; None as long as none is."""
        name = self.plan.robot
        if name is None:
            return None
        key = (name, self.stamped(name))
        if key not in self._robots:
            self._robots = {key: self._inside(try_look(described, self.place(name)))}
        return self._robots[key]

    def _inside(self, found: _Found | Problem) -> _Found | Problem:
        """The same with files called by their names in the folder."""
        return found.inside(self.folder.root) if isinstance(found, Problem) else found

    def place(self, robot: str) -> str:
        """A robot's or model's name for functions: catalogue names stay, files get their path."""
        return robot if robot in catalogue() else str(self.folder.path(robot))

    def begin(self, kind: str, make: Callable[[str], Step]) -> Job:
        """Begin a step in a folder of its own.

        Raises:
            DeltaidError: another one runs.
        """
        if self.busy:
            raise DeltaidError(
                "a step is still running", where=kind, cure="wait for its end, or cancel it"
            )
        place = new_run(self.folder, kind)
        of = self.store.checked_of() if kind in ("check", "fit") else ""
        self.job = Job(make(place), self.folder, place, of=of, robot=self.plan.robot or "")
        self._start(self.job)
        return self.job

    @property
    def is_shown(self) -> bool:
        """Whether the robot's page is of the robot as it is now, or will be."""
        return self.view is not None and self.view.of == self._robot_now()

    def show(self) -> None:
        """Draw the robot's page.

        Raises:
            DeltaidError: none is picked, another one is being drawn, or no folder can be made.
        """
        robot = self.plan.robot
        if robot is None:
            raise DeltaidError("there is none", where="robot", cure="pick one")
        if self.view is not None and self.view.state == "running":
            raise DeltaidError(
                "cannot be drawn while another robot is", where=robot, cure="wait for its end"
            )
        with refusing(RUNS):
            (self.folder.root / _DRAWN).mkdir(parents=True, exist_ok=True)
        self.view = Job(show_step(robot, VIEW), self.folder, _DRAWN, of=self._robot_now())
        self._start(self.view)

    def _robot_now(self) -> str:
        return f"{self.plan.robot} {self.stamped(self.plan.robot or '')}"

    async def look(self, function: Callable[..., _Found], *given: Any) -> _Found | Problem:
        """A look at files in a process of its own, remembered until they change."""
        key = (
            function.__name__,
            *map(repr, given),
            *(self.stamped(name) for name in given if isinstance(name, str)),
        )
        if key in self._seen:
            return self._seen[key]
        found = await self.glance(function, *given)
        if not (isinstance(found, Problem) and found.passes):
            self._seen[key] = found
        while len(self._seen) > _REMEMBERED:
            del self._seen[next(iter(self._seen))]
        return found

    async def glance(self, function: Callable[..., _Found], *given: Any) -> _Found | Problem:
        """The same, not remembered."""
        pool, asked = self.warm(), partial(try_look, function, *given)
        try:
            found: Any = await asyncio.get_running_loop().run_in_executor(pool, asked)
        except BrokenProcessPool:  # killed from outside, such as for want of memory
            if self._pool is pool:
                self._pool = None
            what = "the process that reads files was ended, perhaps for want of memory"
            return Problem(what, cure="load the page again", passes=True)
        return self._inside(found)

    def warm(self) -> ProcessPoolExecutor:
        """The process that looks at files, begun now if there is none."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"))
            self._pool.submit(try_look, ready)
        return self._pool

    async def close(self) -> None:
        """End all that still runs."""
        for job in filter(None, (self.job, self.view)):
            await job.cancel()
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=5)
        if self._pool is not None:
            for child in multiprocessing.active_children():  # none but the pool's
                child.terminate()
            self._pool.shutdown(cancel_futures=True)

    def _start(self, job: Job) -> None:
        task = asyncio.get_running_loop().create_task(self._run(job))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        self.store.tell()

    async def _run(self, job: Job) -> None:
        """Run a job to an end, whatever comes between; keep what a check or a fit has come to."""
        try:
            await job.go()
        except DeltaidError as error:
            job.fail(error)
        finally:
            if job.state == "running":
                what = "was ended by a defect of deltaid"
                job.fail(DeltaidError(what, where=job.step.kind, cure="please report it"))
                self.store.tell()
        if job.run is not None and job.state == "done":
            run = job.run
            if job.step.kind == "check":
                grade = str(output(self.folder, run).get("grade", ""))
                checked = Checked(of=job.of, grade=grade, run=run.folder)
                self.store.change(lambda plan: plan.changed(checked=checked))
            elif job.step.kind == "fit":
                self.store.change(lambda plan: plan.changed(model=run.file("model.yaml")))
        self.store.tell()

    def stamped(self, name: str) -> str:
        """What a file is now; empty for what is no file of the folder."""
        if name in catalogue() or not self.folder.has(name):
            return ""
        return f"{name} {stamp(self.folder.path(name))}"


def standing(session: Session) -> dict[str, str]:
    """How far each stage is: 'done', 'open', 'wrong' or 'later', by name."""
    plan, robot = session.plan, session.robot()
    found: dict[str, str] = dict.fromkeys(STAGES, "later")
    found["robot"] = "open" if robot is None else "wrong" if isinstance(robot, Problem) else "done"
    if found["robot"] != "done":
        return found
    mapped = bool(plan.fitted) and not unmapped(session)
    found["recording"] = "done" if mapped else "open"
    if mapped:
        grade = plan.checked.grade if plan.checked and session.store.is_checked else ""
        found["check"] = "wrong" if grade == "wrong" else "done" if grade else "open"
        found["fit"] = "open" if grade else "later"
    if plan.model is not None and session.folder.has(plan.model):
        found["fit"] = "done" if found["fit"] == "open" else found["fit"]
        found["result"], found["use"] = "done", "open"
    return found


def unmapped(session: Session) -> list[str]:
    """Recordings in use that are not there, or whose mapping is none yet, or not complete."""
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
    except DeltaidError:  # the page of recordings says why
        return False


def draft_key(used: Used) -> str:
    """The key of what is being edited of a recording's mapping."""
    return used.mapping or f"{used.file}: new mapping"


def mapping_name(session: Session, file: str) -> str:
    """What a new mapping file for a recording is called."""
    if not session.folder.has("mapping.yaml"):
        return "mapping.yaml"
    return session.folder.free_name(f"mapping-{file.partition('.')[0]}.yaml")


def mapping_of(session: Session, used: Used) -> str | None:
    """The path of a recording's mapping file."""
    return str(session.folder.path(used.mapping)) if used.mapping else None
