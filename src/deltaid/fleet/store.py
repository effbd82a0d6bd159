"""Files of any place that fsspec knows: on this machine, on S3, and others."""

import glob
import os
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from deltaid.errors import DeltaidError, RecordingError
from deltaid.robot.load import catalogue

_MAGIC = "*?["


def is_address(path: str) -> bool:
    """Whether a name is an address such as s3://bucket/key and no path."""
    return "://" in path


@dataclass(frozen=True)
class Store:
    """Where recordings lie.

    Attributes:
        options: of fsspec, by protocol, such as {"s3": {"endpoint_url": …}}; secrets come from the
            environment as its libraries find them there.
    """

    options: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def matching(self, pattern: str, folder: Path) -> list[str]:
        """Files that a path, an address or a pattern stands for, sorted; none if there are none.

        Raises:
            DeltaidError: the store cannot be reached.
        """
        if not is_address(pattern):
            path = self._local(pattern, folder)
            if not any(sign in pattern for sign in _MAGIC):
                return [path] if os.path.isfile(path) else []
            return sorted(one for one in glob.glob(path, recursive=True) if os.path.isfile(one))
        protocol = pattern.partition("://")[0]
        system = self._system(protocol)
        with self._told(pattern):
            if any(sign in pattern for sign in _MAGIC):
                return sorted(f"{protocol}://{one}" for one in system.glob(pattern))
            return [pattern] if system.isfile(pattern) else []

    def beside(self, name: str, folder: Path) -> str:
        """A description or mapping: a catalogue's name, an address, or a path from a folder."""
        if name in catalogue() or is_address(name):
            return name
        return self._local(name, folder)

    @contextmanager
    def local(self, path: str) -> Generator[Path]:
        """A file on this machine with the contents of a path or address, for as long as needed.

        Raises:
            DeltaidError: the store cannot be reached, or has no such file.
        """
        if not is_address(path):
            yield Path(path)
            return
        system = self._system(path.partition("://")[0])
        with TemporaryDirectory(prefix="deltaid-") as folder:
            copy = Path(folder) / path.rpartition("/")[2]
            with self._told(path):
                system.get_file(path, str(copy))
                size = system.size(path)
            if size is not None and copy.stat().st_size != size:
                raise RecordingError(
                    f"came incomplete: {copy.stat().st_size} of {size} bytes",
                    where=path,
                    cure="call the command again",
                )
            yield copy

    def stamp(self, path: str) -> str:
        """What changes when a file does, without reading it: its size and time or entity tag.

        Raises:
            RecordingError: there is no such file, or the store cannot be reached.
        """
        with self._told(path):
            if not is_address(path):
                found = os.stat(path)
                return f"{found.st_size} {found.st_mtime_ns}"
            info = self._system(path.partition("://")[0]).info(path)
        tag = info.get("ETag") or info.get("etag") or info.get("LastModified") or info.get("mtime")
        return f"{info.get('size')} {tag}"

    def _local(self, name: str, folder: Path) -> str:
        path = Path(name).expanduser()
        return str(path if path.is_absolute() else folder / path)

    def _system(self, protocol: str) -> Any:
        import fsspec

        try:
            return fsspec.filesystem(protocol, **self.options.get(protocol, {}))
        except (ImportError, ValueError) as error:
            raise DeltaidError(
                f"no library for {protocol}:// is installed: {error}",
                where=f"{protocol}://",
                cure="install what fsspec asks for, such as s3fs for s3://",
            ) from None

    @contextmanager
    def _told(self, path: str) -> Generator[None]:
        """What a store says when it cannot, in words."""
        try:
            yield
        except FileNotFoundError:
            raise RecordingError("no such file", where=path, cure="check the manifest") from None
        except OSError as error:
            raise RecordingError(
                f"cannot be read: {error}", where=path, cure="check the address, rights and network"
            ) from None
