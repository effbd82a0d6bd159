"""`deltaid calibrate`: hidden machines of a generator that shares no code with the package."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import deltaid
from command import refused, run
from deltaid.calibration.loops import Loops
from deltaid.calibration.unknowns import unknowns
from oracle.measured_delta import BuiltDelta, built
from oracle.tree import Array

CLAVEL, KOSSEL = "clavel-delta3", "anycubic-kossel"
SIZES = {
    CLAVEL: ([0, 120, 240], 0.33, 0.125, 0.42, 1.055),
    KOSSEL: ([0, 120, 240], 0.1654, 0.031, None, 0.267),
}
BOXES = {
    CLAVEL: ([-0.35, -0.35, -1.1], [0.35, 0.35, -0.85]),
    KOSSEL: ([-0.06, -0.06, -0.5], [0.06, 0.06, -0.3]),
}
NOISE = 2e-5


@cache
def kinematics(name: str) -> deltaid.Kinematics:
    return deltaid.Kinematics(name)


def machine(name: str, seed: int, **options: float) -> tuple[BuiltDelta, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return built(rng, *SIZES[name], **options), rng


def somewhere(name: str, rng: np.random.Generator, count: int) -> Array:
    return rng.uniform(*BOXES[name], (count, 3))


def real(robot: BuiltDelta, name: str, commanded: Array) -> Array:
    """Where a machine stands that believes in its description."""
    q = kinematics(name).inverse(commanded)
    return np.array([robot.tool_point(*pose) for pose in zip(q, commanded, strict=True)])


def tracked(name: str, x: Array, m: Array, rng: np.random.Generator) -> dict[str, Array]:
    """Readings of a tracker somewhere."""
    turn = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix()
    points = m @ turn.T + [1.0, 2.0, 0.5] + rng.normal(0, NOISE, m.shape)
    q = kinematics(name).inverse(x)
    return {f"q{i + 1}": q[:, i] for i in range(q.shape[1])} | dict(
        zip(("px", "py", "pz"), points.T, strict=True)
    )


def touched(
    robot: BuiltDelta, name: str, places: Array, noise: float, rng: np.random.Generator
) -> dict[str, Array]:
    """Commanded points at which a machine touches planes at heights `places[:, 2]`."""
    x = places.copy()
    for _ in range(5):
        x[:, 2] -= real(robot, name, x)[:, 2] - places[:, 2]
    x[:, 2] += rng.normal(0, noise, len(x))
    return dict(zip("xyz", x.T, strict=True)) | {"block": places[:, 2] - places[:, 2].min()}


def spans(
    robot: BuiltDelta, name: str, a: Array, b: Array, rng: np.random.Generator
) -> dict[str, Array]:
    """Distances between pairs of commanded points."""
    length = np.linalg.norm(real(robot, name, a) - real(robot, name, b), axis=1)
    return {
        f"{end}_{axis}": points[:, k]
        for end, points in (("a", a), ("b", b))
        for k, axis in enumerate("xyz")
    } | {"distance": length + rng.normal(0, NOISE, len(a))}


def shape_error(x: Array, m: Array) -> float:
    """Root mean square of what no rigid motion explains."""
    turn, _ = Rotation.align_vectors(m - m.mean(0), x - x.mean(0))
    return float(np.sqrt(np.mean(np.sum((m - m.mean(0) - turn.apply(x - x.mean(0))) ** 2, axis=1))))


def truth(robot: BuiltDelta, name: str) -> dict[str, float]:
    """The generator's numbers as the package names them, to second order."""
    azimuths, base, _, arm, strut = SIZES[name]
    found = {}
    for i, (limb, phi) in enumerate(zip(robot.limbs, np.deg2rad(azimuths), strict=True)):
        out, across = (
            np.array([np.cos(phi), np.sin(phi), 0]),
            np.array([-np.sin(phi), np.cos(phi), 0]),
        )
        off, own = limb.base - base * out, limb.struts[0][0] - strut
        if arm is None:
            each = {
                "rail_out": off @ out,
                "rail_across": off @ across,
                "lean_out": limb.along @ out,
                "lean_across": limb.along @ across,
                "zero": limb.zero - off[2],
                "scale": limb.scale - 1,
            }
        else:
            each = {
                "base_out": off @ out,
                "base_across": off @ across,
                "base_up": off[2],
                "azimuth": -limb.along @ out,
                "tilt": limb.along[2],
                "upper_arm": limb.arm - arm,
                "zero": limb.zero,
            }
        found |= {f"limb{i + 1}.{kind}": value for kind, value in (each | {"strut": own}).items()}
    return found


@pytest.mark.parametrize("name", [CLAVEL, KOSSEL])
def test_intervals_hold_and_predicted_errors_are_true_ones(name: str) -> None:
    scores, true, predicted = [], [], []
    for seed in range(8):
        robot, rng = machine(name, seed, scale=1e-3 if name == KOSSEL else 0.0)
        x = somewhere(name, rng, 60)
        found = deltaid.calibrate(name, points=tracked(name, x, real(robot, name, x), rng))
        assert found.verdict.startswith("good: ")
        assert found.sessions[0].residual == pytest.approx(NOISE, rel=0.3)
        expected = truth(robot, name)
        scores += [
            (v - expected[n]) / s
            for n, v, s in zip(found.names, found.values, found.std, strict=True)
        ]
        loops, over = found.fit.loops, somewhere(name, rng, 60)
        q = loops.inverse(over)
        now = loops.points(q, found.values, loops.start(q))
        m = real(robot, name, over)
        true.append(shape_error(now.x, m))
        J = now.slopes.reshape(-1, len(found.values)) @ found.known.G @ found.fit.root
        arms = over - over.mean(0)
        turns = [np.cross(axis, arms).ravel() for axis in np.eye(3)]
        rigid = np.linalg.qr(np.column_stack([*np.tile(np.eye(3), (60, 1)).T, *turns]))[0]
        predicted.append(np.linalg.norm(J - rigid @ (rigid.T @ J)) / np.sqrt(60))
        assert true[-1] < 0.2 * shape_error(over, m)
    # 170 to 190 numbers, correlated: 95 % give or take three standard deviations
    assert 0.88 < np.mean(np.abs(scores) < 1.96) < 1.0
    assert np.sqrt(np.mean(np.square(true))) == pytest.approx(
        np.sqrt(np.mean(np.square(predicted))), rel=0.25
    )


def test_struts_apart_show_the_tilt_of_the_platform() -> None:
    robot, rng = machine(CLAVEL, 3, spacing=0.1, length=5e-4)
    described = deltaid.load_robot(CLAVEL)
    described = described.changed(limbs=described.limbs.changed(strut_spacing=0.1))
    x = somewhere(CLAVEL, rng, 60)
    readings = tracked(CLAVEL, x, real(robot, CLAVEL, x), rng)
    options = {"points": readings, "tool": (0, 0, -0.05), "lengths": 5e-4}
    apart = deltaid.calibrate(described, struts_apart=True, **options)
    assert len(apart.values) == 42
    alike = deltaid.calibrate(described, **options)
    over = somewhere(CLAVEL, rng, 40)
    m, errors = real(robot, CLAVEL, over), []
    for found in (alike, apart):
        loops = found.fit.loops
        q = loops.inverse(over)
        errors.append(shape_error(loops.points(q, found.values, loops.start(q)).x, m))
    assert errors[1] < 3e-5
    assert errors[0] > 1.5 * errors[1]  # one strut a limb cannot hold what the tilt does


@pytest.mark.parametrize("name", ["par4", "h4-linear"])
def test_robots_that_turn_their_tool(name: str) -> None:
    """From commanded points and the description's own loops: slopes, and numbers got back."""
    robot = deltaid.load_robot(name)
    known = unknowns(robot)
    loops = Loops(robot, known)
    rng = np.random.default_rng(0)
    centre, half = robot.workspace.inner_box
    q = kinematics(name).inverse(
        np.column_stack(
            [centre + rng.uniform(-0.5, 0.5, (60, 3)) * half, rng.uniform(-0.3, 0.3, 60)]
        )
    )
    theta = known.G @ rng.normal(0, 1, known.G.shape[1])
    points = loops.points(q, theta, loops.start(q))
    step = 1e-6 * np.eye(len(theta))[7]
    change = (
        loops.points(q, theta + step, loops.start(q)).x
        - loops.points(q, theta - step, loops.start(q)).x
    )
    assert change / 2e-6 == pytest.approx(points.slopes[:, :, 7], abs=1e-7)
    readings = {f"q{i + 1}": q[:, i] for i in range(4)} | dict(
        zip(("px", "py", "pz"), points.x.T, strict=True)
    )
    found = deltaid.calibrate(robot, points=readings)
    again = loops.points(q, found.values, loops.start(q))
    assert shape_error(again.x, points.x) < 1e-5
    assert "platform.half" in found.names


def test_a_bed_alone_does_not_know_sizes_and_one_distance_does() -> None:
    """Numbers of a printer's firmware, an eleven-point pattern: the diagonal is known to 2.7 mm."""
    rng = np.random.default_rng(0)
    robot, _ = machine(KOSSEL, 1, length=2e-4, angle=1e-9)
    ring = [
        0.105 * np.array([np.cos(a), np.sin(a), 0]) for a in np.pi / 6 + np.arange(6) * np.pi / 3
    ]
    inner = [
        0.0525 * np.array([np.cos(a), np.sin(a), 0]) for a in np.pi / 6 + np.arange(4) * np.pi / 2
    ]
    places = np.array([*ring, *inner, np.zeros(3)]) - [0, 0, 0.5]
    bed = touched(robot, KOSSEL, places, 1e-5, rng)
    held = {
        "lengths": 1e-2,
        "shared": ("strut", "rail_out"),
        "hold": ("lean_out", "lean_across", "scale"),
    }
    alone = deltaid.calibrate(KOSSEL, probe=bed, **held)
    spread = dict(zip(alone.names, alone.std, strict=True))
    assert 2e-3 < spread["limb1.strut"] < 5e-3
    assert alone.sessions[0].residual < 1e-5  # and yet the bed is flat
    assert alone.open[0].words.startswith("sizes stay uncertain by ")
    assert "strut" in alone.open[0].words
    assert alone.open[0].size * 0.1 > 0.5e-3  # of a part of 100 mm
    a, b = np.array([[-0.05, 0, -0.5]]), np.array([[0.05, 0, -0.5]])
    both = deltaid.calibrate(KOSSEL, probe=bed, distances=spans(robot, KOSSEL, a, b, rng), **held)
    assert both.after.size < 1e-3 < 5 * alone.after.size
    assert not any("sizes" in direction.words for direction in both.open)
    off = truth(robot, KOSSEL)["limb1.strut"] - both.values[both.names.index("limb1.strut")]
    assert abs(off) < 5e-4 + 3 * both.std[both.names.index("limb1.strut")]


def test_outliers_and_rows_given_twice_are_named() -> None:
    robot, rng = machine(CLAVEL, 5)
    x = somewhere(CLAVEL, rng, 60)
    readings = tracked(CLAVEL, x, real(robot, CLAVEL, x), rng)
    clean = deltaid.calibrate(CLAVEL, points=readings)
    readings["pz"][7] += 1e-3
    readings["px"][30] -= 2e-4
    twice = {name: np.append(column, column[4]) for name, column in readings.items()}
    found = deltaid.calibrate(CLAVEL, points=twice)
    excluded = found.sessions[0].excluded
    assert len(excluded) == 3
    sizes = {text.split(":")[0]: text.split()[-2] for text in excluded[:2]}
    assert float(sizes["row 8"]) == pytest.approx(1.0, abs=0.1)
    assert float(sizes["row 31"]) == pytest.approx(0.2, abs=0.1)
    assert "row 61: the same as row 5" in excluded
    assert np.all(np.abs(found.values - clean.values) < clean.std)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tracker's points, a bed and distances of one machine."""
    folder = tmp_path_factory.mktemp("measured")
    robot, rng = machine(CLAVEL, 2)
    x = somewhere(CLAVEL, rng, 40)
    pl.DataFrame(tracked(CLAVEL, x, real(robot, CLAVEL, x), rng)).write_csv(folder / "points.csv")
    places = rng.uniform([-0.3, -0.3, -1.05], [0.3, 0.3, -1.05], (30, 3))
    pl.DataFrame(touched(robot, CLAVEL, places, 1e-5, rng)).write_csv(folder / "bed.csv")
    a, b = somewhere(CLAVEL, rng, 18), somewhere(CLAVEL, rng, 18)
    pl.DataFrame(spans(robot, CLAVEL, a, b, rng)).write_csv(folder / "parts.csv")
    return folder


def test_the_command_says_the_verdict_first_on_one_screen(files: Path, tmp_path: Path) -> None:
    out, page = tmp_path / "robot.yaml", tmp_path / "page.html"
    done = run("calibrate", CLAVEL, "--points", files / "points.csv", "-o", out, "--report", page)
    lines = done.out.splitlines()
    assert done.code == 0, done.err
    assert lines[0].startswith("good: positions to 0.0")
    assert len(lines) <= 25
    assert (
        max(
            map(
                len,
                (line for line in lines if str(files) not in line and str(tmp_path) not in line),
            )
        )
        <= 80
    )
    assert "Positions over the workspace" in page.read_text("utf-8")
    found = json.loads(run("calibrate", CLAVEL, "--points", files / "points.csv", "--json").out)
    robot = deltaid.load_robot(out)
    readings = pl.read_csv(files / "points.csv")
    q = readings.select("q1", "q2", "q3").to_numpy() + list(found["zeros"].values())
    x = deltaid.Kinematics(robot).forward(q)
    assert shape_error(x, readings.select("px", "py", "pz").to_numpy()) < 6e-5
    assert robot.tolerances.of_length("strut") < 2e-4


def test_instruments_mix_and_what_none_knows_is_said(files: Path) -> None:
    bed = run("calibrate", CLAVEL, "--probe", files / "bed.csv")
    assert bed.out.startswith("doubtful: ")
    assert "not known: " in bed.out
    both = ("--probe", files / "bed.csv", "--distances", files / "parts.csv")
    mixed = json.loads(run("calibrate", CLAVEL, *both, "--json").out)
    alone = json.loads(run("calibrate", CLAVEL, *both[:2], "--json").out)
    assert mixed["after"]["position"] < 0.5 * alone["after"]["position"]
    assert mixed["rank"] > alone["rank"]
    assert {x["decided_by"] for x in mixed["numbers"]} <= {"description", "probe", "distances"}


def swapped(frame: pl.DataFrame) -> pl.DataFrame:
    return frame.rename({"q1": "q2", "q2": "q1"})


def thousandfold(*names: str) -> Callable[[pl.DataFrame], pl.DataFrame]:
    return lambda frame: frame.with_columns(pl.col(*names) * 1e3)


def changed(**columns: pl.Expr) -> Callable[[pl.DataFrame], pl.DataFrame]:
    return lambda frame: frame.with_columns(**columns)


POINT = ("px", "py", "pz")
HOLE = pl.when(pl.int_range(pl.len()) != 9).then(pl.col("px"))
REVERSED = {name: pl.col(name).reverse() for name in POINT}
MISTAKES = {
    "mm": ("points", thousandfold(*POINT), "likely they are in mm"),
    "parts in mm": ("parts", thousandfold("distance"), "likely they are in mm"),
    "mirrored": ("points", changed(px=-pl.col("px")), "the frame is left-handed"),
    "order": ("points", changed(**REVERSED), "in another order"),
    "exchanged": ("points", swapped, "drives 1 and 2 are exchanged"),
    "degrees": ("points", changed(q1=57.3 * pl.col("q1")), "likely degrees"),
    "hole": ("points", changed(px=HOLE), "is empty"),
    "column": ("points", lambda frame: frame.drop("pz"), "has no column pz"),
    "many": (
        "points",
        lambda frame: frame.sample(30_000, with_replacement=True),
        "has 30000 readings; at most 20000",
    ),
    "few": ("points", lambda frame: frame.head(2), "too few"),
    "bed": ("bed", thousandfold("z"), "cannot reach"),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_are_named(mistake: str, files: Path, tmp_path: Path) -> None:
    name, change, said = MISTAKES[mistake]
    option = {"points": "--points", "bed": "--probe", "parts": "--distances"}[name]
    change(pl.read_csv(files / f"{name}.csv")).write_csv(tmp_path / "wrong.csv")
    message = refused("calibrate", CLAVEL, option, tmp_path / "wrong.csv", folder=tmp_path)
    assert said in message
    assert "wrong.csv" in message


def test_what_cannot_be_is_refused(files: Path, tmp_path: Path) -> None:
    own = tmp_path / "columns.yaml"
    own.write_text("points: {noize: 1}\n", encoding="utf-8")
    bed = ("--probe", files / "bed.csv")
    for arguments, said in {
        (): "nothing was measured",
        (*bed, "--hold", "strutt"): "did you mean strut?",
        (*bed, "--lengths", "5"): "must lie between",
        (*bed, "--struts-apart"): "strut_spacing",
        (*bed, "--tool", "1"): "must be three numbers",
        (*bed, "--columns", own): "did you mean noise?",
    }.items():
        assert said in refused("calibrate", CLAVEL, *arguments, folder=tmp_path)


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


def sphere_point(towers: Array, rods: Array) -> Array:
    """The lower of two points at given distances of three."""
    A, b = 2 * (towers[1:] - towers[0]), np.sum(towers**2, axis=1) - rods**2
    way = np.cross(A[0], A[1])
    p = np.linalg.lstsq(A, b[1:] - b[0], rcond=None)[0]
    t = np.roots(
        [way @ way, 2 * way @ (p - towers[0]), np.sum((p - towers[0]) ** 2) - rods[0] ** 2]
    )
    return min((p + root * way for root in t.real), key=lambda point: point[2])


def letters(line: str) -> dict[str, list[float]]:
    return {word[0]: [float(x) for x in word[1:].split(":")] for word in line.split()[1:]}


def test_a_firmware_with_these_numbers_stands_where_the_printer_does(tmp_path: Path) -> None:
    robot, rng = machine(KOSSEL, 4, length=5e-4, angle=1e-6, scale=0.0)
    x = somewhere(KOSSEL, rng, 60)
    pl.DataFrame(tracked(KOSSEL, x, real(robot, KOSSEL, x), rng)).write_csv(tmp_path / "points.csv")
    places = np.column_stack([rng.uniform(-0.07, 0.07, (20, 2)), np.full(20, -0.5)])
    pl.DataFrame(touched(robot, KOSSEL, places, 1e-6, rng)).write_csv(tmp_path / "bed.csv")
    names = ("klipper", "marlin", "reprap")
    given = ("--points", tmp_path / "points.csv", "--probe", tmp_path / "bed.csv")
    configs = [word for name in names for word in (f"--{name}", tmp_path / name)]
    done = run("calibrate", KOSSEL, *given, *configs)
    assert done.code == 0, done.err
    left = float(re.search(r"leaves (\S+) mm", done.out)[1]) * 1e-3
    text = {name: (tmp_path / name).read_text("utf-8") for name in names}
    values = dict(re.findall(r"\[(stepper_.)\]\n((?:\w+: .*\n)+)", text["klipper"]))
    towers = [dict(line.split(": ") for line in part.splitlines()) for part in values.values()]
    R = float(re.search(r"delta_radius: (.*)", text["klipper"])[1])
    rods, angle, end = (
        np.array([float(t[k]) for t in towers]) for k in ("arm_length", "angle", "position_endstop")
    )
    m665, m666 = (letters(line) for line in text["reprap"].splitlines()[-2:])
    assert m665["H"] + np.ravel([m666[k] for k in "XYZ"]) == pytest.approx(end, abs=1e-3)
    m665, m666 = (letters(line) for line in text["marlin"].splitlines()[-2:])
    assert m665["H"] - np.ravel([m666[k] for k in "XYZ"]) == pytest.approx(end, abs=1e-3)
    assert m665["L"] + np.ravel([m665[k] for k in "ABC"]) == pytest.approx(rods, abs=1e-3)
    trims = np.ravel([m665[k] for k in "XYZ"])
    assert (angle - trims) % 360 == pytest.approx(np.array([0, 120, 240]), abs=1e-3)
    a, q = np.deg2rad(angle), 1e3 * kinematics(KOSSEL).inverse(x)
    at_home = end + np.sqrt(rods**2 - R**2)
    believed = np.array([
        sphere_point(np.column_stack([R * np.cos(a), R * np.sin(a), at_home - row]), rods)
        for row in q
    ]) * 1e-3  # fmt: skip
    m = real(robot, KOSSEL, x)
    assert shape_error(believed, m) < 1.5 * left + 3e-5
    assert shape_error(x, m) > 5 * shape_error(believed, m)
    assert believed[:, 2] == pytest.approx(m[:, 2] + 0.5, abs=3 * left + 1e-4)  # above the bed
    alone = ("calibrate", KOSSEL, *given[:2], "--klipper", tmp_path / "new")
    refusal = refused(*alone, folder=tmp_path)
    assert "no bed was probed" in refusal


def test_next_readings_are_worth_what_they_promise(files: Path) -> None:
    arguments = ("calibrate", CLAVEL, "--probe", files / "bed.csv", "--next", 4)
    assert "next, 4 points: positions to " in run(*arguments).out
    plans = {plan["kind"]: plan for plan in json.loads(run(*arguments, "--json").out)["next"]}
    assert set(plans) == {"points", "probe", "distances"}
    assert max(plans["probe"]["blocks"]) == 0.1  # a second height shows most
    robot, rng = machine(CLAVEL, 2)
    ends = np.array(plans["distances"]["poses"]).swapaxes(0, 1)
    taken = spans(robot, CLAVEL, *ends, rng)
    after = deltaid.calibrate(CLAVEL, probe=files / "bed.csv", distances=taken).after.position
    assert after == pytest.approx(plans["distances"]["position"], rel=0.1)
    worse = [
        deltaid.calibrate(
            CLAVEL,
            probe=files / "bed.csv",
            distances=spans(robot, CLAVEL, *somewhere(CLAVEL, rng, 8).reshape(2, 4, 3), rng),
        )
        for _ in range(3)
    ]
    assert after < min(found.after.position for found in worse)
