"""Semantic mutants of numerical code: one changed sign, factor, term, axis or index each.

A mutant is a text edit of one expression, so the rest of a file, its comments and line numbers
stay. Mutants that could only crash (sums of strings or lists) or only change words are not made.
"""

import ast
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

_SUMS = (ast.Add, ast.Sub)
_PRODUCTS = (ast.Mult, ast.Div)
_NOT_NUMBERS = (ast.List, ast.Tuple, ast.JoinedStr, ast.ListComp, ast.Dict, ast.Set)


@dataclass(frozen=True)
class Mutant:
    """One edit.

    Attributes:
        path: of the file, relative to the source folder.
        line: first line of the expression that is replaced; `last` is its last one.
        start: byte at which the expression begins, `end` where it ends.
        operator: what was changed.
        before: the expression; `after` is what stands in its place.
        inside: name of the innermost function around it, empty at the level of a module or class.
    """

    path: str
    line: int
    last: int
    start: int
    end: int
    operator: str
    before: str
    after: str
    inside: str

    @property
    def room(self) -> str:
        """Folder of the package, `.` for its single files."""
        folder = Path(self.path).parent.parts
        return folder[1] if len(folder) > 1 else "."

    def __str__(self) -> str:
        return (
            f"{self.path}:{self.line} {self.operator}: {_short(self.before)} → {_short(self.after)}"
        )

    def rank(self, seed: int) -> bytes:
        """Place in the draw: random, and the same after edits elsewhere in the package."""
        words = (seed, self.path, self.inside, self.operator, self.before, self.after)
        return hashlib.sha256(repr(words).encode()).digest()

    def applied(self, source: bytes) -> bytes:
        """The file's bytes with the edit made."""
        return source[: self.start] + self.after.encode() + source[self.end :]


def drawn(source: Path, count: int, seed: int) -> list[Mutant]:
    """Mutants over all rooms of the package: one a room, the rest by the number of places.

    Args:
        source: folder that holds the package.
        count: of mutants, at least one a room.
        seed: of the draw.
    """
    found = [
        mutant
        for path in sorted(source.rglob("*.py"))
        for mutant in mutants(path, path.relative_to(source).as_posix())
    ]
    found.sort(key=lambda mutant: mutant.rank(seed))
    rooms = {mutant.room: mutant for mutant in reversed(found)}
    chosen = {(mutant.path, mutant.line): mutant for _, mutant in sorted(rooms.items())}
    for mutant in found:
        if len(chosen) < count:
            chosen.setdefault((mutant.path, mutant.line), mutant)
    return list(chosen.values())


def mutants(path: Path, name: str) -> Iterator[Mutant]:
    text = path.read_bytes()
    tree = ast.parse(text)
    starts = np.cumsum([0, *(len(line) for line in text.splitlines(keepends=True))])

    def edit(node: ast.expr, operator: str, after: str, inside: str) -> Mutant:
        start = int(starts[node.lineno - 1]) + node.col_offset
        end = int(starts[(node.end_lineno or node.lineno) - 1]) + (node.end_col_offset or 0)
        before = text[start:end].decode()
        last = node.end_lineno or node.lineno
        return Mutant(name, node.lineno, last, start, end, operator, before, f"({after})", inside)

    for node, inside in _expressions(tree, ""):
        for operator, changed in _changes(node):
            yield edit(node, operator, ast.unparse(changed), inside)


def _expressions(node: ast.AST, inside: str) -> Iterator[tuple[ast.expr, str]]:
    """Expressions below a node with the function around each; no annotations, no decorators."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_comment"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST):
                continue
            if isinstance(child, ast.JoinedStr):
                continue  # words
            function = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef)
            within = child.name if function else inside
            if isinstance(child, ast.expr):
                yield child, within
            yield from _expressions(child, within)


def _changes(node: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    """What a mutant makes of an expression."""
    match node:
        case ast.BinOp(left, op, right) if isinstance(op, _SUMS) and _number(left, right):
            other = ast.Sub() if isinstance(op, ast.Add) else ast.Add()
            yield "sign", ast.BinOp(left, other, right)
            if not isinstance(right, ast.Constant):  # that is one off, below
                yield "dropped term", left
                yield "dropped term", right
        case ast.BinOp(left, op, right) if isinstance(op, _PRODUCTS) and _number(left, right):
            other = ast.Div() if isinstance(op, ast.Mult) else ast.Mult()
            yield "factor", ast.BinOp(left, other, right)
            yield "factor", left
        case ast.BinOp(left, ast.Pow(), ast.Constant(int() | float())):
            yield "factor", left
        case ast.UnaryOp(ast.USub(), operand) if not isinstance(operand, ast.Constant):
            yield "sign", operand
        case ast.Attribute(value, "T"):
            yield "axis", value
        case ast.Call(func, args, keywords):
            yield from (("axis", call) for call in _other_axes(func, args, keywords))
            yield from (("off by one", call) for call in _off_by_one(func, args, keywords))
        case ast.Subscript(value, index):
            yield from (
                ("off by one", ast.Subscript(value, moved, ast.Load())) for moved in _moved(index)
            )
        case _:
            return


def _number(left: ast.expr, right: ast.expr) -> bool:
    """Whether a sum or product may be one of numbers."""
    return not any(
        isinstance(side, _NOT_NUMBERS)
        or (isinstance(side, ast.Constant) and isinstance(side.value, str | bytes))
        for side in (left, right)
    )


def _other_axes(
    func: ast.expr, args: list[ast.expr], keywords: list[ast.keyword]
) -> Iterator[ast.Call]:
    for k, keyword in enumerate(keywords):
        if keyword.arg == "axis" and (number := _whole(keyword.value)) is not None:
            other = ast.Constant(1 if number == 0 else 0)
            changed = [*keywords[:k], ast.keyword("axis", other), *keywords[k + 1 :]]
            yield ast.Call(func, args, changed)


def _off_by_one(
    func: ast.expr, args: list[ast.expr], keywords: list[ast.keyword]
) -> Iterator[ast.Call]:
    """The same range or division of a variance, off by one."""
    if isinstance(func, ast.Name) and func.id == "range" and args:
        k = 0 if len(args) == 1 else 1
        for step in (ast.Add(), ast.Sub()):
            end = ast.BinOp(args[k], step, ast.Constant(1))
            yield ast.Call(func, [*args[:k], end, *args[k + 1 :]], keywords)
    for k, keyword in enumerate(keywords):
        if keyword.arg == "ddof" and _whole(keyword.value) is not None:
            other = ast.BinOp(keyword.value, ast.Add(), ast.Constant(1))
            yield ast.Call(
                func, args, [*keywords[:k], ast.keyword("ddof", other), *keywords[k + 1 :]]
            )


def _moved(index: ast.expr) -> Iterator[ast.expr]:
    """An index or the end of a slice, moved by one; columns and rows exchanged."""
    match index:
        case ast.Slice(lower, upper, None):
            for end in (lower, upper):
                if end is None or (number := _whole(end)) is None:
                    continue
                moved = ast.Constant(_away(number))
                yield ast.Slice(*((moved, upper) if end is lower else (lower, moved)))
        case ast.Tuple([first, second]):
            if isinstance(first, ast.Slice) != isinstance(second, ast.Slice):
                yield ast.Tuple([second, first], ast.Load())
        case _ if (number := _whole(index)) is not None:
            yield ast.Constant(_away(number))


def _away(index: int) -> int:
    """The next index, counted from the end that it is counted from."""
    return index + 1 if index >= 0 else index - 1


def _whole(node: ast.expr) -> int | None:
    match node:
        case ast.Constant(int() as number) if not isinstance(number, bool):
            return number
        case ast.UnaryOp(ast.USub(), ast.Constant(int() as number)):
            return -number
        case _:
            return None


def _short(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 60 else text[:57] + "…"
