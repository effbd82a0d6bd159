"""Mistakes of those who measure, and damaged files: each is named in one message."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from command import accepted, refused
from measured_poses import CLAVEL, NOISE, POINT, measured


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return measured(tmp_path_factory.mktemp("measured"), 2)


def thousandfold(*names: str) -> Callable[[pl.DataFrame], pl.DataFrame]:
    return lambda frame: frame.with_columns(pl.col(*names) * 1e3)


def changed(**columns: pl.Expr) -> Callable[[pl.DataFrame], pl.DataFrame]:
    return lambda frame: frame.with_columns(**columns)


def in_row(row: int, name: str, value: float) -> Callable[[pl.DataFrame], pl.DataFrame]:
    return changed(**{name: pl.when(pl.int_range(pl.len()) == row).then(value).otherwise(name)})


def exchanged(a: str, b: str) -> Callable[[pl.DataFrame], pl.DataFrame]:
    return lambda frame: frame.rename({a: b, b: a})


def ten_times_noisier(frame: pl.DataFrame) -> pl.DataFrame:
    rng = np.random.default_rng(0)
    return frame.with_columns(
        pl.col(name) + pl.Series(10 * NOISE * rng.standard_normal(len(frame))) for name in POINT
    )


OUTLIERS = pl.when(pl.int_range(pl.len()).is_in([3, 11, 30])).then(2e-3).otherwise(0) + pl.col("pz")
ALONE = {name: pl.col(name).first() for name in POINT}
MISTAKES = {
    "mm": ("points", thousandfold(*POINT), "likely they are in mm"),
    "parts in mm": ("parts", thousandfold("distance"), "likely they are in mm"),
    "block in mm": ("gauge", thousandfold("block"), "likely they are in mm"),
    "poses in mm": ("bed", thousandfold("x", "y", "z"), "likely they are in mm"),
    "mirrored": ("points", changed(px=-pl.col("px")), "the frame is left-handed"),
    "shuffled": ("points", changed(**{name: pl.col(name).shuffle(seed=1) for name in POINT}),
                 "points stand in another order"),
    "limbs": ("points", exchanged("q1", "q2"), "or two drives are exchanged"),
    "sign": ("points", changed(q2=-pl.col("q2")), "if the sign of drive 2 is reversed"),
    "blocks": ("gauge", changed(block=pl.col("block").shuffle(seed=1)),
               "blocks stand in another order"),
    "radii": ("parts", changed(distance=pl.col("distance") / 2),
              "times what they should be → check their unit, and what was measured"),
    "feet": ("points", changed(**{name: pl.col(name) / 0.3048 for name in POINT}),
             "times what they should be"),
    "distances": ("parts", changed(distance=pl.col("distance").shuffle(seed=1)),
                  "distances stand in another order"),
    "outliers and mirrored": ("points", changed(px=-pl.col("px"), pz=OUTLIERS),
                              "the frame is left-handed"),
    "shuffled and mirrored": (
        "points",
        changed(**{name: sign * pl.col(name).shuffle(seed=1)
                   for name, sign in zip(POINT, (-1, 1, 1), strict=True)}),
        "points stand in another order (rows 2, 3, 4, 5, 6, 7, …) and the frame is left-handed",
    ),
    "mm and order": ("points", changed(**{name: 1e3 * pl.col(name).reverse() for name in POINT}),
                     "likely they are in mm"),
    "twice and blocks": (
        "gauge",
        lambda frame: pl.concat([frame.with_columns(pl.col("block").shuffle(seed=1)), frame[:2]]),
        "blocks stand in another order",
    ),
    "noise and limbs": ("points", lambda frame: exchanged("q1", "q2")(ten_times_noisier(frame)),
                        "or two drives are exchanged"),
}  # fmt: skip
THIRD = pl.int_range(pl.len()) % 3 == 1
DRIVES = ("q1", "q2", "q3")
HALF = pl.int_range(pl.len()) < pl.len() // 2
TOGETHER = {
    "some rows in mm": (
        "points",
        changed(**{name: pl.when(THIRD).then(1e3).otherwise(1.0) * pl.col(name) for name in POINT}),
        "rows 3, 6, 9, 12, 15, 18, … are 1000 times too large, the others are not; likely these "
        "are in mm",
    ),
    "some distances in mm": (
        "parts",
        changed(distance=pl.when(THIRD).then(1e3).otherwise(1.0) * pl.col("distance")),
        "are 1000 times too large",
    ),
    "frame": (
        "points",
        changed(px=pl.when(HALF).then(pl.col("px")).otherwise(pl.col("py") + 0.3),
                py=pl.when(HALF).then(pl.col("py")).otherwise(-pl.col("px"))),
        "if points up to row 21 are in one frame and those from row 22 in another",
    ),
}  # fmt: skip
DAMAGE = TOGETHER | {
    "degrees": ("points", changed(q1=57.3 * pl.col("q1")), "likely degrees"),
    "hole": ("points", changed(px=pl.when(pl.int_range(pl.len()) != 9).then(pl.col("px"))),
             "is empty"),
    "German": ("bed", lambda frame: frame.rename({"x": "Höhe X", "z": "Höhe"}),
               "its columns are Höhe X, y, Höhe, block"),
    "column": ("points", lambda frame: frame.drop("pz"), "has no column pz"),
    "many": (
        "points",
        lambda frame: frame.sample(30_000, with_replacement=True),
        "has 30000 readings; at most 20000",
    ),
    "few": ("points", lambda frame: frame.head(2), "too few"),
    "nothing": ("points", lambda frame: frame.head(0), "has no rows"),
    "one place": ("points", changed(**ALONE), "in one place"),
    "line": ("bed", changed(x=pl.lit(0.0)), "lie on a line"),
    "z down": ("bed", changed(z=-pl.col("z")), "does not stand at this point"),
    "below": ("gauge", changed(block=-pl.col("block")), "blocks stand below the plane"),
    "homing": (
        "points",
        changed(**{q: pl.col(q) + 0.02 for q in DRIVES}),
        ".zero off by 18 times what the description allows",
    ),
    "no block": ("gauge", lambda frame: frame.drop("block"), "misfit every geometry"),
    "negative": ("parts", changed(distance=-pl.col("distance")), "not positive"),
    "huge": ("points", changed(py=1e300 * pl.col("py")), "wrong.csv, row 2: column py is "),
    "huge block": ("gauge", in_row(9, "block", 1e199), "row 11: column block is 1e+199 m, which"),
    "huge pose": ("bed", in_row(3, "x", 1e199), "wrong.csv, row 5: column x is 1e+199 m, which"),
    "huge drive": ("points", in_row(3, "q2", -1e199), "row 5: column q2 is -1e+199 rad, which"),
    "counts": ("points", changed(q1=3e4 * pl.col("q1")), "rad; more than an arm turns"),
    "out of reach": ("bed", in_row(3, "x", 9.0), "wrong.csv, row 5: limb "),
    "stated in mm": ("points", changed(**{name: pl.col(name) / 1e3 for name in POINT}),
                     "times those of the robot's poses → check units and columns"),
    "drives stated in degrees": ("points", changed(**{q: pl.col(q) / 57.3 for q in DRIVES}),
                                 "check units and columns"),
    "one axis in mm": ("points", thousandfold("pz"), "not in all directions"),
}  # fmt: skip


@pytest.mark.parametrize("seed", range(3))
def test_mistakes_are_named(
    seed: int, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = measured(tmp_path_factory.mktemp("measured"), seed)
    for mistake in MISTAKES.values():
        require_refused(*mistake, folder, tmp_path)


@pytest.mark.parametrize("damage", DAMAGE)
def test_tables_that_cannot_be_used_are_refused(damage: str, files: Path, tmp_path: Path) -> None:
    require_refused(*DAMAGE[damage], files, tmp_path)


def require_refused(
    name: str, change: Callable[[pl.DataFrame], pl.DataFrame], said: str, files: Path, own: Path
) -> None:
    wrong = own / "wrong.csv"
    option = {"points": "--points", "parts": "--distances"}.get(name, "--probe")
    change(pl.read_csv(files / f"{name}.csv")).write_csv(wrong)
    message = refused("calibrate", CLAVEL, option, wrong, "-o", own / "new.yaml", folder=own)
    assert said in " ".join(message.split())
    assert "wrong.csv" in message
    assert "Warning" not in message


def test_what_cannot_be_is_refused(files: Path, tmp_path: Path) -> None:
    own = tmp_path / "columns.yaml"
    own.write_text("points: {noize: 1}\n", encoding="utf-8")
    below = tmp_path / "below.yaml"
    below.write_text("points: {noise: -1}\n", encoding="utf-8")
    misspelt, heavy, doubled = (tmp_path / f"{name}.yaml" for name in ("misspelt", "kg", "doubled"))
    misspelt.write_text("probe: {columns: {blok: block}}\n", encoding="utf-8")
    heavy.write_text("probe: {unit: kg}\n", encoding="utf-8")
    doubled.write_text("points: {columns: {px: py}}\n", encoding="utf-8")
    bed = ("--probe", files / "bed.csv")
    for arguments, said in {
        (): "nothing was measured",
        (*bed, "--struts-apart"): "strut_spacing",
        (*bed, "--tool", "1"): "must be three numbers",
        (*bed, "--tool", "0,0,-0.05"): "--tool: has no effect without --struts-apart",
        (*bed, "--struts-apart", "--tool", "0,0,-50"): "tool: must lie between",
        (*bed, "--budget", "100"): "--budget: has no effect without --next",
        (*bed, "--sensors", files / "shop.yaml"): "--sensors: has no effect without --next",
        (*bed, "--columns", own): "did you mean noise?",
        (*bed, "--columns", below): "deltaid schema measurements",
        (*bed, "--columns", misspelt): "did you mean block?",
        (*bed, "--columns", heavy): "unit 'kg' is not known",
        ("--points", files / "points.csv", "--columns", doubled): "px and py are one column",
    }.items():
        assert said in refused("calibrate", CLAVEL, *arguments, folder=tmp_path)


def test_of_several_files_the_one_at_fault_is_named(files: Path, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.csv"
    exchanged("b_x", "b_y")(pl.read_csv(files / "parts.csv")).write_csv(wrong)
    given = ("--probe", files / "gauge.csv", "--distances", wrong)
    assert "gauge.csv" not in refused("calibrate", CLAVEL, *given, folder=tmp_path)


def test_arguments_that_cannot_be_are_refused_in_python(files: Path) -> None:
    points = files / "points.csv"
    for argument, said in (
        ({"lengths": -1e-3}, "lengths: must lie between"),
        ({"angles": float("nan")}, "angles: must lie between"),
        ({"tool": (0.0, 0.0)}, "tool: must be three numbers"),
        ({"hold": "strutt"}, "did you mean strut"),
    ):
        with pytest.raises(deltaid.DeltaidError, match=said):
            deltaid.calibrate(CLAVEL, points=points, **argument)
    held = deltaid.calibrate(CLAVEL, points=points, hold="strut")
    assert held.values[held.names.index("limb1.strut")] == 0


def test_noise_that_is_stated_ten_times_too_large_is_named(files: Path, tmp_path: Path) -> None:
    own = tmp_path / "columns.yaml"
    own.write_text(f"points: {{noise: {10 * NOISE}}}\n", encoding="utf-8")
    stated = deltaid.calibrate(CLAVEL, points=files / "points.csv", columns=own)
    (doubt,) = stated.doubts
    assert "the stated noise, so intervals are too wide" in doubt
    done = accepted("calibrate", CLAVEL, "--points", files / "points.csv", "--columns", own)
    assert f"Doubtful: {doubt}" in done.out
    assert deltaid.calibrate(CLAVEL, points=files / "points.csv").doubts == ()


def test_readings_that_are_given_twice_or_to_another_option_are_refused(
    files: Path, tmp_path: Path
) -> None:
    points, longer = files / "points.csv", tmp_path / "longer.csv"
    frame = pl.read_csv(points)
    pl.concat([frame, frame[:3] + 1e-4]).write_csv(longer)  # exported again with more poses
    for again in (points, longer):
        given = ("calibrate", CLAVEL, "--points", points, "--points", again)
        assert "40 rows are the same as in " in refused(*given, folder=tmp_path)
    touches = ("calibrate", CLAVEL, "--probe", points)
    assert "give the file with --points" in refused(*touches, folder=tmp_path)


def test_units_and_names_of_columns(files: Path, tmp_path: Path) -> None:
    frame = pl.read_csv(files / "points.csv")
    frame.select(
        (pl.col("q1", "q2", "q3") * 180 / np.pi).name.prefix("motor "),
        pl.col("px", "py", "pz") * 1e3,
    ).write_csv(tmp_path / "mm.csv")
    own = tmp_path / "columns.yaml"
    own.write_text(
        "points:\n  unit: mm\n  noise: 0.02\n  drive_unit: deg\n"
        "  columns: {q1: motor q1, q2: motor q2, q3: motor q3}\n",
        encoding="utf-8",
    )
    plain = deltaid.calibrate(CLAVEL, points=files / "points.csv")
    mapped = deltaid.calibrate(CLAVEL, points=tmp_path / "mm.csv", columns=own)
    assert mapped.values == pytest.approx(plain.values, abs=1e-8)


def test_a_reading_far_away_is_an_outlier(files: Path, tmp_path: Path) -> None:
    """One of 50 km is excluded by its row, as one of 2 mm is, and hides no unit."""
    far = tmp_path / "far.csv"
    in_row(3, "py", 5e4)(pl.read_csv(files / "points.csv")).write_csv(far)
    (session,) = deltaid.calibrate(CLAVEL, points=far).sessions
    assert [words.partition(":")[0] for words in session.excluded] == ["row 5"]
