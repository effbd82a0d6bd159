"""One recording in every kind of file, and the addresses of what files hold."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pytest
import scipy.io

from deltaid.recording.columns import ColumnMapping
from logs import read, recorded, write

FRAME = recorded(1500)
ROWS = FRAME.to_numpy()
T, Q, TAU = ROWS[:, 0], ROWS[:, 1:4], ROWS[:, 4:7]


def mapping(**given: object) -> ColumnMapping:
    return ColumnMapping.model_validate(given)


def in_group(base: str) -> ColumnMapping:
    """The mapping for arrays t, q, tau below a group or struct."""
    return mapping(
        time={"column": f"{base}t"},
        position={"column": f"{base}q", "unit": "rad"},
        torque={"column": f"{base}tau", "unit": "N m"},
    )


def hdf5(path: Path, by_columns: bool = False, base: str = "", libver: str = "earliest", **how):
    with h5py.File(path, "w", libver=libver) as file:
        for key, value in (("t", T), ("q", Q), ("tau", TAU)):
            array = value.T if by_columns else value
            file.create_dataset(f"{base}{key}", data=array, **how)


def matlab_73(path: Path) -> None:
    """As MATLAB writes a struct by `save -v7.3`: transposed, classes as attributes, a preamble."""
    with h5py.File(path, "w", userblock_size=512) as file:
        log = file.create_group("log")
        log.attrs["MATLAB_class"] = np.bytes_("struct")
        for key, value in (("t", T[None]), ("q", Q.T), ("tau", TAU.T)):
            log.create_dataset(key, data=value, chunks=True, compression="gzip")
            log[key].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\x00\x02IM")


def structured(frame: pl.DataFrame) -> np.ndarray:
    array = np.zeros(len(T), dtype=[("t", "f8"), ("q", "f8", (3,)), ("tau", "f8", (3,))])
    array["t"], array["q"], array["tau"] = T, Q, TAU
    return array


# How a file is written, and the mapping that it needs.
LISTS = pl.DataFrame({"t": T, "q": pl.Series(Q.tolist()), "tau": pl.Series(TAU.tolist())})
ARRAYS = LISTS.with_columns(pl.col("q", "tau").cast(pl.Array(pl.Float64, 3)))
KINDS: dict[str, tuple[str, Callable[[Path], object], ColumnMapping | None]] = {
    "CSV": ("log.csv", lambda p: write(p, FRAME), None),
    "Parquet": ("log.parquet", lambda p: write(p, FRAME), None),
    "Parquet of lists": ("log.parquet", lambda p: write(p, LISTS), None),
    "Parquet of arrays": ("log.parquet", lambda p: write(p, ARRAYS), None),
    "npz": ("log.npz", lambda p: np.savez(p, t=T, q=Q, tau=TAU), None),
    "npz, packed": ("log.npz", lambda p: np.savez_compressed(p, time=T, q=Q, tau=TAU), None),
    "npz by columns": ("log.npz", lambda p: np.savez_compressed(p, t=T, q=Q.T, tau=TAU.T), None),
    "npz in Fortran's order": (
        "log.npz",
        lambda p: np.savez(p, t=T, q=np.asfortranarray(Q), tau=np.asfortranarray(TAU)),
        None,
    ),
    "npz, structured": ("log.npz", lambda p: np.savez(p, log=structured(FRAME)), in_group("log.")),
    "npy": (
        "log.npy",
        lambda p: np.save(p, ROWS),
        mapping(
            time={"column": "array[0]"},
            position={"columns": ["array[1]", "array[2]", "array[3]"], "unit": "rad"},
            torque={"columns": ["array[4]", "array[5]", "array[6]"], "unit": "N m"},
        ),
    ),
    "npy, structured": ("log.npy", lambda p: np.save(p, structured(FRAME)), None),
    "HDF5": ("log.h5", lambda p: hdf5(p), None),
    "HDF5, newest": ("log.h5", lambda p: hdf5(p, libver="latest"), None),
    "HDF5 in chunks": (
        "log.h5",
        lambda p: hdf5(p, base="run/7/", chunks=True, compression="gzip", shuffle=True),
        in_group("run/7/"),
    ),
    "HDF5 by columns": ("log.h5", lambda p: hdf5(p, by_columns=True), None),
    "MAT 7.3": ("log.mat", matlab_73, in_group("log.")),
    "MAT 5": ("log.mat", lambda p: scipy.io.savemat(p, {"t": T, "q": Q, "tau": TAU}), None),
    "MAT 5 in columns": (
        "log.mat",
        lambda p: scipy.io.savemat(p, {"t": T[:, None], "q": Q.T, "tau": TAU.T}),
        None,
    ),
    "MAT 7": (
        "log.mat",
        lambda p: scipy.io.savemat(
            p, {"log": {"t": T, "q": Q, "tau": TAU, "s": "text"}}, do_compression=True
        ),
        in_group("log."),
    ),
}


@pytest.mark.parametrize("kind", KINDS)
def test_one_recording_in_every_kind_of_file(tmp_path: Path, kind: str) -> None:
    name, save, columns = KINDS[kind]
    save(tmp_path / name)
    np.testing.assert_array_equal(read(tmp_path / name, columns), ROWS)
