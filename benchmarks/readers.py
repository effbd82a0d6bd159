"""Time and memory of reading one recording in every kind of file: python benchmarks/readers.py.

Each file is read in a process of its own, all columns in SI units, once; memory is the largest that
the process had, less what it had before it opened the file. The table is of the time before bags
and exports of TwinCAT Scope were among the kinds.
"""

import gzip
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from statistics import median

import h5py
import numpy as np
import polars as pl
import scipy.io
from _table import STATED, leave
from _timing import options

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
DRIVES = 4
# Samples that are written as messages at once.
_PART = 10_000
_ENDS = 4


def frame(samples: int) -> pl.DataFrame:
    """Numbers with 53 random bits, which no compression makes much smaller."""
    rng = np.random.default_rng(1)
    columns = {"t": np.arange(samples) / 1000}
    for name in ("q", "tau"):
        columns |= {f"{name}{i + 1}": rng.standard_normal(samples) for i in range(DRIVES)}
    return pl.DataFrame(columns)


def arrays(table: pl.DataFrame) -> dict[str, np.ndarray]:
    """Arrays t, q and tau, samples by drives."""
    q, tau = (table.select(pl.col(f"^{x}\\d$")).to_numpy(order="c") for x in ("q", "tau"))
    return {"t": table["t"].to_numpy(), "q": q, "tau": tau}


def _csv(table: pl.DataFrame, path: Path, change: Callable[[bytes], bytes] = bytes) -> None:
    path.write_bytes(change(table.write_csv().encode()))


def _zstd(data: bytes) -> bytes:
    import zstandard

    return zstandard.compress(data)


def _by_samples(table: pl.DataFrame, path: Path) -> None:
    np.savez(path, **{name: np.ascontiguousarray(a.T) for name, a in arrays(table).items()})


def _dated(table: pl.DataFrame, path: Path) -> None:
    lists = {name: pl.concat_list(f"^{name}\\d$") for name in ("q", "tau")}
    stamps = (1e6 * pl.col("t")).round().cast(pl.Int64).cast(pl.Datetime("us"))
    table.select(t=stamps, **lists).write_parquet(path)


def _hdf5(table: pl.DataFrame, path: Path, **how: object) -> None:
    with h5py.File(path, "w") as file:
        for name, array in arrays(table).items():
            file.create_dataset(name, data=array, **how)


def _matlab_73(table: pl.DataFrame, path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays(table).items():
            held = np.atleast_2d(array.T)
            chunks = (len(held), 1 << 14)
            file.create_dataset(name, data=held, chunks=chunks, compression="gzip")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")


def _bag(kind: str) -> Callable[[pl.DataFrame, Path], None]:
    """As a bag with joints joint1, …, a message a sample."""

    def save(table: pl.DataFrame, path: Path) -> None:
        import bags

        held, joints = arrays(table), [f"joint{i + 1}" for i in range(DRIVES)]
        messages = (
            message
            for first in range(0, len(table), _PART)
            for message in bags.states(
                held["t"][first : first + _PART],
                {
                    "position": held["q"][first : first + _PART],
                    "effort": held["tau"][first : first + _PART],
                },
                joints,
            )
        )
        bags.KINDS[kind](path.parent, messages).rename(path)

    return save


def _scope(every: int) -> Callable[[pl.DataFrame, Path], None]:
    """As an export of TwinCAT Scope, with torques in every so-manieth millisecond."""

    def save(table: pl.DataFrame, path: Path) -> None:
        import scopes

        curves: list[scopes.Curve] = []
        for name in table.columns[1:]:
            step = every if name.startswith("tau") else 1
            time = np.arange(0.0, len(table), step)
            curves.append(scopes.Curve(name, time, table[name].to_numpy()[::step]))
        path.write_text(scopes.scope(curves), encoding="utf-8")

    return save


# Names of kinds, of files, and how these are written.
WRITERS: dict[str, tuple[str, Callable[[pl.DataFrame, Path], object]]] = {
    "CSV": ("log.csv", _csv),
    "CSV, gzip": ("log.csv.gz", partial(_csv, change=partial(gzip.compress, compresslevel=6))),
    "CSV, zstd": ("log.csv.zst", partial(_csv, change=_zstd)),
    "CSV, UTF-16": ("log.csv", partial(_csv, change=lambda d: d.decode().encode("utf-16"))),
    "Parquet": ("log.parquet", lambda f, p: f.write_parquet(p)),
    "Parquet, dates and lists": ("log.parquet", _dated),
    "npz": ("log.npz", lambda f, p: np.savez(p, **arrays(f))),
    "npz, compressed": ("log.npz", lambda f, p: np.savez_compressed(p, **arrays(f))),
    "npz, drives by samples": ("log.npz", _by_samples),
    "npy, structured": ("log.npy", lambda f, p: np.save(p, f.to_numpy(structured=True))),
    "HDF5": ("log.h5", _hdf5),
    "HDF5, gzip": ("log.h5", partial(_hdf5, chunks=True, compression="gzip", shuffle=True)),
    "MATLAB 5": ("log.mat", lambda f, p: scipy.io.savemat(p, arrays(f))),
    "MATLAB 7": ("log.mat", lambda f, p: scipy.io.savemat(p, arrays(f), do_compression=True)),
    "MATLAB 7.3": ("log.mat", _matlab_73),
    "ROS 1 bag": ("log.bag", _bag("ros1")),
    "ROS 2 bag, SQLite": ("log.db3", _bag("db3")),
    "MCAP, lz4": ("log.mcap", _bag("mcap-lz4")),
    "TwinCAT Scope": ("log.txt", _scope(1)),
    "TwinCAT Scope, two clocks": ("log.txt", _scope(4)),
}


def main() -> None:
    stated = STATED["readers"]
    given = options(__doc__, samples=stated["samples"], repeats=stated["repeats"], read=Path)
    if given.read:
        print(json.dumps(_read(given.read)))
        return
    table, rows = frame(given.samples), []
    for kind, (name, save) in WRITERS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / name
            save(table, path)
            command = [sys.executable, __file__, "--read", str(path)]
            runs = [
                json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
                for _ in range(given.repeats)
            ]
            # Where a slow channel ends before a fast one, so do the samples of both.
            if any(run["samples"] < given.samples - _ENDS for run in runs):
                raise RuntimeError(f"{kind}: not all samples were read")
            size = path.stat().st_size / 1e6
        cpu, peak = (median(run[key] for run in runs) for key in ("cpu", "megabytes"))
        rows.append((kind, f"{size:.0f}", f"{cpu:.2f}", f"{peak:.0f}"))
    note = (
        f"Reading {given.samples:,} samples of {DRIVES} drives (time, positions, torques: "
        f"{table.estimated_size() / 1e6:.0f} MB of numbers) once, checks of the recording not "
        f"included; median of {given.repeats}."
    )
    head = ("kind of file", "file, MB", "CPU s", "peak MB")
    leave(head, rows, note, samples=given.samples, repeats=given.repeats)


def _read(path: Path) -> dict[str, float]:
    """Time, memory and samples of reading one file."""
    import_module("deltaid.recording.recording")  # what every command loads
    from damage import largest_memory
    from deltaid.recording.resolution import resolve_columns
    from deltaid.recording.table import open_table, read_batches

    before, start = largest_memory(), time.process_time()
    table = open_table(path)
    columns = resolve_columns(table, (False,) * DRIVES)
    samples = sum(len(batch) for batch in read_batches(table, columns))
    cpu = time.process_time() - start
    return {"samples": samples, "cpu": cpu, "megabytes": largest_memory() - before}


if __name__ == "__main__":
    main()
