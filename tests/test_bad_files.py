"""A file that is no log, is damaged or cannot be read, or whose library fails, gets one message.

`benchmarks/damaged_files.py` damages hundreds of files of each kind.
"""

import bz2
import errno
import gzip
import io
import lzma
import os
import random
import subprocess
import sys
import tarfile
from pathlib import Path

import numpy as np
import pytest
import zstandard

from bad_logs import GOOD, ROWS, with_field
from damage import complaint, damaged, outcome
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DeltaidError
from deltaid.recording import log as surveyed
from deltaid.recording.formats.matlab import DamagedMatError, Numbers
from kinds_of_files import KINDS
from kinds_of_files import ROWS as SAVED
from logs import read, recorded, refusal, write

FOREIGN = {
    "binary": (bytes(range(256)) * 8, "row 1: is not text"),
    "endless line": (b"t" * (2 << 20), "row 1: is too long"),
    "UTF-16 with a bad field": (
        with_field(150, "q2", "x").encode("utf-16"),
        "row 150: column q2 is 'x'",
    ),
    "UTF-16 cut off": (GOOD.encode("utf-16")[:-41], f"row {ROWS + 1}: "),
    "Excel": (b"PK\x03\x04" + bytes(100), "is an Excel workbook"),
    "JSON of rows": (b'\xef\xbb\xbf[ {"t": 0.0, "q1": 0.1}, {"t": 0.001, "q1": 0.1}]', "is JSON"),
    "JSON of columns": (b'{\n"t": [0.0, 0.001], "q1": [0.1, 0.2]}', "is JSON"),
    "JSON of arrays": (b"[[0.0, 0.1], [0.001, 0.2]]", "is JSON"),
    "xz": (lzma.compress(GOOD.encode()), "is a file compressed by xz\n  → unpack it"),
    "bzip2": (bz2.compress(GOOD.encode()), "is a file compressed by bzip2\n  → unpack it"),
    "tar inside gzip": (
        gzip.compress(tarfile.TarInfo("log.csv").tobuf() + GOOD.encode()),
        "is a tar archive\n  → unpack it",
    ),
    "names in Chinese": (
        GOOD.replace("q", "位置").encode("gb18030"),
        "→ save the file as UTF-8, in which its names are not; or rename",
    ),
    "page": (b"\n<!DOCTYPE html><html>login</html>", "is XML or a web page"),
    "MATLAB": (b"MATLAB 5.0 MAT-file" + bytes(200), "is a damaged MATLAB file"),
    "HDF5": (b"\x89HDF\r\n\x1a\n" + bytes(100), "is a damaged HDF5 file"),
    "gzip cut off": (gzip.compress(GOOD.encode())[:-20], "is a gzip file that is cut off"),
    "gzip with a wrong checksum": (
        gzip.compress(GOOD.encode())[:-8] + bytes(8),
        "is a damaged gzip file",
    ),
    "gzip of MATLAB": (
        gzip.compress(b"MATLAB 5.0 MAT-file" + bytes(200)),
        "is a MATLAB file inside gzip\n  → unpack it",
    ),
    "zstd cut off": (zstandard.compress(GOOD.encode())[:-20], "is a zstd file that is cut off"),
    "endless line of data": (
        b"t,q1,q2,q3,tau1,tau2,tau3\n" + b"1" * (6 << 20),
        "row 2: is too long",
    ),
}


@pytest.mark.parametrize("name", FOREIGN)
def test_files_that_are_no_csv(tmp_path, opened, name: str) -> None:
    content, fragment = FOREIGN[name]
    path = write(tmp_path / "log.csv", content)
    message = refusal(opened, path)
    assert message.startswith(str(path))
    assert fragment in message


def test_zstd_without_its_library(tmp_path, opened, monkeypatch) -> None:
    path = write(tmp_path / "log.csv.zst", zstandard.compress(GOOD.encode()))
    monkeypatch.setitem(sys.modules, "zstandard", None)
    assert "pip install zstandard" in refusal(opened, path)


def test_damaged_compressed_logs_are_refused(tmp_path, opened) -> None:
    rng = random.Random(3)
    for compress in (gzip.compress, zstandard.ZstdCompressor(write_checksum=True).compress):
        whole = compress(GOOD.encode())
        for _ in range(30):
            data = bytearray(whole)
            data[rng.randrange(12, len(data) - 8)] ^= 1 << rng.randrange(8)
            path = write(tmp_path / "log.csv", bytes(data))
            message = refusal(opened, path)
            assert message.startswith(str(path))
            assert "→" in message


def test_no_file(tmp_path, opened) -> None:
    assert "no such file" in refusal(opened, tmp_path / "nothing.csv")
    assert "is a folder" in refusal(opened, tmp_path)
    assert "cannot be read" in refusal(opened, tmp_path / ("x" * 300))
    os.mkfifo(tmp_path / "pipe")
    assert "is no regular file" in refusal(opened, tmp_path / "pipe")


def test_no_permission(tmp_path, opened, monkeypatch) -> None:
    path = write(tmp_path / "log.csv", GOOD)

    def denied(*_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(io, "open", denied)  # as root, no permission stops anyone
    message = refusal(opened, path)
    reason = f"{path}: cannot be read: Permission denied"
    assert message == f"{reason}\n  → check its name and permissions"


def test_files_that_change_between_two_passes(tmp_path, opened, monkeypatch) -> None:
    """A log too long to be kept in memory is read again; any other one is not."""
    path = write(tmp_path / "log.csv", GOOD)
    short = opened(path)
    monkeypatch.setattr(surveyed, "_MOST_NUMBERS", 0)
    long = opened(path)
    path.unlink()
    assert sum(len(batch) for batch in short.batches()) == ROWS
    with pytest.raises(DeltaidError, match="no such file"):
        list(long.batches())


def test_a_library_that_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "log.h5"
    KINDS["HDF5"].save(path)
    monkeypatch.setitem(sys.modules, "h5py", None)
    message = refusal(read, path)
    assert "is an HDF5 file, and the library h5py that reads it is not installed" in message
    assert "pip install h5py" in message


def test_libraries_are_loaded_when_they_are_needed(tmp_path: Path) -> None:
    log = write(tmp_path / "log.csv", recorded(300))
    code = (
        "import sys, pathlib, deltaid.recording.table as t;"
        f"t.open_table(pathlib.Path({str(log)!r}));"
        "assert not {'h5py', 'scipy.io', 'zstandard', 'pandas'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_process_that_is_aborted_says_why() -> None:
    code = (
        "import os; from deltaid.recording.formats.frames import last_words\n"
        "with last_words('log: is damaged', 2): pass\n"
        "with last_words('log: is damaged', 2): os.abort()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, "error: log: is damaged\n")


COUNT = 6


@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files(tmp_path: Path, clavel: Dynamics, kind: str) -> None:
    of, path, rng = KINDS[kind], tmp_path / KINDS[kind].name, random.Random(11)
    of.save(path)
    data = path.read_bytes()
    ends = set()
    for _ in range(COUNT):
        path.write_bytes(damaged(data, rng))
        found = outcome(path, of.columns, SAVED, clavel.kinematics)
        assert not complaint(found, path)
        ends.add(found.end)
    assert "refused" in ends


def test_an_array_of_a_mat_file_that_ends_behind_its_variable_is_refused() -> None:
    data = memoryview(np.arange(6.0).tobytes())
    np.testing.assert_array_equal(Numbers(8, "<f8", (5,)).array(data), np.arange(1.0, 6.0))
    with pytest.raises(DamagedMatError, match="6 numbers ends behind the end of its variable"):
        Numbers(8, "<f8", (6,)).array(data)
