"""Factors of recordings that are not all alike: loads, warmth, tolerances, lags, gains, sensors."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltaid.errors import RecordingError
from deltaid.fleets.factor_file import FactorFile, read, write
from deltaid.fleets.factor_record import FactorGroups
from deltaid.fleets.gather import gathered
from deltaid.fleets.identify_gathered import identify_gathered, validate_gathered
from deltaid.fleets.robot_recordings import merged_files
from deltaid.fleets.steps import gain_rows
from deltaid.identification.identify import identify
from deltaid.identification.prediction import validate
from deltaid.model.corrections import Correction
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.recording.mapping import ColumnMapping
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


def require_same(found: IdentifiedModel, expected: IdentifiedModel) -> None:
    """What data tell is the same, with the same intervals."""
    own = {parameter.name: parameter for parameter in found.parameters}
    for parameter in expected.parameters:
        if parameter.determined_by == "data":
            same = own[parameter.name]
            assert abs(same.value - parameter.value) < 0.35 * parameter.std, parameter.name
            widths = [(x.high or 0.0) - (x.low or 0.0) for x in (same, parameter)]
            assert 0.6 < widths[0] / widths[1] < 1.6, parameter.name


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> list[FactorFile]:
    """Two recordings that hold a load now and then, and one that knows of none."""
    name, folder = robot()[0].robot, tmp_path_factory.mktemp("factors")
    each = ((1, "cycles", GRIPPER), (2, "cycles", GRIPPER), (3, "never", None))
    return [
        written(gathered(name, table(seed, held), columns=columns, settings=PLAIN), folder)
        for seed, held, columns in each
    ]


@pytest.mark.slow
def test_loads_of_some_recordings_are_found_from_all(loaded: list[FactorFile]) -> None:
    found = identify_gathered(robot()[0].robot, loaded, PLAIN).model
    columns = [GRIPPER, GRIPPER, ColumnMapping()]
    tables = [table(1, "cycles"), table(2, "cycles"), table(3, "never")]
    expected = identify(robot()[0].robot, tables, columns=columns, settings=PLAIN).model
    require_same(found, expected)
    (load,), (same,) = found.loads, expected.loads
    assert load.logs == ("table", "table")
    for parameter, other, true in zip(load.parameters, same.parameters, body(), strict=True):
        if other.determined_by == "data":
            assert abs(parameter.value - other.value) < 0.35 * other.std
            assert 0.7 < parameter.std / other.std < 1.4
            assert abs(parameter.value - true) < 4.0 * parameter.std


@pytest.mark.slow
def test_what_was_taken_for_a_load_to_begin_with_does_not_matter(loaded) -> None:
    """Torques of a heavier load taken out, and the same columns: the same load."""
    file, other = loaded[:2]
    expected = identify_gathered(robot()[0].robot, [file, other], PLAIN).model
    heavier, at = 0.2, file.record.names.index("load.m")

    def without(group: FactorGroups) -> FactorGroups:
        factors = [R.copy() for R in group.factors]
        for R, columns in zip(factors, file.record.felt, strict=True):
            if at in columns:
                R[..., -1] -= heavier * R[..., columns.index(at)]
        return replace(group, factors=tuple(factors))

    (load,) = file.record.loads
    taken = (load.taken[0] + heavier, *load.taken[1:])
    record = file.record.changed(loads=(load.changed(taken=taken),))
    same = FactorFile(record, without(file.whole), without(file.groups), file.geometry)
    for files in ([same, other], [other, same]):
        found = identify_gathered(robot()[0].robot, files, PLAIN).model
        for a, b in zip(found.loads[0].parameters, expected.loads[0].parameters, strict=True):
            assert a.value == pytest.approx(b.value, rel=1e-4, abs=1e-7)
        assert found.fit.rms == pytest.approx(expected.fit.rms, rel=1e-6)


@pytest.mark.slow
def test_friction_that_warms_up_in_one_recording_is_that_of_its_mean(tmp_path: Path) -> None:
    robot = load_robot("clavel-delta3")
    tables = [recorded(robot, 4, warm=cooling), recorded(robot, 5)]
    files = [written(gathered(robot, table), tmp_path) for table in tables]
    names = [set(file.record.names) for file in files]
    assert any("change" in name for name in names[0] - names[1])
    alone = identify_gathered(robot, files[:1]).model
    require_same(alone, files[0].record.model)
    both = identify_gathered(robot, files).model
    for drive in robot.drives:
        own = [file.record.model.value(f"coulomb.{drive}") for file in files]
        assert min(own) < both.value(f"coulomb.{drive}") < max(own)


def test_tolerances_widen_intervals_from_files_as_well(tmp_path: Path) -> None:
    robot = load_robot("clavel-delta3").changed(tolerances=Tolerances(lengths=1e-3))
    file = gathered(robot, recorded(robot, 6), settings=PLAIN)
    kept = identify_gathered(robot, [written(file, tmp_path)], PLAIN).model
    require_same(kept, file.record.model)
    geometry = [
        parameter.share.geometry
        for parameter in kept.parameters
        if parameter.determined_by == "data"
    ]
    assert max(geometry) > 0.3


def test_a_lag_is_as_sure_as_in_the_recording() -> None:
    robot = load_robot("clavel-delta3")
    file = gathered(robot, recorded(robot, 7, late=2e-3), settings=PLAIN)
    assert any(correction.kind == "lag" for correction in file.record.model.corrections)
    require_same(identify_gathered(robot, [file], PLAIN).model, file.record.model)


def with_gain(file: FactorFile, low: float, high: float) -> FactorFile:
    """As if the torque constant of drive1 had been put right."""
    value = 0.5 * (low + high)
    gain = Correction(
        kind="gain", subject="drive1", value=value, low=low, high=high, text="was off"
    )
    model = file.record.model
    model = model.changed(corrections=(*model.corrections, gain))
    return replace(file, record=file.record.changed(model=model))


def test_torque_constants_corrected_in_one_of_several_are_refused(loaded: list[FactorFile]) -> None:
    described, corrected = robot()[0].robot, with_gain(loaded[0], 1.0, 1.1)
    with pytest.raises(RecordingError, match=r"drive1 was corrected .*and in .* it was not"):
        identify_gathered(described, [corrected, loaded[1]], PLAIN)
    for low, high in ((1.15, 1.2), (0.8, 0.95)):
        # Files go by their names, which are checksums.
        with pytest.raises(RecordingError, match=r"drive1 was corrected .* by .*, and in .* by"):
            identify_gathered(described, [corrected, with_gain(loaded[1], low, high)], PLAIN)
    alike = [corrected, with_gain(loaded[1], 1.02, 1.04)]
    for files, gain in (([corrected], 1.05), (alike, 1.03)):
        model = identify_gathered(described, files, PLAIN).model
        assert model.gains[0] == pytest.approx(gain)
        ((name, value, std, *_),) = gain_rows(model)
        assert name == "gain.drive1"
        assert value == pytest.approx(gain)
        assert 1.96 * std == pytest.approx({1.05: 0.05, 1.03: 0.01}[gain], rel=1e-3)
        assert any("torque constant" in text and "known" in text for text in model.warnings)


def test_places_of_all_recordings_add_up(loaded: list[FactorFile]) -> None:
    together = merged_files(loaded, robot()[0].robot, PLAIN)
    parts = [together.merging.part(file) for file in loaded]
    apart = [part.rows(part.file.groups.named("place")) for part in parts]
    expected = sum((A.swapaxes(2, 3) @ A).sum(axis=0) for A in apart)
    found = together.gathered.places.sum(axis=0)
    size = np.sqrt(np.einsum("iaa,ibb->iab", expected, expected))
    assert np.max(np.abs(found - expected)[size > 0] / size[size > 0]) < 1e-6  # seven digits
    assert len(together.gathered.parts) == 3
    assert all(20 < len(part) <= 26 for part in together.gathered.parts)


def test_a_load_is_compared_as_the_model_knows_it(loaded: list[FactorFile]) -> None:
    model = identify_gathered(robot()[0].robot, loaded[:1], PLAIN).model
    found = validate_gathered(model, loaded[1])
    expected = validate(model, table(2, "cycles"), columns=GRIPPER).error
    np.testing.assert_allclose(found.rms, expected.rms, rtol=0.05)
    (held,) = model.loads
    mass = held.parameters[0].changed(value=held.p[0] + 0.5)
    heavier = held.changed(parameters=(mass, *held.parameters[1:]))
    worse = validate_gathered(model.changed(loads=(heavier,)), loaded[1])
    assert np.all(worse.rms[:3] > 1.5 * found.rms[:3])
    with pytest.raises(RecordingError, match="holds load load, which is not one of the model's"):
        validate_gathered(model.changed(loads=()), loaded[1])
