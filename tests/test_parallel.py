"""Work shared among threads: nothing may depend on how many there are."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.errors import RecordingError
from deltaid.parallel import cores, ordered, threads
from deltaid.recording import table, windows
from logs import recorded, write

COUNTS = [1, 2, 3]


@pytest.mark.parametrize("count", COUNTS)
def test_results_come_in_order(count: int) -> None:
    later = threading.Event()

    def work(item: int) -> int:
        if item == 1 and count > 1:
            assert later.wait(60)  # is done after the one behind it
        if item == 2:
            later.set()
        return item**2

    with threads(count):
        assert list(ordered(work, range(20))) == [i**2 for i in range(20)]
        assert list(ordered(work, range(1))) == [0]
        assert list(ordered(work, ())) == []


@pytest.mark.parametrize("count", COUNTS)
def test_errors_come_in_order(count: int) -> None:
    """A log that cannot be read further is told after what is wrong with the rows before."""

    def rows() -> Iterator[int]:
        yield from range(5)
        raise RecordingError("cannot be read")

    def work(item: int) -> int:
        if item == bad:
            raise RecordingError(f"item {item}")
        return item

    with threads(count):
        for bad, delivered in ((3, [0, 1, 2]), (9, [0, 1, 2, 3, 4])):
            seen = []
            with pytest.raises(RecordingError) as caught:
                seen.extend(iter_into(seen, ordered(work, rows())))
            assert seen == delivered
            assert str(caught.value) == ("item 3" if bad == 3 else "cannot be read")


def iter_into(seen: list[int], results: Iterator[int]) -> list[int]:
    """Take results one by one, so that those before an error are known."""
    for result in results:
        seen.append(result)  # noqa: PERF402 - extend would lose them
    return []


def test_few_items_are_in_memory_and_workers_share_no_further() -> None:
    made, inside = [], []

    def items() -> Iterator[int]:
        for item in range(100):
            made.append(item)
            yield item

    def work(item: int) -> int:
        inside.append((threading.get_ident(), cores()))
        return item

    with threads(2):
        results = ordered(work, items())
        for taken in range(50):
            assert next(results) == taken
            assert len(made) <= taken + 6
        results.close()
        assert cores() == 2
    here = threading.get_ident()
    assert all(count == 1 for thread, count in inside if thread != here)
    assert len({thread for thread, _ in inside} - {here}) in (1, 2)


@pytest.mark.parametrize("columns", ["t q tau", "t q qd qdd tau"])
def test_an_identification_has_the_same_bits_on_any_number_of_threads(
    tmp_path: Path, monkeypatch, columns: str
) -> None:
    """Over many batches and windows."""
    monkeypatch.setattr(table, "BATCH_ROWS", 500)
    monkeypatch.setattr(windows, "WINDOW", 400)
    frame = recorded(3000, derivatives=True)
    kinds = tuple(columns.split())
    frame = frame.select([c for c in frame.columns if c.rstrip("0123456789") in kinds])
    noise = np.random.default_rng(0).normal(size=(len(frame), 3))
    noisy = [pl.Series(f"tau{i + 1}", frame[f"tau{i + 1}"] + noise[:, i]) for i in range(3)]
    log = write(tmp_path / "log.parquet", frame.with_columns(noisy))
    found = []
    for count in (1, 3):
        with threads(count):
            result = deltaid.identify(deltaid.load_robot("clavel-delta3"), [log])
        found.append((result.model.model_dump_json(), result.problem.gathered.places.tobytes()))
    assert found[0] == found[1]


FORKED = """
import multiprocessing, sys
import numpy as np
import polars as pl
import deltaid
from deltaid.identification.prediction import validate  # all that is compiled before

log, manifest = sys.argv[1:]
t, *columns = np.loadtxt(log, delimiter=",", skiprows=1).T
ARRAYS = {"t": t, "q": np.array(columns[:3]).T, "tau": np.array(columns[3:]).T}
CALLS = {
    "identify": lambda source: deltaid.identify("clavel-delta3", source),
    "check": lambda source: deltaid.check("clavel-delta3", source),
    "validate": lambda source: validate("clavel-delta3", source),
    "columns": lambda source: deltaid.columns(source),
    "fleet": lambda source: deltaid.fleet(manifest, manifest + ".out", workers=1),
}

def ended(of):
    call, source = of
    try:
        CALLS[call](source)
    except deltaid.DeltaidError as error:
        return str(error)
    return "done"

if __name__ == "__main__":
    for begun in (False, True):
        if begun:
            pl.DataFrame({"a": range(100)}).lazy().group_by("a").len().collect()
        calls = [(call, source) for call in CALLS for source in (log, ARRAYS)]
        with multiprocessing.get_context("fork").Pool(1) as pool:
            for said in pool.map(ended, calls if begun else calls[:1]):
                print(said, flush=True)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="no other system forks by default")
def test_a_process_without_its_threads_refuses_to_read(tmp_path: Path) -> None:
    """Polars that is only loaded has none yet, and works after a fork."""
    log = write(tmp_path / "log.csv", recorded(1000))
    robots = "type: clavel-delta3\nrobots:\n- robot: a\n  recordings: log.csv\n"
    manifest = write(tmp_path / "fleet.yaml", robots)
    script = [sys.executable, "-c", FORKED, str(log), str(manifest)]
    done = subprocess.run(script, capture_output=True, text=True, timeout=60, check=True)
    first, *refusals = done.stdout.splitlines()
    assert first == "done"
    assert sum("this process: was forked from one" in line for line in refusals) == 10
    assert sum("spawn" in line for line in refusals) == 10
    assert not (tmp_path / "fleet.yaml.out").exists()
