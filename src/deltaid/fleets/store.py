"""Files of any store that fsspec supports: on this machine, on S3, and others.

Credentials and options of a store come from the environment, where fsspec's libraries look for
them.
"""

import glob
import os
import re
import sys
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from stat import S_ISREG
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from deltaid.errors import DeltaidError
from deltaid.files import write_bytes
from deltaid.grouping import grouped

_MAGIC = "*?["
# Number of attempts of a request, and wait before the second one [s].
_TRIES, _WAIT = 4, 0.3

_Result = TypeVar("_Result")


class StoreError(DeltaidError):
    """A store cannot be reached, or has changed meanwhile; another call may succeed."""


def is_address(path: str) -> bool:
    """Whether a name is an address such as s3://bucket/key instead of a path."""
    return "://" in path


def has_pattern(path: str) -> bool:
    return any(sign in path for sign in _MAGIC)


def matching(pattern: str) -> dict[str, str]:
    """Files that match a pattern, each with its stamp.

    A stamp changes when a file does, and is known without reading it: size and time of change, or
    entity tag.

    Raises:
        DeltaidError: the store cannot be reached.
    """
    if not is_address(pattern):
        return stamps_of(sorted(glob.glob(pattern, recursive=True)))
    infos = _request(partial(_system(pattern).glob, pattern, detail=True), pattern)
    return _stamps(infos, pattern)


def stamps_of(paths: Iterable[str]) -> dict[str, str]:
    """Stamps of existing files; several of one folder take a single listing.

    Raises:
        DeltaidError: the store cannot be reached.
    """
    stamps = dict[str, str]()
    folders = grouped(
        (path.rpartition("/")[0] if is_address(path) else "", path) for path in dict.fromkeys(paths)
    )
    for folder, files in folders.items():
        if folder and len(files) > 1:
            with suppress(FileNotFoundError):
                infos = _request(partial(_system(folder).ls, folder, detail=True), folder)
                listed = _stamps({info["name"]: info for info in infos}, folder)
                stamps |= {path: listed[path] for path in files if path in listed}
        else:
            stamps |= {path: stamp for path in files if (stamp := stamp_of(path))}
    return stamps


def stamp_of(path: str) -> str:
    """Stamp of a file; empty if it is missing.

    Raises:
        StoreError: the store cannot be reached.
    """
    if not is_address(path):
        try:
            status = os.stat(path)
        except (OSError, ValueError):  # no file, or a name that no file can have
            return ""
        return f"{status.st_size} {status.st_mtime_ns}" if S_ISREG(status.st_mode) else ""
    try:
        info = _request(lambda: _system(path).info(path), path)
        return _stamp(info) if info.get("type") == "file" else ""
    except (FileNotFoundError, NotADirectoryError):
        return ""


def is_folder(path: str) -> bool:
    """Whether a path is a folder on this machine."""
    return not is_address(path) and os.path.isdir(path)


@contextmanager
def local_file(path: str, stamp: str = "") -> Generator[Path]:
    """A local file with the contents of a path or address, as a context.

    Args:
        stamp: required stamp, if given.

    Raises:
        StoreError: the store cannot be reached, or the file is missing or changes.
    """
    if not is_address(path):
        _require_stamp(path, stamp, stamp and stamp_of(path))
        yield Path(path)
        _require_stamp(path, stamp, stamp and stamp_of(path))
        return
    with TemporaryDirectory(prefix="deltaid-") as folder:
        copy = Path(folder) / path.rpartition("/")[2]
        _request(lambda: _fetch(path, copy, stamp), path)
        yield copy


def read(path: str) -> bytes | None:
    """Bytes of a file; None if it is missing.

    Raises:
        StoreError: the store cannot be reached.
    """
    try:
        if not is_address(path):
            return Path(path).read_bytes()
        return _request(lambda: _system(path).cat_file(path), path)
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:  # ValueError: a NUL in a name
        raise StoreError(
            f"cannot be read: {getattr(error, 'strerror', None) or error}",
            where=path.replace("\0", "\\0"),
            cure="check its name and permissions",
        ) from None


def write(path: str, data: bytes) -> None:
    """Write a file, whole or not at all.

    Raises:
        DeltaidError: it cannot be written.
    """
    if not is_address(path):
        write_bytes(Path(path), data)
    else:
        _request(lambda: _system(path).pipe_file(path, data), path)


def listing(folder: str) -> dict[str, int]:
    """Sizes of all files in a folder and its subfolders [bytes], by their relative names.

    Raises:
        StoreError: the store cannot be reached.
    """
    if not is_address(folder):
        sizes = dict[str, int]()
        for path in Path(folder).rglob("*"):
            with suppress(FileNotFoundError):  # another call removes it just now
                if path.is_file():
                    sizes[path.relative_to(folder).as_posix()] = path.stat().st_size
        return sizes
    system = _system(folder)
    base = system._strip_protocol(folder).rstrip("/") + "/"
    files = _request(lambda: system.find(folder, detail=True), folder)
    return {name.removeprefix(base): int(info["size"] or 0) for name, info in files.items()}


def remove(path: str) -> None:
    """Remove a file, if it is there.

    Raises:
        StoreError: the store cannot be reached.
    """
    with suppress(FileNotFoundError):
        if is_address(path):
            _request(lambda: _system(path).rm_file(path), path)
        else:
            os.unlink(path)


def _system(path: str) -> Any:
    """The file system of an address.

    Raises:
        DeltaidError: no library for it is installed.
    """
    protocol = path.partition("://")[0]
    try:
        import fsspec

        return fsspec.filesystem(protocol, use_listings_cache=False)
    except (ImportError, ValueError) as error:
        raise DeltaidError(
            f"no library for {protocol}:// is installed: {error}",
            where=path,
            cure="install what fsspec asks for, such as s3fs for s3://",
        ) from None


def _fetch(path: str, copy: Path, stamp: str) -> None:
    system = _system(path)
    system.get_file(path, str(copy))
    after = system.info(path)
    _require_stamp(path, stamp, _stamp(after))
    if after.get("size") is not None and copy.stat().st_size != after["size"]:
        # The next attempt may get the whole file.
        raise OSError(f"came incomplete: {copy.stat().st_size} of {after['size']} bytes")


def _require_stamp(path: str, stamp: str, now: str) -> None:
    if stamp and now != stamp:
        raise StoreError(
            "has changed since it was listed",
            where=path,
            cure="call again when nobody writes to it",
        )


def _stamps(infos: Mapping[str, Mapping[str, Any]], address: str) -> dict[str, str]:
    protocol = f"{address.partition('://')[0]}://"
    return {
        f"{protocol}{name.removeprefix(protocol)}": _stamp(infos[name])
        for name in sorted(infos)
        if infos[name].get("type") == "file"
    }


def _stamp(info: Mapping[str, Any]) -> str:
    tag = next(
        (info[key] for key in ("ETag", "etag", "md5", "LastModified", "mtime") if info.get(key)), ""
    )
    return f"{info.get('size')} {tag}".strip()


def _failures() -> tuple[type[BaseException], ...]:
    """Errors of libraries of stores; most are OSErrors."""
    named = (("aiohttp", "ClientError"), ("botocore.exceptions", "BotoCoreError"),
             ("botocore.exceptions", "ClientError"))  # fmt: skip
    loaded = (getattr(sys.modules[name], error) for name, error in named if name in sys.modules)
    return (OSError, *loaded)


def _request(send: Callable[[], _Result], path: str) -> _Result:
    """Result of a request, repeated on failure.

    Raises:
        FileNotFoundError: the file is missing.
        StoreError: all attempts fail; with the store's message.
    """
    for k in range(_TRIES):
        try:
            return send()
        except FileNotFoundError:
            raise
        except _failures() as error:
            text = re.sub(r"\s+", " ", str(error))[:300] or type(error).__name__
            if k == _TRIES - 1 or isinstance(error, PermissionError):
                raise StoreError(
                    f"the store fails: {text}", where=path, cure="check address, rights and network"
                ) from None
            time.sleep(_WAIT * 2**k)
    raise AssertionError
