"""A type from its robots: mean, spreads, who belongs, what is known of the next one."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import IdentificationError
from deltaid.fleets.coordinates import Coordinates
from deltaid.fleets.gather import gathered
from deltaid.fleets.identify_gathered import identify_gathered
from deltaid.fleets.member import MeasuredFact, TypeMember, member
from deltaid.fleets.mixed_model import RobotRows, alone
from deltaid.fleets.population import (
    MEMBERS,
    TYPES,
    Population,
    members_table,
    next_robot,
    types_table,
    widest,
)
from deltaid.fleets.robot_recordings import merged_files
from deltaid.fleets.type_fit import fitted
from deltaid.identification.generic_motion import random_motion_base
from deltaid.identification.uncertainty import uncertainty
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import (
    SensorNoise,
    simulate_recording,
    surrogate_parameters,
    write_recording,
)
from deltaid.robot.load import load_robot, save_yaml
from deltaid.robot.measured import Measured
from plants import BODY, FRICTION, made_alike

ROBOT = load_robot("clavel-delta3")
LAYOUT = compiled(ROBOT).layout
NOISE = 0.004
MASS = list(LAYOUT.names).index("P.m")
STRUT = list(LAYOUT.names).index("S.m")


@cache
def rows() -> np.ndarray:
    """What recordings tell of a robot: its base parameters, each to a share of its size."""
    K = random_motion_base(compiled(ROBOT)).combination()
    sizes = np.abs(K) @ np.array([parameter.scale for parameter in LAYOUT.parameters])
    return K / (NOISE * sizes)[:, None]


def recorded_member(
    name: str, p: np.ndarray, rng: np.random.Generator, gain: float = 1.0
) -> TypeMember:
    """A robot as its recordings show it."""
    values = gain * (rows() @ p) + rng.standard_normal(len(rows()))
    return TypeMember(name, LAYOUT.names, rows(), values, np.zeros((len(values), 0)), (), 60.0)


def fleet(
    count: int, seed: int = 0, body: float = BODY
) -> tuple[np.ndarray, np.ndarray, list[TypeMember]]:
    """Mean of a type, its robots, and what is seen of them."""
    rng = np.random.default_rng(seed)
    mean = surrogate_parameters(ROBOT, rng, 0.3)
    truths = np.array([made_alike(ROBOT, mean, rng, body) for _ in range(count)])
    return mean, truths, [recorded_member(f"r{k:03}", p, rng) for k, p in enumerate(truths)]


def member_of(found: Population, name: str):
    return next(robot for robot in found.members if robot.name == name)


@pytest.fixture(scope="module")
def known() -> tuple[np.ndarray, np.ndarray, list[TypeMember], Population]:
    mean, truths, members = fleet(40, 1)
    return mean, truths, members, fitted(members, ROBOT)


def test_spreads_are_found_with_intervals(known) -> None:
    _, truths, _, found = known
    true = {"viscous": FRICTION, "coulomb": FRICTION}
    half = 2.6 * np.sqrt(np.diag(found.spreads.covariance))
    for kind, log, reach in zip(found.spreads.kinds, found.spreads.log, half, strict=True):
        assert abs(log - np.log(true.get(kind, BODY))) < reach, kind
        assert reach < 1.5, kind
    friction = LAYOUT.friction
    expected = truths[:, friction].std(axis=0, ddof=1)
    spread, low, high = found.spreads.of_parameters(found.coordinates.to_p[friction])
    np.testing.assert_allclose(spread, expected, rtol=0.35)
    assert np.all(low < expected)
    assert np.all(expected < high)


def test_what_all_see_well_is_their_average(known) -> None:
    _, truths, _, found = known
    friction = LAYOUT.friction
    np.testing.assert_allclose(
        found.mean.value[friction], truths[:, friction].mean(axis=0), rtol=0.01
    )
    expected = truths[:, friction].std(axis=0, ddof=1) / np.sqrt(len(truths))
    np.testing.assert_allclose(found.mean.std[friction], expected, rtol=0.35)


def test_intervals_hold_and_what_no_torque_tells_stays_open(known) -> None:
    _, truths, _, found = known
    inside = [
        np.abs(robot.within.value - p)[found.free] <= robot.within.half[found.free]
        for robot, p in zip(found.members, truths, strict=True)
    ]
    assert 0.92 < np.mean(inside) <= 1.0
    first_member = found.members[0]
    assert first_member.within.std[MASS] > 0.9 * first_member.alone_std[MASS]
    assert all(robot.belongs for robot in found.members)


def test_one_weighed_robot_tells_of_all_others(known) -> None:
    _, truths, members, before = known
    c = np.eye(len(LAYOUT.names))[STRUT]
    weighed = replace(members[0], facts=(MeasuredFact("scale", c, truths[0, STRUT], 1e-3),))
    found = fitted([weighed, *members[1:]], ROBOT)
    errors = [robot.within.value[STRUT] - p[STRUT]
              for robot, p in zip(found.members, truths, strict=True)]  # fmt: skip
    stds = np.array([robot.within.std[STRUT] for robot in found.members])
    assert np.all(stds[1:] < 0.2 * before.members[1].within.std[STRUT])
    assert np.mean(np.abs(errors) < 1.96 * stds) > 0.8
    assert np.all(stds[1:] > 0.4 * BODY * truths[0, STRUT])


def test_the_same_measurement_in_all_descriptions_is_one(known) -> None:
    _, truths, members, _ = known
    c = np.eye(len(LAYOUT.names))[STRUT]
    fact = MeasuredFact("scale", c, truths[0, STRUT], 1e-4)
    every = fitted([replace(robot, facts=(fact,)) for robot in members], ROBOT)
    own = replace(members[0], facts=(fact,))
    single = fitted([own, *members[1:]], ROBOT)
    # Were it one of each robot, the mean would be known √40 times better.
    assert single.mean.std[STRUT] < every.mean.std[STRUT] < 2 * single.mean.std[STRUT]
    assert every.members[5].within.std[STRUT] > 0.4 * BODY * truths[0, STRUT]


def test_robots_that_do_not_belong_are_named_and_have_no_say(known) -> None:
    mean, _, members, before = known
    rng = np.random.default_rng(5)
    heavy = made_alike(ROBOT, mean, rng)
    heavy[MASS] += 0.3 * mean[MASS]
    strangers = [
        recorded_member("heavy", heavy, rng),
        *(
            recorded_member(f"amplified {k}", made_alike(ROBOT, mean, rng), rng, 1.3)
            for k in range(9)
        ),
    ]
    found = fitted([*members, *strangers], ROBOT)
    assert not any(member_of(found, stranger.name).belongs for stranger in strangers)
    assert all(robot.belongs for robot in found.members if robot.name.startswith("r"))
    assert member_of(found, "heavy").reason.startswith("P.m is 0.")
    assert "more than in the type: another tool" in member_of(found, "heavy").reason
    assert "its torques are 1." in member_of(found, "amplified 3").reason
    assert "torque constants" in member_of(found, "amplified 3").reason
    shift = np.abs(found.mean.value - before.mean.value)[found.free]
    assert np.all(shift < 0.05 * before.mean.std[found.free])


def test_worn_friction_is_said_and_the_robot_stays(known) -> None:
    mean, _, members, _ = known
    rng = np.random.default_rng(6)
    worn = made_alike(ROBOT, mean, rng)
    worn[LAYOUT.viscous.start + 1] *= 2.5
    found = member_of(fitted([*members, recorded_member("worn", worn, rng)], ROBOT), "worn")
    assert found.belongs
    assert found.reason.startswith("viscous friction of drive2 is 2.")


def test_few_robots_say_what_they_cannot(known) -> None:
    _, truths, members, _ = known
    for count in (1, 2):
        found = fitted(members[:count], ROBOT)
        assert not found.spreads.known
        assert np.all(np.isnan(found.spreads.of_parameters(found.coordinates.to_p)[0]))
        assert "cannot show how much robots differ" in " ".join(found.notes)
        assert types_table("x", found)["spread"].null_count() == sum(found.free)
    inside = np.abs(found.mean.value - truths[0])[found.free] < 3 * found.mean.std[found.free]
    assert inside.mean() > 0.9


def test_one_of_few_is_named_though_it_would_widen_the_spreads() -> None:
    mean, _, members = fleet(7, 4)
    heavy = made_alike(ROBOT, mean, np.random.default_rng(8))
    heavy[MASS] *= 1.3
    found = fitted([*members, recorded_member("heavy", heavy, np.random.default_rng(9))], ROBOT)
    assert [robot.name for robot in found.members if not robot.belongs] == ["heavy"]
    assert np.exp(found.spreads.log[0]) < 2 * BODY


@pytest.mark.parametrize("gain", [0.95, 1.05])
def test_a_wrong_scale_of_torques_is_named_among_eight(gain: float) -> None:
    """By 5 %, where bodies are alike within 1 %."""
    _, truths, members = fleet(8, 2, body=0.01)
    members[0] = recorded_member("r000", truths[0], np.random.default_rng(102), gain)
    found = fitted(members, ROBOT)
    assert [robot.name for robot in found.members if not robot.belongs] == ["r000"]
    assert found.members[0].reason.startswith("its torques are ")
    assert "torque constants" in found.members[0].reason


def test_the_order_of_robots_does_not_matter(known) -> None:
    _, _, members, found = known
    again = fitted(members[::-1], ROBOT)
    assert np.array_equal(again.mean.value, found.mean.value)
    with pytest.raises(IdentificationError, match="'r000' is given 2 times"):
        fitted([members[0], *members], ROBOT)
    with pytest.raises(IdentificationError, match="no robot was given"):
        fitted([], ROBOT)


def test_widths_claim_no_more_than_is_known() -> None:
    # A sum of two is known to 0.01, their difference to 10: no entry alone may be narrow.
    sum_, difference = np.array([1.0, 1.0]), np.array([1.0, -1.0])
    Q = np.outer(sum_, sum_) / 0.01**2 + np.outer(difference, difference) / 10.0**2
    w = widest(Q, np.eye(2))
    left = np.linalg.eigvalsh(Q - np.diag(w))
    assert left[0] > -1e-9 * left[1]
    assert np.all(w < 2.1 / 10.0**2)
    np.testing.assert_allclose(widest(np.diag([4.0, 9.0]), np.eye(2)), [4.0, 9.0], rtol=1e-2)


def test_the_next_robot_has_the_type_as_its_prior(known, tmp_path: Path) -> None:
    _, truths, members, _ = known
    c = np.eye(len(LAYOUT.names))[STRUT]
    fact = MeasuredFact("scale", c, truths[0, STRUT], 1e-3)
    found = fitted([replace(members[0], facts=(fact,)), *members[1:]], ROBOT)
    robot = next_robot(found, "plant A")
    save_yaml(robot, tmp_path / "type.yaml")
    assert robot == load_robot(str(tmp_path / "type.yaml"))
    assert "mean of 40 robots of plant A" in robot.sources["bodies.S"]
    mass, spread = robot.bodies["S"].prior_parameters()[0], robot.bodies["S"].spread
    assert mass == pytest.approx(found.mean.value[STRUT])
    assert isinstance(spread, dict)
    assert BODY < spread["m"] < 3 * BODY
    assert not any(body.measured for body in robot.bodies.values())


def test_tables_are_tidy(known) -> None:
    _, _, _, found = known
    types, members = types_table("delta", found), members_table("delta", found)
    assert types.columns == list(TYPES)
    assert members.columns == list(MEMBERS)
    assert len(types) == found.free.sum()
    assert len(members) == len(found.members) * found.free.sum()
    assert types["robots"].unique().to_list() == [40]
    assert members["alone_std"].null_count() == 0


def test_a_member_says_what_its_recording_says(tmp_path: Path) -> None:
    dynamics, rng = compiled(ROBOT), np.random.default_rng(3)
    motion = random_motion(dynamics.kinematics, rng)
    truth = made_alike(ROBOT, prior_parameters(ROBOT), rng)
    table = simulate_recording(dynamics, truth, motion, rng, duration=4.0, noise=SensorNoise())
    write_recording(table, tmp_path / "log.csv")
    settings = Settings(cutoff=15.0, friction="described")
    file = gathered(ROBOT, tmp_path / "log.csv", settings=settings)
    body = ROBOT.bodies["S"].changed(measured=(Measured(mass=0.2, std=0.001),))
    weighed = ROBOT.changed(bodies=ROBOT.bodies | {"S": body})
    plain, own = (
        member("one", merged_files([file], each, settings), settings) for each in (ROBOT, weighed)
    )
    problem = identify_gathered(ROBOT, [file], settings).problem
    np.testing.assert_allclose(plain.rows @ problem.estimate.full, plain.values, rtol=1e-6)
    np.testing.assert_array_equal(plain.rows, own.rows)
    assert [(fact.value, fact.std) for fact in own.facts] == [(0.2, 0.001)]
    alone = fitted([plain], ROBOT).members[0].alone_std[problem.reduction.A.any(axis=1)]
    expected = uncertainty(problem).std[problem.reduction.A.any(axis=1)]
    assert np.median(alone / expected) == pytest.approx(1.0, abs=0.05)
    found = fitted([own], weighed)
    assert found.members[0].within.std[STRUT] == pytest.approx(0.001, rel=0.05)


@pytest.mark.parametrize(("wide", "factor"), [(3, 1.0), (4, 5.5), (6, 6.5)])
def test_a_prior_is_as_wide_as_more_than_half_of_the_recordings_ask_for(
    wide: int, factor: float
) -> None:
    """The median of what they ask for: 4, 5, 6 … times."""
    _, _, members = fleet(6, 1)
    asked = [{"P.m": 4.0 + k} if k < wide else None for k in range(6)]
    some = [replace(member, widened=asks) for member, asks in zip(members, asked, strict=True)]
    reduction = Coordinates.for_type(ROBOT, some, Settings()).reduction
    assert reduction.widened.get("P.m", 1.0) == factor


def test_a_robot_alone_is_least_squares_of_its_rows_and_of_what_is_known() -> None:
    """Against a singular value decomposition of both, in units of the standard deviations."""
    _, _, members = fleet(6, 1)
    coordinates = Coordinates.for_type(ROBOT, members, Settings())
    rows = RobotRows.stacked([coordinates.rows(member, ()) for member in members])
    root = np.linalg.cholesky(coordinates.precision).T
    for (u, C), H, b in zip(
        alone(rows, coordinates.precision, coordinates.prior), rows.H, rows.b, strict=True
    ):
        U, S, Vt = np.linalg.svd(np.vstack([root, H]), full_matrices=False)
        expected = Vt.T @ (U.T @ np.concatenate([root @ coordinates.prior, b]) / S)
        std = np.linalg.norm(Vt.T / S, axis=1)
        np.testing.assert_allclose(u / std, expected / std, rtol=0, atol=1e-8)
        np.testing.assert_allclose(np.sqrt(np.diag(C)), std, rtol=1e-9)
