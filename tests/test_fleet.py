"""A fleet, on this machine and on a cluster: what is done is not done again, and what is bad or
fails stops nothing else, loses nothing and doubles nothing.

Store, scheduler and workers are processes of their own in what takes long.
"""

import os
import shutil
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from random import Random
from time import monotonic, sleep
from unittest.mock import Mock

import polars as pl
import psutil
import pytest
import s3fs

from command import accepted, json_of
from damage import changed_bit
from deltaid import libraries
from deltaid.errors import DeltaidError
from deltaid.fleets.factor_file import FactorFile, read
from deltaid.fleets.fleet import find_fleet
from deltaid.fleets.gather_all import RECORDINGS_SCHEMA, recordings_table
from deltaid.fleets.place import Place
from deltaid.fleets.run import fleet as run_fleet
from deltaid.fleets.step import Chain, work
from deltaid.fleets.workers import Workers, open_workers, require_shared
from deltaid.model.record import IdentifiedModel
from deltaid.robot.load import load_robot
from plant import DAYS, SETTINGS, Plant, manifest, no_workers, plant, recordings
from stores import KEYS, dask_cluster, s3_server, unreliable

FIRST = [f"north/{day}" for day in DAYS[:2]]


def cut_short(whole: Plant) -> bytes:
    """A recording whose end has been lost."""
    return whole.path("south/2026-01-05").read_bytes()[:-900]


# Another filter than that of what was gathered.
OTHER = SETTINGS.changed(cutoff=20.0)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Plant:
    """All recordings, in one call, beside one that is none."""
    found = plant(tmp_path_factory.mktemp("whole")).record(*recordings())
    found.path("south/2026-01-09").write_bytes(cut_short(found))
    with no_workers():
        found.run()
    return found


@pytest.mark.slow
def test_a_robot_and_a_period_are_rows_of_one_table(whole: Plant) -> None:
    table = whole.table()
    assert table.select("robot", "period", "recordings").unique(maintain_order=True).rows() == [
        ("north", "2026-W02", 2),
        ("north", "2026-W03", 1),
        ("north", "all", 3),
        ("south", "2026-W02", 1),
        ("south", "all", 1),
    ]
    mass = table.filter(pl.col("parameter") == "coulomb.drive1", pl.col("period") == "all")
    assert mass["decided_by"].to_list() == ["data", "data"]
    assert mass["value"][1] / mass["value"][0] == pytest.approx(1.2, abs=0.02)
    assert ((table["low"] <= table["value"]) & (table["value"] <= table["high"])).all()


def test_what_is_no_recording_is_reported_and_stops_nothing(whole: Plant) -> None:
    refused = pl.read_csv(whole.output / "quarantine.csv")
    assert refused.select("what", "robot").rows() == [("recording", "south")]
    assert "south/2026-01-09.parquet" in refused["which"][0]
    assert "is no Parquet file" in refused["reason"][0]
    failures = whole.table("recordings.parquet").filter(pl.col("reason") != "")
    assert failures["path"].to_list() == refused["which"].to_list()


def test_nothing_is_done_again(whole: Plant, monkeypatch: pytest.MonkeyPatch) -> None:
    before = (whole.output / "parameters.parquet").read_bytes()
    monkeypatch.setattr("deltaid.fleets.run.open_workers", lambda *_: pytest.fail("were started"))
    run = whole.run()
    assert run.computed == (0, 0, 0)
    assert repr(run).startswith(
        "Fleet\n2 robots, 4 recordings (0 processed now), 4 fits (0 made now).\n1 in quarantine\n"
        "recording of south: "
    )
    assert run.to_frame().height == 5
    assert (whole.output / "parameters.parquet").read_bytes() == before


def without_results(whole: Plant, folder: Path) -> Path:
    """The fleet's folder as a call leaves it that was ended once recordings were gathered."""
    shutil.copytree(whole.output, folder)
    for name in ("parameters", "friction", "drift", "types", "members"):
        (folder / f"{name}.parquet").unlink()
    shutil.rmtree(folder / "members")
    return folder


def test_a_night_reads_each_factor_file_once_for_its_week_and_once_for_all_and_no_model(
    whole: Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reads, folder = Counter[str](), without_results(whole, tmp_path / "own")

    def counted(path: Path) -> FactorFile:
        reads[f"{path.parent.name}/{path.name[:10]}"] += 1
        return read(path)

    monkeypatch.setattr("deltaid.fleets.place.read", counted)
    monkeypatch.setattr(IdentifiedModel, "load", lambda *_: pytest.fail("a model was read"))
    with no_workers():
        assert run_fleet(whole.manifest, folder, settings=SETTINGS).computed == (0, 4, 2)
    assert reads == {**{f"north/{day}": 2 for day in DAYS}, f"south/{DAYS[0]}": 1}
    for name in ("parameters", "drift", "members"):
        assert (
            pl.read_parquet(folder / f"{name}.parquet")
            .drop("key")
            .equals(whole.table(f"{name}.parquet"))
        )


def test_what_a_worker_has_done_before_it_dies_counts(
    whole: Plant, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = without_results(whole, tmp_path / "own")

    def dying(_: object, chains: list[Chain], failed: Callable[[Chain, str], object]) -> list:
        """North is fitted by all of its recordings, and nothing else is done."""
        for job in (chain[0] for chain in chains if len(chain) > 1):
            if job.robot == "north":
                work(job, Place.named(folder))
        return [failed(chain, "died") for chain in chains]

    here = Mock(spec=Workers, done=dying)
    monkeypatch.setattr("deltaid.fleets.run.open_workers", lambda *_: nullcontext(here))
    done = run_fleet(whole.manifest, folder, settings=SETTINGS)
    assert [(fit.job.robot, fit.job.names[-1]) for fit in done.fits if not fit.reason] == [
        ("north", "all")
    ]
    assert [(study.job.robot, study.reason) for study in done.studies] == [("north", "died")]
    assert not done.types
    with no_workers():
        again = run_fleet(whole.manifest, folder, settings=SETTINGS)
    assert again.computed == (0, 3, 2)
    assert [line.what for line in again.quarantine] == ["recording"]
    for name in ("friction.parquet", "drift.parquet"):  # by a model that was saved and is read
        found = pl.read_parquet(folder / name)
        assert found.drop("key").equals(whole.table(name))


def test_the_command_tells_what_it_has_done(whole: Plant) -> None:
    path = whole.folder / "next.yaml"
    words = ("--cutoff", 15, "--friction", "described", "--prior-out", path)
    report = json_of("fleet", whole.manifest, "-o", whole.output, *words)
    assert {key: report[key] for key in ("robots", "used", "gathered", "fits", "fitted")} == {
        "robots": 2, "used": 4, "gathered": 0, "fits": 4, "fitted": 0,
    }  # fmt: skip
    assert [line["which"] for line in report["quarantine"]] == [str(whole.path("south/2026-01-09"))]
    assert Path(report["site"]).is_file()
    assert "mean of 2 robots" in load_robot(path).sources["friction"]


def test_without_dask_no_cluster_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(libraries, "find_spec", lambda name: None)
    with pytest.raises(DeltaidError) as caught, open_workers("tcp://127.0.0.1:1"):
        pass
    assert "needs Dask, which is not installed" in str(caught.value)
    assert "fleet]" in str(caught.value)


@pytest.mark.slow
def test_days_that_come_later_give_the_same_bits(whole: Plant, tmp_path: Path) -> None:
    """Meanwhile a factor file is cut short, a recording is thrown away, another one copied."""
    here = plant(tmp_path / "own", robots=("north",)).record(*FIRST)
    with no_workers():
        assert here.run().computed == (2, 1, 1)
    here.record(f"north/{DAYS[2]}").path(FIRST[1]).unlink()
    shutil.copy(here.path(FIRST[0]), here.path("north/2026-01-08"))
    cut = next((here.output / "factors" / "north").glob("2026-01-05*"))
    cut.write_bytes(cut.read_bytes()[:-500])
    with no_workers():
        second = here.run()
    assert second.computed == (3, 3, 1)
    assert [line.which for line in second.quarantine] == [str(here.path("north/2026-01-08"))]
    assert "is a copy of" in second.quarantine[0].reason
    assert here.table().equals(whole.table().filter(pl.col("robot") == "north"))
    gone = here.table("recordings.parquet").filter(~pl.col("there"))
    assert gone["path"].to_list() == [str(here.path(FIRST[1]))]


def test_nothing_that_was_gathered_is_lost(tmp_path: Path) -> None:
    """Neither where recordings are away, whatever mapping they have, nor with other options."""
    here = plant(tmp_path / "own", robots=("north",)).record(*FIRST)
    columns = here.folder / "columns.yaml"
    columns.write_text("time: {column: t, unit: s}\n", encoding="utf-8")
    text = here.manifest.read_text(encoding="utf-8")
    here.manifest.write_text(f"{text.rstrip()}\n    columns: columns.yaml\n", encoding="utf-8")
    with no_workers():
        here.run()
        rows = here.table("recordings.parquet")
        assert rows["there"].all()
        away = here.folder / "away"
        here.path(FIRST[0]).parent.rename(away)
        here.run()
        kept = here.table("recordings.parquet")
        assert kept.drop("there").equals(rows.drop("there"))
        assert not kept["there"].any()
        assert here.table("before/recordings.parquet").equals(rows)
        unnamed = here.manifest.with_name("unnamed.yaml")
        unnamed.write_text(text.replace("north/*", "south/*"), encoding="utf-8")
        for manifest, settings in ((here.manifest, OTHER), (unnamed, SETTINGS)):
            with pytest.raises(DeltaidError, match=r"lose .* 2 recordings that (.|\n)*--drop"):
                run_fleet(manifest, here.output, settings=settings)
            assert here.table("recordings.parquet").equals(kept)
        factors = here.output / kept["file"][0]
        whole = factors.read_bytes()
        factors.write_bytes(changed_bit(whole, Random(1)))
        with pytest.raises(DeltaidError, match=r"1 recording that .* files are damaged"):
            run_fleet(here.manifest, here.output, settings=SETTINGS.changed(prior_spread=0.4))
        assert here.table("recordings.parquet").equals(kept)
        factors.write_bytes(whole)
        away.rename(here.path(FIRST[0]).parent)
        with pytest.raises(DeltaidError, match=r"2 recordings that are gathered otherwise"):
            run_fleet(here.manifest, here.output, settings=OTHER)
        run_fleet(here.manifest, here.output, settings=OTHER, regather=True)
        assert set(here.table("recordings.parquet")["how"]).isdisjoint(rows["how"])
        run_fleet(unnamed, here.output, settings=OTHER, drop_absent=True)
        assert here.table("recordings.parquet").is_empty()


def test_a_damaged_table_of_recordings_is_put_back_and_not_removed(tmp_path: Path) -> None:
    """Without it those that are away would be forgotten."""
    place = Place.named(tmp_path)
    place.save("recordings.parquet", recordings_table([]))
    path = tmp_path / "recordings.parquet"
    path.write_bytes(changed_bit(path.read_bytes(), Random(1)))
    with pytest.raises(DeltaidError, match=r"is damaged(.|\n)*before/recordings.parquet"):
        place.tables({"recordings": RECORDINGS_SCHEMA})


def test_a_robot_without_a_description_and_a_log_without_a_date_stop_nothing(whole: Plant) -> None:
    text = whole.manifest.read_text(encoding="utf-8")
    more = whole.folder / "more.yaml"
    (whole.folder / "x").mkdir()
    (whole.folder / "x" / "a.csv").touch()
    (whole.folder / "x" / "2026-01-01.csv").touch()
    more.write_text(
        text + "  - robot: x\n    type: x.yaml\n    recordings: x/*\n", encoding="utf-8"
    )
    copy = whole.folder / "copy"
    shutil.copytree(whole.output, copy, copy_function=os.link)
    done = accepted("fleet", more, "-o", copy, "--cutoff", 15, "--friction", "described", width=300)
    assert "x/a.csv: nothing says when it was made" in done.err
    assert "x.yaml: no such file" in done.err or "no robot file" in done.err


FLEET = "s3://plant/fleet"


@dataclass(frozen=True)
class Site:
    """A store with recordings, and a cluster that works on them."""

    files: s3fs.S3FileSystem
    scheduler: str

    def workers(self) -> list[psutil.Process]:
        """Processes that do the work."""
        nannies = [process for process in psutil.process_iter(["cmdline"])
                   if {"worker", self.scheduler} <= set(process.info["cmdline"] or ())]  # fmt: skip
        return [
            child for nanny in nannies for child in nanny.children(recursive=True)
            if "spawn_main" in " ".join(child.cmdline())
        ]  # fmt: skip


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Site]:
    for name, value in KEYS.items():
        monkeypatch.setenv(name, value)
    with s3_server(tmp_path) as address, unreliable(address) as before_it:
        monkeypatch.setenv("AWS_ENDPOINT_URL", before_it)
        environment = {"PYTHONPATH": os.pathsep.join(sys.path)}
        with dask_cluster(tmp_path, 2, environment) as scheduler:
            files = s3fs.S3FileSystem(endpoint_url=address, use_listings_cache=False)
            files.mkdir("plant")
            files.pipe_file("plant/fleet.yaml", manifest().encode())
            for name, frame in recordings().items():
                buffer = BytesIO()
                frame.write_parquet(buffer)
                files.pipe_file(f"plant/{name}.parquet", buffer.getvalue())
            yield Site(files, scheduler)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the store comes for Linux only")
def test_a_cluster_and_a_store_that_fail_give_the_same_bits(whole: Plant, site: Site) -> None:
    site.files.pipe_file("plant/south/2026-01-09.parquet", cut_short(whole))
    _killed_call(site)

    hurt = set[str]()

    def hurting(text: str) -> None:
        """A worker is killed in each stage."""
        stage = text.partition(" ")[0]
        if stage in ("gathered", "fitted") and stage not in hurt:
            hurt.add(stage)
            site.workers()[0].send_signal(signal.SIGKILL)

    fleet = find_fleet("s3://plant/fleet.yaml")
    run = run_fleet(fleet, FLEET, settings=SETTINGS, scheduler=site.scheduler, progress=hurting)
    assert hurt == {"gathered", "fitted"}
    assert [line.which for line in run.quarantine] == ["s3://plant/south/2026-01-09.parquet"]
    assert "is no Parquet file" in run.quarantine[0].reason
    assert "/tmp" not in run.quarantine[0].reason
    for name in ("parameters", "drift", "types", "members"):
        data = site.files.cat_file(f"plant/fleet/{name}.parquet")
        found = pl.read_parquet(BytesIO(data)).drop("key")
        assert found.equals(whole.table(f"{name}.parquet")), name
    assert site.files.isfile("plant/fleet/site/index.html")
    assert len(site.files.find("plant/fleet/factors")) == 4
    again = run_fleet(fleet, FLEET, settings=SETTINGS, scheduler="tcp://127.0.0.1:1")
    assert again.computed == (0, 0, 0)


def _killed_call(site: Site) -> None:
    """A call that is killed when a recording has been gathered."""
    words = ["fleet", "s3://plant/fleet.yaml", "-o", FLEET, "--scheduler", site.scheduler,
             "--cutoff", str(SETTINGS.cutoff), "--friction", "described"]  # fmt: skip
    code = f"import sys; sys.argv[1:] = {words}; from deltaid.cli import main; main()"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    call, end = subprocess.Popen([sys.executable, "-c", code], env=environment), monotonic() + 600
    while not site.files.find("plant/fleet/factors"):
        assert call.poll() is None
        assert monotonic() < end
        sleep(0.05)
    call.kill()
    call.wait()


def test_a_folder_that_workers_do_not_see_is_reported(tmp_path: Path) -> None:
    blind = Mock(run=lambda *_, **__: {"tcp://far:1": False, "tcp://near:1": True})
    with pytest.raises(
        DeltaidError, match=r"not visible to 1 of 2 workers.* tcp://far:1(.|\n)*s3://"
    ):
        require_shared(blind, tmp_path)
    assert not list(tmp_path.iterdir())


def test_nobody_at_the_address_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deltaid.fleets.workers._PATIENCE", 1)
    with (
        pytest.raises(DeltaidError, match=r"--scheduler tcp://127.0.0.1:1: no scheduler answers"),
        open_workers("tcp://127.0.0.1:1"),
    ):
        pass
