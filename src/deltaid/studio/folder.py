"""The studio's folder: its files, and names that cannot lead out of it."""

import itertools
import math
import os
import re
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from deltaid.errors import DeltaidError
from deltaid.files import DEVICES, YAML_ENDINGS, refusing, write_bytes
from deltaid.recording.table import FORMATS
from deltaid.robot.load import LARGEST_FILE, holds_a_model, read_text

RUNS = "runs"
# What is wrong with a folder or file, and the fix, if the operating system refuses it.
UNUSABLE = (
    "cannot be used", "see whether the folder is still there, may be written to, and has room"
)  # fmt: skip
_PACKED = (".gz", ".zst", ".zstd")
# Top-level keys that identify a file's kind.
_ROBOT = re.compile(r"^(limbs|mechanism)\s*:", re.MULTILINE)
_MAPPING = re.compile(r"^(time|position|velocity|torque|load)\s*:", re.MULTILINE)
# Largest number of characters of a name, of its endings, and of an answer.
LONGEST = 60
_SAFE = re.compile(r"[^\w.()+-]+")
_DEVICES = re.compile(rf"(?i)({DEVICES})(\..*)?")


class ConflictError(DeltaidError):
    """A file has changed since its edit began."""


@dataclass(frozen=True)
class Folder:
    """A folder and its files.

    Attributes:
        root: absolute path, without links.
    """

    root: Path

    @staticmethod
    def open(path: Path) -> "Folder":
        """The folder at a path, which is made if it does not exist.

        Raises:
            DeltaidError: it cannot be made or written to, or is a file.
        """
        with refusing(path, UNUSABLE[0], "give the name of a folder that you may write to"):
            path.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=path).close()
        return Folder(path.resolve())

    def path(self, name: str) -> Path:
        """A name inside the folder as a path.

        Raises:
            DeltaidError: it leads out of the folder, or names a hidden file.
        """
        parts = Path(name).parts
        plain = parts and not any(
            part.startswith(".") or "\\" in part or ":" in part for part in parts
        )
        if plain and "\0" not in name:
            path = self.root / name
            # Links may lead out of the folder; an absolute name has another root.
            if Path(os.path.realpath(path)).is_relative_to(self.root):
                return path
        raise DeltaidError("is no file of this folder", where=name, cure="give a name inside it")

    def has(self, name: str) -> bool:
        """Whether there is a file of this name inside the folder."""
        try:
            return os.path.isfile(self.path(name))
        except DeltaidError:
            return False

    def text(self, name: str) -> str:
        """Content of a small file; empty if it does not exist."""
        path = self.path(name)
        return read_text(path) if os.path.exists(path) else ""

    def write(self, name: str, text: str, *, instead_of: str | None = None) -> None:
        """Write a file whole.

        Args:
            name: inside the folder.
            text: new content.
            instead_of: content when the change began; None for a new file.

        Raises:
            ConflictError: the content has changed since.
            DeltaidError: it cannot be written.
        """
        path = self.path(name)
        before = self.text(name) if os.path.exists(path) else None
        if before == text:
            return
        if before != instead_of:
            what = "has been changed meanwhile, in another tab or by another program"
            if before is None:
                what = "has been removed meanwhile"
            elif instead_of is None:
                what = "is there already"
            raise ConflictError(
                what, where=name, cure="look at it as it is now, and make the change again"
            )
        write_bytes(path, text.encode())

    def free_name(self, wanted: str) -> str:
        """A safe and unused name similar to the wanted one."""
        name = _SAFE.sub("-", Path(wanted.replace("\\", "/")).name).strip(".-") or "file"
        if _DEVICES.fullmatch(name):
            name = f"file-{name}"
        stem, dot, suffix = name.partition(".")
        stem, ending = stem[:LONGEST], dot + suffix[-LONGEST:]
        names = (f"{stem}{f'-{k}' if k > 1 else ''}{ending}" for k in itertools.count(1))
        return next(name for name in names if not (self.root / name).exists())

    def files(self) -> list[Path]:
        """Visible files at the top of the folder; none if the folder has been removed."""
        return sorted(p for p in self.root.glob("*") if p.is_file() and not p.name.startswith("."))

    @contextmanager
    def called_by_name(self) -> Generator[None, None, None]:
        """Shorten paths in errors raised inside to names in the folder."""
        try:
            yield
        except DeltaidError as error:
            error.where = str(error.where).replace(f"{self.root}{os.sep}", "")
            raise

    def require(self) -> None:
        """Refuse a folder that no longer exists.

        Raises:
            DeltaidError: it has been removed.
        """
        if not self.root.is_dir():
            raise DeltaidError("is no longer there", where=str(self.root), cure="put it back")

    def robots(self) -> list[str]:
        """Names of files that describe a robot."""
        return [n for n, text in self._texts() if _ROBOT.search(text) and not holds_a_model(text)]

    def mappings(self) -> list[str]:
        """Names of files that map columns."""
        return [n for n, text in self._texts() if _MAPPING.search(text) and not _ROBOT.search(text)]

    def recordings(self) -> list[str]:
        """Names of files that may be recordings, judged by their endings."""
        endings = {suffix for form in FORMATS for suffix in form.suffixes} | {".csv", ".txt"}
        packed = (f"{ending}{pack}" for ending in endings for pack in _PACKED)
        kinds = (*(endings - set(YAML_ENDINGS)), *packed)
        return [path.name for path in self.files() if path.name.lower().endswith(kinds)]

    def _texts(self) -> list[tuple[str, str]]:
        return [
            (path.name, path.read_text(encoding="utf-8", errors="replace"))
            for path in self.files()
            if path.suffix.lower() in YAML_ENDINGS
            and (stamp(path) or [math.inf])[0] <= LARGEST_FILE
        ]


def stamp(path: Path) -> tuple[int, int] | None:
    """Size and time of the last change [ns] of a file; None if it has just been removed."""
    try:
        known = path.stat()
        return known.st_size, known.st_mtime_ns
    except OSError:
        return None
