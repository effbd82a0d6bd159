"""The choice of friction laws, on simulated recordings with noise."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.effects.joint import joints_of
from deltaid.errors import IdentificationError
from deltaid.identification import fit as fit_module
from deltaid.identification import identify as identify_module
from deltaid.identification import stages
from deltaid.identification.common_constant import missing_offsets
from deltaid.identification.fit import FittedProblem
from deltaid.identification.friction_choice import shared_terms
from deltaid.identification.friction_rows import FrictionRows
from deltaid.identification.identify import Identification, identify
from deltaid.model.record import Settings
from deltaid.motion.surrogate import (
    surrogate_parameters,
    write_recording,
)
from deltaid.progress import Progress
from deltaid.robot.description import RobotDescription
from deltaid.robot.friction import Friction
from deltaid.robot.load import load_robot
from drives import case
from drives.identify import identified
from drives.judge import judge
from identified import simulated
from sweeps import swept

PLAIN = {"viscous": 1.2, "coulomb": 3.5}


def robot_with(laws: dict[str, dict], name: str) -> RobotDescription:
    data = load_robot(name).model_dump(exclude_none=True)
    data["friction"] = {j: {**law, **laws.get(j, {})} for j, law in data["friction"].items()}
    return RobotDescription.model_validate(data)


def chosen(
    folder: Path, laws: dict[str, dict], name: str, values: dict[str, float], seed: int = 0
) -> tuple[Identification, dict[str, float]]:
    """What comes out, knowing nothing of the laws, of a recording with them; and the truth."""
    robot, rng = robot_with(laws, name), np.random.default_rng(seed)
    dynamics = compiled(robot)
    p = surrogate_parameters(robot, rng)
    for parameter, value in values.items():
        p[dynamics.layout.names.index(parameter)] = value
    recording = simulated(robot, p, rng, duration=20.0, rate=1000.0)
    write_recording(recording, folder / "log.csv")
    settings = Settings(
        friction="choose", lag="none", compliance="none", effects="none", events=False
    )
    result = identify(load_robot(name), [folder / "log.csv"], settings=settings)
    return result, dict(zip(dynamics.layout.names, p, strict=True))


def test_each_joint_gets_the_law_it_has_and_no_other(tmp_path):
    laws = {
        "drive2": {"offset": 1.0},
        "drive3": {"stribeck": {"coefficient": 2.0, "speed": 0.3, "exponent": 1.4}},
        "drive4": {"power": {"coefficient": 0.2, "exponent": 0.6}},
    }
    values = {"offset.drive2": -2.5, "stribeck.drive3": 2.0, "power.drive4": 0.2}
    result, truth = chosen(tmp_path, laws, "irb360-6-1600", values)
    robot = result.model.robot
    more = {
        j: set(law.model_dump(exclude_none=True)) - {*PLAIN} for j, law in robot.friction.items()
    }
    assert more == {
        "drive1": set(),
        "drive2": {"offset"},
        "drive3": {"stribeck"},
        "drive4": {"power"},
        "slide": set(),
    }
    stribeck = robot.friction["drive3"].stribeck
    assert stribeck.speed == pytest.approx(0.3, rel=0.1)
    assert stribeck.exponent == pytest.approx(1.4, rel=0.15)
    assert result.model.value("offset.drive2") == pytest.approx(-2.5, rel=0.02)
    assert result.model.value("stribeck.drive3") == pytest.approx(2.0, rel=0.1)
    speed = np.geomspace(0.3, 40, 30)
    power = robot.friction["drive4"].power
    found, true = (
        coulomb + viscous * speed + coefficient * speed**exponent
        for coulomb, viscous, coefficient, exponent in (
            (
                result.model.value("coulomb.drive4"),
                result.model.value("viscous.drive4"),
                result.model.value("power.drive4"),
                power.exponent,
            ),
            (truth["coulomb.drive4"], truth["viscous.drive4"], 0.2, 0.6),
        )
    )
    np.testing.assert_allclose(found, true, rtol=0.05)
    choice = result.model.friction_choice
    assert choice.chosen_error < 0.3 * choice.plain_error
    saved = tmp_path / "model.yaml"
    result.model.save(saved)
    assert type(result.model).load(saved).friction_choice == choice


def test_a_weak_term_is_that_of_other_drives_of_the_same_make(tmp_path: Path) -> None:
    stribeck = {"speed": 0.3, "exponent": 2.0}
    sizes = {"drive1": 2.0, "drive2": 2.0, "drive3": 0.05}
    laws = {drive: {"stribeck": {"coefficient": size, **stribeck}} for drive, size in sizes.items()}
    values = {f"stribeck.{drive}": size for drive, size in sizes.items()}
    result, _ = chosen(tmp_path, laws, "irb360-6-1600", values)
    friction = result.robot.friction
    speeds = [friction[drive].stribeck.speed for drive in sizes if friction[drive].stribeck]
    assert speeds == pytest.approx([0.3, 0.3, 0.3], rel=0.3)
    assert friction["drive4"].stribeck is None  # of another make


def test_terms_are_shared_by_drives_of_identical_limbs_alone() -> None:
    robot = load_robot("irb360-6-1600")
    terms = shared_terms(robot, [("drive2", "load"), ("drive4", "power"), ("platform", "stribeck")])
    assert terms == {("drive1", "load"), ("drive3", "load")}


@pytest.mark.parametrize("noise_seed", swept([1, 2], 1))
def test_plain_friction_stays_plain(tmp_path, noise_seed):
    result, _ = chosen(tmp_path, {}, "clavel-delta3", {}, noise_seed)
    assert all(
        set(law.model_dump(exclude_none=True)) == {*PLAIN}
        for law in result.model.robot.friction.values()
    )
    choice = result.model.friction_choice
    assert choice.chosen_error == choice.plain_error
    assert not choice.steps


@pytest.mark.slow
def test_directions_and_load(tmp_path):
    laws = {"drive1": {"viscous_back": 0.5, "coulomb_back": 2.0}, "drive2": {"load": 0.1}}
    values = {
        "viscous.drive1": 0.5, "coulomb.drive1": 0.8, "viscous_back.drive1": 1.0,
        "coulomb_back.drive1": 1.6, "load.drive2": 0.12,
    }  # fmt: skip
    result, truth = chosen(tmp_path, laws, "clavel-delta3", values)
    friction = result.model.robot.friction
    assert not friction["drive1"].both_ways
    assert friction["drive2"].load is not None
    for name in values:
        assert result.model.value(name) == pytest.approx(truth[name], rel=0.1), name


@pytest.mark.slow
def test_a_chosen_load_term_that_does_not_settle_is_dropped(tmp_path, monkeypatch):
    """A described one is refused: only who wrote it knows why it is there."""
    settled = fit_module.settled
    monkeypatch.setattr(
        fit_module,
        "settled",
        lambda posed_with, load: (settled(posed_with, load)[0], load is None),
    )
    laws, values = {"drive2": {"load": 0.1}}, {"load.drive2": 0.12}
    result, _ = chosen(tmp_path, laws, "clavel-delta3", values)
    assert result.model.robot.friction["drive2"].load is None
    with pytest.raises(IdentificationError, match="does not settle"):
        identify(robot_with(laws, "clavel-delta3"), [tmp_path / "log.csv"])


def test_a_term_that_a_fit_puts_at_zero_is_not_chosen_and_causes_are_weighed_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    dropped, idle, weighed = frozenset({("drive1", "stribeck")}), stages.idle, list[int]()

    def idle_at_first(setup: stages.Setup, problem: FittedProblem) -> stages.Idle:
        return idle(setup, problem) if dropped & setup.barred else stages.Idle(dropped)

    def contested(setup: stages.Setup, progress: Progress) -> stages.Setup:
        weighed.append(1)
        return contest(setup, progress)

    contest = stages.contested
    monkeypatch.setattr(identify_module, "idle", idle_at_first)
    monkeypatch.setattr(
        stages, "STAGES", tuple(contested if s is contest else s for s in stages.STAGES)
    )
    friction = identified(case("stribeck", "delta3", 0)).model.robot.friction
    assert friction["drive1"].stribeck is None
    assert friction["drive2"].stribeck is not None
    assert weighed == [1]


def test_no_drive_of_identical_limbs_is_without_a_constant_that_others_have() -> None:
    """What two drives' constants have in common would be weight of all limbs."""
    made = case("mixture", "delta3", 102)
    result = identified(made)
    laws = result.model.robot.friction
    assert all(laws[drive].has_constant for drive in made.robot.drives)
    judged = judge(made, result)
    assert np.mean(judged.base) > 0.9
    assert judged.friction < 0.015


def test_offsets_are_for_limbs_whose_other_drives_have_a_constant() -> None:
    robot = load_robot("irb360-6-1600")
    joints = {joint.name: replace(joint, fastest=1.0) for joint in joints_of(compiled(robot))}
    p = prior_parameters(robot)
    rows = Mock(spec=FrictionRows, dynamics=compiled(robot), joints=joints, p=p)
    law = robot.friction["drive1"]
    offset = law.changed(offset=0.1)
    directions = law.changed(viscous_back=law.viscous, coulomb_back=law.coulomb)

    def missing(**laws: Friction) -> set[tuple[str, str]]:
        return {variant.term for variant in missing_offsets(rows, laws)}

    assert missing(drive1=offset, drive3=directions) == {("drive2", "offset")}
    assert missing(drive2=directions) == {("drive1", "offset"), ("drive3", "offset")}
    assert not missing(drive4=offset)
    assert not missing(drive1=law.changed(load=0.02))
