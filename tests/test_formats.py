"""One recording in every kind of file, and the addresses of what files hold."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

from deltaid.recording.mapping import ColumnMapping
from kinds_of_files import KINDS, ROWS, TAU, Q, T
from logs import read, recorded, refusal, write


@pytest.mark.parametrize("kind", KINDS)
def test_one_recording_in_every_kind_of_file(tmp_path: Path, kind: str) -> None:
    of, path = KINDS[kind], tmp_path / KINDS[kind].name
    of.save(path)
    np.testing.assert_array_equal(read(path, of.columns), ROWS)


def saved(path: Path, **arrays: object) -> Path:
    np.savez(path, **arrays)
    return path


def declared(**keys: object) -> ColumnMapping:
    """A mapping of positions that differ from the default, with everything else as by default."""
    return ColumnMapping.model_validate({"position": keys})


CUBE = np.stack([Q, -Q, 2 * Q], axis=2)
ADDRESSES = {
    "array": ({"q": Q}, {"column": "q"}),
    "columns, reordered by name": ({"a": Q[:, ::-1]}, {"columns": ["a[2]", "a[1]", "a[0]"]}),
    "axes named": ({"a": Q}, {"columns": ["a[:,0]", "a[:, 1]", "a[ : ,2]"]}),
    "axes named, drives by samples": ({"a": Q.T}, {"columns": ["a[0,:]", "a[1,:]", "a[2,:]"]}),
    "three axes": ({"a": CUBE}, {"columns": ["a[:,0,0]", "a[:,1,0]", "a[:,2,0]"]}),
    "axes of length one": ({"a": Q[:, None, :]}, {"column": "a"}),
    "vectors of all shapes": (
        {"a": Q[:, 0], "b": Q[:, [1]], "c": Q[:, 2][None, None]},
        {"columns": ["a[0]", "b", "c[0]"]},
    ),
    "brackets in a name": (
        {"q[0]": Q[:, 0], "q[1]": Q[:, 1], "q[2]": Q[:, 2], "q": Q + 1},
        {"column": "q"},
    ),
    "big-endian singles": ({"q": Q.astype(">f4")}, {"column": "q"}),
    "counts": ({"n": np.round(Q * 1e4).astype(np.int16)}, {"column": "n", "unit": "1e-4 rad"}),
    "one a drive": (
        {"n": Q * [2, -1, 4] + [1, 2, 3]},
        {"column": "n", "gear": [2, 1, 4], "sign": [1, -1, 1], "zero": [1, 2, 3]},
    ),
}


@pytest.mark.parametrize("case", ADDRESSES)
def test_addresses(tmp_path: Path, case: str) -> None:
    arrays, keys = ADDRESSES[case]
    path = saved(tmp_path / "log.npz", t=T, tau=TAU, **arrays)
    values = read(path, declared(**{"unit": "rad"} | keys))
    exact = not {"singles", "counts", "drive"} & set(case.split())
    np.testing.assert_allclose(values, ROWS, atol=0 if exact else 3e-4, rtol=0 if exact else 1e-6)


def test_a_square_array_has_samples_in_rows(tmp_path: Path) -> None:
    path = saved(tmp_path / "log.npz", t=T[:3], q=Q[:3], tau=TAU[:3])
    np.testing.assert_array_equal(read(path), ROWS[:3])
    columns = ["q[0,:]", "q[1,:]", "q[2,:]"]
    values = read(path, declared(columns=columns, unit="rad"))
    np.testing.assert_array_equal(values[:, 1:4], Q[:3].T)


WRONG_ADDRESSES = [
    (
        {"column": "p", "unit": "rad"},
        "no column p[0], p[1], p[2]; its columns are t (1500), q (1500 × 3)",
    ),
    ({"columns": ["q[0]", "q[1]", "q[3]"], "unit": "rad"}, "there is no q[3]: it has 3 columns"),
    ({"columns": ["q[0]", "q[1]", "q"], "unit": "rad"}, "q has 3 columns\n  → say which one: q[0]"),
    ({"columns": ["q[0]", "q[1]", "q[-1]"], "unit": "rad"}, "q has no column '-1'"),
    ({"columns": ["q[0]", "q[1]", "q[:,3]"], "unit": "rad"}, "there is no q[:,3]: it is q ("),
    ({"columns": ["q[0]", "q[1]", "q[:,:]"], "unit": "rad"}, "there is no q[:,:]"),
    ({"columns": ["q[0]", "q[1]", "q[0,:]"], "unit": "rad"}, "q[0,:] has 3 samples, but t has"),
    ({"columns": ["t[1]", "q[1]", "q[2]"], "unit": "rad"}, "there is no t[1]: it is a single"),
    ({"columns": ["q[0]", "q[1]", "k"], "unit": "rad"}, "k is one number, not a column"),
    ({"columns": ["q[0]", "q[1]", "short"], "unit": "rad"}, "short has 9 samples, but t has 1500"),
    ({"columns": ["q[0]", "q[1]", "cube"], "unit": "rad"}, "cube (1500 × 3 × 3) has more than two"),
    ({"columns": ["q[0]", "q[1]", "text"], "unit": "rad"}, "column text holds text, not numbers"),
    ({"columns": ["q[0]", "q[1]", "Tau[2]"], "unit": "rad"}, "did you mean tau?"),
    ({"columns": ["q[0]", "q[1]"], "unit": "rad"}, "position.columns: lists 2 columns, but the"),
    ({"column": "q", "unit": "rad", "gear": [1, 2]}, "position.gear: lists 2 values, but"),
]


@pytest.mark.parametrize(("keys", "fragment"), WRONG_ADDRESSES)
def test_wrong_addresses(tmp_path: Path, keys: dict, fragment: str) -> None:
    path = saved(
        tmp_path / "log.npz", t=T, q=Q, tau=TAU, k=3.0, short=T[:9], cube=CUBE, text=["a"] * 1500
    )
    message = refusal(read, path, declared(**keys))
    assert fragment in message
    assert "→" in message


def test_the_mapping_names_its_columns_in_one_way() -> None:
    for keys in ({"unit": "rad"}, {"unit": "rad", "column": "q", "columns": ["a", "b", "c"]}):
        with pytest.raises(ValueError, match="give one of column, columns"):
            declared(**keys)


def test_simulink_structure_with_time(tmp_path: Path) -> None:
    signals = np.zeros(2, dtype=[("values", "O"), ("label", "O")])
    signals["values"][:] = [Q, TAU[:, :, None]]
    path = tmp_path / "log.mat"
    columns = ColumnMapping.model_validate(
        {
            "time": {"column": "out.time"},
            "position": {"column": "out.signals[0].values", "unit": "rad"},
            "torque": {"column": "out.signals[1].values", "unit": "N m"},
        }
    )
    for packed in (False, True):
        scipy.io.savemat(path, {"out": {"time": T, "signals": signals}}, do_compression=packed)
        np.testing.assert_array_equal(read(path, columns), ROWS)
    structure = {"time": T, "signals": {"values": np.hstack([Q, TAU])}}
    scipy.io.savemat(path, {"out": structure})
    torque = [f"out.signals[0].values[{i}]" for i in (3, 4, 5)]
    columns = columns.changed(torque={"columns": torque, "unit": "N m"})
    np.testing.assert_array_equal(read(path, columns), ROWS)


def test_struct_arrays_of_matlab_7_3(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        held = [file.create_dataset(f"#refs#/{i}", data=a.T) for i, a in enumerate((Q, TAU))]
        file["time"] = T[None]
        signals = file.create_group("signals")
        signals.attrs["MATLAB_class"] = np.bytes_("struct")
        signals.create_dataset("values", (2, 1), dtype=h5py.ref_dtype)
        signals["values"][:, 0] = [values.ref for values in held]
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    columns = ColumnMapping.model_validate(
        {
            "position": {"column": "signals[0].values", "unit": "rad"},
            "torque": {"column": "signals[1].values", "unit": "N m"},
        }
    )
    np.testing.assert_array_equal(read(path, columns), ROWS)


def tagged(kind: int, data: bytes) -> bytes:
    """An element of a MATLAB 5 file."""
    return np.array([kind, len(data)], "<u4").tobytes() + data + bytes(-len(data) % 8)


def test_objects_of_matlab(tmp_path: Path) -> None:
    flags = np.array([17, 0], "<u4").tobytes()
    parts = tagged(6, flags) + b"".join(tagged(1, t) for t in (b"logs", b"MCOS", b"timeseries"))
    header = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path = write(tmp_path / "log.mat", header + tagged(14, parts))
    named = ColumnMapping.model_validate({"time": {"column": "t"}})
    message = refusal(read, path, named)
    assert "its columns are logs (a MATLAB object of class timeseries)" in message
    assert "in MATLAB: x = logs; s.t = x.Time; s.q = squeeze(x.Data); save(" in message
    with h5py.File(path, "w", userblock_size=512) as file:
        file["logs"] = np.zeros((1, 6), np.uint32)
        file["logs"].attrs["MATLAB_class"] = np.bytes_("timetable")
        file["logs"].attrs["MATLAB_object_decode"] = np.int32(3)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    assert "x = logs; s.t = seconds(x.Time - x.Time(1))" in refusal(read, path, named)


def test_what_else_matlab_keeps(tmp_path: Path) -> None:
    cell = np.empty(3, dtype=object)
    cell[:] = list(TAU.T)
    scipy.io.savemat(
        tmp_path / "log.mat",
        {
            "t": np.round(T * 1000).astype(np.uint16),
            "q": Q.astype(np.float32),
            "tau": cell,
            "s": "text",
            "z": np.array([1 + 2j]),
            "e": np.zeros((0, 0)),
        },
    )
    columns = {"time": {"column": "t", "unit": "ms"}, "torque": {"column": "tau", "unit": "N m"}}
    values = read(tmp_path / "log.mat", ColumnMapping.model_validate(columns))
    np.testing.assert_array_equal(values[:, 1:4], Q.astype(np.float32))
    np.testing.assert_array_equal(values[:, 4:], TAU)
    np.testing.assert_allclose(values[:, 0], T, atol=1e-12)
    message = refusal(read, tmp_path / "log.mat", declared(column="s", unit="rad"))
    assert "s holds text, not numbers" in message
    assert "z holds complex numbers" in refusal(
        read, tmp_path / "log.mat", declared(column="z", unit="rad")
    )


def test_tables_in_hdf5(tmp_path: Path) -> None:
    table = np.zeros(1500, dtype=[("t", "<f8"), ("drive", [("q", ">f8", (3,)), ("tau", "f4", 3)])])
    table["t"], table["drive"]["q"], table["drive"]["tau"] = T, Q, TAU
    path = tmp_path / "log.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("a/b", data=table, chunks=(700,), compression="gzip")
    columns = ColumnMapping.model_validate(
        {
            "time": {"column": "a/b.t"},
            "position": {"column": "/a/b/drive/q", "unit": "rad"},
            "torque": {"column": "a.b.drive.tau", "unit": "N m"},
        }
    )
    np.testing.assert_array_equal(read(path, columns), np.hstack([T[:, None], Q, np.float32(TAU)]))


def test_hdf5_that_leads_elsewhere(tmp_path: Path) -> None:
    path, other = tmp_path / "log.h5", tmp_path / "other.h5"
    with h5py.File(other, "w") as file:
        file["q"] = Q
    layout = h5py.VirtualLayout(Q.shape, Q.dtype)
    layout[:] = h5py.VirtualSource(other, "q", Q.shape)
    with h5py.File(path, "w") as file:
        file["t"], file["tau"] = T, TAU
        file["q"] = h5py.ExternalLink(other, "q")
        file["self"] = file["/"]  # a loop
        file.create_virtual_dataset("v", layout)
        file.create_dataset("never", (10**12,), "f4", chunks=(1000,))
    assert "has no column q1, q2, q3; its columns are " in refusal(read, path)
    message = refusal(read, path, declared(column="v", unit="rad"))
    assert "column v holds numbers kept in other files" in message
    columns = ColumnMapping.model_validate(
        {"time": {"column": "never"}, "position": {"column": "never", "unit": "rad"}}
    )
    message = refusal(read, path, columns)
    assert "claims 4e+12 bytes" in message or "there is no never[1]" in message


def test_files_that_hold_something_else(tmp_path: Path) -> None:
    path = saved(tmp_path / "log.npz", t=T, q=np.array([{"a": 1}] * 1500), tau=TAU)
    message = refusal(read, path, declared(column="q", unit="rad"))
    assert "column q holds objects, which are never loaded, not numbers" in message
    assert "its columns are arr_0 (1500 × 7)" in refusal(read, saved(path, arr_0=ROWS))
    for name in ("log.npz", "log.npy", "log.mat", "log.h5"):
        message = refusal(read, write(tmp_path / name, "t,q1,q2,q3\n0,0,0,0\n"))
        assert message.startswith(str(tmp_path / name))
        assert "damaged" in message


def test_default_names_of_arrays(tmp_path: Path) -> None:
    path = saved(tmp_path / "log.npz", time=T, q=np.column_stack([Q, T]), tau=TAU, qd=Q)
    np.testing.assert_array_equal(read(path), np.hstack([T[:, None], Q, Q, TAU]))
    path = write(tmp_path / "log.csv", recorded(1500).rename({"t": "time"}))
    np.testing.assert_array_equal(read(path), ROWS)
    numbered = {f"q{i + 1}": f"q[{i}]" for i in range(3)}
    path = write(tmp_path / "log.csv", recorded(1500).rename(numbered))
    np.testing.assert_array_equal(read(path), ROWS)
