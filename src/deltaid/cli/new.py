"""`deltaid new`: a description of a user's robot, from a few numbers."""

import inspect
import json
import signal
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import deltaid
from deltaid.cli.options import output_file, require_outputs
from deltaid.cli.output import (
    console,
    print_found,
    print_next,
    print_written,
    remark,
    styled,
    write_files,
)
from deltaid.errors import DeltaidError
from deltaid.files import YAML_ENDINGS, require_writable
from deltaid.studio.drafting.questions import KINDS, QUESTIONS, Question

if TYPE_CHECKING:
    from deltaid.studio.drafting.draft import Draft

_TITLES = {
    "lengths": "Lengths and ends", "masses": "Masses", "motors": "Motors", "tool": "Tool",
    "friction": "Friction", "workspace": "Workspace and speed",
}  # fmt: skip


def new(
    file: Annotated[
        Path, typer.Argument(help="Description to write (YAML).", show_default=True)
    ] = Path("my-robot.yaml"),
    kind: Annotated[
        str | None, typer.Option(help=f"Kind of robot: {', '.join(KINDS)}.", metavar="KIND")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option("--from", metavar="ROBOT", help="Robot whose numbers replace missing ones."),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Name of the robot. Default: the name of the file.")
    ] = None,
    title: Annotated[str | None, typer.Option(help="Title of the robot, in words.")] = None,
    yes: Annotated[
        bool, typer.Option("--yes", "-y", help="Ask nothing, and assume missing numbers.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
    report: Annotated[
        Path | None,
        output_file(help="HTML page to write: picture, workspace, reach, condition."),
    ] = None,
    **given: str | None,
) -> None:
    """Describe your robot: answer questions, get a file.

    The command asks for lengths, motors and masses.

    Numbers may have units: 235mm, 0.235, "3 kg cm²", 400rpm. The file marks assumed numbers.
    Without a terminal the command asks nothing.
    """
    if file.suffix.lower() not in YAML_ENDINGS:
        raise DeltaidError("must end in .yaml", where=str(file))
    require_writable(file)
    if not force and file.exists():
        raise DeltaidError(
            "is there already", where=str(file), cure="give another name, or --force to replace it"
        )
    require_outputs([file], {"--report": report})
    asker = None if yes or not (sys.stdin.isatty() and sys.stdout.isatty()) else _Terminal()
    try:
        draft = _draft(file, kind, start, name, title, given, asker)
        from deltaid.studio.drafting.interview import interview  # slow; the first question is not

        draft = interview(draft, asker)
    except (KeyboardInterrupt, EOFError):
        console.print()
        remark("note", "nothing was written")
        raise typer.Exit(130) from None
    _write(draft, file, report)


# An option for every question.
_parameters = inspect.signature(new).parameters.values()
_options = [
    inspect.Parameter(
        question.key,
        inspect.Parameter.KEYWORD_ONLY,
        default=None,
        annotation=Annotated[
            str | None,
            typer.Option(
                question.option,
                help=question.label.replace("[", r"\["),  # Rich reads [m] as a style
                rich_help_panel=_TITLES[question.group],
                metavar="NUMBER",
            ),
        ],
    )
    for question in QUESTIONS
]
new.__signature__ = inspect.Signature(  # pyright: ignore[reportFunctionMemberAccess]
    [*(p for p in _parameters if p.kind is not p.VAR_KEYWORD), *_options]
)


def _draft(
    file: Path,
    kind: str | None,
    start: str | None,
    name: str | None,
    title: str | None,
    given: Mapping[str, str | None],
    asker: "_Terminal | None",
) -> "Draft":
    from deltaid.studio.drafting.draft import Draft, answers, kind_of

    offered: dict[str, float] = {}
    if start is not None:
        robot = deltaid.load_robot(start)
        offered, its_kind = answers(robot), kind_of(robot)
        if kind not in (None, its_kind):
            raise DeltaidError(
                f"{start} is a {its_kind}", where=f"--kind {kind}", cure="leave --kind out"
            )
        kind = its_kind
    kind = asker.kind() if kind is None and asker is not None else _known_kind(kind)
    return Draft(
        kind=kind,
        name=name or file.stem,
        title=title or KINDS[kind].split(",")[0],
        offered=offered,
        source=Path(start).stem if start else "",
    ).answered_in_words(given, lambda question: question.option)


def _known_kind(kind: str | None) -> str:
    """The given kind of robot, if it exists.

    Raises:
        DeltaidError: no kind has this name.
    """
    if kind in KINDS:
        return str(kind)
    what = "is missing" if kind is None else f"{kind!r} is not known"
    raise DeltaidError(what, where="--kind", cure=f"choose from {', '.join(KINDS)}")


@dataclass
class _Terminal:
    """Questions and answers in a terminal; `title` is the current group of questions."""

    title: str = ""

    def kind(self) -> str:
        console.print("What kind of robot is it?")
        names = dict(enumerate(KINDS, 1))
        for i, name in names.items():
            console.print(f"  {i}  {name}: {KINDS[name]}")
        console.print("A number may have a unit (235 mm, 3 kg cm²); ? shows how to find it out.")
        while True:
            text = _line("number or name: ").strip()
            try:
                return names.get(int(text) if text.isdecimal() else 0) or _known_kind(text)
            except DeltaidError as error:
                self.tell(error)

    def ask(self, question: Question, offer: tuple[float, str] | None) -> str:
        if self.title != question.group:
            self.title = question.group
            console.print()
            console.print(styled(_TITLES[question.group]))
        unit = f" {question.shown_unit}".rstrip()
        shown = f" ({offer[0]:g}{unit}, {offer[1]})" if offer else f" [{unit.strip()}]" * bool(unit)
        while True:
            text = _line(f"{question.text}{shown}: ")
            if text.strip() != "?":
                return text
            console.print(f"  {question.how}")

    def tell(self, error: "DeltaidError") -> None:
        remark("error", error)


def _line(prompt: str) -> str:
    """A line that the user types.

    Ctrl-C must interrupt reading, even if a library's signal handler has changed this.
    """
    if hasattr(signal, "siginterrupt"):
        signal.siginterrupt(signal.SIGINT, True)
    return console.input(prompt)


def _write(draft: "Draft", file: Path, report: Path | None) -> None:
    """Write the description, the page, and the schema that its first line names unless this exists;
    print which numbers are assumed, and the robot at rest."""
    from deltaid.dynamics.limits import AtRest
    from deltaid.studio.drafting import interview, text
    from deltaid.studio.drafting.draft import ASSUMED
    from deltaid.view import html, reach, robots

    schema = file.with_name(text.SCHEMA_FILE)
    keys = json.dumps(deltaid.RobotDescription.model_json_schema(), indent=2, ensure_ascii=False)
    write_files((file, text.written(draft)), (None if schema.exists() else schema, f"{keys}\n"))
    model = deltaid.load(str(file))
    at_rest = AtRest(model.dynamics, model.p)
    surveyed, doubts = reach.survey(at_rest), interview.unusual(draft)
    remark("warning", *doubts, *robots.rest_warnings(at_rest, surveyed))
    assumed = [key.replace("_", " ") for key, origin in draft.origins.items() if origin == ASSUMED]
    lines = [
        f"wrote {file}, {'in doubt' if doubts else 'good'} by `deltaid check`",
        f"{len(draft.values) - len(assumed)} numbers are known, {len(assumed)} are assumed"
        + (f": {', '.join(assumed)}" if assumed else ""),
        "",
        *robots.rest_lines(at_rest, reach.reach(at_rest), surveyed),
    ]
    print_found(lines, full=False)
    print_next(f"`deltaid show {file}` prints drives and limits")
    if report is not None:
        html.write_page(
            robots.rest_page(at_rest, "Robot at rest, with its prior parameters"), report
        )
        print_written(report)
