"""Names of pages: of any robot's or type's name a file name that every system takes."""

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import PurePosixPath
from urllib.parse import quote

_PLAIN = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,79}")
_UNSAFE = re.compile(r"[^A-Za-z0-9_-]+")
# Those that Windows keeps for itself.
_TAKEN = re.compile(r"con|prn|aux|nul|(com|lpt)\d", re.IGNORECASE)


def file_names(names: Iterable[str]) -> dict[str, str]:
    """A file's name for each name: the same where it is plain, else with a part of its checksum.

    Letters alone tell two files apart, whether small or capital.
    """
    given = list(dict.fromkeys(names))
    alike = Counter(name.casefold() for name in given)
    return {name: _file(name, alone=alike[name.casefold()] == 1) for name in given}


def _file(name: str, *, alone: bool) -> str:
    if alone and _PLAIN.fullmatch(name) and not _TAKEN.fullmatch(name):
        return f"{name}.html"
    start = _UNSAFE.sub("-", name).strip("-")[:40] or "robot"
    return f"{start}-{hashlib.sha256(name.encode()).hexdigest()[:8]}.html"


def address(folder: str, file: str) -> str:
    """Of a page, as a link has it."""
    return quote(f"{folder}/{file}")


def type_labels(types: Iterable[str]) -> Mapping[str, str]:
    """Types as people call them: a description's file without its folder where that is enough."""
    given = list(dict.fromkeys(types))
    short = {name: PurePosixPath(name.replace("\\", "/")).name or name for name in given}
    count = Counter(short.values())
    return {name: short[name] if count[short[name]] == 1 else name for name in given}
