"""Files as a stream of bytes, text in UTF-8, whether they lie compressed on the disk or in UTF-16.

Memory stays flat: a file is unpacked and transcoded chunk by chunk, each time it is read.
"""

import codecs
import io
import sys
import zlib
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from deltaid.errors import RecordingError
from deltaid.recording.source import opened

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

# Bytes read at once: few, because a chunk may unpack to a thousand times its size.
_CHUNK = 1 << 14
_GZIP = b"\x1f\x8b"
ZSTD = b"\x28\xb5\x2f\xfd"
_UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# One member of a gzip file or one frame of a zstd file: each library has a class of its own.
_Unpacker = Any


@contextmanager
def content(path: Path) -> Generator[io.BufferedReader, None, None]:
    """A log open for reading, without its compression and in UTF-8 if it is in UTF-16.

    Raises:
        RecordingError: it cannot be read, its compressed data is damaged or cut off, or the library
            for it is missing.
    """
    with opened(path) as file:
        stream = file
        start = stream.peek(4)
        if start.startswith(_GZIP):
            chunks = _unpacked(stream, path, "gzip", lambda: zlib.decompressobj(31), zlib.error)
            stream = _buffered(chunks)
        elif start.startswith(ZSTD):
            chunks = _unpacked(stream, path, "zstd", *_zstd(path))
            stream = _buffered(chunks)
        if stream.peek(2).startswith(_UTF_16):
            stream = _buffered(_transcoded(stream))
        yield stream


def packed_by(path: Path) -> str:
    """What a file is compressed by; empty if it is not."""
    with opened(path) as file:
        start = file.peek(4)
    return "gzip" if start.startswith(_GZIP) else "zstd" if start.startswith(ZSTD) else ""


def skip(stream: io.BufferedReader, size: int) -> None:
    """Go on by a number of bytes."""
    if stream.seekable():
        stream.seek(size, io.SEEK_CUR)
        return
    while size and (read := len(stream.read(min(size, 1 << 20)))):
        size -= read


def unzstd(data: bytes, path: Path) -> bytes:
    """One piece of a file that is compressed by zstd for itself.

    Raises:
        RecordingError: it is damaged, or the library for it is missing.
    """
    new, damaged = _zstd(path)
    try:
        return new().decompress(data)
    except damaged as error:
        raise _damaged(path, f"has damaged zstd data: {error}") from None


class _Chunks(io.RawIOBase):
    def __init__(self, chunks: Iterator[bytes]) -> None:
        self._chunks = chunks
        self._rest = b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: "WriteableBuffer", /) -> int:
        while not self._rest:
            chunk = next(self._chunks, None)
            if chunk is None:
                return 0
            self._rest = chunk
        view = memoryview(buffer)
        size = min(len(view), len(self._rest))
        view[:size] = self._rest[:size]
        self._rest = self._rest[size:]
        return size


def _buffered(chunks: Iterator[bytes]) -> io.BufferedReader:
    return cast("io.BufferedReader", io.BufferedReader(_Chunks(chunks)))


def _unpacked(
    file: io.BufferedReader,
    path: Path,
    kind: str,
    new: Callable[[], _Unpacker],
    damaged: type[Exception],
) -> Iterator[bytes]:
    """What compressed data holds; members and frames that follow one another are joined."""
    unpacker: Any = None
    while data := file.read(_CHUNK):
        # Files from tapes and some loggers are filled up with zeros.
        while data and (unpacker or data.strip(b"\0")):
            unpacker = unpacker or new()
            try:
                yield unpacker.decompress(data)
            except damaged as error:
                raise _damaged(path, f"is a damaged {kind} file: {error}") from None
            data = unpacker.unused_data if unpacker.eof else b""
            unpacker = None if unpacker.eof else unpacker
    if unpacker:
        raise _damaged(path, f"is a {kind} file that is cut off")


def _damaged(path: Path, what: str) -> RecordingError:
    return RecordingError(what, where=str(path), cure="copy or export it again")


def _zstd(path: Path) -> tuple[Callable[[], _Unpacker], type[Exception]]:
    if sys.version_info >= (3, 14):
        from compression import zstd

        return zstd.ZstdDecompressor, zstd.ZstdError
    try:
        import zstandard
    except ModuleNotFoundError:
        raise RecordingError(
            "is compressed by zstd, and the library zstandard is not installed",
            where=str(path),
            cure="pip install zstandard, or unpack it by `zstd -d`",
        ) from None
    return zstandard.ZstdDecompressor().decompressobj, zstandard.ZstdError


def _transcoded(file: io.BufferedReader) -> Iterator[bytes]:
    decoder = codecs.getincrementaldecoder("utf-16")(errors="replace")
    while data := file.read1(1 << 16):
        yield decoder.decode(data).encode()
    yield decoder.decode(b"", final=True).encode()
