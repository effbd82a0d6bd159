"""What decided a parameter is said truly: data, data with others' priors, prior, consistency."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.identification.identify import Identification, identify
from deltaid.identification.widening import PriorEvidence
from deltaid.model.parameter_record import Parameter
from deltaid.model.record import IdentifiedModel
from deltaid.motion.random_motion import random_motion
from deltaid.robot.body import ExplicitInertia
from deltaid.robot.load import load_robot
from deltaid.view.model_tables import parameter_table, value_and_width
from identified import simulated
from poor_priors import PLAIN, Outcome, outcome
from support import along

ROBOT = "irb360-6-1600"


def parameter_named(model: IdentifiedModel, name: str) -> Parameter:
    return model.parameters[model.layout.names.index(name)]


def inside(parameter: Parameter, value: float) -> bool:
    return parameter.low <= value <= parameter.high


def recorded(p: np.ndarray, seed: int, noise: float = 0.01) -> pl.DataFrame:
    return simulated(load_robot(ROBOT), p, seed, noise)


@pytest.fixture(scope="module")
def case() -> tuple[Identification, np.ndarray]:
    p = prior_parameters(load_robot(ROBOT))
    return identify(load_robot(ROBOT), recorded(p, 0), settings=PLAIN), p


def at_the_ends(p: np.ndarray) -> dict[str, tuple[np.ndarray, ...]]:
    """Other robots with the same torques, as far away as physics lets them be, by what differs.

    Torques show only the sum of the tool's inertia and the rotor of the drive that turns it; and a
    point mass may pass from the struts to the platform.
    """
    robot = load_robot(ROBOT)
    names = compiled(robot).layout.names
    at = {name: names.index(name) for name in names}
    struts = 2 * len(robot.drives[:3])
    turned = p.copy()
    turned[at["EE.Izz"]] += p[at["rotor.drive4"]]
    for name in ("EE.Ixx", "EE.Iyy"):  # Izz = Sxx + Syy
        turned[at[name]] += 0.5 * p[at["rotor.drive4"]]
    turned[at["rotor.drive4"]] = 0.0
    still = p.copy()
    still[at["rotor.drive4"]] += p[at["EE.Izz"]]
    still[at["EE.Izz"]] = 0.0
    masses = []
    length = robot.limbs.strut
    for share in (-1.0, 1.0):
        moved = p.copy()
        # A point mass at x = l: of the platform all that it has, of a strut what leaves M̄ ≽ 0.
        mass = share * p[at["P.m"]] / struts
        if share < 0:
            M = np.array([[p[at["S.Iyy"]], p[at["S.mcx"]]], [p[at["S.mcx"]], p[at["S.m"]]]])
            end = np.array([length, 1.0])
            mass = -0.999 / float(end @ np.linalg.solve(M, end))
        moved[at["S.m"]] += mass
        moved[at["S.mcx"]] += mass * length
        moved[at["S.Iyy"]] += mass * length**2
        moved[at["S.Izz"]] += mass * length**2
        moved[at["P.m"]] -= struts * mass
        masses.append(moved)
    return {"rotor": (turned, still), "mass": tuple(masses)}


def test_intervals_hold_all_robots_with_the_same_torques(case) -> None:
    result, p = case
    dynamics, rng = compiled(load_robot(ROBOT)), np.random.default_rng(3)
    z, _, qd, qdd = along(dynamics.kinematics, rng, np.linspace(0, 10, 50))
    tau = dynamics.torque(z, qd, qdd, p)
    for name, others in at_the_ends(p).items():
        for other in others:
            assert np.allclose(dynamics.torque(z, qd, qdd, other), tau, rtol=0, atol=1e-9), name
            for parameter, value, true in zip(result.model.parameters, other, p, strict=True):
                if value != true and parameter.determined_by in ("data", "sum", "limit"):
                    assert inside(parameter, value), (name, parameter.name)


def test_what_only_a_sum_shows_says_whose_prior_it_rests_on(case) -> None:
    result, p = case
    rotor = parameter_named(result.model, "rotor.drive4")
    assert (rotor.determined_by, rotor.rests_on) == ("sum", ("EE.Izz",))
    assert rotor.high is not None
    total = p[result.model.layout.names.index("EE.Izz")] + rotor.prior
    assert rotor.low == 0
    assert total < rotor.high < 1.2 * total  # no farther than the sum and its noise
    assert parameter_named(result.model, "EE.mcx").determined_by == "data"
    assert parameter_named(result.model, "EE.mcx").rests_on == ()
    table = parameter_table(result.model)
    row = next(row for row in table.rows if row[0] == "rotor.drive4")
    assert "…" in row[3]
    assert row[-1] == "sum"
    assert "rotor.drive4 on EE.Izz" in table.caption


def test_what_fell_to_its_bound_is_at_the_limit_with_one_end() -> None:
    p = prior_parameters(load_robot(ROBOT))
    names = compiled(load_robot(ROBOT)).layout.names
    p[names.index("viscous.drive1")] = 1e-9
    log = recorded(p, 1)
    # Noise of the drive that looks a little like friction that pushes.
    speed = np.gradient(log["q1"].to_numpy(), 1 / 500.0)
    log = log.with_columns(pl.col("tau1") - 0.05 * speed)
    model = identify(load_robot(ROBOT), log, settings=PLAIN).model
    fell = parameter_named(model, "viscous.drive1")
    assert fell.value < 1e-3 * fell.prior
    assert fell.determined_by == "limit"
    assert fell.low == 0
    assert fell.value < fell.high < 0.1 * fell.prior
    again = IdentifiedModel.model_validate(model.model_dump(mode="json"))
    assert again.parameters == model.parameters


@pytest.fixture(scope="module")
def contradicted() -> tuple[Identification, np.ndarray]:
    """A slender strut whose longitudinal inertia is eight thousand times the prior's."""
    p = prior_parameters(load_robot(ROBOT))
    p[compiled(load_robot(ROBOT)).layout.names.index("S.Ixx")] = 0.0246
    return identify(load_robot(ROBOT), recorded(p, 2, 0.001), settings=PLAIN), p


def test_a_prior_that_the_recording_contradicts_is_widened_and_said(contradicted, case) -> None:
    model, truth = contradicted[0].model, contradicted[1]
    (correction,) = model.corrections
    assert (correction.kind, correction.subject) == ("prior", "S")
    assert "S.Ixx" in correction.text
    assert correction.value > 1000
    (warning,) = model.warnings
    assert "requires the prior of S to be " in warning
    entry = parameter_named(model, "S.Ixx")
    assert entry.determined_by == "data"
    assert inside(entry, 0.0246)
    assert entry.low > 0.01
    for parameter, true in zip(model.parameters, truth, strict=True):
        if parameter.determined_by == "sum":
            assert inside(parameter, true), parameter.name
    assert case[0].model.corrections == ()
    assert case[0].model.warnings == ()


def test_a_weight_that_the_user_chose_stays_and_the_contradiction_is_a_warning(
    contradicted,
) -> None:
    result, truth = contradicted
    settings = PLAIN.changed(gamma=float(result.problem.objective.gamma))
    model = identify(load_robot(ROBOT), recorded(truth, 2, 0.001), settings=settings).model
    assert model.corrections == ()
    (warning,) = model.warnings
    assert "the prior of this body is too far off" in warning


def test_the_entropic_metric_with_a_widened_prior_is_certified(contradicted) -> None:
    settings = PLAIN.changed(regularizer="entropic")
    result = identify(load_robot(ROBOT), recorded(contradicted[1], 2, 0.001), settings=settings)
    assert result.problem.reduction.widened
    assert result.model.fit.duality_gap < 1e-6 * result.model.fit.objective
    assert result.model.value("S.Ixx") > 0.01


@pytest.mark.parametrize(("name", "is_small"), [("S.Ixx", True), ("P.Izz", False)])
def test_moments_have_log_normal_priors_no_surer_than_bodies_are_symmetric(
    case, name: str, is_small: bool
) -> None:
    result, p = case
    parameter = parameter_named(result.model, name)
    body, names = name[:-4], result.model.layout.names
    assert parameter.determined_by == "prior"
    moments = [p[names.index(f"{body}.{axis}")] for axis in ("Ixx", "Iyy", "Izz")]
    least = 0.3 * 0.5 * sum(moments) / parameter.prior  # m ℓ² = tr Σ
    assert (least > 1) == is_small
    factor = np.exp(1.959964 * np.sqrt(np.log(1 + (0.5 * max(1.0, least)) ** 2)))
    assert parameter.high == pytest.approx(parameter.prior * factor, rel=1e-6)
    assert parameter.low == pytest.approx(parameter.prior / factor, rel=1e-6)
    assert value_and_width(parameter)[1] == f"×÷ {float(f'{factor:.2g}'):g}"


def test_a_spread_that_is_stated_is_taken_at_its_word() -> None:
    robot, p = load_robot(ROBOT), prior_parameters(load_robot(ROBOT))
    bodies = robot.bodies | {"S": robot.bodies["S"].changed(spread={"Ixx": 0.1})}
    result = identify(robot.changed(bodies=bodies), recorded(p, 0), settings=PLAIN)
    parameter = parameter_named(result.model, "S.Ixx")
    assert parameter.high / parameter.prior == pytest.approx(1.216, abs=0.002)


def random_evidence(rng: np.random.Generator) -> PriorEvidence:
    """Four base parameters of five entries, the third of which is far from its prior."""
    rows = np.vstack([np.eye(5), 0.3 * rng.normal(size=(1, 5))])
    columns = np.eye(4, 5) + 0.2 * rng.normal(size=(4, 5))
    N = 0.01 * np.diag(rng.uniform(1, 2, 4))
    x = np.array([0.5, -0.3, 40.0, 0.1, 0.2])
    names = ("B.a", "B.b", "C.c", "C.d")
    return PriorEvidence(names, ([0, 1], [2, 3]), rows, columns, columns @ x, N)


def log_evidence(given: PriorEvidence, s: np.ndarray) -> float:
    """Twice the logarithm of N(d; 0, C), but for a constant."""
    scaled = given.rows / s[:, None]
    C = given.N + given.columns @ np.linalg.inv(scaled.T @ scaled) @ given.columns.T
    return -float(given.d @ np.linalg.solve(C, given.d)) - float(np.linalg.slogdet(C)[1])


def test_factors_and_gains_are_those_of_the_marginal_likelihood() -> None:
    given, s = random_evidence(np.random.default_rng(4)), np.ones(6)
    s[1] = 2.0
    baseline, tried = log_evidence(given, s), np.geomspace(1, 1e4, 800)
    gained = 0
    for candidate in given._widest(s, ([0], [1], [2], [3], [0, 1, 2])):
        wider = s.copy()
        wider[candidate.at] = np.maximum(s[candidate.at], candidate.factor)
        gain = log_evidence(given, wider) - baseline
        assert gain == pytest.approx(candidate.gain, rel=1e-5, abs=1e-3)
        if len(candidate.at) == 1:
            (j,) = candidate.at
            best = max(log_evidence(given, np.where(np.arange(6) == j, s * k, s)) for k in tried)
            # Tried factors are 1.6 times apart; the gain is flat at its best.
            if best > baseline + 1:
                assert best - baseline - 0.3 < candidate.gain < best - baseline + 1e-2
                gained += 1
    assert gained


def test_only_what_is_far_off_is_widened() -> None:
    given = random_evidence(np.random.default_rng(4))
    widened = given.contradicted()
    assert "C.c" in widened
    assert not {"B.a", "B.b"} & set(widened)
    assert 15 < widened["C.c"] < 60
    assert replace(given, d=0.02 * given.d).contradicted() == {}


@pytest.fixture(scope="module")
def robots() -> list[Outcome]:
    found = []
    for name, count in (("clavel-delta3", 3), ("irb360-6-1600", 2)):
        robot = load_robot(name)
        motion = random_motion(compiled(robot).kinematics, np.random.default_rng(0))
        found += [
            outcome(robot, motion, seed, poor=True, duration=6.0, rate=400.0, noise=0.01)
            for seed in range(count)
        ]
    return found


def test_intervals_by_the_data_hold_although_priors_are_far_off(robots) -> None:
    hold, every = zip(*(robot.held() for robot in robots), strict=True)
    for label in ("data", "sum"):
        count = sum(each[label] for each in every)
        assert count > 10
        assert sum(each[label] for each in hold) >= 0.9 * count, label
    assert sum(robot.mass_error < 0.02 for robot in robots) >= 0.9 * len(robots)
    assert any(robot.found.model.corrections for robot in robots)


def test_a_heavy_strut_described_as_light_is_corrected_by_its_body() -> None:
    robot = load_robot("clavel-delta3")
    p = prior_parameters(robot)
    log = simulated(robot, p, 5, 0.01, duration=10.0)
    part = compiled(robot).layout.body("S")
    light = robot.bodies["S"].changed(prior=ExplicitInertia.from_parameters(p[part] / 20))
    model = identify(
        robot.changed(bodies={**robot.bodies, "S": light}, sources={}), log, settings=PLAIN
    ).model
    (strut_correction,) = (
        correction for correction in model.corrections if correction.kind == "prior"
    )
    assert strut_correction.subject == "S"
    for parameter, true in zip(model.parameters[part], p[part], strict=True):
        if parameter.determined_by in ("data", "sum"):
            assert inside(parameter, true), parameter.name
