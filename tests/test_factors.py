"""Factors of recordings in the place of recordings: columns, files, merging, fits."""

from dataclasses import replace
from itertools import permutations
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from command import accepted, json_of, refused, run
from deltaid.dynamics.dynamics import compiled
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.fleets import gather_folder
from deltaid.fleets.factor_columns import KNOTS, GatheredColumns, map_to, plain, splines
from deltaid.fleets.factor_file import FactorFile, read, write
from deltaid.fleets.gather import gathered
from deltaid.fleets.gather_folder import Gathering, gather_into
from deltaid.fleets.identify_gathered import identify_gathered, validate_gathered
from deltaid.identification.identify import identify
from deltaid.identification.prediction import validate
from deltaid.model.record import Settings
from deltaid.motion.surrogate import write_recording
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.load import load_robot
from drifting import recording
from support import along

ROBOT = "clavel-delta3"
# Factor files have rows as recorded.
SETTINGS = Settings(cutoff=15.0, effects="none")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three recordings of one robot whose friction differs from the described."""
    folder = tmp_path_factory.mktemp("logs")
    written = [folder / f"log{seed}.csv" for seed in range(3)]
    for seed, path in enumerate(written):
        write_recording(recording(seed, friction=1.4, duration=4.0), path)
    return written


@pytest.fixture(scope="module")
def files(logs: list[Path]) -> list[FactorFile]:
    return [gathered(ROBOT, log, settings=SETTINGS) for log in logs]


@pytest.fixture(scope="module")
def known(
    logs: list[Path], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[Gathering]]:
    """A folder of factor files, and what became of the two recordings, one of which is none."""
    place = tmp_path_factory.mktemp("known")
    wrong = place / "wrong.csv"
    wrong.write_text("a,b\n1,2\n", encoding="utf-8")
    return place, list(gather_into(place, load_robot(ROBOT), [wrong, logs[0]], settings=SETTINGS))


@pytest.mark.parametrize("name", [ROBOT, "irb360-6-1600", "linear-delta", "par4", "h4"])
def test_rigid_bodies_and_plain_friction_are_exact_combinations(name: str) -> None:
    robot = load_robot(name)
    assert _apart(robot) < 1e-9


@pytest.mark.parametrize(
    ("law", "within"),
    [
        ({"stribeck": {"coefficient": 0.3, "speed": 0.4, "exponent": 2.0}}, 0.02),
        ({"stribeck": {"coefficient": 0.3, "speed": 2.0}}, 0.02),
        ({"power": {"coefficient": 0.3, "exponent": 0.5}}, 0.02),
        ({"power": {"coefficient": 0.3, "exponent": 2.0}}, 0.01),
        ({"hess_soom": {"coefficient": 0.3, "speed": 0.5}}, 0.02),
        ({"viscous_back": 1.0, "coulomb_back": 2.0}, 1e-9),
        ({"offset": 0.3}, 1e-9),
    ],
)
def test_friction_of_any_law_is_a_combination(law: dict[str, object], within: float) -> None:
    robot = load_robot(ROBOT)
    joints = {joint: friction.changed(**law) for joint, friction in robot.friction.items()}
    assert _apart(robot.changed(friction=joints)) < within


def _apart(robot) -> float:
    """How far columns of a robot are from combinations of those that are gathered, as a share."""
    from deltaid.estimation.additions import extended

    dynamics, simple = compiled(robot), plain(robot)
    columns = GatheredColumns.for_robot(robot, prior_parameters(simple))
    z, _, qd, qdd = along(dynamics.kinematics, np.random.default_rng(3), 700)
    Y = dynamics.sparse_regressor(z, qd, qdd)
    own = columns.dynamics.sparse_regressor(z, qd, qdd).values
    from deltaid.recording.windows import SampleBlock

    none = np.zeros((len(z), 0))
    w = SampleBlock(np.arange(len(z)) * 1.0, z, qd, qdd, none, none, none, np.zeros_like(qd))
    G = np.vstack(
        [
            own,
            *(
                addition.entries(w, own, Mock(spec=PreparedRecording))
                for addition in columns.additions
            ),
        ]
    )
    rows, at = extended(columns.dynamics, columns.additions).regressor_pattern
    T, worst = map_to(columns, dynamics), 0.0
    for i in range(dynamics.dof):
        wide = np.zeros((len(columns.names), len(z)))
        np.add.at(wide, at[rows == i], G[rows == i])
        expected = np.zeros((len(dynamics.layout.names), len(z)))
        expected[Y.columns[Y.rows == i]] = Y.values[Y.rows == i]
        left = T.T @ wide[columns.stored] - expected
        size = np.linalg.norm(expected, axis=1)
        worst = max(worst, float(np.max(np.linalg.norm(left, axis=1)[size > 0] / size[size > 0])))
    return worst


def test_splines_add_up() -> None:
    v = np.abs(np.random.default_rng(0).standard_normal(500)) * 3.0
    found = splines(v, 2.0)
    np.testing.assert_allclose(found.sum(axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose(2.0 * np.array(KNOTS) @ found, v, atol=1e-12)


def test_a_fit_from_factors_is_that_from_recordings(logs: list[Path], files) -> None:
    """With the described friction; else recordings count a constant that it may lack."""
    expected = identify(ROBOT, logs, settings=SETTINGS.changed(friction="described")).model
    found = identify_gathered(ROBOT, files, SETTINGS).model
    assert found.fit.base_parameters == expected.fit.base_parameters
    np.testing.assert_allclose(found.fit.noise_level, expected.fit.noise_level, rtol=0.02)
    np.testing.assert_allclose(found.fit.rms, expected.fit.rms, rtol=0.02)
    np.testing.assert_allclose(found.fit.rms_unfiltered, expected.fit.rms_unfiltered, rtol=0.02)
    own = {parameter.name: parameter for parameter in found.parameters}
    for parameter in expected.parameters:
        if parameter.determined_by == "data":
            same = own[parameter.name]
            assert same.determined_by == "data"
            assert abs(same.value - parameter.value) < 0.35 * parameter.std, parameter.name
            assert 0.6 < same.std / parameter.std < 1.7, parameter.name


def test_order_changes_no_bit(files) -> None:
    found = [identify_gathered(ROBOT, order, SETTINGS).model for order in permutations(files)]
    assert all(group.parameters == found[0].parameters for group in found[1:])


def test_a_file_is_small_and_keeps_what_it_is_given(files, tmp_path: Path) -> None:
    path = tmp_path / "a.factors.parquet"
    write(files[0], path)
    again = read(path)
    assert path.stat().st_size < 1e6
    assert again.record == files[0].record
    for a, b in zip(files[0].whole.factors, again.whole.factors, strict=True):
        np.testing.assert_array_equal(a, b[: len(a)])
    kept = identify_gathered(ROBOT, [again], SETTINGS).model
    for a, b in zip(
        identify_gathered(ROBOT, files[:1], SETTINGS).model.parameters, kept.parameters, strict=True
    ):
        assert (a.value, a.std) == pytest.approx((b.value, b.std), rel=1e-2, abs=1e-9)


def test_what_cannot_be_merged_is_named(files, logs: list[Path]) -> None:
    robot = load_robot(ROBOT)
    longer = robot.changed(limbs=robot.limbs.changed(upper_arm=robot.limbs.upper_arm + 1e-3))
    with pytest.raises(RecordingError, match=r"limbs\.upper_arm 0\.\d+, and the robot has 0\."):
        identify_gathered(longer, files)
    with pytest.raises(RecordingError, match="the same recording as"):
        identify_gathered(ROBOT, [files[0], files[0]])
    sources = (files[0].record.model.sources[0].changed(sha256="of an export with a comment"),)
    again = files[0].record.changed(model=files[0].record.model.changed(sources=sources))
    with pytest.raises(RecordingError, match="the same recording as"):
        identify_gathered(ROBOT, [files[0], replace(files[0], record=again)])
    other = gathered(ROBOT, logs[1], settings=Settings(cutoff=22.0))
    with pytest.raises(RecordingError, match=r"filtered at 22 Hz, .* at 15 Hz"):
        identify_gathered(ROBOT, [files[0], other])


def test_priors_may_change_after_gathering(files) -> None:
    robot = load_robot(ROBOT)
    heavy = robot.bodies["S"].changed(spread=0.01)
    found = identify_gathered(robot.changed(bodies=robot.bodies | {"S": heavy}), files, SETTINGS)
    assert found.model.value("S.m") == pytest.approx(
        robot.bodies["S"].prior_parameters()[0], rel=0.05
    )


def test_what_is_no_recording_is_refused_and_the_rest_gathered(known) -> None:
    _, found = known
    assert [outcome.state for outcome in found] == ["refused", "new"]
    assert "no column t" in str(found[0].error)


def test_a_recording_is_gathered_once(logs: list[Path], known, monkeypatch) -> None:
    place, (_, first) = known
    monkeypatch.setattr(gather_folder, "gathered", lambda *_, **__: pytest.fail("was read again"))
    (again,) = gather_into(place, load_robot(ROBOT), logs[:1], settings=SETTINGS)
    assert again.state == "there"
    assert again.path == first.path


def test_a_damaged_file_is_made_again(logs: list[Path], known, tmp_path: Path) -> None:
    whole = known[1][1].path.read_bytes()
    damaged = tmp_path / known[1][1].path.name
    damaged.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordingError, match="has no checksum"):
        read(damaged)
    (again,) = gather_into(tmp_path, load_robot(ROBOT), logs[:1], settings=SETTINGS)
    assert (again.state, again.path) == ("new", damaged)
    assert damaged.read_bytes() == whole


def test_the_command_takes_a_folder_of_factor_files(logs: list[Path], tmp_path: Path) -> None:
    done = accepted("gather", ROBOT, *logs[:2], "--cutoff", 15, "-o", tmp_path / "factors")
    assert "2 gathered, 0 there already, 0 refused" in done.out
    files = sorted((tmp_path / "factors").iterdir())
    whole = json_of("identify", ROBOT, tmp_path / "factors", "--verify", logs[2])
    assert json_of("identify", ROBOT, *files)["parameters"] == whole["parameters"]
    assert max(whole["verify"]["nrmse"]) < 0.01
    for option, words in (
        (("--lag", "none"), "--lag: was decided as the recordings were gathered"),
        (("--report", tmp_path / "a.html"), "--report: needs samples"),
    ):
        command = ("identify", ROBOT, tmp_path / "factors", *option)
        assert words in refused(*command, folder=tmp_path)
    mixed = refused("identify", ROBOT, files[0], logs[2], folder=tmp_path)
    assert "is a recording, and others are factor files" in mixed
    assert "is a folder, not a file" in refused("identify", ROBOT, tmp_path, folder=tmp_path)


def test_a_model_is_compared_with_a_recording_by_its_factors(logs, files, tmp_path: Path) -> None:
    model = identify_gathered(ROBOT, files[:2], SETTINGS).model
    expected, _ = validate(model, logs[2])
    found = validate_gathered(model, files[2])
    np.testing.assert_allclose(found.rms, expected.rms, rtol=0.05)
    np.testing.assert_allclose(found.nrmse, expected.nrmse, rtol=0.05)
    np.testing.assert_allclose(found.rms_unfiltered, expected.rms_unfiltered, rtol=0.05)
    saved, file = tmp_path / "model.yaml", tmp_path / "log.factors.parquet"
    model.save(saved)
    write(files[2], file)
    assert json_of("validate", saved, file)["rms"] == found.rms.tolist()
    own = tmp_path / "own.factors.parquet"
    write(files[0], own)
    assert "so it verifies nothing" in run("validate", saved, own).err
    page = refused("validate", saved, file, "--report", tmp_path / "a.html", folder=tmp_path)
    assert "--report: needs samples" in page
    again = json_of("identify", ROBOT, logs[0], "--cutoff", 15, "--verify", file)
    assert max(again["verify"]["nrmse"]) < 0.01


@pytest.mark.parametrize(
    "law",
    [
        {"load": 0.08},
        pytest.param({"stribeck": {"coefficient": 2.0, "speed": 0.5}}, marks=pytest.mark.slow),
        pytest.param({"viscous_back": 2.5, "coulomb_back": 7.0}, marks=pytest.mark.slow),
    ],
)
def test_laws_that_a_recording_asks_for_are_those_of_its_factors(law) -> None:
    robot = load_robot(ROBOT)
    joints = {joint: friction.changed(**law) for joint, friction in robot.friction.items()}
    log = recording(5, robot.changed(friction=joints), duration=8.0, rate=1000.0)
    file = gathered(robot, log, settings=SETTINGS)
    expected, own = file.record.model, identify_gathered(robot, [file], SETTINGS).model
    assert own.robot.friction == expected.robot.friction
    np.testing.assert_allclose(own.fit.rms, expected.fit.rms, rtol=0.1)
    kinematics = compiled(robot).kinematics
    q = kinematics.inverse(kinematics.home)
    M = [compiled(model.robot).mass_matrix(q, model.p) for model in (expected, own)]
    np.testing.assert_allclose(M[1], M[0], atol=0.01 * np.abs(M[0]).max())
