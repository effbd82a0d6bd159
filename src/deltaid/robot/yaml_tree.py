"""Reads YAML text as plain values, each with its line.

ruamel.yaml parses the text to events. This module resolves them by the core schema of YAML 1.2
without tags, so no text can name a type, run a constructor or contain itself.
"""

import functools
import math
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import (
    AliasEvent,
    DocumentEndEvent,
    DocumentStartEvent,
    Event,
    MappingEndEvent,
    ScalarEvent,
    SequenceEndEvent,
    SequenceStartEvent,
    StreamEndEvent,
)
from ruamel.yaml.reader import ReaderError

from deltaid.errors import DescriptionError, quoted

Scalar = bool | int | float | str | None
Value = Scalar | list["Entry"] | dict[str, "Entry"]

# Limits of nodes and of levels. A model file has about 700 nodes and 50 per recording; aliases of
# aliases can expand a short text to billions.
MOST_NODES, _DEEPEST = 20_000, 30
_WORDS: dict[str, Scalar] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
    **dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), math.inf),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf),
}
_INTEGER = re.compile(r"[-+]?[0-9]+")
_OTHER_BASE = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_MERGE = "<<"


@dataclass(frozen=True)
class Entry:
    """A value with the line of its key or item, from 1; for a merged key that of the merge (<<)."""

    line: int
    value: Value


@functools.lru_cache(maxsize=16)  # parsing takes most of the time to load a robot
def read_tree(text: str, where: str, most: int = MOST_NODES) -> Entry | None:
    """Document of a YAML text; None if it is empty. Calls share it, so do not change it.

    Args:
        where: name of the text in messages.
        most: largest number of nodes.

    Raises:
        DescriptionError: the text is not YAML, has tags, keys that are not words, references to
            later anchors, or too many nodes.
    """
    return _Composer(text, where, most).document()


def child(value: Value, key: object) -> Entry | None:
    """Entry at a key of a mapping or an index of a list; None if there is none."""
    if isinstance(value, dict):
        return value.get(str(key))
    if isinstance(value, list) and isinstance(key, int) and key < len(value):
        return value[key]
    return None


def plain(tree: Entry, where: str, most: int = MOST_NODES) -> Any:
    """Convert a tree to lists, dictionaries and scalars, with references expanded.

    Raises:
        DescriptionError: the result has more than `most` nodes or too many levels.
    """
    nodes = 0

    def written_out(value: Value, depth: int) -> Any:
        nonlocal nodes
        nodes += 1
        if nodes > most or depth > _DEEPEST:
            raise _too_much(where)
        if isinstance(value, dict):
            return {key: written_out(entry.value, depth + 1) for key, entry in value.items()}
        if isinstance(value, list):
            return [written_out(entry.value, depth + 1) for entry in value]
        return value

    return written_out(tree.value, 0)


class _Composer:
    def __init__(self, text: str, where: str, most: int) -> None:
        self._events = _events(text, where)
        self._where = where
        self._most = most
        self._anchors: dict[str, Value] = {}
        self._nodes = 0

    def document(self) -> Entry | None:
        next(self._events)  # start of the stream
        first = next(self._events)
        if not isinstance(first, DocumentStartEvent):
            return None
        event = next(self._events)
        tree = Entry(_line(event), self._value(event, 0))
        for end in self._events:
            if not isinstance(end, DocumentEndEvent | StreamEndEvent):
                raise self._invalid("a second document begins here", end)
        return tree

    def _value(self, event: Any, depth: int) -> Value:
        self._count(1)
        if depth > _DEEPEST:
            raise _too_much(self._where)
        if isinstance(event, AliasEvent):
            if event.anchor not in self._anchors:
                raise self._invalid(f"*{event.anchor} is not there before this line", event)
            return self._anchors[event.anchor]
        self._refuse_tag(event)
        if isinstance(event, ScalarEvent):
            value = self._text(event)
            value = _resolved(value) if event.implicit[0] else value
        elif isinstance(event, SequenceStartEvent):
            value = self._list(depth)
        else:
            value = self._mapping(depth)
        if event.anchor:  # set after its value, so that nothing can contain itself
            self._anchors[event.anchor] = value
        return value

    def _list(self, depth: int) -> list[Entry]:
        entries = []
        while not isinstance(event := next(self._events), SequenceEndEvent):
            entries.append(Entry(_line(event), self._value(event, depth + 1)))
        return entries

    def _mapping(self, depth: int) -> dict[str, Entry]:
        entries: dict[str, Entry] = {}
        merged: dict[str, Entry] = {}
        while not isinstance(event := next(self._events), MappingEndEvent):
            if not isinstance(event, ScalarEvent):
                raise self._unusable("has a key that is not a word", event)
            self._refuse_tag(event)
            key = self._text(event)
            value = self._value(next(self._events), depth + 1)
            if key == _MERGE and event.implicit[0]:
                merged = self._merged(value, event) | merged
            elif key in entries:
                raise self._invalid(f"found duplicate key {key[:60]}", event)
            else:
                entries[key] = Entry(_line(event), value)
        return entries | {key: entry for key, entry in merged.items() if key not in entries}

    def _merged(self, value: Value, event: Event) -> dict[str, Entry]:
        """Merge the entries of one or several mappings; earlier ones take precedence."""
        sources = [entry.value for entry in value] if isinstance(value, list) else [value]
        merged: dict[str, Entry] = {}
        for source in sources:
            if not isinstance(source, dict):
                raise self._unusable(f"merges ({_MERGE}) what has no keys", event)
            self._count(len(source))
            entries = {key: Entry(_line(event), entry.value) for key, entry in source.items()}
            merged = entries | merged
        return merged

    def _count(self, nodes: int) -> None:
        self._nodes += nodes
        if self._nodes > self._most:
            raise _too_much(self._where)

    def _text(self, event: ScalarEvent) -> str:
        """Text of a scalar, with JSON's surrogate pairs combined."""
        if event.value.isascii():
            return event.value
        try:
            return event.value.encode("utf-16", "surrogatepass").decode("utf-16")
        except UnicodeDecodeError:
            raise self._invalid("half a character (a surrogate)", event) from None

    def _refuse_tag(self, event: Any) -> None:
        if event.tag is not None:
            raise self._unusable(f"has the tag {str(event.tag)[:60]}", event)

    def _unusable(self, what: str, event: Event) -> DescriptionError:
        return DescriptionError(
            f"{what}, which means nothing here",
            where=f"{self._where}, line {_line(event)}",
            cure="write plain numbers, text, lists and keys with values",
        )

    def _invalid(self, what: str, event: Event) -> DescriptionError:
        return _not_yaml(what, f"{self._where}, line {_line(event)}")


def _events(text: str, where: str) -> Iterator[Event]:
    """Events of the parser; its errors become `DescriptionError` with their line, if known."""
    try:
        yield from YAML(typ="safe", pure=True).parse(text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{where}, line {mark.line + 1}" if mark else where
        raise _not_yaml(str(error.problem or error.context), place) from None
    except ReaderError as error:
        place = f"{where}, line {text.count(chr(10), 0, error.position) + 1}"
        character = error.character if isinstance(error.character, int) else ord(error.character)
        raise _not_yaml(f"character U+{character:04X} cannot be in it", place) from None
    except (YAMLError, ValueError, OverflowError) as error:  # chr() of an invalid code point
        raise _not_yaml(quoted(str(error).strip().split("\n", 1)[0]), where) from None


def _resolved(text: str) -> Scalar:
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text) if len(text) <= sys.float_info.max_10_exp else float(text)
    if _OTHER_BASE.fullmatch(text):  # four bits a digit at most
        return int(text, 0) if 4 * len(text) <= sys.float_info.max_exp else math.inf
    return float(text) if _FLOAT.fullmatch(text) else text


def _line(event: Event) -> int:
    return event.start_mark.line + 1


def _not_yaml(what: str, where: str) -> DescriptionError:
    return DescriptionError(
        f"is not valid YAML: {what}",
        where=where,
        cure="look there for indentation, tabs, colons and quotes",
    )


def _too_much(where: str) -> DescriptionError:
    return DescriptionError(
        "has too many entries or levels", where=where, cure="is it a description at all?"
    )
