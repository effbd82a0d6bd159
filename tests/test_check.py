"""`deltaid check`: verdicts on descriptions and on what recordings tell, exit codes, cures."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import deltaid
from command import run
from deltaid.check.evidence import evidence
from deltaid.check.information import checked_information
from deltaid.check.lengths import checked_lengths
from deltaid.check.mended import as_written, changes, mended
from deltaid.check.run import OF_ROBOT, of_robot, verdicts
from deltaid.check.verdict import KEYS, Grade, Proposal, Verdict, worst
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.motion.random_motion import random_motion
from deltaid.recording.opening import open_log
from deltaid.robot.load import catalogue, described_in, load_robot, yaml_text
from sessions import ROOT

Data = dict[str, Any]


def scaled(data: Data, factor: float, part: str = "") -> Data:
    """A description with all lengths, or those of one part, multiplied."""
    lengths = {
        "limbs": ("base_radius", "platform_radius", "upper_arm", "strut", "base_points",
                  "platform_points"),
        "workspace": ("radius", "z"),
        "telescope": ("stroke",),
        "platform": ("half_length", "length"),
    }  # fmt: skip

    def times(value: Any) -> Any:
        return [times(one) for one in value] if isinstance(value, list) else value * factor

    result = json.loads(json.dumps(data))
    for name, keys in lengths.items():
        for key in keys if name.startswith(part) else ():
            if key in (result.get(name) or {}):
                result[name][key] = times(result[name][key])
    if not part:
        for limits in result["drive_limits"].values():
            if "position" in limits:
                limits["position"] = times(limits["position"])
        for body in result["bodies"].values():
            for shape in body["prior"]:
                for key in {"length", "outer_radius", "inner_radius", "centre"} & set(shape):
                    shape[key] = times(shape[key])
    return result


def written(data: Data, path: Path) -> Path:
    path.write_text(yaml_text(data), encoding="utf-8")
    return path


def of(found: tuple[Verdict, ...], key: str) -> Verdict:
    matches = [one for one in found if one.key == key]
    assert len(matches) == 1, found
    return matches[0]


def moved(name: str, pace: float = 1.0, which: tuple[int, ...] = (0, 1, 2, 3)) -> deltaid.Recording:
    """Ten seconds of a random motion, slowed down, of some of the task coordinates."""
    dynamics, rng = compiled(load_robot(name)), np.random.default_rng(3)
    time = np.arange(2500) / 250
    z, zd, zdd = random_motion(dynamics.kinematics, rng).evaluate(pace * time)
    chosen = np.isin(np.arange(dynamics.dof), which)
    z = np.where(chosen, z, dynamics.kinematics.home)
    q, qd, qdd = dynamics.kinematics.drive_motion(z, pace * zd * chosen, pace**2 * zdd * chosen)
    tau = dynamics.torque(z, qd, qdd, 1.1 * prior_parameters(dynamics.robot))
    tau += 0.02 * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape) + 1e-6 * rng.normal(
        size=tau.shape
    )
    return deltaid.Recording.from_arrays(t=time, q=q, qd=qd, qdd=qdd, tau=tau)


@pytest.mark.parametrize("name", catalogue())
def test_the_catalogue_is_good(name: str) -> None:
    found = of_robot(load_robot(name))
    assert [one for one in found if one.grade is not Grade.GOOD] == []
    assert len(found) == 6
    assert len(OF_ROBOT) == 5


@pytest.mark.parametrize("part", ["", "limbs", "workspace"])
@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600", "h4-linear", "par4"])
def test_millimetres_are_seen_and_mended_exactly(name: str, part: str, tmp_path: Path) -> None:
    data = as_written(name)
    wrong = written(scaled(data, 1000, part), tmp_path / "robot.yaml")
    verdict = of(verdicts(wrong), "millimetres")
    assert verdict.grade is Grade.WRONG
    assert "metres" in verdict.cause
    again = mended(as_written(wrong), changes([verdict], "robot"))
    assert described_in(yaml_text(again), "mended") == load_robot(name)


def test_one_length_in_millimetres(tmp_path: Path) -> None:
    data = mended(as_written("clavel-delta3"), {"limbs.platform_radius": 125})
    verdict = of(verdicts(written(data, tmp_path / "robot.yaml")), "millimetres")
    (proposal,) = verdict.proposals
    assert proposal.changes == (("limbs.platform_radius", 0.125),)


@pytest.mark.parametrize("factor", [0.05, 0.3, 3.0])
def test_small_and_large_robots_have_good_lengths(factor: float) -> None:
    for name in catalogue():
        assert checked_lengths(scaled(as_written(name), factor)).grade is Grade.GOOD, name


def test_a_robot_a_thousand_times_too_small() -> None:
    small = checked_lengths(scaled(as_written("irb360-6-1600"), 1e-3))
    assert small.grade is Grade.WRONG
    assert dict(small.proposals[0].changes)["limbs.strut"] == 1.18


PRIORS: dict[str, tuple[Callable[[Data], dict[str, object]], str, float | None]] = {
    "a mass in grams": (
        lambda d: {"bodies.P.prior[0].mass": 1000.0},
        "bodies.P.prior[0].mass",
        1.0,
    ),
    "a density in g/cm³": (
        lambda d: {"bodies.P.prior[0].mass": None, "bodies.P.prior[0].density": 2.7},
        "bodies.P.prior[0].density",
        2700.0,
    ),
    "a point mass in grams": (
        lambda d: {"bodies.U.prior[1].mass": 300.0},
        "bodies.U.prior[1].mass",
        0.3,
    ),
}


@pytest.mark.parametrize("case", PRIORS)
def test_priors_out_of_scale(case: str, tmp_path: Path) -> None:
    make, path, value = PRIORS[case]
    data = as_written("clavel-delta3")
    found = verdicts(written(mended(data, make(data)), tmp_path / "robot.yaml"))
    verdict = of(found, "prior-scale")
    assert verdict.grade in (Grade.WRONG, Grade.DOUBTFUL)
    assert dict(verdict.proposals[0].changes) == {path: value}
    if verdict.grade is Grade.WRONG:  # what follows from it is not said as well
        assert not [one for one in found if one.key == "torque-limit"]


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
    data = mended(as_written("clavel-delta3"), {"bodies.S.prior": prior})
    verdict = of(verdicts(written(data, tmp_path / "robot.yaml")), "prior-scale")
    assert verdict.grade is (Grade.DOUBTFUL if word == "kg" else Grade.WRONG)
    assert verdict.subject == "S"
    assert word in verdict.seen


def test_missing_friction_is_proposed_from_a_drive_alike(tmp_path: Path) -> None:
    data = mended(as_written("clavel-delta3"), {"friction.drive2": None})
    verdict = of(verdicts(written(data, tmp_path / "robot.yaml")), "friction-missing")
    assert (verdict.grade, verdict.subject) == (Grade.DOUBTFUL, "drive2")
    assert dict(verdict.proposals[0].changes) == {
        "friction.drive2.viscous": 1.5,
        "friction.drive2.coulomb": 5.0,
    }


def test_missing_limits_say_which_defaults_act(tmp_path: Path) -> None:
    gone = {"platform_speed": None, "platform_acceleration": None, "drive_limits.drive1": None}
    data = mended(as_written("clavel-delta3"), gone)
    verdict = of(verdicts(written(data, tmp_path / "robot.yaml")), "limits-missing")
    assert verdict.grade is Grade.DOUBTFUL
    assert "5 m/s" in verdict.seen
    assert "50 m/s²" in verdict.seen
    assert "no torque limit of drive1" in verdict.seen


def test_a_workspace_that_limits_cut(tmp_path: Path) -> None:
    ranges = {f"drive_limits.drive{i}.angle_deg": [-10, 30] for i in (1, 2, 3)}
    data = mended(as_written("clavel-delta3"), ranges)
    verdict = of(verdicts(written(data, tmp_path / "robot.yaml")), "workspace-cut")
    assert verdict.grade is Grade.DOUBTFUL
    assert "drive angle" in verdict.seen
    assert verdict.number is not None
    assert 0.2 < verdict.number < 0.95
    assert "drive1 -" in verdict.cure  # the range that it would take, beyond −10°


def test_a_torque_limit_below_gravity(tmp_path: Path) -> None:
    low = {f"drive_limits.drive{i}.torque": 2.0 for i in (1, 2, 3)}
    data = mended(as_written("clavel-delta3"), low)
    verdict = of(verdicts(written(data, tmp_path / "robot.yaml")), "torque-limit")
    assert verdict.grade is Grade.WRONG
    assert verdict.number == pytest.approx(9.15 / 2.0, rel=0.02)


@pytest.fixture(scope="module")
def told() -> dict[str, tuple[Verdict, ...]]:
    """Verdicts on recordings of the 4-DOF Delta by their motion: all of a usual one."""
    name, kinds = "irb360-6-1600", {"slow": {"pace": 1 / 15}, "tool rests": {"which": (0, 1, 2)}}
    found = {"usual": verdicts(name, moved(name))}
    for key, how in kinds.items():
        one = evidence(load_robot(name), moved(name, **how))
        found[key] = checked_information(one)
    return found


def test_a_usual_motion_is_good(told: dict[str, tuple[Verdict, ...]]) -> None:
    assert worst(told["usual"]) is Grade.GOOD
    assert of(told["usual"], "excitation").number == pytest.approx(1.0, abs=0.3)


def test_a_slow_motion_is_doubtful(told: dict[str, tuple[Verdict, ...]]) -> None:
    verdict = of(told["slow"], "excitation")
    assert verdict.grade is Grade.DOUBTFUL
    assert verdict.number is not None
    assert verdict.number > 10
    assert "as fast as the limits allow" in verdict.cure


def test_a_tool_that_rests_is_named_with_the_motion_that_shows_it(
    told: dict[str, tuple[Verdict, ...]],
) -> None:
    assert of(told["tool rests"], "excitation").subject == "drive4"
    verdict = of(told["tool rests"], "base-parameters")
    assert verdict.grade is Grade.DOUBTFUL
    assert "viscous.drive4" in verdict.cure
    assert "fast turns of the tool" in verdict.cure


def test_a_recording_that_cannot_be_used_has_a_verdict() -> None:
    rows = evidence(load_robot("clavel-delta3"), moved("clavel-delta3")).rows
    far = deltaid.Recording.from_arrays(t=rows.time, q=rows.q + 1.7, tau=rows.tau)
    found = verdicts("clavel-delta3", far)
    assert worst(found) is Grade.WRONG


def test_identify_refuses_what_is_wrong_in_the_words_of_the_check(tmp_path: Path) -> None:
    data = mended(as_written("clavel-delta3"), {"bodies.P.prior[0].mass": 1000.0})
    robot = written(data, tmp_path / "robot.yaml")
    words = of(verdicts(robot), "prior-scale")
    log = moved("clavel-delta3")
    with pytest.raises(deltaid.DeltaidError) as error:
        deltaid.identify(robot, log)
    assert words.seen in str(error.value)
    assert "bodies.P.prior[0].mass: 1" in str(error.value)
    forced = deltaid.identify(robot, log, force=True)
    assert forced.model.warnings[0] == words.sentence


def test_identify_begins_with_what_is_doubtful(tmp_path: Path) -> None:
    log = moved("clavel-delta3", pace=1 / 15)
    result = deltaid.identify("clavel-delta3", log)
    poor = [one for one in result.verdicts if one.grade is not Grade.GOOD]
    assert [one.key for one in poor] == ["base-parameters", "excitation", "torque-lag"]
    assert poor[2].grade is Grade.CANNOT_TELL  # at this pace a lag hardly shows
    assert result.model.warnings[:3] == tuple(one.sentence for one in poor)


def test_two_recordings_are_judged_together() -> None:
    """What one does not move, the other does; all else is said of each."""
    name = "irb360-6-1600"
    logs = [moved(name, which=(0, 1, 2)), moved(name, which=(2, 3))]
    result = deltaid.identify(name, logs)
    told = of(result.verdicts, "base-parameters")
    assert "drive4" not in told.seen + told.cure
    assert "drive4" not in of(result.verdicts, "excitation").seen
    assert not any("constant" in text for text in result.model.warnings)
    found = verdicts(name, logs)
    assert of(found, "base-parameters").seen == told.seen
    assert of(found, "excitation").seen == of(result.verdicts, "excitation").seen
    assert {one.subject for one in found if one.key == "velocity"} == {"arrays"}


def test_a_drive_that_rests_in_all_recordings_is_named_once() -> None:
    name = "irb360-6-1600"
    result = deltaid.identify(name, [moved(name, which=which) for which in ((0, 1, 2), (0, 1))])
    assert of(result.verdicts, "excitation").subject == "drive4"
    assert sum("drive4 hardly moves" in text for text in result.model.warnings) == 1
    assert not any("constant" in text for text in result.model.warnings)


def test_what_a_fit_contradicts_is_not_said_where_a_verdict_tells_why() -> None:
    name = "clavel-delta3"
    rows = evidence(load_robot(name), moved(name)).rows
    log = deltaid.Recording.from_arrays(t=rows.time, q=rows.q, tau=rows.tau * [1, -1, 1])
    forced = deltaid.identify(name, log, force=True)
    assert of(forced.verdicts, "torque-sign").grade is Grade.WRONG
    assert (
        sum("contradict" in text or "no robot has" in text for text in forced.model.warnings) == 0
    )


# The command.


def test_exit_codes(tmp_path: Path) -> None:
    assert run("check", "clavel-delta3").code == 0
    data = as_written("clavel-delta3")
    doubtful = written(mended(data, {"friction.drive1": None}), tmp_path / "doubtful.yaml")
    assert run("check", doubtful).code == 3
    wrong = written(scaled(data, 1000), tmp_path / "wrong.yaml")
    assert run("check", wrong).code == 4
    broken = written({"name": "nothing"}, tmp_path / "broken.yaml")
    outcome = run("check", broken)
    assert (outcome.code, outcome.out) == (2, "")
    assert run("check", "clavel-delta3", tmp_path / "no.csv").code == 2


def test_what_is_written_loads_and_is_better(tmp_path: Path) -> None:
    data = scaled(mended(as_written("clavel-delta3"), {"friction.drive1": None}), 1000)
    robot = written(data, tmp_path / "robot.yaml")
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    outcome = run("check", robot, "--write", first)
    assert outcome.code == 4
    assert f"wrote {first}" in outcome.out.replace("\n", "")
    assert run("check", first, "--write", second).code == 3  # the friction is left
    assert run("check", second).code == 0
    assert load_robot(second).limbs == load_robot("clavel-delta3").limbs


def test_nothing_proposed_is_said(tmp_path: Path) -> None:
    path = tmp_path / "fixed.yaml"
    outcome = run("check", "clavel-delta3", "--write", path)
    assert "nothing was written" in outcome.out
    assert not path.exists()


def test_json_has_all_fields(tmp_path: Path) -> None:
    data = mended(as_written("clavel-delta3"), {"bodies.P.prior[0].mass": 1000.0})
    outcome = run("check", written(data, tmp_path / "robot.yaml"), "--json")
    value = json.loads(outcome.out)
    assert (value["robot"], value["grade"]) == ("clavel-delta3", "wrong")
    verdict = next(one for one in value["verdicts"] if one["key"] == "prior-scale")
    assert set(verdict) == {
        "key", "grade", "subject", "seen", "number", "unit", "cause", "cure", "proposals"
    }  # fmt: skip
    assert verdict["proposals"] == [{"file": "robot", "changes": {"bodies.P.prior[0].mass": 1.0}}]


@pytest.mark.parametrize("width", [80, 200])
def test_lines_to_paste_are_yaml_of_the_whole_list(width: int, tmp_path: Path) -> None:
    data = mended(as_written("clavel-delta3"), {"bodies.P.prior[0].mass": 1000.0})
    outcome = run("check", written(data, tmp_path / "robot.yaml"), width=width)
    lines = outcome.out.split("into the robot file:\n")[1]
    from ruamel.yaml import YAML

    pasted = YAML(typ="safe", pure=True).load(lines)
    assert pasted == {
        "bodies": {"P": {"prior": as_written("clavel-delta3")["bodies"]["P"]["prior"]}}
    }
    assert max(map(len, outcome.out.splitlines())) <= width


def test_report_holds_verdicts_and_lines(tmp_path: Path) -> None:
    data = mended(as_written("clavel-delta3"), {"bodies.P.prior[0].mass": 1000.0})
    path = tmp_path / "check.html"
    run("check", written(data, tmp_path / "robot.yaml"), "--report", path)
    page = path.read_text(encoding="utf-8")
    assert "a mass in grams" in page
    assert "<pre" in page


def test_mapping_and_robot_go_into_two_files(tmp_path: Path, monkeypatch: Any) -> None:
    """Proposals for both files, as several checks may make them."""
    log = tmp_path / "log.csv"
    rows = evidence(load_robot("clavel-delta3"), moved("clavel-delta3")).rows
    names = ["t", *(f"{kind}{i}" for kind in ("q", "tau") for i in (1, 2, 3))]
    columns = np.column_stack([rows.time, rows.q, rows.tau])
    np.savetxt(log, columns, delimiter=",", header=",".join(names), comments="")
    wrong = Verdict(
        "torque-sign", Grade.WRONG, "seen", proposals=(
            Proposal("mapping", (("torque[1].sign", -1),)),
            Proposal("robot", (("friction.drive1.coulomb", 6.0),)),
        ),
    )  # fmt: skip
    monkeypatch.setattr("deltaid.check.run.of_recording", lambda *_: (wrong,))
    outcome = run("check", "clavel-delta3", log, "--write", tmp_path / "fixed.yaml")
    assert outcome.code == 4
    mapping = deltaid.load_mapping(tmp_path / "fixed-columns.yaml")
    assert mapping.torque is not None
    assert [column.sign for column in mapping.torque] == [1, -1, 1]
    assert mapping.position is not None
    assert mapping.position[0].unit == "rad"
    robot = load_robot(tmp_path / "fixed-robot.yaml")
    assert robot.friction["drive1"].coulomb == 6.0
    assert open_log(log, compiled(robot).kinematics, mapping).samples == len(rows.time)


# The page.


CODE = "\n".join(
    path.read_text(encoding="utf-8") for path in (ROOT / "src/deltaid/check").rglob("*.py")
    if path.name != "verdict.py"
)  # fmt: skip


def test_the_page_lists_every_key_and_no_other() -> None:
    page = (ROOT / "docs" / "check.md").read_text(encoding="utf-8")
    keys = [key for group in KEYS.values() for key in group]
    assert re.findall(r"^### `([a-z-]+)`", page, re.M) == keys
    assert re.findall(r"^## About (.*)$", page, re.M) == list(KEYS)
    for section in page.split("\n### ")[1:]:
        assert "```" in section, f"no example: {section[:30]}"


def test_every_key_is_said_somewhere_and_no_other() -> None:
    keys = {key for group in KEYS.values() for key in group}
    assert set(re.findall(r'Verdict\(\s*"([a-z-]+)"', CODE)) <= keys
    assert {key for key in keys if f'"{key}"' not in CODE} == set()
