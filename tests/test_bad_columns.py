"""Columns that cannot be used, declared or in Parquet: what is wrong, where, how to mend it."""

import io

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltaid.errors import DescriptionError, RecordingError
from deltaid.recording.formats import frames
from deltaid.recording.mapping import ColumnMapping, load_mapping
from deltaid.recording.units import si_factor
from logs import recorded, refusal, text, write

ROWS = 300
FRAME = recorded(ROWS)
GOOD = text(FRAME)


def parquet_of(frame: pl.DataFrame) -> bytes:
    buffer = io.BytesIO()
    frame.write_parquet(buffer)
    return buffer.getvalue()


Q2_AT_150 = pl.int_range(pl.len()) == 149
BAD_COLUMNS = {
    "null": (
        pl.when(Q2_AT_150).then(None).otherwise("q2").alias("q2"),
        "row 150: column q2 is empty",
    ),
    "NaN": (
        pl.when(Q2_AT_150).then(np.nan).otherwise("q2").alias("q2"),
        "row 150: column q2 is 'nan'",
    ),
    "nothing": (pl.lit(None).alias("q2"), "row 1: column q2 is empty"),
    "text": (pl.col("q2").cast(pl.String), "column q2 holds String, not numbers"),
    "truth": (pl.col("q2") > 0, "column q2 holds truth values, not numbers"),
    "list": (pl.concat_list("q2", "q1").alias("q2"), "q2 has 2 columns"),
    "struct": (pl.struct("q1").alias("q2"), "did you mean q2.q1?"),
    "dates": (
        (1e6 * pl.col("t")).cast(pl.Int64).cast(pl.Datetime("us")).alias("q2"),
        "column q2 holds dates or times of day",
    ),
}


@pytest.mark.parametrize("name", BAD_COLUMNS)
@pytest.mark.parametrize("size", [1 << 16, 64])
def test_bad_parquet_columns(tmp_path, opened, monkeypatch, name: str, size: int) -> None:
    monkeypatch.setattr(frames, "BATCH_ROWS", size)
    expression, fragment = BAD_COLUMNS[name]
    path = write(tmp_path / "log.parquet", FRAME.with_columns(expression))
    message = refusal(opened, path)
    assert message.startswith(str(path))
    assert fragment in message


@pytest.mark.parametrize(
    ("damage", "fragment"),
    [
        (lambda data: data[: len(data) // 2], "damaged"),
        (lambda data: data[:1000] + data[3000:], "damaged"),
        (lambda data: b"", "is empty"),
        (lambda data: GOOD.encode(), "damaged"),
        (lambda data: parquet_of(FRAME.head(1)), "fewer than two rows"),
        (lambda data: parquet_of(FRAME.drop("q3")), "has no column q3"),
    ],
)
def test_bad_parquet_files(tmp_path, opened, capfd, damage, fragment) -> None:
    path = write(tmp_path / "log.parquet", damage(parquet_of(FRAME)))
    message = refusal(opened, path)
    assert message.startswith(str(path))
    assert fragment in message
    assert "panic" not in message
    assert capfd.readouterr().err == ""


def drives(**keys: object) -> list[dict]:
    return [{"column": f"q{i}", "unit": "rad", **keys} for i in (1, 2, 3)]


TORQUES = [{"column": f"M{i}", "unit": "Nm"} for i in (1, 2, 3)]
BAD_MAPPINGS = [
    ({"position": drives(unit="nan")}, "position[0]: unit 'nan' is not known"),
    ({"position": drives(unit="1/0")}, "is not known"),
    ({"position": drives(unit="m**1e9")}, "is not known"),
    ({"position": drives(unit="1e99 rad")}, "no recording of this robot goes beyond"),
    ({"time": {"column": "t", "unit": "0 s"}}, "it does not run"),
    ({"position": drives(unit="")}, "position[0]: unit '' is not known"),
    ({"position": drives(unit="9**9**9 deg")}, "is not known"),
    ({"position": drives(unit="0 deg")}, "position[0]"),
    ({"position": drives(unit="__import__('os')")}, "is not known"),
    ({"position": drives(unit="a" * 100_000)}, "is not known"),
    ({"position": drives(unit="N*m")}, "position[0]: unit 'N*m' is not a unit of rad"),
    ({"velocity": drives(unit="1/min")}, "unit '1/min' is not"),
    ({"velocity": drives(unit="Hz")}, "velocity[0]: unit 'Hz' is not known"),
    ({"position": drives(torque_constant=1.0)}, "position[0].torque_constant: belongs to torque"),
    ({"torque": drives(unit="A")}, "torque[0]: unit 'A' is not a unit of N m"),
    ({"torque": drives(unit="N*m", torque_constant=1.0)}, "unit 'N*m' is not a current"),
    ({"position": drives()[:2]}, "position: lists 2 columns, but the robot has 3 drives"),
    ({"torque": []}, "torque: lists 0 columns"),
    ({"time": {"column": "t", "unit": "deg"}}, "time.unit: unit 'deg' is not a unit of s"),
    ({"time": {"column": "T"}}, "row 1: has no column T"),
    ({"position": drives(), "torque": TORQUES}, "no column M1, M2, M3"),
    ({"position": drives(column="q1")}, "column q1 is declared 3 times"),
    ({"position": drives(unit="deg", gear=1e12), "torque": drives(unit="Nm")}, "declared 2 times"),
    ({"header_row": 2}, "row 2: has no header"),
    ({"header_row": 9999}, "row 9999: is an empty line"),
    ({"header_row": 99999999999}, "row 99999999999: is an empty line"),
]


@pytest.mark.parametrize(("declared", "fragment"), BAD_MAPPINGS)
def test_bad_mappings(tmp_path, opened, declared: dict, fragment: str) -> None:
    path = write(tmp_path / "log.csv", GOOD)
    mapping = ColumnMapping.model_validate(declared)
    assert fragment in refusal(opened, path, mapping)


@pytest.mark.parametrize("content", ["", "# nothing\n"])
def test_an_empty_mapping_is_no_robot(tmp_path, content: str) -> None:
    path = tmp_path / "columns.yaml"
    path.write_text(content)
    with pytest.raises(
        DescriptionError, match=r"is empty(.|\n)*`deltaid columns` writes a mapping"
    ):
        load_mapping(path)


UNIT_PARTS = [*"degsNmAkµ01.-+*/^²()°_ ·", "rad", "rad/s", "nan", "inf", "1e99", "**", "and"]
UNITS = st.lists(st.sampled_from(UNIT_PARTS), max_size=6).map("".join) | st.text(max_size=8)


@settings(max_examples=300, deadline=None)
@given(UNITS, st.booleans())
def test_any_unit_has_a_factor_or_is_refused(unit: str, current: bool) -> None:
    for target in ("rad", "s", "N m"):
        try:
            factor = si_factor(unit, target, where="x", torque_constant=2.0 if current else None)
        except RecordingError as error:
            assert str(error).startswith("x: unit '")  # noqa: PT017 - both ends are right
        else:
            assert factor >= 0


DERIVATIVES = recorded(1500, derivatives=True)


@pytest.mark.parametrize(
    ("columns", "fragments"),
    [
        ({"qd2": pl.col("qd2").degrees()}, ("column qd2 is 57.3", "rate at which q2", "degrees")),
        ({"qd1": 30 / np.pi * pl.col("qd1")}, ("column qd1 is 9.5", "rpm")),
        ({"qd3": -pl.col("qd3")}, ("column qd3 is -1", "rate at which q3", "sign")),
        ({"qdd2": 1e-3 * pl.col("qdd2")}, ("column qdd2 is 0.001", "rate at which qd2")),
        ({"qd2": pl.lit(0.0)}, ("column qd2 is constant; but q2 is not",)),
        ({"qdd1": pl.lit(0.0)}, ("column qdd1 is constant; but q1 is not",)),
        ({"qd2": pl.lit(None)}, ("column qd2 is empty", "; or exclude it by `velocity: []`")),
        ({"qdd2": pl.lit("NaN")}, ("column qdd2 is 'NaN'", "exclude it by `acceleration: []`")),
    ],
)
def test_derivatives_that_are_none(tmp_path, opened, columns, fragments) -> None:
    path = write(tmp_path / "log.csv", DERIVATIVES.with_columns(**columns))
    excluded = ColumnMapping.model_validate({"velocity": [], "acceleration": []})
    assert len(opened(path, excluded).columns.all) == 7
    message = refusal(opened, path)
    assert message.startswith(str(path))
    for fragment in fragments:
        assert fragment in message
