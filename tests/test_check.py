"""Verdicts of the checks on descriptions and on what recordings tell."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from checked import Data, changed_file, moved, scaled, verdict_of, written
from deltaid.checks.check import check, of_robot
from deltaid.checks.description import checked_lengths
from deltaid.checks.evidence import evidence
from deltaid.checks.identify import _refuse
from deltaid.checks.information import checked_information
from deltaid.checks.verdicts import as_written, changes, with_changes
from deltaid.errors import DescriptionError, RecordingError
from deltaid.model.verdict import Grade, Proposal, Verdict, worst
from deltaid.robot.load import catalogue, described_in, load_robot, yaml_text
from logs import noisy, recorded, tabled, write
from poor_priors import PLAIN
from sweeps import swept


@pytest.mark.parametrize("name", swept(catalogue(), "irb360-6-1600", "i4-linear"))
def test_the_catalogue_is_good(name: str) -> None:
    found = of_robot(load_robot(name))
    assert [verdict for verdict in found if verdict.grade is not Grade.GOOD] == []
    assert len(found) == 6


@pytest.mark.parametrize("part", ["", "limbs", "workspace"])
@pytest.mark.parametrize("name", ["clavel-delta3", "h4-linear"])
def test_millimetres_are_detected_and_corrected_exactly(
    name: str, part: str, tmp_path: Path
) -> None:
    data = as_written(name)
    wrong = written(scaled(data, 1000, part), tmp_path / "robot.yaml")
    verdict = verdict_of(check(wrong), "length-unit")
    assert verdict.grade is Grade.WRONG
    assert "metres" in verdict.cause
    again = with_changes(as_written(wrong), changes([verdict], "robot"))
    assert described_in(yaml_text(again), "mended") == load_robot(name)


@pytest.mark.parametrize("value", [5.0, "x", [1], 10**400])
@pytest.mark.parametrize("key", ["bodies", "limbs", "drive_limits", "workspace"])
def test_what_describes_no_robot_is_refused(tmp_path: Path, key: str, value: object) -> None:
    with pytest.raises(DescriptionError):
        check(changed_file(tmp_path, {key: value}))


def test_a_robot_that_keeps_its_limits_nowhere_is_wrong(tmp_path: Path) -> None:
    found = check(changed_file(tmp_path, {"limbs.working_mode": "inwards"}))
    verdict = verdict_of(found, "workspace")
    assert verdict.grade is Grade.WRONG
    assert "100 % of the workspace cannot be used" in verdict.seen
    assert "working_mode" in verdict.cure


def test_one_length_in_millimetres(tmp_path: Path) -> None:
    found = check(changed_file(tmp_path, {"limbs.platform_radius": 125}))
    (proposal,) = verdict_of(found, "length-unit").proposals
    assert proposal.changes == (("limbs.platform_radius", 0.125),)


def test_numbers_below_a_millimetre_stay_in_metres_beside_others_in_millimetres(
    tmp_path: Path,
) -> None:
    changes = {"workspace.z": [-1150, -800], "workspace.radius": 0.5}
    verdict = verdict_of(check(changed_file(tmp_path, changes)), "length-unit")
    assert dict(verdict.proposals[0].changes) == {
        "workspace.z[0]": -1.15, "workspace.z[1]": -0.8,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "key", "words"),
    [
        ({"friction.drive1.coulomb": 1e9}, "friction-scale", "drive1 is 1e+09 N m at rest"),
        ({"gear_stiffness": 5.0}, "gear-stiffness", "is 5 N m/rad"),
        ({"gear_stiffness": {"drive2": 5.0}}, "gear-stiffness", "drive2 is 5 N m/rad"),
        ({"gear_stiffness": 150.0}, "gear-stiffness", "150 N m would wind the gear up by 1 rad"),
    ],
)
def test_friction_and_gears_with_which_no_robot_moves(
    changes: Data, key: str, words: str, tmp_path: Path
) -> None:
    verdict = verdict_of(check(changed_file(tmp_path, changes)), key)
    assert verdict.grade is Grade.WRONG
    assert words in verdict.seen


def test_soft_gears_that_wind_up_by_a_seventh_of_the_range_are_good(tmp_path: Path) -> None:
    found = check(changed_file(tmp_path, {"gear_stiffness": 500.0}))
    assert worst(found) is Grade.GOOD


@pytest.mark.parametrize(("given", "meant"), [([0, 0, -1], -9.81), ([0, 0, -1.62], None)])
def test_gravity_in_g_is_named_with_the_line_that_corrects_it(
    given: list[float], meant: float | None, tmp_path: Path
) -> None:
    verdicts = [v for v in check(changed_file(tmp_path, {"gravity": given})) if v.key == "gravity"]
    proposed = [proposal.changes for verdict in verdicts for proposal in verdict.proposals]
    assert proposed == ([(("gravity", [0.0, 0.0, meant]),)] if meant else [])


@pytest.mark.parametrize("factor", [0.05, 0.3, 3.0])
def test_small_and_large_robots_have_good_lengths(factor: float) -> None:
    for name in catalogue():
        assert checked_lengths(scaled(as_written(name), factor)).grade is Grade.GOOD, name


def test_a_robot_a_thousand_times_too_small() -> None:
    small = checked_lengths(scaled(as_written("irb360-6-1600"), 1e-3))
    assert small.grade is Grade.WRONG
    assert dict(small.proposals[0].changes)["limbs.strut"] == 1.18


@pytest.mark.parametrize(
    ("changes", "right"),
    [
        ({"bodies.P.prior[0].mass": 1000.0}, {"bodies.P.prior[0].mass": 1.0}),  # in grams
        ({"bodies.P.prior[0].mass": None, "bodies.P.prior[0].density": 2.7},  # in g/cm³
         {"bodies.P.prior[0].density": 2700.0}),
        ({"bodies.P.prior[0].mass": 1e6}, None),  # a thousandth is no mass of it either
        ({"bodies.U.prior[1].mass": 300.0}, {"bodies.U.prior[1].mass": 0.3}),  # of a point
    ],
)  # fmt: skip
def test_priors_out_of_scale(changes: Data, right: Data | None, tmp_path: Path) -> None:
    found = check(changed_file(tmp_path, changes))
    verdict = verdict_of(found, "prior-scale")
    assert verdict.grade in (Grade.WRONG, Grade.DOUBTFUL)
    assert [dict(proposal.changes) for proposal in verdict.proposals] == ([right] if right else [])
    assert ("in grams would fit" in verdict.cure) == (right == {"bodies.P.prior[0].mass": 1.0})
    if verdict.grade is Grade.WRONG:  # what follows from it is not said as well
        assert not [verdict for verdict in found if verdict.key == "torque-limit"]


@pytest.mark.parametrize(
    ("factors", "word"),
    [((1, 1, 1e6), "gyration"), ((1, 1000, 1e6), "centre of mass"), ((1000, 1000, 1000), "kg")],
)
def test_numbers_of_a_body_out_of_scale(
    factors: tuple[float, float, float], word: str, tmp_path: Path
) -> None:
    m, c, i = factors
    prior = {
        "mass": 0.21 * m,
        "first_moment": [0.11 * c, 0.0, 0.0],
        "inertia": {"xx": 1e-5 * i, "yy": 0.08 * i, "zz": 0.08 * i},
    }
    verdict = verdict_of(check(changed_file(tmp_path, {"bodies.S.prior": prior})), "prior-scale")
    assert verdict.grade is (Grade.DOUBTFUL if word == "kg" else Grade.WRONG)
    assert verdict.subject == "S"
    assert word in verdict.seen


def test_missing_friction_is_proposed_from_a_drive_alike(tmp_path: Path) -> None:
    verdict = verdict_of(check(changed_file(tmp_path, {"friction.drive2": None})), "friction")
    assert (verdict.grade, verdict.subject) == (Grade.DOUBTFUL, "drive2")
    assert dict(verdict.proposals[0].changes) == {
        "friction.drive2.viscous": 1.5,
        "friction.drive2.coulomb": 5.0,
    }


def test_missing_limits_say_which_defaults_act(tmp_path: Path) -> None:
    gone = {"platform_speed": None, "platform_acceleration": None, "drive_limits.drive1": None}
    verdict = verdict_of(check(changed_file(tmp_path, gone)), "limits")
    assert verdict.grade is Grade.DOUBTFUL
    assert "5 m/s" in verdict.seen
    assert "50 m/s²" in verdict.seen
    assert "no torque limit of drive1" in verdict.seen


def test_a_workspace_that_limits_cut(tmp_path: Path) -> None:
    ranges = {f"drive_limits.drive{i}.angle_deg": [-10, 30] for i in (1, 2, 3)}
    verdict = verdict_of(check(changed_file(tmp_path, ranges)), "workspace")
    assert verdict.grade is Grade.DOUBTFUL
    assert "drive angle" in verdict.seen
    assert 0.2 < verdict.number < 0.95
    assert "drive1 -" in verdict.cure  # the range that it would take, beyond −10°


def test_a_torque_limit_below_gravity(tmp_path: Path) -> None:
    low = {f"drive_limits.drive{i}.torque": 2.0 for i in (1, 2, 3)}
    verdict = verdict_of(check(changed_file(tmp_path, low)), "torque-limit")
    assert verdict.grade is Grade.WRONG
    assert verdict.number == pytest.approx(9.15 / 2.0, rel=0.02)


@pytest.mark.parametrize(("torque", "said"), [(1.5e5, True), (1500.0, False)])
def test_a_torque_limit_in_another_unit(torque: float, said: bool, tmp_path: Path) -> None:
    limits = {"drive_limits.drive2.torque": torque, "drive_limits.drive2.speed_deg_s": 600.0}
    verdict = verdict_of(check(changed_file(tmp_path, limits)), "torque-limit")
    assert verdict.grade is (Grade.DOUBTFUL if said else Grade.GOOD)
    assert verdict.subject == "drive2" * said
    # ω M_22 / τ with M_22 = 0.458 kg m²
    assert ("10.5 rad/s in 0.032 ms" in verdict.seen) == said
    limits["drive_limits.drive1.torque"] = 2.0  # the robot would sink, which is worse
    assert verdict_of(check(changed_file(tmp_path, limits)), "torque-limit").grade is Grade.WRONG


@pytest.fixture(scope="module")
def by_motion() -> dict[str, tuple[Verdict, ...]]:
    """Verdicts on recordings of the 4-DOF Delta by their motion: all of a usual one."""
    name, kinds = "irb360-6-1600", {"slow": {"pace": 1 / 15}, "tool rests": {"which": (0, 1, 2)}}
    found = {"usual": check(name, moved(name))}
    for key, how in kinds.items():
        moved_evidence = evidence(load_robot(name), moved(name, **how))
        found[key] = checked_information(moved_evidence)
    return found


def test_a_usual_motion_is_good(by_motion: dict[str, tuple[Verdict, ...]]) -> None:
    assert worst(by_motion["usual"]) is Grade.GOOD
    assert verdict_of(by_motion["usual"], "excitation").number == pytest.approx(1.0, abs=0.3)


def test_a_slow_motion_is_doubtful(by_motion: dict[str, tuple[Verdict, ...]]) -> None:
    verdict = verdict_of(by_motion["slow"], "excitation")
    assert verdict.grade is Grade.DOUBTFUL
    assert verdict.number > 10
    assert "as fast as the limits allow" in verdict.cure


def test_a_tool_that_rests_is_named_with_the_motion_that_shows_it(
    by_motion: dict[str, tuple[Verdict, ...]],
) -> None:
    assert verdict_of(by_motion["tool rests"], "excitation").subject == "drive4"
    verdict = verdict_of(by_motion["tool rests"], "base-parameters")
    assert verdict.grade is Grade.DOUBTFUL
    assert "viscous.drive4" in verdict.cure
    assert "fast turns of the tool" in verdict.cure


def test_a_recording_that_cannot_be_used_has_a_verdict() -> None:
    rows = evidence(load_robot("clavel-delta3"), moved("clavel-delta3")).rows
    far = deltaid.Recording.from_arrays(t=rows.time, q=rows.q + 1.7, tau=rows.tau)
    found = check("clavel-delta3", far)
    assert worst(found) is Grade.WRONG


def test_lost_readings_are_no_fast_motion() -> None:
    lost = np.random.default_rng(0).random(1500) < 0.01
    log = recorded().with_columns(q1=pl.when(pl.Series(lost)).then(0.0).otherwise(pl.col("q1")))
    (verdict,) = check(load_robot("clavel-delta3"), log).poor
    assert (verdict.key, verdict.grade) == ("refused", Grade.WRONG)
    assert "column q1 is 0 rad for one row" in verdict.seen


@pytest.mark.parametrize("rows", [2, 50, 200])
def test_a_recording_that_is_too_short_has_no_other_fault(rows: int) -> None:
    noise = np.random.default_rng(1).normal(size=(3, rows))
    log = recorded(rows).with_columns(
        pl.Series(f"tau{k + 1}", 5.0 + n) for k, n in enumerate(noise)
    )
    found = [v for v in check("clavel-delta3", log) if v.grade in (Grade.WRONG, Grade.DOUBTFUL)]
    assert [(v.key, v.grade) for v in found] == [("refused", Grade.WRONG)]
    assert "too few" in found[0].seen


def test_identify_refuses_what_is_wrong_in_the_words_of_the_check(tmp_path: Path) -> None:
    robot = changed_file(tmp_path, {"bodies.P.prior[0].mass": 1000.0})
    words = verdict_of(check(robot), "prior-scale")
    log = moved("clavel-delta3")
    with pytest.raises(deltaid.DeltaidError) as error:
        deltaid.identify(robot, log)
    assert words.seen in str(error.value)
    assert str(error.value).endswith("mass: 1.0")
    forced = deltaid.identify(robot, log, force=True, settings=PLAIN)
    assert forced.model.warnings[0] == words.sentence


def test_identify_begins_with_what_is_doubtful() -> None:
    log = moved("clavel-delta3", pace=1 / 15)
    result = deltaid.identify("clavel-delta3", log)
    poor = [verdict for verdict in result.verdicts if verdict.grade is not Grade.GOOD]
    assert [verdict.key for verdict in poor] == ["base-parameters", "excitation", "torque-lag"]
    assert poor[2].grade is Grade.CANNOT_TELL  # at this pace a lag hardly shows
    assert result.model.warnings[:3] == tuple(verdict.sentence for verdict in poor)


def test_two_recordings_are_judged_together() -> None:
    """What one does not move, the other does; all else is said of each."""
    name = "irb360-6-1600"
    logs = [moved(name, which=(0, 1, 2)), moved(name, which=(2, 3))]
    result = deltaid.identify(name, logs, settings=PLAIN)
    base_verdict = verdict_of(result.verdicts, "base-parameters")
    assert "drive4" not in base_verdict.seen + base_verdict.cure
    assert "drive4" not in verdict_of(result.verdicts, "excitation").seen
    assert not any("constant" in text for text in result.model.warnings)
    found = check(name, logs)
    assert verdict_of(found, "base-parameters").seen == base_verdict.seen
    assert verdict_of(found, "excitation").seen == verdict_of(result.verdicts, "excitation").seen
    assert {verdict.subject for verdict in found if verdict.key == "velocity"} == {"arrays"}


def test_a_drive_that_rests_in_all_recordings_is_named_once() -> None:
    name = "irb360-6-1600"
    logs = [moved(name, which=which) for which in ((0, 1, 2), (0, 1))]
    result = deltaid.identify(name, logs, settings=PLAIN)
    assert verdict_of(result.verdicts, "excitation").subject == "drive4"
    assert sum("drive4 hardly moves" in text for text in result.model.warnings) == 1
    assert not any("constant" in text for text in result.model.warnings)


def test_what_a_fit_contradicts_is_not_said_where_a_verdict_tells_why() -> None:
    name = "clavel-delta3"
    rows = evidence(load_robot(name), moved(name)).rows
    log = deltaid.Recording.from_arrays(t=rows.time, q=rows.q, tau=rows.tau * [1, -1, 1])
    forced = deltaid.identify(name, log, force=True, settings=PLAIN)
    assert verdict_of(forced.verdicts, "torque-sign").grade is Grade.WRONG
    warnings = " ".join(forced.model.warnings)
    assert "contradict" not in warnings
    assert "no robot has" not in warnings


def test_missing_limits_are_said_of_a_description_not_of_every_recording(tmp_path: Path) -> None:
    data = as_written("clavel-delta3")
    data.pop("platform_speed", None)
    robot = written(data, tmp_path / "robot.yaml")
    assert verdict_of(check(robot), "limits").grade is Grade.DOUBTFUL
    assert "limits" not in {verdict.key for verdict in check(robot, recorded(3000)).poor}


def test_a_recording_at_rest_beside_a_good_one_is_named_as_one() -> None:
    moving, rng = noisy(recorded(6000)), np.random.default_rng(0)
    noise = rng.normal(0.0, 1e-6, (13_000, 3))
    still = tabled(t=1e-3 * np.arange(len(noise)), q=0.3 + noise, tau=1.0 + 1e3 * noise)
    found = check("clavel-delta3", [moving, still])
    (verdict,) = [verdict for verdict in found if verdict.grade is not Grade.GOOD]
    assert (verdict.key, verdict.grade) == ("standing", Grade.DOUBTFUL)
    assert "the robot stands still" in verdict.seen
    assert any(verdict.key == "base-parameters" for verdict in found)
    fitted = deltaid.identify("clavel-delta3", [moving, still])
    assert any("the robot stands still" in warning for warning in fitted.model.warnings)


def test_one_row_is_no_robot_at_rest() -> None:
    (verdict,) = check("clavel-delta3", recorded(1)).poor
    assert "fewer than two rows" in verdict.seen


def test_a_refusal_that_proposes_nothing_offers_nothing_to_write() -> None:
    wrong = Verdict("limits", Grade.WRONG, "what was seen", "", "a cause", "a cure")
    with pytest.raises(DescriptionError) as caught:
        _refuse([wrong], load_robot("clavel-delta3"), False)
    assert "`deltaid check` shows more, --force continues" in str(caught.value)


def test_a_refusal_ends_with_the_lines_that_it_proposes() -> None:
    changed = (
        Proposal("robot", (("limbs.strut", 0.8),)),
        Proposal("mapping", (("time.unit", "ms"),)),
    )
    wrong = Verdict("limits", Grade.WRONG, "seen", "", "a cause", "a cure", proposals=changed)
    record = evidence(load_robot("clavel-delta3"), moved("clavel-delta3"))
    for subject, kind in ((record.robot, DescriptionError), (record, RecordingError)):
        with pytest.raises(kind) as caught:
            _refuse([wrong], subject, False)
        assert "\n# into the robot file\nlimbs: {strut: 0.8}" in str(caught.value)
        mapping = "\n# into the mapping of columns\ntime: {unit: ms}" in str(caught.value)
        assert mapping == (subject is record)


def test_a_refused_recording_of_several_is_named_once(tmp_path: Path) -> None:
    logs = [write(tmp_path / f"{rows}.csv", noisy(recorded(rows))) for rows in (4000, 100)]
    (verdict,) = check("clavel-delta3", logs).poor
    assert verdict.key == "refused"
    assert verdict.finding.count("100.csv") == 1
