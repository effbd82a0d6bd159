"""Factors of recordings that are not all alike: loads, warmth, tolerances, lags, gains, sensors."""

from dataclasses import replace
from pathlib import Path

import pytest

from deltaid.errors import RecordingError
from deltaid.factors.condensed import Group, Groups
from deltaid.factors.file import FactorFile, read, write
from deltaid.factors.gather import gathered
from deltaid.factors.identify import identify_gathered
from deltaid.identification.identify import identify
from deltaid.model.corrections import Correction
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from deltaid.robot.tolerances import Tolerances
from test_friction_by_itself import cooling, recorded
from test_loads import GRIPPER, body, robot, table

PLAIN = Settings(events=False, friction="described", cutoff=15.0)


def written(found: FactorFile, folder: Path) -> FactorFile:
    """The same, as it is after it has been written and read."""
    path = folder / f"{found.record.sha256[:8]}.factors.parquet"
    write(found, path)
    return read(path)


def require_same(found: IdentifiedModel, expected: IdentifiedModel, within: float = 0.35) -> None:
    """What data tell is the same, with the same intervals."""
    own = {one.name: one for one in found.parameters}
    for one in expected.parameters:
        if one.determined_by == "data":
            same = own[one.name]
            assert abs(same.value - one.value) < within * one.std, one.name
            widths = [(x.high or 0.0) - (x.low or 0.0) for x in (same, one)]
            assert 0.6 < widths[0] / widths[1] < 1.6, one.name


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> list[FactorFile]:
    """Two recordings that hold a load now and then, and one that knows of none."""
    name, folder = robot()[0].robot, tmp_path_factory.mktemp("factors")
    each = ((1, "cycles", GRIPPER), (2, "cycles", GRIPPER), (3, "never", None))
    return [
        written(gathered(name, table(seed, held), columns=columns, settings=PLAIN), folder)
        for seed, held, columns in each
    ]


def test_loads_of_some_recordings_are_found_from_all(loaded: list[FactorFile]) -> None:
    found = identify_gathered(robot()[0].robot, loaded, PLAIN).model
    columns = [GRIPPER, GRIPPER, ColumnMapping()]
    tables = [table(1, "cycles"), table(2, "cycles"), table(3, "never")]
    expected = identify(robot()[0].robot, tables, columns=columns, settings=PLAIN).model
    require_same(found, expected)
    (load,), (same,) = found.loads, expected.loads
    assert load.logs == ("table", "table")
    for one, other, true in zip(load.parameters, same.parameters, body(), strict=True):
        if other.determined_by == "data":
            assert abs(one.value - other.value) < 0.35 * other.std
            assert 0.7 < one.std / other.std < 1.4
            assert abs(one.value - true) < 4.0 * one.std


def test_what_was_taken_for_a_load_to_begin_with_does_not_matter(loaded) -> None:
    """Torques of a heavier load taken out, and the same columns: the same load."""
    one, other = loaded[:2]
    expected = identify_gathered(robot()[0].robot, [one, other], PLAIN).model
    heavier, at = 0.2, one.condensed.names.index("load.m")

    def without(group: Group) -> Group:
        factors = [R.copy() for R in group.factors]
        for R, felt in zip(factors, one.condensed.felt, strict=True):
            if at in felt:
                R[:, -1] -= heavier * R[:, felt.tolist().index(at)]
        return replace(group, factors=tuple(factors))

    condensed = replace(
        one.condensed,
        whole=without(one.condensed.whole),
        groups=Groups.of(without(group) for group in one.condensed.groups),
    )
    (load,) = one.record.loads
    taken = (load.taken[0] + heavier, *load.taken[1:])
    record = one.record.changed(loads=(load.changed(taken=taken),))
    for files in ([FactorFile(record, condensed), other], [other, FactorFile(record, condensed)]):
        found = identify_gathered(robot()[0].robot, files, PLAIN).model
        for a, b in zip(found.loads[0].parameters, expected.loads[0].parameters, strict=True):
            assert a.value == pytest.approx(b.value, rel=1e-4, abs=1e-7)
        assert found.fit.rms == pytest.approx(expected.fit.rms, rel=1e-6)


def test_friction_that_warms_up_in_one_recording_is_that_of_its_mean(tmp_path: Path) -> None:
    robot = load_robot("clavel-delta3")
    tables = [recorded(robot, 4, warm=cooling), recorded(robot, 5)]
    files = [written(gathered(robot, one), tmp_path) for one in tables]
    names = [set(one.condensed.names) for one in files]
    assert any("change" in name for name in names[0] - names[1])
    alone = identify_gathered(robot, files[:1]).model
    require_same(alone, files[0].record.model)
    both = identify_gathered(robot, files).model
    for drive in robot.drives:
        own = [one.record.model.value(f"coulomb.{drive}") for one in files]
        assert min(own) < both.value(f"coulomb.{drive}") < max(own)


def test_tolerances_widen_intervals_from_files_as_well(tmp_path: Path) -> None:
    robot = load_robot("clavel-delta3").changed(tolerances=Tolerances(lengths=1e-3))
    one = gathered(robot, recorded(robot, 6), settings=PLAIN)
    kept = identify_gathered(robot, [written(one, tmp_path)], PLAIN).model
    require_same(kept, one.record.model)
    geometry = [one.share.geometry for one in kept.parameters if one.determined_by == "data"]
    assert max(geometry) > 0.3


def test_a_lag_is_as_sure_as_in_the_recording(tmp_path: Path) -> None:
    robot = load_robot("clavel-delta3")
    one = gathered(robot, recorded(robot, 7, late=2e-3), settings=PLAIN)
    assert any(told.kind == "lag" for told in one.record.model.corrections)
    require_same(identify_gathered(robot, [one], PLAIN).model, one.record.model)


def test_torque_constants_put_right_in_one_of_several_are_refused(loaded) -> None:
    gain = Correction(kind="gain", subject="drive1", value=1.05, low=1.0, high=1.1, text="was off")
    model = loaded[0].record.model
    with_gain = model.changed(corrections=(*model.corrections, gain))
    one = FactorFile(loaded[0].record.changed(model=with_gain), loaded[0].condensed, "a")
    described: RobotDescription = robot()[0].robot
    with pytest.raises(RecordingError, match="torque constant of drive1 was put right"):
        identify_gathered(described, [one, loaded[1]], PLAIN)
    alone = identify_gathered(described, [one], PLAIN).model
    assert any("torque constant" in text and "known" in text for text in alone.warnings)
