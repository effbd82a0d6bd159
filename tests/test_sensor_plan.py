"""What sensors and scales would tell: against dense algebra, and what is bought first."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltaid.errors import DescriptionError
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.excitation.problem import by_bodies
from deltaid.robot.load import load_robot
from deltaid.sensors.planning.knowledge import unknowns
from deltaid.sensors.planning.offers import Offers, shipped_offers
from deltaid.sensors.planning.plan import PlanSettings, sensor_plan
from deltaid.view.sensor_plan import stopped
from sensor_offers import DELTA, PLATE, SETTINGS, dense, offers, planned


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
    by_name = {outlook.name: outlook for outlook in (*plan.uses, *plan.combinations)}

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
    by_name = {use.name: use for use in plan.uses}
    # Limbs that are alike tell the gains' ratios, nothing their common scale.
    assert plan.torques.goal > 0.04
    assert by_name["plate"].goal < 0.005
    assert by_name["kitchen-scale:P"].goal > 0.02


def test_greedy_buys_what_gains_most_for_its_price() -> None:
    plan = planned()
    ratios = {use.name: use.gain / use.cost for use in plan.uses}
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
        left = [use.name for use in plan.uses if use.name not in taken]
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


def test_without_a_budget_the_dearest_plate_is_not_named() -> None:
    plan, rich = sensor_plan(DELTA), sensor_plan(DELTA, budget=20_000)
    assert rich.steps[-1][0].use.name == "plate-tared"
    assert rich.beyond is None
    names = [step.use.name for step, _ in plan.steps]
    assert names == [step.use.name for step, _ in rich.steps[: len(names)]]
    assert plan.beyond is not None
    spent, gained = plan.steps[-1][0].spent, plan.last.gain
    assert plan.beyond.gain / plan.beyond.cost < 0.1 * gained / spent
    assert "Enough for its price: trifilar:S" in stopped(plan)
    assert spent < 0.05 * rich.steps[-1][0].spent


def test_the_wanted_uncertainty_is_reached_with_nothing_to_spare() -> None:
    wanted = PlanSettings(enough=0.2)
    plan = sensor_plan(DELTA, settings=wanted)
    names = [step.use.name for step, _ in plan.steps]
    rest = [[name for name in names if name != other] for other in names]
    less = sensor_plan(DELTA, combinations=rest, settings=replace(wanted, steps=0))
    assert plan.last.goal <= 0.2 < min(outlook.goal for outlook in less.combinations)
    assert sensor_plan(DELTA, goal="forces").steps == ()  # torques alone are enough


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
    alone = {key: offer.changed(group="") for key, offer in two.offers.items()}
    plan = sensor_plan(DELTA, offers=Offers.model_validate({"offers": alone}), budget=10.0)
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
    scale = next(use for use in plan.uses if use.name == "scale:S")
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
    assert "scale:P" not in {use.name for use in plan.uses}
    assert any("known by the description: P" in note for note in plan.notes)


def test_a_plan_is_the_same_every_time() -> None:
    first, second = (sensor_plan(DELTA, settings=PlanSettings(seed=5)) for _ in range(2))
    assert [s.use.name for s, _ in first.steps] == [s.use.name for s, _ in second.steps]
    assert all(
        np.array_equal(a.shares, b.shares) for a, b in zip(first.uses, second.uses, strict=True)
    )


@pytest.mark.parametrize("goal", ["forces", "P", "gains", "bodies"])
def test_goals_gain_by_what_tells_of_them(goal: str) -> None:
    plan = sensor_plan(DELTA, goal=goal, offers=offers(), budget=1e5, settings=SETTINGS)
    gains = {use.name: use.gain for use in plan.uses}
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
        gains[enough] = [use.gain for use in plan.uses]
    assert gains[0.1][0] < 1.05 * gains[0.1][1]
    assert gains[1e-4][0] > 1.5 * gains[1e-4][1]


def test_a_planned_motion_in_place_of_a_random_one(tmp_path: Path) -> None:
    from deltaid.motion.excitation.run import write_run

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
    judged = [account.judged for account in result.optimum.accounts]
    assert result.optimum.best.judged == min(value for value in judged if value is not None)
    # A plate that is nothing but noise leaves more open.
    blind = robot.changed(sensors={"plate": {**PLATE, "force_noise": 1e9, "moment_noise": 1e9}})
    motion = result.optimum.motion
    exciters = (Exciter(described, settings) for described in (robot, blind))
    sharp, dull = (
        by_bodies(exciter.dynamics, 0.02 * exciter.torque_reference, 1000.0)(motion)
        for exciter in exciters
    )
    assert sharp < dull - 5
    plain = Exciter(robot, replace(settings, by="torques")).optimise()
    assert all(account.judged is None for account in plain.optimum.accounts)
    assert [account.after for account in plain.optimum.accounts] == pytest.approx(
        [account.after for account in result.optimum.accounts]
    )
    with pytest.raises(DescriptionError, match="no sensors to plan a motion for"):
        Exciter(DELTA, settings)


def test_measured_values_of_a_list_are_as_in_a_description() -> None:
    entry = {"of": {"U": 1, "S": 2}, "mass": 1.4, "std": 0.002}
    given = {"offers": {"arm": {"title": "arm", "price": 1, "measured": [entry]}}}
    plan = sensor_plan(DELTA, offers=Offers.model_validate(given), settings=SETTINGS)
    same = next(use for use in planned().uses if use.name == "scale:U+2S")
    assert np.allclose(plan.uses[0].shares, same.shares, rtol=1e-9)


def test_each_is_one_on_every_limb_or_drive() -> None:
    by_name = {use.name: use for use in planned().uses}
    assert by_name["gauges"].cost == 3 * (300 + 2 * 30)
    assert set(by_name) == {
        *(f"scale:{name}" for name in ("U", "S", "P", "U+2S")),
        "edge:S", "pendulum:U", "plate", "gauges",
    }  # fmt: skip


def test_a_motion_is_judged_with_the_likely_size_of_offsets_that_nobody_stated() -> None:
    """An offset of which nothing at all is known leaves more open."""
    plate = {key: value for key, value in PLATE.items() if key != "force_bias"}
    exciter = Exciter(DELTA, ExcitationSettings(duration=4.0, harmonics=2, starts=1))
    motion = exciter.optimise().optimum.motion

    def criterion(**changed: float) -> float:
        robot = load_robot(DELTA).changed(sensors={"plate": {**plate, **changed}})
        dynamics = Exciter(robot, exciter.settings).dynamics
        return by_bodies(dynamics, 0.02 * exciter.torque_reference, 1000.0)(motion)

    assert criterion() < criterion(force_bias=1e4, moment_bias=1e4) - 1e-4
