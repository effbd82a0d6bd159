"""Measured values of bodies as rows, against clouds of points; and in a fit."""

import re

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.parameters import parameter_layout
from deltaid.errors import DescriptionError
from deltaid.identification.identify import identify
from deltaid.robot.load import load_robot
from deltaid.robot.measured import MeasuredTogether
from deltaid.sensors.weighings import weighing, weighings
from poor_priors import PLAIN
from sensed import CASES, drawn, identified, recorded, sensed

EXACT = {"lengths": 0.0, "homing": 0.0, "mounting": 0.0}


def cloud(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Masses and places of a body's points."""
    return rng.uniform(0.1, 1.0, 7), rng.uniform(-0.5, 0.5, (7, 3))


def ten(m: np.ndarray, r: np.ndarray) -> np.ndarray:
    """The ten parameters of points about the origin."""
    x, y, z = r.T
    return np.array([
        m.sum(), m @ x, m @ y, m @ z,
        m @ (y * y + z * z), m @ (x * x + z * z), m @ (x * x + y * y),
        -m @ (x * y), -m @ (y * z), -m @ (x * z),
    ])  # fmt: skip


def turned(angles_deg: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Points turned about x, then about y, then about z, which stay where they are."""
    for axis, angle in enumerate(np.deg2rad(angles_deg)):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        c, s = np.cos(angle), np.sin(angle)
        r = r.copy()
        r[:, a], r[:, b] = c * r[:, a] - s * r[:, b], s * r[:, a] + c * r[:, b]
    return r


def test_every_quantity_of_bodies_together_is_that_of_their_points() -> None:
    rng, robot = np.random.default_rng(5), load_robot("clavel-delta3")
    layout = parameter_layout(robot)
    p, placed, masses, places = np.zeros(len(layout.names)), [], [], []
    for body, count in (("U", 1), ("S", 2)):
        m, r = cloud(rng)
        p[layout.body(body)] = ten(m, r)
        angles, at = rng.uniform(-90, 90, 3), rng.uniform(-1, 1, 3)
        placed.append({"body": body, "count": count, "at": at.tolist(), "turned_deg": angles})
        masses.append(count * m)
        places.append(turned(angles, r) + at)
    m, r = np.concatenate(masses), np.concatenate(places)
    axis, about = rng.normal(size=3), rng.normal(size=3)
    e = axis / np.linalg.norm(axis)
    off = r - about
    centre = 0.123
    given = {
        "mass": (m.sum(), {}),
        "first_moment": (m @ r @ e, {"axis": axis}),
        "inertia": (m @ (np.sum(off**2, axis=1) - (off @ e) ** 2), {"axis": axis, "about": about}),
        "centre": (m @ r @ e - centre * m.sum(), {"axis": axis}),
    }
    for quantity, (truth, keys) in given.items():
        value = centre if quantity == "centre" else 1.0
        measurement = MeasuredTogether.model_validate(
            {quantity: value, "std": 0.01, "of": placed, **keys}
        )
        row = weighing(measurement, measurement.placed, layout, p)
        assert row.coefficients @ p == pytest.approx(truth, rel=1e-12)
        if quantity == "centre":
            assert (row.value, row.std) == pytest.approx((0.0, 0.01 * m.sum()))
        else:
            assert (row.value, row.std) == (1.0, 0.01)


def test_weighed_bodies_are_known_as_well_as_they_were_weighed() -> None:
    of, rng = sensed("clavel-delta3", "strut and platform weighed", 0.2), np.random.default_rng(3)
    held = []
    for _ in range(6):
        p = drawn(of.reduction, 0.2, rng)
        _, found = identified("clavel-delta3", of, p, 0.2, rng)
        by_name = {weighing.name: weighing for weighing in found}
        for name, std in (("S.m", 0.005 * 0.21), ("P.m", 0.005)):
            assert by_name[name].determined_by == "measured"
            assert by_name[name].std == pytest.approx(std, rel=0.05)
            share = by_name[name].share
            assert share.measured > 0.9
        assert by_name["viscous.drive1"].determined_by == "data"
        held += [
            parameter.low <= value <= parameter.high
            for parameter, value in zip(found, p, strict=True)
            if parameter.determined_by in ("data", "measured") and parameter.low is not None
        ]
    assert np.mean(held) > 0.88


@pytest.mark.parametrize(
    ("body", "off"), [("S", 0.03), pytest.param("P", 0.2, marks=pytest.mark.slow)]
)
def test_a_weighing_that_the_recording_contradicts_is_reported(body: str, off: float) -> None:
    of, rng = sensed("clavel-delta3", "strut and platform weighed", 0.2), np.random.default_rng(4)
    p = of.reduction.p_reg
    log = recorded("clavel-delta3", of, p, rng)
    # Three values of two bodies: of S.m, P.m and a sum that torques know, the odd one is seen.
    true = {weighing.name: weighing.coefficients @ p for weighing in weighings(of.robot)}
    values = [
        {"of": "S", "mass": true["mass of S"], "std": 0.0005},
        {"of": "P", "mass": true["mass of P"], "std": 0.0005},
        {"of": "U", "first_moment": float(p[1]), "axis": "x", "std": 0.0005},
    ]
    robot = of.robot.changed(measured=values)
    right = identify(robot, log, settings=PLAIN).model.warnings
    assert not [text for text in right if text.startswith("measured")]
    wrong = [
        value | {"mass": value["mass"] + off} if value["of"] == body else value for value in values
    ]
    warnings = identify(robot.changed(measured=wrong), log, settings=PLAIN).model.warnings
    assert any(
        "standard deviations apart" in text
        and "the recording, with what else was measured, says" in text
        for text in warnings
    )


def test_a_weighing_that_only_consistency_contradicts_is_reported() -> None:
    of, rng = sensed("clavel-delta3", "platform weighed", 0.5), np.random.default_rng(8)
    p = of.reduction.p_reg
    log, (row,) = recorded("clavel-delta3", of, p, rng), weighings(of.robot)
    heavy = [{"of": "P", "mass": 3.0 * float(row.coefficients @ p), "std": 0.005}]
    model = identify(of.robot.changed(measured=heavy), log, settings=PLAIN).model
    (warning,) = (text for text in model.warnings if text.startswith("measured"))
    assert "the fit, whose bodies must be possible, says" in warning


def test_only_what_no_torque_shows_becomes_free() -> None:
    free = {name: body.free for name, body in load_robot("clavel-delta3").bodies.items()}
    CASES["arm weighed"] = {"measured": [("U", 0.01)]}
    of = sensed("clavel-delta3", "arm weighed", 0.5)
    assert set(of.robot.bodies["U"].free) == {*free["U"], "m"}
    assert of.robot.bodies["S"].free == free["S"]
    wrench = sensed("clavel-delta3", "wrench", 0.5)
    assert {"m", "Szz", "mcx"} <= set(wrench.robot.bodies["U"].free)
    assert {"mcx", "mcy", "mcz"} <= set(wrench.robot.bodies["P"].free)
    assert "Sxx" not in wrench.robot.bodies["P"].free  # the platform does not turn
    assert wrench.robot.bodies["S"].free == free["S"]  # torques show what it leaves out


def test_one_value_is_given_with_its_axis() -> None:
    robot = load_robot("clavel-delta3")
    for wrong, words in (
        ({"std": 1.0}, "gives none of them"),
        ({"mass": 1.0, "centre": 0.1, "std": 1.0}, "mass and centre"),
        ({"mass": 1.0, "axis": "x", "std": 1.0}, "no axis"),
        ({"inertia": 1.0, "std": 1.0}, "needs its axis"),
        ({"centre": 0.1, "axis": "x", "about": (0.1, 0, 0), "std": 1.0}, "inertia alone"),
        ({"mass": 1.0}, "std"),
    ):
        with pytest.raises(DescriptionError, match=words):
            robot.changed(measured=[{"of": "S", **wrong}])


def test_spread_of_an_entry_is_that_of_its_prior() -> None:
    robot = load_robot("clavel-delta3")
    bodies = dict(robot.bodies)
    bodies["S"] = bodies["S"].changed(spread={"m": 0.01})
    of, rng = sensed("clavel-delta3", "torque", 0.5), np.random.default_rng(0)
    log = recorded("clavel-delta3", of, of.reduction.p_reg, rng)
    wide = {
        parameter.name: parameter
        for parameter in identify(of.robot, log, settings=PLAIN).model.parameters
    }
    sure = identify(of.robot.changed(bodies=bodies), log, settings=PLAIN).model
    narrow = {parameter.name: parameter for parameter in sure.parameters}
    assert wide["S.m"].std == pytest.approx(0.5 * 0.21, rel=1e-6)
    assert narrow["S.m"].std == pytest.approx(0.01 * 0.21, rel=1e-6)
    assert narrow["U.mcx"].std < 0.5 * wide["U.mcx"].std  # with which it makes a sum


def test_a_prior_that_is_stated_to_be_wide_is_not_contradicted() -> None:
    of, rng = sensed("clavel-delta3", "torque", 0.1), np.random.default_rng(0)
    heavy = of.reduction.p_reg.copy()
    heavy[of.reduction.layout.body("P")] *= 1.6
    log = recorded("clavel-delta3", of, heavy, rng)
    settings = PLAIN.changed(prior_spread=0.1)
    corrections = identify(of.robot, log, settings=settings).model.corrections
    assert any(
        (correction.kind, correction.subject) == ("prior", "P") for correction in corrections
    )
    bodies = dict(of.robot.bodies)
    bodies["P"] = bodies["P"].changed(spread=1.0)
    unsure = identify(of.robot.changed(bodies=bodies), log, settings=settings).model.corrections
    assert not [parameter.subject for parameter in unsure if parameter.kind == "prior"]


def test_what_is_weighed_says_that_it_rests_on_torque_constants() -> None:
    """Torques 3 % too large: the warning foretells what goes wrong, and a tolerance takes it in."""
    CASES["both known"] = {"measured": [("S", 0.001), ("P", 0.001)]}
    name = "clavel-delta3"
    of, rng = sensed(name, "both known", 0.5), np.random.default_rng(5)
    p = of.reduction.p_reg
    log = recorded(name, of, p, rng)
    large = log.with_columns(pl.selectors.starts_with("tau") * 1.03)
    right, wrong = (identify(of.robot, table, settings=PLAIN).model for table in (log, large))
    (warning,) = (text for text in right.warnings if "torque constants" in text)
    foretold = dict(re.findall(r"(\S+) by ([\d.]+) %", warning))
    assert len(foretold) == 3
    values = [
        {parameter.name: parameter.value for parameter in model.parameters}
        for model in (right, wrong)
    ]
    for entry, share in foretold.items():
        seen = abs(values[1][entry] / values[0][entry] - 1) / 0.03
        assert seen == pytest.approx(float(share) / 100 / 0.01, rel=0.2), entry
    unsure = of.robot.changed(tolerances={**EXACT, "torque_constants": 0.03})
    model = identify(unsure, large, settings=PLAIN).model
    assert not [text for text in model.warnings if "torque constants" in text]
    for parameter, true in zip(model.parameters, p, strict=True):
        if parameter.determined_by in ("data", "measured"):
            assert abs(parameter.value - true) < 3 * parameter.std, parameter.name
    # The constants that a plate tells are not in its intervals twice.
    of = sensed(name, "wrench", 0.5)
    log = recorded(name, of, of.reduction.p_reg, rng)
    widths = [
        [parameter.std for parameter in identify(robot, log, settings=PLAIN).model.parameters]
        for robot in (of.robot, of.robot.changed(tolerances={**EXACT, "torque_constants": 0.03}))
    ]
    np.testing.assert_allclose(widths[0], widths[1], rtol=1e-6)
