"""Disk cache of compiled kernels.

An entry is the machine code of one graph for one CPU, named by a checksum of everything that the
code depends on. It begins with a checksum of its content, so damaged entries are compiled again.
The least recently used entries are removed automatically.
"""

import hashlib
import os
import sys
from contextlib import suppress
from pathlib import Path

from deltaid.errors import DeltaidError
from deltaid.files import write_bytes

VARIABLE = "DELTAID_KERNEL_CACHE"
_OFF, _SUFFIX = "off", ".kernel"
_DIGEST = hashlib.sha256().digest_size
# Largest size of all entries together [bytes]; those of a robot take about one megabyte.
_LARGEST = 128 << 20
# Every sixteenth save, at random, removes old entries: listing them takes as long as a compilation.
_LOOKS = 16


def key(*parts: str | bytes) -> str:
    """Name of the entry for the parts that it depends on: their SHA-256."""
    whole = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        whole.update(len(data).to_bytes(8, "little") + data)
    return whole.hexdigest() + _SUFFIX


def switch_off() -> None:
    """Disable the cache in this process and its children."""
    os.environ[VARIABLE] = _OFF


def folder() -> Path | None:
    """Cache folder, from `DELTAID_KERNEL_CACHE` if that is set; None if it is `off` or the user has
    no home."""
    asked = os.environ.get(VARIABLE, "")
    if asked:
        return None if asked.lower() == _OFF else Path(asked)
    caches = _caches()
    return caches / "deltaid" / "kernels" if caches else None


def load(name: str) -> bytes | None:
    """Content of an entry; None if it is missing or damaged."""
    if (place := folder()) is None:
        return None
    data = b""
    with suppress(OSError):
        data = (place / name).read_bytes()
    checksum, content = data[:_DIGEST], data[_DIGEST:]
    if hashlib.sha256(content).digest() != checksum:
        return None
    with suppress(OSError):  # the folder may be read-only
        os.utime(place / name)
    return content


def save(name: str, content: bytes) -> None:
    """Store an entry; store nothing if the default folder is not writable or the disk is full.

    Raises:
        DeltaidError: the folder that `DELTAID_KERNEL_CACHE` names cannot be written.
    """
    if (place := folder()) is None:
        return
    try:
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        checksum = hashlib.sha256(content).digest()
        write_bytes(place / name, checksum + content)
        if checksum[0] % _LOOKS == 0:  # a random sample
            _make_room(place)
    except (OSError, DeltaidError) as error:
        if os.environ.get(VARIABLE) and not os.access(place, os.W_OK):
            reason = error.what if isinstance(error, DeltaidError) else error.strerror or error
            raise DeltaidError(
                f"compiled kernels cannot be kept there: {reason}",
                where=str(place),
                cure=f"set {VARIABLE} to a folder that can be written, or to {_OFF}",
            ) from None


def _make_room(place: Path) -> None:
    """Remove the least recently used entries until the total size is within the limit.

    Another process may remove entries at the same time.
    """
    entries = []
    for path in place.glob(f"*{_SUFFIX}"):
        with suppress(OSError):
            entry = path.stat()
            entries.append((entry.st_mtime, entry.st_size, path))
    total = sum(size for _, size, _ in entries)
    for _, size, path in sorted(entries):
        if total <= _LARGEST:
            break
        with suppress(OSError):
            path.unlink()
        total -= size


def _caches() -> Path | None:
    """The operating system's cache folder; None for a user without a home."""
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "darwin":
        return home / "Library" / "Caches"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    given = os.environ.get("XDG_CACHE_HOME", "")
    return Path(given) if os.path.isabs(given) else home / ".cache"
