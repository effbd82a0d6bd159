"""Sensors beside the drives in a fit: intervals hold, gains follow from a plate, facts scatter."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
from scipy.spatial.transform import Rotation

import deltaid
from deltaid.dynamics.dynamics import compiled
from deltaid.estimation.additions import extended
from deltaid.estimation.scatter import Scatter
from deltaid.identification.identify import identify
from deltaid.identification.measured_rows import MeasuredRows, SensorAddition
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.recording import open_recordings
from deltaid.robot.load import load_robot
from deltaid.robot.sensors import BaseWrench
from identified import identified as shared
from identified import simulated
from poor_priors import PLAIN
from sensed import CASES, drawn, identified, motion, recorded, sensed, weighed

SPREAD = 0.2


@pytest.mark.parametrize("case", ["wrench", "gauges"])
def test_intervals_of_what_sensors_show_hold(case: str) -> None:
    of, rng = sensed("clavel-delta3", case, SPREAD), np.random.default_rng(11)
    held, z = [], []
    for _ in range(5):
        p = drawn(of.reduction, SPREAD, rng)
        problem, found = identified("clavel-delta3", of, p, SPREAD, rng)
        left = problem.information.rms(problem.values)[3:]
        np.testing.assert_allclose(left / problem.information.levels, problem.noise, rtol=0.1)
        determined = [
            (parameter, x)
            for parameter, x in zip(found, p, strict=True)
            if parameter.determined_by == "data"
        ]
        held += [
            parameter.low <= x <= parameter.high
            for parameter, x in determined
            if parameter.low is not None
        ]
        z += [(parameter.value - x) / parameter.std for parameter, x in determined]
        shares = {
            parameter.name: parameter.share
            for parameter, _ in determined
            if parameter.share is not None
        }
        name = "P.mcx" if case == "wrench" else "P.m"
        assert shares[name].sensors > 0.5
        assert shares["viscous.drive2"].sensors < 0.2
    assert np.mean(held) > 0.88
    assert 0.75 < np.std(z) < 1.3


def test_gains_of_drives_follow_from_a_plate_without_any_load() -> None:
    of, rng = sensed("clavel-delta3", "wrench", 0.5), np.random.default_rng(2)
    gains = {0: 1.05, 1: 0.93, 2: 1.02}
    log = recorded("clavel-delta3", of, of.reduction.p_reg, rng, gains)
    model = identify(of.robot, log, settings=PLAIN).model
    found = {
        correction.subject: correction
        for correction in model.corrections
        if correction.kind == "gain"
    }
    for i, c in gains.items():
        gain = found[f"drive{i + 1}"]
        assert gain.value == pytest.approx(c, rel=3e-3)
        assert "plate" in gain.text
    (plate,) = model.sensors
    assert [channel.name for channel in plate.channels][:2] == ["plate.fx", "plate.fy"]
    biases = [parameter for parameter in plate.parameters if "bias" in parameter.name]
    assert len(biases) == 6


def test_a_recording_without_the_sensor_is_fitted_as_ever() -> None:
    of, rng = sensed("clavel-delta3", "wrench", 0.5), np.random.default_rng(6)
    log = recorded("clavel-delta3", of, of.reduction.p_reg, rng)
    bare = log.select([name for name in log.columns if not name.startswith("plate")])
    alone = identify(of.robot, bare, settings=PLAIN).model
    assert alone.sensors == ()
    logs = [bare, recorded("clavel-delta3", of, of.reduction.p_reg, rng)]
    assert identify(of.robot, logs, settings=PLAIN).model.sensors[0].name == "plate"


def test_facts_add_their_own_variance_to_the_scatter_of_groups() -> None:
    """Of least squares over rows in groups and rows whose noise is known, by simulation."""
    rng = np.random.default_rng(0)
    A, F, sigma = rng.normal(size=(400, 3)), np.diag([30.0, 5.0, 0.0]), 0.7
    root = np.linalg.qr(np.vstack([A, F]), mode="r")
    inverse = np.linalg.inv(root)
    Q, shares = A @ inverse, []
    groups = np.array_split(np.arange(400), 20)
    shares = np.stack([Q[g].T @ Q[g] for g in groups])
    seen, true = [], []
    for _ in range(400):
        # Twice the noise in rows, the known one in facts.
        e, f = 2 * sigma * rng.normal(size=400), sigma * rng.normal(size=3)
        s = Q.T @ e + (F @ inverse).T @ f
        left = e - Q @ s
        scores = np.stack([Q[g].T @ left[g] for g in groups])
        v, _ = Scatter(shares, scores, sigma).variances(np.eye(3))
        seen.append(v)
        true.append(s**2)
    assert np.mean(seen, axis=0) == pytest.approx(np.mean(true, axis=0), rel=0.15)


@pytest.mark.slow
def test_gain_and_pose_of_a_plate_are_found_and_do_not_follow_its_noise() -> None:
    CASES["plate noisy"] = {
        "sensors": {
            "plate": {
                "kind": "base-wrench",
                "force_noise": 8.0,
                "moment_noise": 0.8,
                "position_tolerance": 0.003,
                "rotation_tolerance": 0.01,
                "gain_tolerance": 0.02,
            }
        }
    }
    of, rng = sensed("clavel-delta3", "plate noisy", 0.5), np.random.default_rng(7)
    (rows,) = of.sensors
    true = np.array([0.0] * 6 + [0.002, -0.003, 0.004, 0.01, -0.005, 0.008, 0.02])
    log = recorded("clavel-delta3", of, of.reduction.p_reg, rng, unknowns=true)
    model = identify(of.robot, log, settings=PLAIN).model
    (plate,) = model.sensors
    assert [parameter.name for parameter in plate.parameters] == [
        parameter.name for parameter in rows.parameters
    ]
    for parameter, x in zip(plate.parameters, true, strict=True):
        assert abs(parameter.value - x) < 4 * parameter.std, parameter.name
    # Neither torques nor the plate are known in N better than the plate's tolerance.
    assert plate.parameters[-1].std > 1e-4
    assert "gain" in plate.parameters[-1].name


@pytest.mark.parametrize(
    ("place", "doubted"),
    [((0.0, 0.0, 0.05), "position_z"), ((0.002, -0.003, 0.002), ""),
     pytest.param((0.05, 0.0, 0.0), "position_x", marks=pytest.mark.slow)],
)  # fmt: skip
def test_a_plate_outside_of_its_tolerance_is_reported_and_not_absorbed(
    place: tuple[float, float, float], doubted: str
) -> None:
    """Mounted 50 mm off with 2 mm of tolerance, and within it."""
    plate = BaseWrench(
        kind="base-wrench", force_noise=0.5, moment_noise=0.1, position_tolerance=0.002
    )
    rng = np.random.default_rng(1)
    robot = load_robot("clavel-delta3").changed(sensors={"plate": plate})
    true = plate.changed(position=place, position_tolerance=0.0)
    p = surrogate_parameters(robot, rng)
    log = simulated(robot.changed(sensors={"plate": true}), p, rng, duration=10.0)
    model = identify(robot, log, settings=PLAIN).model
    warnings = [text for text in model.warnings if text.startswith("sensors.plate")]
    found = {
        parameter.name.partition(".")[0]: parameter for parameter in model.sensors[0].parameters
    }
    for axis, x in zip("xyz", place, strict=True):
        offset = found[f"position_{axis}"]
        assert offset.low is not None
        assert offset.high is not None
        assert offset.low <= x <= offset.high
    assert [text.partition(" is ")[0].split()[-1] for text in warnings] == [doubted] * bool(doubted)
    if doubted:
        assert float(re.findall(r"probability (\S+)\)", warnings[0])[0]) < 1e-8


@pytest.mark.parametrize(
    ("place", "turn", "gain"),
    [
        pytest.param((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), 0.0, marks=pytest.mark.slow),
        ((0.03, -0.02, 0.01), (0.05, -0.06, 0.04), 0.1),
    ],
)
def test_a_plate_that_truly_stands_elsewhere_is_found_there(
    place: tuple[float, ...], turn: tuple[float, ...], gain: float
) -> None:
    """Another plate, in that place and with those axes, has shown it."""
    about = {"kind": "base-wrench", "force_noise": 1.0, "moment_noise": 0.1}
    axes = Rotation.from_rotvec(turn).as_euler("xyz", degrees=True).tolist()
    unsure = {"position_tolerance": 0.05, "rotation_tolerance": 0.1, "gain_tolerance": 0.1}
    CASES["plate unsure"] = {"sensors": {"plate": about | unsure}}
    CASES["plate elsewhere"] = {
        "sensors": {"plate": about | {"position": list(place), "rotation_deg": axes}}
    }
    of, other = (
        sensed.__wrapped__("clavel-delta3", case, 0.5)
        for case in ("plate unsure", "plate elsewhere")
    )
    log = recorded("clavel-delta3", other, of.reduction.p_reg, np.random.default_rng(7))
    log = log.with_columns(pl.selectors.starts_with("plate") / (1.0 - gain))
    (plate,) = identify(of.robot, log, settings=PLAIN).model.sensors
    for parameter, x in zip(plate.parameters[6:], (*place, *turn, gain), strict=True):
        # A turn is told as 2 tan(θ/2), which is 0.1 mrad more at a tenth of a radian.
        assert abs(parameter.value - x) < 4 * parameter.std + 1e-4 * (parameter.unit == "rad"), (
            parameter.name
        )


@pytest.mark.parametrize("known", [pytest.param(True, marks=pytest.mark.slow), False])
def test_what_the_robot_holds_hangs_on_the_plate_too(known: bool) -> None:
    of, rng = sensed("clavel-delta3", "wrench", 0.5), np.random.default_rng(3)
    bare = of.reduction.p_reg
    held = bare.copy()
    held[of.reduction.layout.names.index("P.m")] += 0.8
    bias = np.array([3.0, -2.0, 5.0, 0.3, 0.2, -0.1])
    two = [recorded("clavel-delta3", of, p, rng, unknowns=bias) for p in (bare, held)]
    half = two[0]["t"].max() / 2
    log = pl.concat([two[0].filter(pl.col("t") < half), two[1].filter(pl.col("t") >= half)])
    load = {"name": "part", "spans": [[half - 1e-4, 1e6]]} | ({"mass": 0.8} if known else {})
    mapping = ColumnMapping.model_validate({"load": load})
    model = identify(of.robot, log, columns=mapping, settings=PLAIN).model
    (part,), (plate,) = model.loads, model.sensors
    assert part.mass.value == pytest.approx(0.8, abs=0.01)
    for parameter, x in zip(plate.parameters[:6], bias, strict=True):
        # Of the force upwards the base's own weight is a part.
        assert abs(parameter.value - x) < 4 * parameter.std, parameter.name
    for channel in plate.channels:
        assert channel.left < channel.stated


@pytest.mark.parametrize("name", [pytest.param("plate", marks=pytest.mark.slow), "weighed"])
def test_verdicts_after_a_fit_with_more_than_torques_are_those_of_torques(name: str) -> None:
    more = shared(name)
    plain = more.robot.changed(sensors={}, measured=[])
    bare = more.frames[0].select(~pl.selectors.starts_with("plate"))
    found, alone = (
        {
            verdict.key: verdict.seen
            for verdict in verdicts
            if verdict.key in ("base-parameters", "excitation")
        }
        for verdicts in (more.result.verdicts, deltaid.identify(plain, bare).verdicts)
    )
    assert found == alone
    assert len(found) == 2


def drag(v: np.ndarray) -> np.ndarray:
    """By the square of speed."""
    return np.sign(v) * v**2


def drag_backwards(v: np.ndarray) -> np.ndarray:
    """By speed, in one direction."""
    return np.minimum(v, 0.0)


@pytest.mark.parametrize(
    ("case", "shape", "word"),
    [
        ("wrench", drag, "|speed|"),
        pytest.param("strut and platform weighed", drag, "|speed|", marks=pytest.mark.slow),
        pytest.param("gauges", drag_backwards, "each direction its own", marks=pytest.mark.slow),
    ],
)
def test_friction_that_the_description_lacks_is_found_beside_sensors_and_scales(
    case: str, shape: Callable[[np.ndarray], np.ndarray], word: str
) -> None:
    """More columns come when gains and facts are known already; gains give friction no scale.

    Over the speeds of a motion another term may bend as much (of 24 drags 3 were such, by kernels),
    so that what the law gives is compared, and its name for one drive only.
    """
    of, rng = sensed("clavel-delta3", case, SPREAD), np.random.default_rng(3)
    p, (_, _, _, qd, _) = drawn(of.reduction, SPREAD, rng), motion("clavel-delta3")
    log = recorded("clavel-delta3", of, p, rng)
    sizes = list[float]()
    for i, v in enumerate(qd.T):
        tau = log[f"tau{i + 1}"].to_numpy()
        sizes.append(0.05 * np.abs(tau).max())
        more = sizes[i] * shape(v / np.abs(v).max())
        log = log.with_columns(pl.Series(f"tau{i + 1}", tau + more))
    settings = PLAIN.changed(prior_spread=SPREAD, friction="choose")
    model = identify(weighed(of, p, rng), log, settings=settings).model
    laws = [correction.text for correction in model.corrections if correction.kind == "friction"]
    assert len(laws) == 3
    assert any(word in text for text in laws)
    gains = [correction.value for correction in model.corrections if correction.kind == "gain"]
    assert gains == pytest.approx([1.0] * len(gains), abs=5e-3)
    true = dict(zip(of.reduction.layout.names, p, strict=True))
    for i, v in enumerate(qd.T):
        (curve,) = (curve for curve in model.friction_curves if curve.joint == f"drive{i + 1}")
        speed = 0.8 * np.abs(v).max() * np.array([-1.0, -0.7, 0.7, 1.0])
        law = true[f"viscous.drive{i + 1}"] * speed + true[f"coulomb.drive{i + 1}"] * np.sign(speed)
        expected = law + sizes[i] * shape(speed / np.abs(v).max())
        friction = np.interp(speed, curve.speed, curve.friction)
        np.testing.assert_allclose(friction, expected, rtol=0, atol=0.05 * sizes[i])
    known = [x for x in model.parameters if x.determined_by in ("data", "measured")]
    held = [x.low <= true[x.name] <= x.high for x in known if x.name in true and x.name[1] == "."]
    assert np.mean(held) > 0.8


def test_torques_that_do_not_count_leave_a_sensor_its_rows() -> None:
    """What makes one drive's torque useless does not reach a plate; what stops all of them does."""
    of = sensed("clavel-delta3", "wrench", SPREAD)
    dynamics = compiled(of.robot)
    log = recorded("clavel-delta3", of, of.reduction.p_reg, np.random.default_rng(3))
    (recording,) = open_recordings([log], dynamics.kinematics)
    window = next(iter(recording.windows(dynamics.kinematics)))
    plate = SensorAddition.for_sensor(dynamics, "plate", SPREAD)
    (part,) = MeasuredRows(extended(dynamics, [plate])).sensors
    for weights, counted in (([0.0, 1.0, 1.0], 1.0), ([0.0, 0.0, 0.0], 0.0)):
        some = replace(window.wide, weights=np.tile(weights, (len(window.wide.time), 1)))
        entries, y = part.weighted(some, recording)
        assert np.all(part.shown(some, recording)[1] == counted)
        assert np.any(entries) == np.any(y) == (counted > 0)
