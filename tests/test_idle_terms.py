"""Terms of friction and effects that a fit puts at zero, and estimates within their intervals."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.effects.at_drives import RippleColumns
from deltaid.effects.at_platform import AtPlatform, platform_forces
from deltaid.estimation.scatter import NORMAL
from deltaid.identification.fit import FittedProblem, fit
from deltaid.identification.friction_choice import choose_friction
from deltaid.identification.friction_rows import friction_rows
from deltaid.identification.judgement import judged_parameters
from deltaid.identification.setup import Setup
from deltaid.identification.stages import idle
from deltaid.identification.uncertainty import covariance, uncertainty
from deltaid.model.parameter_record import FrictionChoice, FrictionTrial
from deltaid.model.record import Settings
from deltaid.recording.recording import open_recordings
from drives import case
from drives.identify import identified as cause_identified
from identified import identified

LOG = "clavel-delta3"
PLAIN = Settings(friction="described")


def chosen_loads(drives: Iterable[str]) -> FrictionChoice:
    """The record of a choice that gave these drives losses by load."""
    trial = {"addition": "load", "error": 0.1, "gain": 0.1, "significance": 5, "useful": True}
    steps = tuple(FrictionTrial(joint=drive, **trial) for drive in drives)
    return FrictionChoice(folds=40, plain_error=0.1, chosen_error=0.1, steps=steps, trials=())


@cache
def with_loads() -> tuple[Setup, FittedProblem]:
    """A fit whose laws have got losses by load that the robot does not have."""
    found = identified(LOG)
    friction = found.robot.friction
    laws = {drive: friction[drive].changed(load=0.02) for drive in ("drive1", "drive2")}
    robot = found.robot.changed(friction=dict(friction) | laws)
    recordings = open_recordings(found.frames[0], compiled(robot).kinematics)
    choice = chosen_loads(laws)
    setup = Setup(robot, tuple(recordings), PLAIN, friction_choice=choice)
    return setup, fit(setup.dynamics, setup.recordings, PLAIN)


def test_a_term_at_zero_is_idle() -> None:
    setup, problem = with_loads()
    assert ("drive1", "load") in idle(setup, problem).terms
    assert not idle(replace(setup, friction_choice=None), problem).terms


def test_a_term_that_the_recording_asks_for_is_not() -> None:
    made = case("load-friction", "delta3", 1)
    law = {drive: law.changed(load=0.02) for drive, law in made.robot.friction.items()}
    robot = made.robot.changed(friction=law)
    recordings = open_recordings(made.logs[0], compiled(robot).kinematics)
    choice = chosen_loads(robot.drives)
    setup = Setup(robot, tuple(recordings), PLAIN, friction_choice=choice)
    assert not idle(setup, fit(setup.dynamics, setup.recordings, PLAIN)).terms


def test_a_force_that_nothing_pulls_with_is_idle_and_a_ripple_is_searched() -> None:
    result = identified(LOG).result
    dynamics = compiled(result.robot)
    force = platform_forces(dynamics, 1.0)[0]
    ripple = RippleColumns(dynamics, (0,), (1.0, 1.0), (12.5,))
    setup = Setup(result.robot, result.recordings, PLAIN, additions=(force, ripple))
    problem = fit(dynamics, setup.recordings, PLAIN, additions=setup.additions)
    assert idle(setup, problem) == (frozenset(), {force.name})


def test_a_force_that_pulls_is_not_idle() -> None:
    result = cause_identified(case("hose", "delta3", 1))
    problem = result.problem
    setup = Setup(result.robot, result.recordings, PLAIN)
    assert {a.name for a in problem.additions if isinstance(a, AtPlatform)}
    assert not idle(setup, problem).effects


def test_coefficients_that_are_uncertain_only_one_by_one_are_not_idle() -> None:
    """A drag along the combination of its two coefficients that a recording determines best."""
    result = identified(LOG).result
    dynamics = compiled(result.robot)
    drag = platform_forces(dynamics, 1.0)[-1]
    setup = Setup(result.robot, result.recordings, PLAIN, additions=(drag,))
    problem = fit(dynamics, setup.recordings, PLAIN, additions=setup.additions)
    assert idle(setup, problem).effects == {drag.name}
    places = [len(problem.p), len(problem.p) + 1]
    C = covariance(problem, places)
    std = np.sqrt(np.diag(C))
    sizes, ways = np.linalg.eigh(C / np.outer(std, std))
    values = 4.0 * np.sqrt(sizes[0]) * ways[:, 0] * std
    assert np.all(np.abs(values) < NORMAL * std)
    A = problem.reduction.A[places]
    x = problem.solution.x + np.linalg.pinv(A) @ (values - problem.values[places])
    moved = replace(problem, solution=replace(problem.solution, x=x))
    assert not idle(setup, moved).effects


def test_a_covariance_is_that_of_any_combination() -> None:
    problem = identified(LOG).result.problem
    own = ("viscous.drive1", "coulomb.drive1", "rotor.drive1")
    places = [problem.layout.names.index(name) for name in own if name in problem.layout.names]
    C = covariance(problem, places)
    assert abs(C[0, 1]) > 0.1 * np.sqrt(C[0, 0] * C[1, 1])
    weights = np.random.default_rng(1).standard_normal(len(places))
    combination = np.zeros((1, len(problem.values)))
    combination[0, places] = weights
    variance = uncertainty(problem, combination).std[0] ** 2
    assert weights @ C @ weights == pytest.approx(variance, rel=0.02)


def test_barred_terms_are_not_chosen() -> None:
    made = case("load-friction", "delta3", 1)
    dynamics = compiled(made.robot)
    rows = friction_rows(dynamics, open_recordings(made.logs[0], dynamics.kinematics))
    barred = frozenset((drive, "load") for drive in made.robot.drives)
    _, free = choose_friction(rows)
    _, choice = choose_friction(rows, barred=barred)
    assert any(step.addition == "load" for step in free.steps)
    assert not any(step.addition == "load" for step in choice.steps)


def test_an_estimate_lies_inside_of_its_interval() -> None:
    # What a fit holds may put it far from what the recording has without.
    problem = identified(LOG).result.problem
    moved = replace(problem.solution, x=1.1 * problem.solution.x)
    for parameter in judged_parameters(replace(problem, solution=moved)):
        if parameter.std:
            assert parameter.low < parameter.value < parameter.high, parameter.name
