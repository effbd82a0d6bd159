"""Libraries that read some kinds of files: loaded when needed, missing, ended by a damaged file."""

import subprocess
import sys
from pathlib import Path

import pytest

from kinds_of_files import KINDS
from logs import read, recorded, refusal, write


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


def test_a_process_that_is_aborted_says_why(tmp_path: Path) -> None:
    code = (
        "import os; from deltaid.recording.formats.parquet import last_words\n"
        "with last_words('log: is damaged', 2): pass\n"
        "with last_words('log: is damaged', 2): os.abort()"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (2, "error: log: is damaged\n")
