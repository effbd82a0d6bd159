"""Nights of a robot: recordings merged in blocks, of which a night makes what is new.

Numbers are those of all factor files, to the bit, whichever blocks there are.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import timedelta
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from deltaid.errors import RecordingError
from deltaid.estimation.problem import KNOWN, LinearProblem, Span, scatter
from deltaid.fleets import block, factor_file, place, robot_recordings, steps, store
from deltaid.fleets.block import RecordingBlock, block_bytes, block_of, halved
from deltaid.fleets.drift_findings import DriftSettings
from deltaid.fleets.drift_friction import friction_series, unknowns_of
from deltaid.fleets.factor_file import ENDING, FactorFile, digest, write
from deltaid.fleets.factor_record import GatheredLoad
from deltaid.fleets.fleet import ALL, Recorded
from deltaid.fleets.gather_plan import GatherResult
from deltaid.fleets.identify_gathered import identify_gathered
from deltaid.fleets.merged import merging_of
from deltaid.fleets.place import Place, Tables
from deltaid.fleets.robot_recordings import RobotRecordings
from deltaid.fleets.step import FleetJob, work_chain
from deltaid.fleets.steps import fit_jobs, robot_chains
from deltaid.model.record import IdentifiedModel
from deltaid.recording.carried import Load
from deltaid.robot.friction import Stribeck
from deltaid.robot.load import load_robot
from drifting import ROBOT, SETTINGS, START, days, one_recording

COUNT = 24


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[FactorFile]:
    """A robot day by day, whose second drive wears."""
    folder, own = tmp_path_factory.mktemp("log"), list[FactorFile]()
    for seed in range(3):
        recordings = days(
            one_recording(folder, seed), COUNT // 3, lambda day: [0.0, 0.02 * day, 0.0],
            every=3, first=seed,
        )  # fmt: skip
        own += [recording.file for recording in recordings]
    return sorted(own, key=lambda file: file.record.log)


@pytest.fixture(scope="module")
def written(files: list[FactorFile], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The fleet's folder with all factor files."""
    folder = tmp_path_factory.mktemp("fleet")
    (folder / "factors/r").mkdir(parents=True)
    for k, file in enumerate(files):
        write(file, folder / f"factors/r/{k:02d}{ENDING}")
    return folder


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    """A folder with the same factor files and nothing else."""
    (tmp_path / "factors").symlink_to(written / "factors")
    return tmp_path


@pytest.fixture
def reads(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the factor files that are read."""
    names = list[str]()

    def counted(path: Path) -> FactorFile:
        names.append(path.name[:2])
        return factor_file.read(path)

    monkeypatch.setattr(place, "read", counted)
    return names


def outcomes(files: list[FactorFile], numbers: list[int]) -> list[GatherResult]:
    """Some recordings as a call has gathered them."""
    return [
        GatherResult(
            Recorded("r", START + timedelta(days=k), files[k].record.log, ROBOT, stamp="1"),
            str(k),
            f"factors/r/{k:02d}{ENDING}",
            sha256=files[k].record.sha256,
        )
        for k in numbers
    ]


def job_of(files: list[FactorFile], numbers: list[int]) -> FleetJob:
    """The job of all of these."""
    jobs = fit_jobs(outcomes(files, numbers), "week", {ROBOT: load_robot(ROBOT)}, SETTINGS)
    return next(job for job in jobs if ALL in job.names)


@pytest.fixture
def merged(files: list[FactorFile], folder: Path) -> Callable[..., RobotRecordings]:
    """Some recordings merged, with the blocks that earlier ones have left."""

    def recordings(numbers: list[int]) -> RobotRecordings:
        return robot_recordings.merged_recordings(job_of(files, numbers), Place.named(folder))

    return recordings


def same(first: RobotRecordings, second: RobotRecordings) -> bool:
    """Whether all numbers and words are the same to the bit."""
    return block_bytes(first.block) == block_bytes(second.block)


EVERY = list(range(COUNT))


@pytest.fixture
def fresh(
    files: list[FactorFile], written: Path, tmp_path_factory
) -> Callable[..., RobotRecordings]:
    """Some recordings merged where there are no blocks."""

    def recordings(numbers: list[int]) -> RobotRecordings:
        empty = tmp_path_factory.mktemp("empty")
        (empty / "factors").symlink_to(written / "factors")
        return robot_recordings.merged_recordings(job_of(files, numbers), Place.named(empty))

    return recordings


def test_a_night_reads_only_what_is_new(merged, fresh, reads: list[str]) -> None:
    merged(EVERY[:14])
    assert len(reads) == 14
    for day in range(14, COUNT):
        reads.clear()
        found = merged(EVERY[: day + 1])
        assert reads == [f"{day:02d}"]
    assert same(found, fresh(EVERY))


def test_small_blocks_are_kept_only_as_long_as_nights_need_them(merged, folder: Path) -> None:
    for day in range(12, COUNT):
        merged(EVERY[: day + 1])
    sizes = [len(block_of(path.read_bytes()).keys) for path in (folder / "merged/r/all").iterdir()]
    assert sum(size < 8 for size in sizes) <= 4
    assert sum(size >= 8 for size in sizes) >= 2


def test_a_recording_that_is_excluded_changes_the_halves_that_it_was_in(
    merged, fresh, reads: list[str]
) -> None:
    merged(EVERY)
    reads.clear()
    rest = [k for k in EVERY if k != 5]
    found = merged(rest)
    assert len(reads) <= 2 * 8 - 3  # two halves of less than eight, without it
    assert same(found, fresh(rest))
    assert same(merged(EVERY), fresh(EVERY))  # it comes back


@pytest.mark.parametrize("harm", ["removed", "cut", "other"])
def test_a_block_that_cannot_be_used_is_made_again(
    merged, fresh, folder: Path, reads: list[str], harm: str
) -> None:
    merged(EVERY[:-1])
    path = max((folder / "merged/r/all").iterdir(), key=lambda path: path.stat().st_size)
    whole = path.read_bytes()
    if harm == "removed":
        path.unlink()
    else:
        own = replace(block_of(whole), fingerprint="of another law")
        path.write_bytes(whole[:-9] if harm == "cut" else block_bytes(own))
    reads.clear()
    found = merged(EVERY)
    assert len(reads) > 1
    assert same(found, fresh(EVERY))
    assert path.read_bytes() == whole


def test_a_night_that_is_killed_is_done_again(
    merged, fresh, monkeypatch: pytest.MonkeyPatch, folder: Path
) -> None:
    written, kept = list[str](), store.write

    def dying(path: str, data: bytes) -> None:
        if len(written) == 2:
            raise KeyboardInterrupt
        written.append(path)
        kept(path, data)

    with monkeypatch.context() as patch:
        patch.setattr(store, "write", dying)
        with pytest.raises(KeyboardInterrupt):
            merged(EVERY)
    assert len(list((folder / "merged/r/all").iterdir())) == 2
    assert same(merged(EVERY), fresh(EVERY))


def test_calls_at_the_same_time_do_not_harm_each_other(merged, fresh) -> None:
    """They read, write and remove blocks of the same robot, of other recordings."""
    without = [k for k in EVERY if k != 5]
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(merged, [EVERY[:-1], without, EVERY, without]))
    assert same(found[1], fresh(without))
    assert same(found[2], fresh(EVERY))
    assert same(found[3], found[1])


def test_blocks_of_a_long_period_are_beside_those_of_all(
    files: list[FactorFile], folder: Path, reads: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robot_recordings, "FEW", 2)
    robots = {ROBOT: load_robot(ROBOT)}
    for day in range(14, 18):  # within one week
        reads.clear()
        *_, week, every = fit_jobs(outcomes(files, EVERY[: day + 1]), "week", robots, SETTINGS)
        for job in (week, every):
            robot_recordings.merged_recordings(job, Place.named(folder))
        if day > 14:
            assert reads == [f"{day:02d}"] * 2


def test_numbers_are_those_of_all_factor_files(merged, files: list[FactorFile]) -> None:
    """In another order of merging."""
    for day in range(14, COUNT):
        found = merged(EVERY[: day + 1])
    problem = identify_gathered(ROBOT, files, SETTINGS).problem
    information = found.gathered.information
    p = problem.values
    np.testing.assert_allclose(information.rms(p), problem.information.rms(p), rtol=1e-9)
    R, expected = (x.weighted() for x in (information, problem.information))
    norms = np.linalg.norm(expected, axis=0)
    difference = (R.T @ R - expected.T @ expected) / np.outer(norms, norms)
    assert np.max(np.abs(difference[np.isfinite(difference)])) < 1e-12
    products, together = found.gathered.places, problem.gathered.places
    np.testing.assert_allclose(products, together, rtol=1e-6, atol=1e-6 * together.max())
    assert len(found.gathered.parts) == COUNT
    wholes = [file.whole for file in files]
    np.testing.assert_allclose(information.samples, sum(whole.samples[0] for whole in wholes))
    largest = np.max([whole.torque_max[0] for whole in wholes], axis=0)
    np.testing.assert_array_equal(information.torque_max, largest)


def test_tables_do_not_depend_on_the_nights(files: list[FactorFile], folder: Path, written) -> None:
    def tables(root: Path, numbers: list[int]) -> Tables:
        own = outcomes(files, numbers)
        jobs = fit_jobs(own, "week", {ROBOT: load_robot(ROBOT)}, SETTINGS)
        chains = robot_chains(jobs, DriftSettings())
        (chain,) = (chain for chain in chains if ALL in chain[0].names)
        results = work_chain(chain, Place.named(root))
        assert not any(result.reason for result in results)
        return {name: table for result in results for name, table in result.tables.items()}

    before = tables(folder, EVERY[:15])
    found = tables(folder, EVERY)
    (folder / "empty").mkdir()
    (folder / "empty/factors").symlink_to(written / "factors")
    expected = tables(folder / "empty", EVERY)
    assert all(found[name].equals(expected[name]) for name in expected)
    assert before["friction"].height * COUNT == found["friction"].height * 15


def test_there_are_never_more_groups_than_intervals_need(
    merged, monkeypatch: pytest.MonkeyPatch
) -> None:
    fine = merged(EVERY).gathered
    monkeypatch.setattr(block, "MOST_GROUPS", 8)
    monkeypatch.setattr(steps, "BLOCKS", "coarse")
    found = merged(EVERY)
    assert sum(found.block.counts) == COUNT
    assert 6 <= len(found.block.counts) <= 16
    assert max(found.block.counts) == 4
    for name in ("time", "place"):
        sums = (
            x.weighted(fine.information.weights)[name].sum(axis=0) for x in (found.gathered, fine)
        )
        first, second = sums
        np.testing.assert_allclose(first, second, rtol=1e-5, atol=1e-5 * second.max())


def test_a_copy_of_a_recording_is_refused(merged, files: list[FactorFile], folder: Path) -> None:
    own = outcomes(files, EVERY)
    copy = replace(own[3], recorded=replace(own[3].recorded, path="copy.csv"))
    jobs = fit_jobs([*own, copy], "week", {ROBOT: load_robot(ROBOT)}, SETTINGS)
    job = next(job for job in jobs if ALL in job.names)
    with pytest.raises(RecordingError, match="is of the same recording as"):
        robot_recordings.merged_recordings(job, Place.named(folder))


def test_halves_do_not_depend_on_other_keys() -> None:
    keys = [3, 4, 5, 8, 9, 13, 40, 41]
    assert [halved(keys), halved(keys[:6]), halved(keys[:3])] == [6, 3, 1]
    for start, end in ((0, 6), (0, 3), (3, 6)):
        inside = keys[start:end]
        assert all(k < m for k, m in pairwise(inside))
        assert 0 < halved(inside) < len(inside)


def test_rows_that_depend_on_other_constants_or_loads_have_another_fingerprint(
    files: list[FactorFile],
) -> None:
    robot, fingerprints = load_robot(ROBOT), set[str]()
    for speed in (0.1, 0.2):
        law = robot.friction["drive1"].changed(stribeck=Stribeck(coefficient=0.1, speed=speed))
        other = robot.changed(friction=dict(robot.friction) | {"drive1": law})
        fingerprints.add(merging_of([files[0].brief], other, SETTINGS).fingerprint)
    for taken in (0.0, 0.1):
        load = GatheredLoad(load=Load(always=True, mass=0.5), taken=(taken, *[0.0] * 9))
        brief = files[0].brief.changed(loads=(load,))
        fingerprints.add(merging_of([brief], robot, SETTINGS).fingerprint)
    assert len(fingerprints) == 4


def test_quantities_of_tolerances_keep_their_torques(
    merged: Callable[..., RobotRecordings],
) -> None:
    found = merged(EVERY[:2]).block
    assert found.geometry is not None
    names = ("another", *reversed(found.quantities))
    for R, wide in zip(found.geometry.factors, found.over(names).factors, strict=True):
        own, count = R.shape[2] - 1 - len(found.quantities), len(names)
        back = wide[0][:, [*range(own), *reversed(range(own + 1, own + count)), own + count]]
        np.testing.assert_allclose(back.T @ back, R[0].T @ R[0], rtol=1e-4, atol=1e-4)
        assert not wide[0][:, own].any()


def test_a_single_stretch_does_not_determine_its_noise(files: list[FactorFile]) -> None:
    model, groups = identify_gathered(ROBOT, files[:2], SETTINGS).model, files[0].groups
    own = replace(files[0], groups=groups.named("time 3").joined(groups.named("place")))
    series = friction_series([own, files[1]], model)
    assert np.isnan(series.std[:, 0]).all()
    assert np.isfinite(series.std[:, 1]).all()


def test_a_block_of_a_file_is_the_same(merged) -> None:
    found = merged(EVERY[:12]).block
    again = block_of(block_bytes(found))
    assert isinstance(again, RecordingBlock)
    assert block_bytes(again) == block_bytes(found)
    assert again.briefs == found.briefs
    assert block_of(None) is None
    assert block_of(block_bytes(found)[:-1]) is None


def test_a_model_of_two_years_of_recordings_is_read(
    files: list[FactorFile], tmp_path: Path
) -> None:
    model = identify_gathered(ROBOT, files[:2], SETTINGS).model
    source = model.sources[0]
    sources = tuple(source.changed(sha256=digest(k)) for k in range(730))
    own = model.changed(sources=sources)
    own.save(tmp_path / "model.yaml")
    assert IdentifiedModel.load(tmp_path / "model.yaml") == own


def test_friction_of_a_recording_is_that_of_its_rows(files: list[FactorFile]) -> None:
    """By least squares of all stretches with the bodies of the model held; the noise is that of the
    recording by itself."""
    model = identify_gathered(ROBOT, files[:6], SETTINGS).model
    series = friction_series(files, model)
    merging = merging_of([file.brief for file in files], model.robot, model.settings)
    unknowns = unknowns_of(merging)
    carrier = model.value("P.m") if "P.m" in merging.dynamics.layout.names else 0.0
    assert carrier > 0
    for n in (0, 9, 20):
        file, part = files[n], merging.part(files[n])
        fixed = model.p[merging.active].copy()
        fixed[unknowns.at[~unknowns.is_carrier]] = 0.0
        F = np.stack([stretch.factors for stretch in part.stretches])
        F /= np.array(file.record.noise)[:, None, None]
        visible = (unknowns.drives == np.arange(3)[:, None]) | (unknowns.drives < 0)
        A = (F[..., unknowns.at] * visible[:, None, :]).reshape(-1, len(unknowns.at))
        b = (F[..., -1] - F[..., :-1] @ fixed).ravel()
        groups = np.repeat(np.arange(len(F)), len(b) // len(F))
        values = float(sum(stretch.samples.sum() for stretch in part.stretches))
        own = 0.3 * carrier + 1e-3
        arms = {"held.m": 1.0, "held.mcx": 0.03, "held.mcy": 0.03, "held.Izz": 0.03**2}
        held = [k for k, name in enumerate(unknowns.names) if name in arms]
        D = np.zeros((len(held), len(unknowns.at)))
        D[range(len(held)), held] = [1.0 / (own * arms[unknowns.names[k]]) for k in held]
        problem = LinearProblem(A, b, groups, values=values).with_known(D, np.zeros(len(held)))
        std = np.sqrt(np.diag(problem.covariance()))
        np.testing.assert_allclose(series.values[n], problem.x, atol=1e-4 * std.min(), rtol=1e-5)
        every = F.reshape(-1, F.shape[-1])
        alone = Span.of_columns(every[:, :-1])
        e = alone.without(every[:, -1])
        influence = problem.span.Q @ problem.inverse.T
        rows, prior = problem.groups != KNOWN, influence[problem.groups == KNOWN]
        noise = scatter(influence[rows], e, groups, values - alone.rank)
        found, expected = series.covariance[n], noise + prior.T @ prior
        size = np.sqrt(np.diag(expected))
        assert np.max(np.abs(found - expected) / np.outer(size, size)) < 1e-4
        np.testing.assert_allclose(np.sqrt(np.diag(found)) / std, 1.0, atol=0.25)
        H = part.information.factors[:, :, unknowns.at] * visible[:, None, :]
        count = part.information.samples
        products = np.einsum("inu,inv,i->uv", H, H, 1.0 / count)
        is_friction = unknowns.drives >= 0
        same_drive = unknowns.drives[:, None] == unknowns.drives
        np.testing.assert_allclose(
            series.products[n], np.where(same_drive & is_friction, products, 0.0), rtol=1e-9,
            atol=1e-12,
        )  # fmt: skip
