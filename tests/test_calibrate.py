"""`deltaid calibrate`: hidden machines of a generator that shares no code with the package."""

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from command import accepted, json_of, refused, run
from deltaid.calibration.loops import Loops
from deltaid.calibration.unknowns import unknowns
from measured_poses import (
    CLAVEL,
    KOSSEL,
    NOISE,
    POINT,
    drives,
    kinematics,
    machine,
    measured,
    real,
    spans,
    touched,
    tracked,
)
from oracle.measured_delta import DRAWINGS, shape_error
from oracle.tree import Array
from sessions import ROOT

# Machines of each kind, so that all kinds take some seconds together.
MACHINES = {
    CLAVEL: 4, KOSSEL: 4, "linear-delta-45": 2, "par4": 2, "h4-linear": 2, "i4": 2,
    "abb-irb360-1-1130": 2,
}  # fmt: skip


@pytest.mark.parametrize("name", MACHINES)
def test_intervals_hold_and_predicted_errors_are_true_ones(name: str) -> None:
    """`benchmarks/calibrate.py` shows the same to a per cent."""
    scores, true, predicted, drawing = [], [], [], DRAWINGS[name]
    for seed in range(MACHINES[name]):
        robot, rng = machine(name, seed, scale=1e-3 if drawing.arm is None else 0.0)
        x = drawing.poses(rng, 60)
        given = {"points": tracked(name, x, real(robot, name, x), rng)}
        tilts = drawing.spacing is not None
        found = deltaid.calibrate(
            name, **given, lengths=1e-3, angles=1e-3, struts_apart=tilts, tool=(0, 0, -0.05)
        )
        assert found.verdict.startswith("good: ")
        assert found.sessions[0].residual == pytest.approx(NOISE, rel=0.3)
        assert len(found.values) == (42 if tilts else len(found.values))
        expected = robot.numbers()
        scores += [
            (v - expected[n]) / s
            for n, v, s in zip(found.names, found.values, found.std, strict=True)
        ]
        loops, over = found.fit.loops, drawing.poses(rng, 60)
        q = drives(name, over)
        now, m = loops.points(q, found.values), real(robot, name, over)
        true.append(shape_error(now.x, m))
        J = now.slopes.reshape(-1, len(found.values)) @ found.known.G @ found.fit.root
        arms = now.x - now.x.mean(0)
        turns = [np.cross(axis, arms).ravel() for axis in np.eye(3)]
        rigid = np.linalg.qr(np.column_stack([*np.tile(np.eye(3), (60, 1)).T, *turns]))[0]
        predicted.append(np.linalg.norm(J - rigid @ (rigid.T @ J)) / np.sqrt(60))
        assert true[-1] < 0.2 * shape_error(over[:, :3], m)
    # 42 to 96 numbers, correlated: of 95 % three standard deviations may be missing
    assert np.mean(np.abs(scores) < 1.96) > 0.84
    ratio = np.sqrt(np.mean(np.square(true)) / np.mean(np.square(predicted)))
    assert 0.6 < ratio < 1.6  # of some twenty directions that readings know, twice or four times


def test_one_strut_a_limb_cannot_hold_what_the_platform_tilts() -> None:
    name, apart = "abb-irb360-1-1130", []
    robot, rng = machine(name, 3)
    x, over = DRAWINGS[name].poses(rng, 60), DRAWINGS[name].poses(rng, 40)
    readings, m = tracked(name, x, real(robot, name, x), rng), real(robot, name, over)
    for struts_apart in (False, True):
        found = deltaid.calibrate(
            name, points=readings, lengths=1e-3, struts_apart=struts_apart, tool=(0, 0, -0.05)
        )
        q = found.fit.loops.inverse(over)
        now = found.fit.loops.points(q, found.values)
        apart.append(shape_error(now.x, m))
    assert apart[1] < 3e-5
    assert apart[0] > 1.5 * apart[1]


@pytest.mark.parametrize("name", ["par4", "h4-linear"])
def test_slopes_of_robots_that_turn_their_tool(name: str) -> None:
    robot = deltaid.load_robot(name)
    known, rng = unknowns(robot), np.random.default_rng(0)
    loops = Loops(robot, known)
    q = drives(name, DRAWINGS[name].poses(rng, 20))
    theta = known.G @ rng.normal(0, 1, known.G.shape[1])
    slopes = loops.points(q, theta).slopes
    for k, step in enumerate(1e-6 * np.eye(len(theta))):
        up, down = (loops.points(q, theta + sign * step).x for sign in (1, -1))
        assert (up - down) / 2e-6 == pytest.approx(slopes[:, :, k], abs=1e-7)


@pytest.mark.parametrize("seed", range(3))
def test_outliers_and_rows_given_twice_are_named(seed: int) -> None:
    robot, rng = machine(CLAVEL, 5 + seed)
    x = DRAWINGS[CLAVEL].poses(rng, 60)
    readings = tracked(CLAVEL, x, real(robot, CLAVEL, x), rng)
    kept = np.delete(np.arange(60), [7, 20, 30, 50])
    clean = deltaid.calibrate(CLAVEL, points={name: x[kept] for name, x in readings.items()})
    readings["pz"][7] += 1e-3
    readings["px"][30] -= 2e-4
    for name in POINT:  # written down at each other's poses
        readings[name][[50, 20]] = readings[name][[20, 50]]
    twice = {name: np.append(column, column[4]) for name, column in readings.items()}
    found = deltaid.calibrate(CLAVEL, points=twice)
    excluded = found.sessions[0].excluded
    assert len(excluded) == 5
    sizes = {text.split(":")[0]: text.split()[-2] for text in excluded}
    assert float(sizes["row 8"]) == pytest.approx(1.0, abs=0.1)
    assert float(sizes["row 31"]) == pytest.approx(0.2, abs=0.1)
    assert "row 61: the same as row 5" in excluded
    assert any(
        text.startswith("row 21: off by ") and text.endswith("it fits the pose of row 51")
        for text in excluded
    )
    assert found.values == pytest.approx(clean.values, abs=1e-8)


@pytest.mark.parametrize("seed", range(3))
def test_outliers_of_a_probe_are_named_and_no_others(seed: int) -> None:
    """Three of thirty touches, of twenty numbers: outliers hide each other, and make others look
    like some."""
    robot, rng = machine(CLAVEL, seed)
    places = rng.uniform([-0.3, -0.3, -1.05], [0.3, 0.3, -1.05], (30, 3))
    places[15:, 2] += 0.1
    bed = touched(robot, CLAVEL, places, 1e-5, rng)
    clean = deltaid.calibrate(CLAVEL, probe=bed)
    rows = rng.choice(30, 3, replace=False)
    bed["z"][rows] += [2e-2, -4e-4, 3e-4]
    found = deltaid.calibrate(CLAVEL, probe=bed)
    named = {
        int(text.split(":")[0].removeprefix("row ")) - 1 for text in found.sessions[0].excluded
    }
    assert named == set(rows.tolist())
    assert np.all(np.abs(found.values - clean.values) < 3 * found.std)


@pytest.mark.parametrize("seed", range(3))
def test_noise_larger_than_stated_widens_intervals_and_excludes_nothing(seed: int) -> None:
    robot, rng = machine(CLAVEL, seed)
    x = DRAWINGS[CLAVEL].poses(rng, 60)
    readings = tracked(CLAVEL, x, real(robot, CLAVEL, x), rng)
    for name in POINT:
        readings[name] += rng.normal(0, 10 * NOISE, 60)
    found = deltaid.calibrate(CLAVEL, points=readings)
    assert found.sessions[0].excluded == ()
    assert found.sessions[0].grown == pytest.approx(10, rel=0.2)
    assert found.verdict.startswith("doubtful: ")
    (doubt,) = found.doubts
    assert "× the stated noise; likeliest cause: noise that is stated too small" in doubt


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return measured(tmp_path_factory.mktemp("measured"), 2)


def test_the_command_says_the_verdict_first_on_one_screen(files: Path, tmp_path: Path) -> None:
    out, page = tmp_path / "robot.yaml", tmp_path / "page.html"
    done = run("calibrate", CLAVEL, "--points", files / "points.csv", "-o", out, "--report", page)
    lines = done.out.splitlines()
    assert done.code == 0, done.err
    assert lines[0].startswith("Good: positions to 0.0")
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
    found = json_of("calibrate", CLAVEL, "--points", files / "points.csv")
    robot = deltaid.load_robot(out)
    readings = pl.read_csv(files / "points.csv")
    q = readings.select("q1", "q2", "q3").to_numpy() + list(found["zeros"].values())
    x = deltaid.Kinematics(robot).forward(q)
    assert shape_error(x, readings.select("px", "py", "pz").to_numpy()) < 6e-5
    assert robot.tolerances.of_length("strut") < 2e-4


def test_instruments_mix_and_what_none_knows_is_said(files: Path) -> None:
    bed = run("calibrate", CLAVEL, "--probe", files / "bed.csv")
    assert bed.out.startswith("Doubtful: ")
    every = run("calibrate", CLAVEL, "--probe", files / "bed.csv", "--full").out
    combinations = [text.count("Not known: ") - 1 for text in (bed.out, every)]  # and mistakes
    assert combinations == [3, len(deltaid.calibrate(CLAVEL, probe=files / "bed.csv").open)]
    assert combinations[1] > 3
    assert "--full prints also" in bed.out
    both = ("--probe", files / "bed.csv", "--distances", files / "parts.csv")
    mixed = json_of("calibrate", CLAVEL, *both)
    alone = json_of("calibrate", CLAVEL, *both[:2])
    assert mixed["after"]["position"] < 0.5 * alone["after"]["position"]
    assert mixed["rank"] > alone["rank"]
    assert {x["decided_by"] for x in mixed["numbers"]} <= {"description", "probe", "distances"}


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
    x = DRAWINGS[KOSSEL].poses(rng, 60)
    pl.DataFrame(tracked(KOSSEL, x, real(robot, KOSSEL, x), rng)).write_csv(tmp_path / "points.csv")
    places = np.column_stack([rng.uniform(-0.07, 0.07, (20, 2)), np.full(20, -0.5)])
    pl.DataFrame(touched(robot, KOSSEL, places, 1e-6, rng)).write_csv(tmp_path / "bed.csv")
    names = ("klipper", "marlin", "reprap")
    given = ("--points", tmp_path / "points.csv", "--probe", tmp_path / "bed.csv")
    configs = [word for name in names for word in (f"--{name}", tmp_path / name)]
    done = accepted("calibrate", KOSSEL, *given, *configs)
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


def test_what_a_calibrated_file_cannot_hold_is_said_as_it_is_written(tmp_path: Path) -> None:
    robot, rng = machine(KOSSEL, 4)
    x = DRAWINGS[KOSSEL].poses(rng, 60)
    pl.DataFrame(tracked(KOSSEL, x, real(robot, KOSSEL, x), rng)).write_csv(tmp_path / "points.csv")
    given = ("calibrate", KOSSEL, "--points", tmp_path / "points.csv")
    out = " ".join(run(*given, "-o", tmp_path / "own.yaml").out.split())
    found = deltaid.calibrate(KOSSEL, points=tmp_path / "points.csv")
    scales = ", ".join(f"{drive} {value:+.6f}" for drive, value in found.scales.items())
    assert f"holds no drive scales; shares that drives move more than recorded: {scales}" in out
    lean = f"holds no rail lean aside, which leaves {1e3 * found.left:.2g} mm of position"
    assert lean in out
    assert scales in " ".join((tmp_path / "own.yaml").read_text("utf-8").split())
    apart = run(*given, "--struts-apart", "-o", tmp_path / "own.yaml").out
    assert "holds no rail lean aside and struts apart, which" in " ".join(apart.split())
    held = run(*given, "--hold", "scale,lean_across", "-o", tmp_path / "own.yaml").out
    assert " holds no " not in held


def test_next_readings_are_worth_what_they_promise(files: Path) -> None:
    arguments = ("calibrate", CLAVEL, "--probe", files / "bed.csv", "--next", 4)
    out = run(*arguments).out
    assert "\nbest for its price, " in out
    assert len(out.splitlines()) <= 25
    found = json_of(*arguments)
    plans = {plan["name"]: plan for plan in found["next"]}
    assert {plan["kind"] for plan in plans.values()} == {"points", "probe", "distances"}
    assert f"{plans['calliper']['cost']:.0f}" in out
    worth = [plan["gain"] / plan["cost"] for plan in found["next"]]
    assert worth == sorted(worth, reverse=True)
    assert all(plan["position"] < found["after"]["position"] for plan in plans.values())
    assert plans["bed-probe"]["cost"] == 25.0  # which is there already: work alone
    assert max(plans["gauge-blocks"]["blocks"]) == 0.1  # a second height shows most
    robot, rng = machine(CLAVEL, 2)
    ends = np.array(plans["calliper"]["poses"]).swapaxes(0, 1)
    taken = spans(robot, CLAVEL, *ends, rng)
    after = deltaid.calibrate(CLAVEL, probe=files / "bed.csv", distances=taken).after
    assert after.position == pytest.approx(plans["calliper"]["position"], rel=0.1)
    assert after.size == pytest.approx(plans["calliper"]["size"], rel=0.2)
    worse = [
        deltaid.calibrate(
            CLAVEL,
            probe=files / "bed.csv",
            distances=spans(robot, CLAVEL, *DRAWINGS[CLAVEL].poses(rng, 8).reshape(2, 4, 3), rng),
        )
        for _ in range(3)
    ]
    assert after.position < min(calibration.after.position for calibration in worse)


def test_prices_of_next_readings_are_a_users_own(files: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text(
        "currency: CHF\nhourly: 0\noffers:\n"
        "  lens: {title: a lens, price: 1, reads: {kind: points, noise: 0.001}}\n"
        "  laser: {title: a laser, price: 2, reads: {kind: points, noise: 0.00002}}\n"
        "  dear: {title: the same, price: 500, reads: {kind: points, noise: 0.00002}}\n"
        "  scale: {title: a scale, price: 3, weigh: {quantity: mass, share: 0.1}}\n",
        encoding="utf-8",
    )
    given = ("calibrate", CLAVEL, "--probe", files / "bed.csv", "--next", 6, "--sensors", own)
    plans = json_of(*given, "--budget", 100)["next"]
    assert [plan["name"] for plan in plans] == ["laser", "lens"]
    assert {plan["currency"] for plan in plans} == {"CHF"}
    assert "at this price" in refused(*given, "--budget", 0.5, folder=tmp_path)


def test_exchanged_axes_of_a_bed_are_not_known_and_said_so(files: Path, tmp_path: Path) -> None:
    """A mirror image of a Delta with equal limbs is one too, so its bed is as flat."""
    printer, exchanged = ROOT / "examples" / "printer", tmp_path / "bed.csv"
    pl.read_csv(printer / "bed.csv").rename({"x": "y", "y": "x"}).write_csv(exchanged)
    for path in (printer / "bed.csv", exchanged):
        found = run("calibrate", KOSSEL, "--probe", path, "--columns", printer / "columns.yaml")
        said = " ".join(found.out.split())
        assert "Not known: whether x and y of commanded points, or two drives, are" in said
        assert "or the points' origin is shifted" in said
    assert not deltaid.calibrate(CLAVEL, points=files / "points.csv").unseen
