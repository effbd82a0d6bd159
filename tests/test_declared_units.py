"""Units that a mapping declares, or a log has under its names, become SI at the joint."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from deltaid.recording.mapping import ColumnMapping, load_mapping
from logs import names, read, recorded, write


def test_units_under_the_header_hold(tmp_path) -> None:
    rows = ["t,q1,q2,q3,tau1,tau2,tau3", "ms,deg,mrad,rad,Nmm,N m,kN*m", "1,90,1,1,1,1,1"]
    path = write(tmp_path / "log.csv", "\n".join([*rows, "2,0,0,0,0,0,0"]))
    expected = [1e-3, np.pi / 2, 1e-3, 1, 1e-3, 1, 1e3]
    np.testing.assert_allclose(read(path)[0], expected, rtol=1e-15)
    columns = tuple({"column": f"q{i}", "unit": "rev"} for i in (1, 2, 3))
    declared = ColumnMapping.model_validate({"position": columns, "time": {"unit": "s"}})
    expected[:4] = [1, 180 * np.pi, 2 * np.pi, 2 * np.pi]
    np.testing.assert_allclose(read(path, declared)[0], expected, rtol=1e-15)


# Declared columns, the numbers in the file, and by hand what they are at the joint in SI.
UNITS = [
    ("position", {"unit": "deg"}, 90.0, np.pi / 2),
    ("position", {"unit": "°", "zero": 10.0}, 100.0, np.pi / 2),
    ("position", {"unit": "rev", "gear": 20.0, "sign": -1}, 5.0, -np.pi / 2),
    ("position", {"unit": "360/65536 deg", "zero": 32768.0}, 49152.0, np.pi / 2),
    ("position", {"unit": "mrad"}, 1500.0, 1.5),
    ("position", {"unit": "1e-3 rad"}, 1500.0, 1.5),
    ("velocity", {"unit": "rpm", "gear": 30.0}, 1800.0, 2 * np.pi),
    ("velocity", {"unit": "rev/min", "gear": 30.0, "sign": -1}, 1800.0, -2 * np.pi),
    ("velocity", {"unit": "deg/s", "zero": -5.0}, 85.0, np.pi / 2),
    ("acceleration", {"unit": "deg/s^2"}, 180.0, np.pi),
    ("acceleration", {"unit": "rad/s²", "gear": 4.0}, 8.0, 2.0),
    ("acceleration", {"unit": "rpm/s"}, 60.0, 2 * np.pi),
    ("torque", {"unit": "mN*m", "gear": 50.0}, 200.0, 10.0),
    ("torque", {"unit": "Nm", "gear": 50.0, "sign": -1}, 0.2, -10.0),
    ("torque", {"unit": "N m"}, 3.5, 3.5),
    ("torque", {"unit": "N·mm"}, 3500.0, 3.5),
    ("torque", {"unit": "A", "torque_constant": 0.5, "gear": 10.0, "zero": 1.0}, 3.0, 10.0),
    ("torque", {"unit": "mA", "torque_constant": 0.5, "sign": -1}, 4000.0, -2.0),
    ("torque", {"unit": "0.0235 N*m", "gear": 2.0}, 100.0, 4.7),
    ("torque", {"unit": "lbf*ft"}, 10.0, 13.558179483314),
]


@pytest.mark.parametrize(("quantity", "declared", "number", "value"), UNITS)
def test_declared_columns_become_si(tmp_path, quantity, declared, number, value) -> None:
    frame = pl.DataFrame({name: [0.0, 0.25] for name in names("t", "q", "qd", "qdd", "tau")})
    frame = frame.with_columns(pl.lit(number).alias("x"), pl.lit(0.0).alias("y"))
    columns = (
        {"column": "y", **declared},
        {"column": "x", **declared},
        {"column": "z", **declared},
    )
    mapping = ColumnMapping.model_validate({quantity: columns})
    path = write(tmp_path / "log.csv", frame.with_columns(pl.lit(7.0).alias("z")))
    start = 1 + 3 * ["position", "velocity", "acceleration", "torque"].index(quantity)
    values = read(path, mapping)
    assert values[0, start + 1] == pytest.approx(value, rel=1e-12)
    assert values.shape == (2, 13)


@pytest.mark.parametrize(
    ("unit", "seconds"), [("s", 1), ("ms", 1e-3), ("us", 1e-6), ("µs", 1e-6), ("min", 60)]
)
def test_units_of_time(tmp_path, unit: str, seconds: float) -> None:
    frame = recorded(300)
    path = write(tmp_path / "log.csv", frame.rename({"t": "Zeit"}))
    mapping = ColumnMapping.model_validate({"time": {"column": "Zeit", "unit": unit}})
    np.testing.assert_allclose(read(path, mapping)[:, 0], seconds * frame["t"].to_numpy())


def test_mapping_file(tmp_path) -> None:
    source = Path(__file__).parents[1] / "examples" / "columns.yaml"
    mapping = load_mapping(source)
    assert mapping.source == str(source)
    names_of = ("time_ms", *(f"{kind}{i}" for kind in ("angle", "speed", "current") for i in "123"))
    path = write(tmp_path / "log.csv", pl.DataFrame({name: [1.0, 2.0] for name in names_of}))
    expected = [1e-3, *np.deg2rad([-1, 0.5, -1]), *[-np.pi / 300] * 3, *[-1.2] * 3]
    np.testing.assert_allclose(read(path, mapping)[0], expected)
