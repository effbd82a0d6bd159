"""What sensors and scales would tell: against dense algebra, and what is bought first."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import DeltaidError, DescriptionError
from deltaid.excitation.by_bodies import by_bodies
from deltaid.excitation.excite import ExcitationSettings, Exciter
from deltaid.planning.bench import PlanSettings
from deltaid.planning.motion import generic_motion
from deltaid.planning.offers import Offers, load_offers, shipped_offers, shipped_text
from deltaid.planning.plan import SensorPlan, sensor_plan
from deltaid.planning.unknowns import unknowns
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, inertia_parameters, pseudo_inertia
from deltaid.robot.load import load_robot, parse
from deltaid.robot.sensors import BaseWrench, StrutForce
from deltaid.sensors.of_robot import sensor_rows
from descriptions import refusal

DELTA = "clavel-delta3"
SETTINGS = PlanSettings(torque_noise=0.03, rate=50.0, duration=8.0, steps=4, seed=3)
PLATE = {
    "kind": "base-wrench",
    "force_noise": 0.7,
    "moment_noise": 0.2,
    "force_bias": 3.0,
    "position_tolerance": 2e-3,
    "rotation_tolerance": 0.01,
    "gain_tolerance": 0.02,
}


def offers(**more: dict) -> Offers:
    """A scale, an edge, a pendulum, a plate and a gauge."""
    given = {
        "scale": {
            "title": "scale", "price": 20, "hours": 0.5,
            "weigh": [{"quantity": "mass", "share": 0.003, "std": 0.001},
                      {"quantity": "mass", "of": "limb", "std": 0.002}],
        },
        "edge": {
            "title": "edge", "price": 5, "hours": 0.2,
            "weigh": {"quantity": "centre", "of": "S", "axis": "x", "std": 2e-3},
        },
        "pendulum": {
            "title": "pendulum", "price": 40, "hours": 1,
            "weigh": {"quantity": "inertia", "of": "U", "axis": "y", "about": [0.1, 0, 0],
                      "share": 0.01},
        },
        "plate": {"title": "plate", "price": 3000, "sensors": {"plate": PLATE}},
        "gauges": {
            "title": "gauges", "price": 300, "hours": 2,
            "sensors": {"g": {"kind": "strut-force", "strut": "each", "at": "platform",
                              "noise": 0.4}},
        },
    }  # fmt: skip
    return Offers.model_validate({"hourly": 30, "offers": given | more})


@cache
def planned() -> SensorPlan:
    both = ("plate", "scale:U+2S")
    return sensor_plan(DELTA, offers=offers(), combinations=[both], settings=SETTINGS)


def dense(robot: RobotDescription, names: tuple[str, ...]) -> dict[str, float]:
    """Standard deviations of all entries of bodies with torques and some uses, as shares.

    One covariance of everything at once: entries of M̄, coefficients, unknowns of sensors.
    """
    dynamics = compiled(robot)
    layout, p = dynamics.layout, prior_parameters(robot)
    motion = generic_motion(dynamics, SETTINGS.duration, SETTINGS.seed)
    q = dynamics.kinematics.drive_motion(motion.z, motion.qd * 0, motion.qdd * 0)[0]
    count = SETTINGS.rate * SETTINGS.duration / len(q)
    # Variables: names, derivative of p by each, prior deviation.
    variables, columns, stds, sizes = [], [], [], []
    for body in robot.body_names:
        at = layout.body(body)
        M = pseudo_inertia(p[at])
        for name, (i, j) in PSEUDO_INERTIA_ENTRIES.items():
            unit = np.zeros((4, 4))
            unit[i, j] = unit[j, i] = 1.0
            column = np.zeros(len(p))
            column[at] = inertia_parameters(unit)
            largest = np.sqrt(M[i, i] * M[j, j])
            size = abs(M[i, j]) if abs(M[i, j]) > 1e-3 * largest else largest
            variables.append(f"{body}.{name}")
            columns.append(column)
            sizes.append(size)
            stds.append(0.5 * size)
    for k in range(10 * len(robot.body_names), len(p)):
        variables.append(layout.names[k])
        columns.append(np.eye(len(p))[k])
        sizes.append(p[k])
        stds.append(0.5 * p[k])
    J = np.column_stack(columns)
    Y = dynamics.regressor(q, motion.qd, motion.qdd)
    noise = SETTINGS.torque_noise * np.abs(Y @ p).max(axis=0)
    information = np.diag(1.0 / np.array(stds) ** 2)
    for i in range(dynamics.dof):
        A = Y[:, i] @ J / noise[i]
        information += count * A.T @ A

    def value(c: np.ndarray, std: float) -> None:
        nonlocal information
        row = np.zeros(len(information))
        row[: len(columns)] = c @ J / std
        information = information + np.outer(row, row)

    def sensor(name: str, described: BaseWrench | StrutForce) -> None:
        nonlocal information
        rows = sensor_rows(dynamics, name, described)
        at, column = rows.pattern
        shape = len(rows.channels), len(p) + len(rows.parameters)
        C = np.zeros((len(q), *shape))
        entries = rows.entries(motion.z, motion.qd, motion.qdd, np.zeros((shape[0], len(q))))
        C[:, at, column] = entries.T
        shown = (C[:, :, : len(p)] @ p).T
        C[:, at, column] = rows.entries(motion.z, motion.qd, motion.qdd, shown).T
        own = len(rows.parameters)
        larger = np.zeros((len(information) + own,) * 2)
        larger[:-own, :-own] = information
        larger[-own:, -own:] = np.diag([one.std**-2.0 for one in rows.parameters])
        for c, channel in enumerate(rows.channels):
            A = np.zeros((len(q), len(larger)))
            A[:, : len(columns)] = C[:, c, : len(p)] @ J
            A[:, -own:] = C[:, c, len(p) :]
            larger += count * A.T @ A / channel.noise**2
        information = larger

    def entry(body: str, k: int) -> np.ndarray:
        return np.eye(len(p))[layout.body(body).start + k]

    for name in names:
        match name.split(":"):
            case "scale", "U+2S":
                value(entry("U", 0) + 2 * entry("S", 0), 0.002)
            case "scale", body:
                m = entry(body, 0)
                value(m, float(np.hypot(0.001, 0.003 * (m @ p))))
            case "edge", _:
                m, mx = entry("S", 0), entry("S", 1)
                value(mx - (mx @ p) / (m @ p) * m, 2e-3 * (m @ p))
            case "pendulum", _:
                # About a point a on x: Iyy − 2 a mcx + a² m.
                c = entry("U", 5) - 0.2 * entry("U", 1) + 0.01 * entry("U", 0)
                value(c, 0.01 * abs(c @ p))
            case ("plate",):
                sensor("plate", BaseWrench.model_validate(PLATE))
            case _:
                for i in (1, 2, 3):
                    gauge = StrutForce(
                        kind="strut-force", strut=f"strut{i}", at="platform", noise=0.4
                    )
                    sensor(f"g{i}", gauge)
    # Scaled, so that a direct inverse keeps its digits.
    d = 1.0 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(d, d)) * np.outer(d, d)
    return {
        name: float(np.sqrt(covariance[k, k]) / size)
        for k, (name, size) in enumerate(zip(variables, sizes, strict=True))
    }


@pytest.mark.parametrize("which", range(-1, 8))
def test_deviations_agree_with_one_dense_covariance(which: int) -> None:
    plan = planned()
    outlook = plan.uses[which] if which >= 0 else plan.torques
    expected = dense(load_robot(DELTA), (outlook.name,) if which >= 0 else ())
    for k, name in enumerate(plan.unknowns.names):
        assert outlook.shares[k] == pytest.approx(expected[name], rel=1e-6), name
    # The largest learn nothing and the others something: the test sees more than the prior.
    assert outlook.shares.min() < 0.25 < 0.499 < outlook.shares.max()


def test_combinations_are_all_of_it_together() -> None:
    plan = planned()
    expected = dense(load_robot(DELTA), ("plate", "scale:U+2S"))
    names = zip(plan.unknowns.names, plan.combinations[0].shares, strict=True)
    assert all(share == pytest.approx(expected[name], rel=1e-6) for name, share in names)
    assert plan.combinations[0].cost == 3000 + 20 + 0.5 * 30


def test_what_a_scale_does_that_a_plate_does_not() -> None:
    # A mass at a ball joint passes from body to body unseen by any sensor at the base.
    plan = sensor_plan(DELTA, combinations=[("kitchen-scale:S", "kitchen-scale:P")])
    by_name = {one.name: one for one in (*plan.uses, *plan.combinations)}

    def share(use: str, entry: str) -> float:
        return float(by_name[use].shares[plan.entry(entry)])

    torque = plan.torques.shares[plan.entry("S.m")]
    assert share("plate-tared", "S.m") > 0.95 * torque > 0.25
    assert share("gauges-platform", "S.m") > 0.9 * torque
    assert share("gauges-elbow", "U.mcx") < 0.02
    assert share("gauges-platform", "S.mcx") < 0.05 < 0.1 < share("gauges-middle", "S.mcx")
    both = "kitchen-scale:S + kitchen-scale:P"
    assert all(share(both, name) < 0.03 for name in ("U.mcx", "U.Sxx", "S.mcx", "S.Sxx", "P.m"))


def test_a_plate_tells_gains_without_any_load() -> None:
    plan = sensor_plan(DELTA, goal="gains")
    by_name = {one.name: one for one in plan.uses}
    # Limbs that are alike tell the gains' ratios, nothing their common scale.
    assert plan.torques.goal > 0.04
    assert by_name["plate"].goal < 0.005
    assert by_name["kitchen-scale:P"].goal > 0.02


def test_greedy_buys_what_gains_most_for_its_price() -> None:
    plan = planned()
    ratios = {one.name: one.gain / one.cost for one in plan.uses}
    first, outlook = plan.steps[0]
    assert first.use.name == max(ratios, key=lambda name: ratios[name])
    assert first.gain == pytest.approx(outlook.gain, rel=1e-9)
    # The scale's price is paid once.
    paid = set[str]()
    for step, _ in plan.steps:
        offer = offers().offers[step.use.offer]
        sets = 3 if step.use.offer == "gauges" else 1
        price = 0.0 if step.use.offer in paid else offer.price * sets
        assert step.cost == pytest.approx(price + 30 * offer.hours * sets)
        paid.add(step.use.offer)
    spent = np.cumsum([step.cost for step, _ in plan.steps])
    assert [step.spent for step, _ in plan.steps] == pytest.approx(spent.tolist())


def test_every_greedy_step_is_the_best_of_all_left() -> None:
    plan = planned()
    taken = list[str]()
    for step, outlook in plan.steps:
        left = [one.name for one in plan.uses if one.name not in taken]
        tried = sensor_plan(
            DELTA,
            offers=offers(),
            combinations=[(*taken, name) for name in left],
            settings=replace(SETTINGS, steps=0),
        )
        before = outlook.gain - step.gain
        best, ratio = "", 0.0
        for name, each in zip(left, tried.combinations, strict=True):
            cost = each.cost - (step.spent - step.cost)
            if (each.gain - before) / cost > ratio:
                best, ratio = name, (each.gain - before) / cost
        assert step.use.name == best
        taken.append(best)


@pytest.mark.parametrize("budget", [4.0, 12.0, 60.0])
def test_a_budget_is_kept(budget: float) -> None:
    plan = sensor_plan(DELTA, offers=offers(), budget=budget, settings=SETTINGS)
    assert all(step.spent <= budget for step, _ in plan.steps)
    assert bool(plan.steps) == (budget > 11)


def test_of_a_group_one_is_bought() -> None:
    plate = shipped_offers().offers["plate"].changed(price=1.0, hours=0.0)
    tared = shipped_offers().offers["plate-tared"].changed(price=1.0, hours=0.0)
    two = Offers.model_validate({"offers": {"a": plate, "b": tared}})
    plan = sensor_plan(DELTA, offers=two)
    assert [step.use.name for step, _ in plan.steps] == ["b"]
    alone = {key: one.changed(group="") for key, one in two.offers.items()}
    plan = sensor_plan(DELTA, offers=Offers.model_validate({"offers": alone}))
    assert [step.use.name for step, _ in plan.steps] == ["b", "a"]


def test_what_the_description_has_counts_before_anything_is_bought() -> None:
    robot = load_robot(DELTA)
    body = robot.bodies["S"].changed(measured=({"mass": 0.3, "std": 0.001},))
    bodies = {**robot.bodies, "S": body}
    weighed = robot.changed(bodies=bodies, sensors={"plate": PLATE})
    plan = sensor_plan(weighed, offers=offers(), settings=SETTINGS)
    assert plan.has_described
    assert not planned().has_described
    expected = dense(robot, ("plate",))
    for k, name in enumerate(plan.unknowns.names):
        assert plan.torques.shares[k] == pytest.approx(planned().torques.shares[k], rel=1e-9)
        assert plan.described.shares[k] <= expected[name] * (1 + 1e-6)
    assert plan.described.shares[plan.entry("S.m")] < 0.001 / 0.21
    scale = next(one for one in plan.uses if one.name == "scale:S")
    assert scale.gain < 1.0 < next(o for o in planned().uses if o.name == "scale:S").gain


def test_stated_spreads_and_known_bodies() -> None:
    robot = load_robot(DELTA)
    bodies = {
        "U": robot.bodies["U"].changed(spread=0.1),
        "S": robot.bodies["S"].changed(spread={"m": 0.02, "Ixx": 3.0}),
        "P": robot.bodies["P"].changed(free=()),
    }
    u = unknowns(robot.changed(bodies=bodies), prior_spread=0.4)
    spread = dict(zip(u.names, u.spread, strict=True))
    assert spread["U.mcx"] == spread["U.Sxy"] == 0.1
    assert spread["S.m"] == 0.02
    assert spread["S.mcx"] == spread["S.Sxx"] == 0.4  # S.Sxx is no part of Ixx
    assert spread["S.Syy"] == 3.0
    assert spread["viscous.drive1"] == 0.4
    assert u.known == ("P",)
    assert u.bodies == ("U", "S")
    assert "P.m" not in u.names
    plan = sensor_plan(robot.changed(bodies=bodies))
    assert "scale:P" not in {one.name for one in plan.uses}
    assert any("known by the description: P" in note for note in plan.notes)


def test_a_plan_is_the_same_every_time() -> None:
    first, second = (sensor_plan(DELTA, settings=PlanSettings(seed=5)) for _ in range(2))
    assert [s.use.name for s, _ in first.steps] == [s.use.name for s, _ in second.steps]
    assert all(
        np.array_equal(a.shares, b.shares) for a, b in zip(first.uses, second.uses, strict=True)
    )


@pytest.mark.parametrize("goal", ["forces", "P", "gains", "bodies"])
def test_goals_gain_by_what_tells_of_them(goal: str) -> None:
    plan = sensor_plan(DELTA, goal=goal, offers=offers(), settings=SETTINGS)
    gains = {one.name: one.gain for one in plan.uses}
    assert min(gains.values()) > -1e-9
    assert plan.steps
    assert plan.last.goal < plan.described.goal
    if goal == "P":  # the arm's mass says nothing of the platform
        assert gains["scale:U"] < 1e-3 < 1.0 < gains["scale:P"]


def test_enough_is_no_gain_to_exceed() -> None:
    fine = {"title": "fine", "price": 1, "weigh": {"quantity": "mass", "of": "P", "share": 1e-5}}
    rough = {"title": "rough", "price": 1, "weigh": {"quantity": "mass", "of": "P", "share": 0.02}}
    gains = {}
    for enough in (0.1, 1e-4):
        plan = sensor_plan(
            DELTA,
            goal="P",
            offers=Offers.model_validate({"offers": {"fine": fine, "rough": rough}}),
            settings=replace(SETTINGS, enough=enough),
        )
        gains[enough] = [one.gain for one in plan.uses]
    assert gains[0.1][0] < 1.05 * gains[0.1][1]
    assert gains[1e-4][0] > 1.5 * gains[1e-4][1]


def test_a_planned_motion_in_place_of_a_random_one(tmp_path: Path) -> None:
    from deltaid.excitation.motion_file import write_run

    exciter = Exciter(DELTA, ExcitationSettings(duration=4.0, harmonics=2, starts=1))
    run = exciter.optimise().run
    write_run(exciter.dynamics.kinematics, run, 200.0, tmp_path / "motion.csv")
    plan = sensor_plan(DELTA, tmp_path / "motion.csv")
    assert "motion.csv" in plan.motion
    assert plan.torques.shares[plan.entry("S.m")] == pytest.approx(0.317, abs=0.03)


def test_a_motion_for_sensors_is_that_of_the_start_that_tells_most() -> None:
    robot = load_robot(DELTA).changed(sensors={"plate": PLATE})
    settings = ExcitationSettings(duration=4.0, harmonics=2, starts=2, by="sensors")
    result = Exciter(robot, settings).optimise()
    judged = [one.judged for one in result.optimum.accounts]
    assert result.optimum.best.judged == min(one for one in judged if one is not None)
    # A plate that is nothing but noise leaves more open.
    blind = robot.changed(sensors={"plate": {**PLATE, "force_noise": 1e9, "moment_noise": 1e9}})
    motion = result.optimum.motion
    exciters = (Exciter(one, settings) for one in (robot, blind))
    sharp, dull = (
        by_bodies(one.dynamics, 0.02 * one.torque_reference, 1000.0)(motion) for one in exciters
    )
    assert sharp < dull - 5
    plain = Exciter(robot, replace(settings, by="torques")).optimise()
    assert all(one.judged is None for one in plain.optimum.accounts)
    assert [one.after for one in plain.optimum.accounts] == pytest.approx(
        [one.after for one in result.optimum.accounts]
    )
    with pytest.raises(DescriptionError, match="no sensors to plan a motion for"):
        Exciter(DELTA, settings)


LIST = """\
offers:
  scale:
    title: scale
    price: 20
    weigh: {quantity: mass, std: 0.001}
"""


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("quantity: mass, std: 0.001", "quantity: mass", "gives neither std nor share"),
        ("quantity: mass", "quantity: weight", "offers.scale.weigh.quantity"),
        ("quantity: mass", "quantity: mass, axis: x", "a mass has no axis"),
        ("quantity: mass", "quantity: inertia", "inertia needs its axis"),
        ("quantity: mass", "quantity: centre, axis: x, of: limb", "centre of a limb"),
        ("quantity: mass", "quantity: inertia, axis: [0, 0, 0]", "weigh.axis: has no direction"),
        ("quantity: mass, std: 0.001", "quantity: centre, axis: x, share: 0.1", "needs std, in m"),
        ("price: 20", "price: -1", "line 4, offers.scale.price"),
        ("price: 20", "cost: 20", "offers.scale.cost: unknown key"),
        ("    price: 20\n", "", "offers.scale.price: is missing"),
        ("    weigh: {quantity: mass, std: 0.001}\n", "", "nothing to do with it"),
        ("weigh:", "sensors: {g: {kind: joint-torque, drive: each}}\n    weigh:", "weigh and"),
        ("weigh: {quantity: mass, std: 0.001}", "sensors: {g: {kind: bathroom}}", "bathroom"),
        ("scale:", "a scale:", "a scale"),
    ],
)
def test_bad_lists_are_refused(old: str, new: str, said: str) -> None:
    assert old in LIST
    message = refusal(LIST.replace(old, new, 1), Offers)
    assert said in message
    assert "deltaid schema sensors" in message


@pytest.mark.parametrize(
    ("weigh", "said"),
    [
        ({"quantity": "mass", "of": "X", "std": 1e-3}, "has no body 'X'"),
        ({"quantity": "mass", "of": {"S": 2, "Q": 1}, "std": 1e-3}, "has no body 'Q'"),
        ({"quantity": "first_moment", "of": "P", "axis": "x", "share": 0.01}, "is zero at the"),
    ],
)
def test_lists_that_do_not_fit_the_robot_are_refused(weigh: dict, said: str) -> None:
    listed = Offers.model_validate({"offers": {"a": {"title": "a", "price": 1, "weigh": weigh}}})
    with pytest.raises(DescriptionError, match=said):
        sensor_plan(DELTA, offers=listed)


def test_what_cannot_be_asked_for_is_refused() -> None:
    with pytest.raises(DeltaidError, match="no goal 'Q'"):
        sensor_plan(DELTA, goal="Q")
    with pytest.raises(DeltaidError, match="nothing called 'scale:S'"):
        sensor_plan(DELTA, combinations=[("scale:S",)])
    with pytest.raises(DeltaidError, match="no goal"):
        sensor_plan(DELTA, goal="gains", settings=PlanSettings(gain_spread=0.0))
    with pytest.raises(DescriptionError, match="no such file"):
        sensor_plan(DELTA, offers="nowhere.yaml")


def test_the_shipped_list_is_a_file_of_its_own_kind(tmp_path: Path) -> None:
    path = tmp_path / "list.yaml"
    path.write_text(shipped_text(), encoding="utf-8")
    assert load_offers(path) == shipped_offers()
    assert parse(LIST, Offers, where="x").offers["scale"].weighs[0].of == "each"


def test_measured_values_of_a_list_are_as_in_a_description() -> None:
    entry = {"of": {"U": 1, "S": 2}, "mass": 1.4, "std": 0.002}
    given = {"offers": {"arm": {"title": "arm", "price": 1, "measured": [entry]}}}
    plan = sensor_plan(DELTA, offers=Offers.model_validate(given), settings=SETTINGS)
    same = next(one for one in planned().uses if one.name == "scale:U+2S")
    assert np.allclose(plan.uses[0].shares, same.shares, rtol=1e-9)


def test_each_is_one_on_every_limb_or_drive() -> None:
    by_name = {one.name: one for one in planned().uses}
    assert by_name["gauges"].cost == 3 * (300 + 2 * 30)
    assert set(by_name) == {
        *(f"scale:{name}" for name in ("U", "S", "P", "U+2S")),
        "edge:S", "pendulum:U", "plate", "gauges",
    }  # fmt: skip
    for limb, body in product(range(3), "US"):
        assert load_robot(DELTA).limb_bodies(limb)["US".index(body)] == body
