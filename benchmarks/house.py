"""How large the package is, room by room, and which numbers stand in it.

    python benchmarks/house.py [--constants]

Counts statements (nodes of `ast.stmt`), lines, files, folders, scalar constants of modules and what
`docs/` names beside them: words of the documents, lines of tests and benchmarks. Leaves
`tables/house.md`. With `--constants` it lists every scalar constant instead, with its place, its
value and the comment that gives its reason, and then those that several modules define.
"""

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from _table import leave
from _timing import options

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "deltaid"
GENERATED = ("cli.md", "notebook.md")  # pages of docs/ that a program writes
HEAD = ("room", "files", "lines", "statements", "constants")


@dataclass(frozen=True)
class Constant:
    """A number of a module: `value` as written, `reason` the comment above or beside it."""

    path: Path
    line: int
    name: str
    value: str
    reason: str


@dataclass(frozen=True)
class Source:
    """A file of the package, parsed."""

    path: Path
    lines: list[str]
    tree: ast.Module

    @property
    def room(self) -> str:
        """First folder below the package, or `.`."""
        parts = self.path.relative_to(PACKAGE).parts
        return parts[0] if len(parts) > 1 else "."

    @property
    def statements(self) -> int:
        return sum(isinstance(node, ast.stmt) for node in ast.walk(self.tree))

    def constants(self) -> Iterator[Constant]:
        """Names of the module that hold one number, those that share a line as well."""
        for node in self.tree.body:
            match node:
                case ast.Assign(targets=[ast.Tuple(names)], value=ast.Tuple(values)):
                    pairs = list(zip(names, values, strict=False))
                case ast.Assign(targets=[target], value=value):
                    pairs = [(target, value)]
                case ast.AnnAssign(target=target, value=ast.expr() as value):
                    pairs = [(target, value)]
                case _:
                    continue
            for target, value in pairs:
                if isinstance(target, ast.Name) and is_number(value):
                    reason = self._reason(node.lineno)
                    yield Constant(self.path, node.lineno, target.id, ast.unparse(value), reason)

    def _reason(self, line: int) -> str:
        """The comment beside a line and the block of comments above it."""
        above = line - 1
        while above and self.lines[above - 1].startswith("#"):
            above -= 1
        _, _, beside = self.lines[line - 1].partition("#")
        comments = [text.lstrip("# ") for text in self.lines[above : line - 1]]
        return " ".join([*comments, beside.strip()]).strip()


def is_number(value: ast.expr) -> bool:
    """Whether an expression is made of numbers alone."""
    match value:
        case ast.Constant(value=int() | float() as number):
            return not isinstance(number, bool)
        case ast.UnaryOp(operand=operand):
            return is_number(operand)
        case ast.BinOp(left=left, right=right):
            return is_number(left) and is_number(right)
    return False


def sources() -> list[Source]:
    texts = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
    return [Source(path, text.splitlines(), ast.parse(text)) for path, text in texts.items()]


def rooms(files: list[Source]) -> list[tuple[object, ...]]:
    """Rows of the table, the largest room first, and their sum."""
    by_room = defaultdict[str, list[Source]](list)
    for file in files:
        by_room[file.room].append(file)
    ordered = sorted(by_room, key=lambda room: -sum(file.statements for file in by_room[room]))
    return [sizes(room, by_room[room]) for room in ordered] + [sizes("all", files)]


def sizes(name: str, files: list[Source]) -> tuple[object, ...]:
    return (
        name,
        len(files),
        sum(len(file.lines) for file in files),
        sum(file.statements for file in files),
        sum(1 for file in files for _ in file.constants()),
    )


def note(files: list[Source]) -> str:
    folders = sum(path.is_dir() and any(path.glob("*.py")) for path in PACKAGE.rglob("*"))
    short = sum(len(file.lines) < 60 for file in files)
    classes = Counter(node.name for file in files for node in ast.walk(file.tree)
                      if isinstance(node, ast.ClassDef))  # fmt: skip
    repeated = sum(count > 1 for count in classes.values())
    words = sum(len(re.findall(r"\S+", path.read_text(encoding="utf-8")))
                for path in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
                if path.name not in GENERATED)  # fmt: skip
    lines = {
        part: sum(len(path.read_text(encoding="utf-8").splitlines())
                  for path in (ROOT / part).rglob("*.py"))
        for part in ("tests", "benchmarks")
    }  # fmt: skip
    lines_of = Counter((each.path, each.line) for file in files for each in file.constants())
    alone = sum(count == 1 for count in lines_of.values())
    return (
        f"{folders} folders, {short} files below 60 lines, {repeated} names of classes used more "
        f"than once; {words:,} words in README and `docs/`, generated pages excepted; "
        f"{lines['tests']:,} lines of tests, {lines['benchmarks']:,} of benchmarks. Constants are "
        f"all that have a name; {alone} have a line to themselves: earlier tables counted these."
    )


def list_constants(files: list[Source]) -> None:
    """Print every constant, then those that stand in several modules."""
    constants, places = [c for file in files for c in file.constants()], defaultdict(list)
    for constant in constants:
        place, text = constant.path.relative_to(PACKAGE), f"{constant.name} = {constant.value}"
        print(f"{place}:{constant.line}: {text}  # {constant.reason or '(no reason)'}")
        places[text].append(str(place))
    unexplained = sum(not constant.reason for constant in constants)
    print(f"\n{len(constants)} constants, {unexplained} without a reason")
    for text, same in places.items():
        if len(same) > 1:
            print(f"{text}: {', '.join(same)}")


def main() -> None:
    given, files = options(__doc__, constants=False), sources()
    if given.constants:
        list_constants(files)
    else:
        leave(HEAD, rooms(files), note(files))


if __name__ == "__main__":
    main()
