"""One recording in every kind of file that is read."""

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import h5py
import numpy as np
import polars as pl
import scipy.io

import bags
import scopes
from deltaid.recording.mapping import ColumnMapping
from logs import recorded, write

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


def structured() -> np.ndarray:
    array = np.zeros(len(T), dtype=[("t", "f8"), ("q", "f8", (3,)), ("tau", "f8", (3,))])
    array["t"], array["q"], array["tau"] = T, Q, TAU
    return array


def bag(kind: str) -> Callable[[Path], object]:
    """How to write a bag of that kind, with three joints."""

    def save(path: Path) -> None:
        with TemporaryDirectory() as folder:
            messages = bags.states(
                T, {"position": Q, "effort": TAU}, ["joint1", "joint2", "joint3"]
            )
            shutil.move(bags.KINDS[kind](Path(folder), messages), path)

    return save


def scope(**how: bool) -> Callable[[Path], object]:
    """How to write an export of TwinCAT Scope."""
    time, names = np.round(1000 * T, 6), FRAME.columns[1:]
    curves = [scopes.Curve(name, time, ROWS[:, k + 1]) for k, name in enumerate(names)]
    return lambda path: path.write_text(scopes.scope(curves, **how), encoding="utf-8")


@dataclass(frozen=True)
class Kind:
    """How a kind of file is written, under which name, and the mapping that it needs."""

    name: str
    save: Callable[[Path], object]
    columns: ColumnMapping | None = None


LISTS = pl.DataFrame({"t": T, "q": pl.Series(Q.tolist()), "tau": pl.Series(TAU.tolist())})
ARRAYS = LISTS.with_columns(pl.col("q", "tau").cast(pl.Array(pl.Float64, 3)))
KINDS = {
    "CSV": Kind("log.csv", lambda p: write(p, FRAME)),
    "Parquet": Kind("log.parquet", lambda p: write(p, FRAME)),
    "Parquet of lists": Kind("log.parquet", lambda p: write(p, LISTS)),
    "Parquet of arrays": Kind("log.parquet", lambda p: write(p, ARRAYS)),
    "npz": Kind("log.npz", lambda p: np.savez(p, t=T, q=Q, tau=TAU)),
    "npz, packed": Kind("log.npz", lambda p: np.savez_compressed(p, time=T, q=Q, tau=TAU)),
    "npz by columns": Kind("log.npz", lambda p: np.savez_compressed(p, t=T, q=Q.T, tau=TAU.T)),
    "npz in Fortran's order": Kind(
        "log.npz", lambda p: np.savez(p, t=T, q=np.asfortranarray(Q), tau=np.asfortranarray(TAU))
    ),
    "npz, structured": Kind("log.npz", lambda p: np.savez(p, log=structured()), in_group("log.")),
    "npy": Kind(
        "log.npy",
        lambda p: np.save(p, ROWS),
        mapping(
            time={"column": "array[0]"},
            position={"columns": ["array[1]", "array[2]", "array[3]"], "unit": "rad"},
            torque={"columns": ["array[4]", "array[5]", "array[6]"], "unit": "N m"},
        ),
    ),
    "npy, structured": Kind("log.npy", lambda p: np.save(p, structured())),
    "HDF5": Kind("log.h5", lambda p: hdf5(p)),
    "HDF5, newest": Kind("log.h5", lambda p: hdf5(p, libver="latest")),
    "HDF5 in chunks": Kind(
        "log.h5",
        lambda p: hdf5(p, base="run/7/", chunks=True, compression="gzip", shuffle=True),
        in_group("run/7/"),
    ),
    "HDF5 by columns": Kind("log.h5", lambda p: hdf5(p, by_columns=True)),
    "MAT 7.3": Kind("log.mat", matlab_73, in_group("log.")),
    "MAT 5": Kind("log.mat", lambda p: scipy.io.savemat(p, {"t": T, "q": Q, "tau": TAU})),
    "MAT 5 in columns": Kind(
        "log.mat", lambda p: scipy.io.savemat(p, {"t": T[:, None], "q": Q.T, "tau": TAU.T})
    ),
    "MAT 7": Kind(
        "log.mat",
        lambda p: scipy.io.savemat(
            p, {"log": {"t": T, "q": Q, "tau": TAU, "s": "text"}}, do_compression=True
        ),
        in_group("log."),
    ),
    "ROS 1 bag": Kind("log.bag", bag("ros1")),
    "ROS 1 bag, lz4": Kind("log.bag", bag("ros1-lz4")),
    "ROS 2 bag, SQLite": Kind("log.db3", bag("db3")),
    "ROS 2 bag, SQLite, zstd": Kind("log.db3.zstd", bag("db3-zstd")),
    "MCAP": Kind("log.mcap", bag("mcap")),
    "MCAP, lz4": Kind("log.mcap", bag("mcap-lz4")),
    "TwinCAT Scope": Kind("log.txt", scope()),
    "TwinCAT Scope, shared times": Kind("log.txt", scope(shared=True)),
}
