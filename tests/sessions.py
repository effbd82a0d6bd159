"""Console sessions and Python blocks of the documentation: run, and compared with what is quoted.

    python tests/sessions.py docs/tutorial.md docs/theory.md

says what no longer agrees; with --renew it rewrites the quoted outputs and says what is left to
mend by hand. In a page, a block marked `console` holds lines `$ command` and below each what it
prints; a line `…` stands for lines left out. A quoted line must occur in what the command prints,
in the order of quoting; numbers and spaces do not count, because they may differ between machines.
A page that runs a command with --json must name all keys of its result. Blocks marked `sh` hold
commands alone. Blocks marked `python` are executed, one namespace a page. A comment `<!-- before`
(or `<!-- before python`) holds lines that have to run first and that a page does not show. All
pages run in one folder, with deltaid inside this process. What `NOT_RUN` matches stays out, and
except for --renew a search for a motion has one start.
"""

import contextlib
import io
import json
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from unittest.mock import patch

from deltaid.cli import output
from deltaid.cli.app import main
from deltaid.exports import fmu_binaries

ROOT = Path(__file__).resolve().parents[1]
SKIPPED = "…"
# These need a network, a new environment or minutes, a recording that is not ours to give, or they
# serve until they are stopped; .ci/run and tests of their own run most of them.
NOT_RUN = re.compile(
    r"\b(pip|venv|ruff|twine|zensical|(pictures|sessions|links|notebook_page|cli_page)\.py|DATA_EMPS)\b"
    r"|\bdeltaid (compare-controllers|reproduce|studio)\b|--live\b"
    r"|\bbenchmarks/|\b(surrogate|irb360)/|^cd "
)
_BEFORE = re.compile(r"<!-- before( python)?\n(.*?)-->", re.DOTALL)
_FENCE = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?")
for console in (output.console, output.error_console):
    console.width = 100  # whatever the terminal


@dataclass
class Command:
    """One command of a console session with its quoted output."""

    line: int
    text: str
    quoted: list[str] = field(default_factory=list)

    @property
    def expected_code(self) -> int:
        """2 where an error is quoted, 4 where a check finds something wrong, 3 where columns are in
        doubt, else 0."""
        starts = {line.partition(" ")[0] for line in self.quoted}
        in_doubt = any(line.endswith(" in doubt") for line in self.quoted)
        return 2 if "error:" in starts else 4 if "wrong" in starts else 3 * in_doubt


@dataclass(frozen=True)
class Code:
    """A Python block."""

    line: int
    text: str


def blocks(page: str, language: str) -> Iterator[tuple[int, str]]:
    """Line number and text of all fenced blocks in a language, those in tabs too."""
    for match in _FENCE.finditer(page):
        if match[2] == language:
            yield page.count("\n", 0, match.start()) + 2, textwrap.dedent(match[3])


def shell_lines(text: str) -> Iterator[str]:
    """Commands of a block without outputs: one a line, or several with `\\` at their ends."""
    for line in text.replace("\\\n", " ").splitlines():
        bare = re.sub(r"\s+#.*$", "", line).strip()
        if bare and not NOT_RUN.search(bare):
            yield bare


def steps(page: str) -> list[Command | Code]:
    """Everything in a page that runs, in its order."""
    found: list[Command | Code] = [
        Code(line, text) for line, text in blocks(page, "python") if not text.startswith("--8<--")
    ]
    for match in _BEFORE.finditer(page):
        line = page.count("\n", 0, match.start()) + 1
        here = [Command(line, text) for text in shell_lines(match[2])]
        found += [Code(line, match[2])] if match[1] else here
    for first, text in blocks(page, "sh"):
        found += [Command(first, line) for line in shell_lines(text)]
    for first, text in blocks(page, "console"):
        command = None
        for i, line in enumerate(text.splitlines()):
            if line.startswith("$ "):
                command = Command(first + i, line[2:])
                found += [] if NOT_RUN.search(line) else [command]
            else:
                assert command, f"line {first + i}: output without a command"
                command.quoted.append(line)
    return sorted(found, key=lambda step: step.line)


def quicker(command: str) -> str:
    """The same with one start of each search for a motion, where the page names no number."""
    return command if "--starts" in command else command.replace(" excite ", " excite --starts 1 ")


def run(command: str, folder: Path) -> tuple[int, list[str]]:
    """Exit code and printed lines of a command in a folder; deltaid and examples in-process."""
    text, _, target = command.partition(" > ")
    argv = shlex.split(text)
    if argv[0] not in ("deltaid", "python"):  # head, sed, …
        done = subprocess.run(command, shell=True, cwd=folder, capture_output=True, text=True)
        return done.returncode, (done.stdout + done.stderr).splitlines()
    printed = io.StringIO()
    with (
        contextlib.ExitStack() as stack,
        contextlib.chdir(folder),
        contextlib.redirect_stderr(printed),
    ):
        out = stack.enter_context(open(target, "w", encoding="utf-8")) if target else printed
        stack.enter_context(contextlib.redirect_stdout(out))
        code = _call(argv)
    return code, printed.getvalue().splitlines()


def _call(argv: list[str]) -> int:
    arguments = argv[1:] if argv[0] == "python" else argv
    with patch.object(sys, "argv", arguments):
        try:
            if argv[0] == "python":
                runpy.run_path(str(ROOT / arguments[0]), run_name="__main__")
            else:
                main()
        except SystemExit as stop:
            return int(stop.code or 0)
    return 0


def execute(code: Code, namespace: dict, folder: Path) -> None:
    """Run a Python block in a folder."""
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()):
        exec(compile("\n" * (code.line - 1) + code.text, "page", "exec"), namespace)


def matched(quoted: list[str], printed: list[str]) -> list[str | None]:
    """For each quoted line the printed one that it stands for; None where there is none."""
    found, start = [], 0
    for line in quoted:
        if line in (SKIPPED, ""):
            found.append(line)
            continue
        same = (i for i in range(start, len(printed)) if _words(printed[i]) == _words(line))
        i = next(same, None)
        found.append(None if i is None else printed[i].rstrip())
        start = start if i is None else i + 1
    return found


def _words(line: str) -> list[str]:
    return _NUMBER.sub("#", line).split()


def compare(path: Path, folder: Path, *, renew: bool = False) -> list[str]:
    """Run a page; complaints about what it quotes. Rewrites outputs if asked to.

    An output that is quoted whole is replaced whole, of one with `…` the lines that still match.
    """
    page, namespace, said = path.read_text(encoding="utf-8"), {}, []
    fresh: list[tuple[Command, list[str]]] = []
    for step in steps(page):
        if isinstance(step, Code):
            execute(step, namespace, folder)
            continue
        where = f"{path.name}:{step.line}: {step.text}"
        code, printed = run(step.text if renew else quicker(step.text), folder)
        if code != step.expected_code:
            said.append("\n  ".join([f"{where}\n  exit code {code}", *printed[-5:]]))
        if "--json" in step.text and code == 0:
            text = "\n".join(printed)  # with notes of standard error
            value, _ = json.JSONDecoder().raw_decode(text, text.index("{"))
            missing = [key for key in value if f"`{key}`" not in page]
            said += [f"{where}\n  the page does not name its key {key}" for key in missing]
        found = matched(step.quoted, printed)
        if renew and None in found and SKIPPED not in step.quoted:
            found = [line.rstrip() for line in printed]
        for old, new in zip(step.quoted, found, strict=False):
            if new is None:
                said.append(f"{where}\n  no longer prints: {old}")
        kept = [new if new is not None else step.quoted[i] for i, new in enumerate(found)]
        fresh.append((step, kept))
    if renew:
        lines = page.split("\n")
        for step, quoted in reversed(fresh):
            lines[step.line : step.line + len(step.quoted)] = quoted
        path.write_text("\n".join(lines), encoding="utf-8")
    return said


def complaints(*arguments: str) -> list[str]:
    """Complaints about pages."""
    pages = [Path(name) for name in arguments if name != "--renew"]
    renew = "--renew" in arguments
    with (
        tempfile.TemporaryDirectory() as temporary,
        patch.object(fmu_binaries, "find_spec", lambda _: None),  # units for this machine alone
    ):
        folder = Path(temporary)
        shutil.copytree(ROOT / "examples", folder / "examples")
        run("deltaid demo --keep demo", folder)  # what all pages may use
        return [complaint for page in pages for complaint in compare(page, folder, renew=renew)]


if __name__ == "__main__":
    found = complaints(*sys.argv[1:])
    print(*found, sep="\n")
    sys.exit(bool(found))
