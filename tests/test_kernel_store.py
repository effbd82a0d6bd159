"""Compiled kernels on disk: used again, never trusted blindly; and those for other processors."""

import os
import platform
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from command import accepted
from deltaid.dynamics import dynamics
from deltaid.errors import DeltaidError
from deltaid.kernel import batch, machine_code, store
from deltaid.kernel.batch import BatchKernel, Recurrence
from deltaid.kernel.machine_code import VARIABLE, target

X = np.random.default_rng(0).normal(size=(2, 37))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch) -> Path:
    """Where entries are kept; does not exist yet."""
    monkeypatch.setenv(store.VARIABLE, str(tmp_path / "kept" / "here"))
    return tmp_path / "kept" / "here"


@pytest.fixture
def compiled(monkeypatch) -> list[str]:
    """Counts what is compiled."""
    done, honest = [], machine_code._compile

    def counted(assembly: str, level: int) -> bytes:
        done.append(assembly)
        return honest(assembly, level)

    monkeypatch.setattr(machine_code, "_compile", counted)
    return done


def kernel(factor: float = 2.0) -> BatchKernel:
    """With functions of libm, which machine code from a file has to find."""
    x = ca.SX.sym("x", 2)
    values = ca.sin(x[0]) * ca.atan2(x[1], x[0]), ca.fabs(x[0]) ** x[1], factor * x[1]
    return BatchKernel(x, ca.vertcat(*values))


def test_a_kernel_is_compiled_once(folder: Path, compiled: list[str]) -> None:
    first, again, other = kernel()(X), kernel()(X), kernel(3.0)(X)
    assert len(compiled) == len(list(folder.iterdir())) == 2
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_a_recurrence_is_no_kernel_of_the_same_graph(
    folder: Path, compiled: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one sample per instruction both have one graph; a recurrence reads what it writes."""
    monkeypatch.setattr(batch, "target", lambda: replace(target(), width=1))
    x, u = ca.SX.sym("x"), ca.SX.sym("u")
    plain = BatchKernel(ca.vertcat(u, x), ca.vertcat(x + u, 2 * x))
    recurrence = Recurrence(x, u, x + u, 2 * x)
    assert len(compiled) == len(list(folder.iterdir())) == 2
    np.testing.assert_array_equal(plain(np.ones((2, 3))), [[2.0] * 3, [2.0] * 3])
    state, outputs = recurrence(np.zeros(1), np.ones((3, 1)))
    assert (state.tolist(), outputs[:, 0].tolist()) == ([3.0], [0.0, 2.0, 4.0])


def test_a_new_process_finds_it_and_its_functions(folder: Path) -> None:
    expected = kernel()(X)
    script = (
        "import sys, numpy as np; sys.path.insert(0, sys.argv[1])\n"
        "import test_kernel_store as t\n"
        "def never(assembly, level): raise AssertionError('compiled again')\n"
        "t.machine_code._compile = never\n"
        "sys.stdout.write(t.kernel()(t.X).tobytes().hex())"
    )
    assert printed(script, str(Path(__file__).parent)) == expected.tobytes().hex()


def printed(script: str, *arguments: str) -> str:
    """By a process of its own."""
    command = [sys.executable, "-c", script, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: b"",
        lambda data: data[:20],
        lambda data: data[:-1],
        lambda data: data[:-9] + bytes([data[-9] ^ 1]) + data[-8:],
        lambda data: b"\0" * len(data),
    ],
)
def test_a_damaged_entry_is_compiled_anew(folder: Path, compiled: list[str], damage) -> None:
    expected = kernel()(X)
    (entry,) = folder.iterdir()
    whole = entry.read_bytes()
    entry.write_bytes(damage(whole))
    np.testing.assert_array_equal(kernel()(X), expected)
    assert len(compiled) == 2
    assert entry.read_bytes() == whole


def test_another_machine_or_version_has_entries_of_its_own(
    folder: Path, compiled: list[str], monkeypatch
) -> None:
    kernel()
    known = machine_code._circumstances(target())
    assert len(known) == 9
    for i in range(len(known)):
        changed = (*known[:i], "another", *known[i + 1 :])
        monkeypatch.setattr(machine_code, "_circumstances", lambda _, changed=changed: changed)
        kernel()
    assert len(compiled) == len(list(folder.iterdir())) == 1 + len(known)


def test_without(folder: Path, compiled: list[str], monkeypatch) -> None:
    kernel()
    dynamics._compiled.cache_clear()
    accepted("--no-cache", "base", "clavel-delta3")
    before = len(compiled)
    assert before > 2
    monkeypatch.setenv(store.VARIABLE, "OFF")
    kernel()
    monkeypatch.setenv(store.VARIABLE, str(folder))
    store.switch_off()
    kernel()
    assert len(compiled) == before + 2
    assert len(list(folder.iterdir())) == 1


def test_a_folder_that_cannot_be_written(tmp_path: Path, monkeypatch) -> None:
    """The user's own is told; in the system's there is nothing to be kept, and nothing to say."""
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv(store.VARIABLE, str(blocked / "kernels"))
    with pytest.raises(DeltaidError, match="compiled kernels cannot be kept there") as caught:
        kernel()
    assert store.VARIABLE in caught.value.cure
    monkeypatch.delenv(store.VARIABLE)
    monkeypatch.setattr(store, "_caches", lambda: blocked)
    assert kernel()(X).shape == (3, 37)
    monkeypatch.setattr(store, "_caches", lambda: None)
    assert kernel()(X).shape == (3, 37)


def test_entries_used_longest_ago_make_room(folder: Path, monkeypatch) -> None:
    names = [store.key(f"{i}") for i in range(4)]
    folder.mkdir(parents=True)
    (folder / "letter.txt").write_bytes(b"x" * 500)
    monkeypatch.setattr(store, "_LARGEST", 350)
    monkeypatch.setattr(store, "_LOOKS", 1)
    for i, name in enumerate(names[:3]):
        store.save(name, bytes(68))  # 100 bytes with the checksum
        os.utime(folder / name, (i + 1, i + 1))
    assert store.load(names[0]) == bytes(68)  # used now
    store.save(names[3], bytes(68))
    assert [store.load(name) is not None for name in names] == [True, False, True, True]
    assert (folder / "letter.txt").exists()


def test_saving_scans_the_folder_only_now_and_then(folder: Path, monkeypatch) -> None:
    monkeypatch.setattr(store, "_LARGEST", 0)
    left = []
    for i in range(300):
        store.save(store.key(f"{i}"), b"%d" % i)
        left.append(len(list(folder.iterdir())))
    assert 5 < left.count(0) < 50
    assert max(left) < 100


def test_writers_at_the_same_time(folder: Path) -> None:
    name, contents = store.key("x"), [bytes([i]) * 50_000 for i in range(4)]
    seen: list[bytes | None] = []

    def write(content: bytes) -> None:
        for _ in range(20):
            store.save(name, content)
            seen.append(store.load(name))

    writers = [threading.Thread(target=write, args=[content]) for content in contents]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert len(seen) == 80
    assert set(seen) <= set(contents)
    assert [entry.name for entry in folder.iterdir()] == [name]


def test_the_systems_folder(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.delenv(store.VARIABLE, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert store.folder() == tmp_path / "deltaid" / "kernels"
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert store.folder() == tmp_path / ".cache" / "deltaid" / "kernels"


def test_a_short_command_loads_neither_scipy_nor_polars() -> None:
    """Each takes longer than all that `deltaid base` computes once its kernels are kept."""
    script = (
        "import sys; from deltaid.cli import main\n"
        "sys.argv = ['deltaid', 'base', 'clavel-delta3']\n"
        "try: main()\n"
        "finally: print({'scipy', 'polars', 'plotly', 'pint'} & sys.modules.keys())"
    )
    assert printed(script).splitlines()[-1] == "set()"


A, B = ca.SX.sym("a"), ca.SX.sym("b")


def test_code_for_another_processor_differs_by_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    """A sum of a product is rounded once or twice, by what the processor offers."""
    x = 1 + np.random.default_rng(0).uniform(size=(2, 37))
    expected = x[0] * x[1] + np.sqrt(x[0] * x[0] + x[1])
    levels = [level for level in ("x86-64-v2", "x86-64-v3", "x86-64-v4") if _usable(level)]
    assert levels or platform.machine() not in ("x86_64", "AMD64")
    for level in levels:
        monkeypatch.setenv(VARIABLE, level)
        assert target().width == (8 if level == "x86-64-v4" else 4)
        kernel = BatchKernel(ca.vertcat(A, B), A * B + ca.sqrt(A * A + B))
        np.testing.assert_allclose(kernel(x)[0], expected, rtol=4e-16)


def _usable(level: str) -> bool:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, level)
        try:
            return target().cpu == level
        except DeltaidError:
            return False


def test_a_processor_that_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "haswell")
    with pytest.raises(DeltaidError, match=f"{VARIABLE}: is 'haswell'.*cannot run"):
        BatchKernel(A, A + 1)


@pytest.mark.parametrize("lacking", ["fma", "bmi2"])
def test_a_processor_needs_all_that_a_level_has(
    monkeypatch: pytest.MonkeyPatch, lacking: str
) -> None:
    """Early ones have AVX2 without fused operations."""
    there = {name: name != lacking for name in ("sse4.2", "popcnt", "avx2", "fma", "bmi2")}
    monkeypatch.setattr(machine_code.llvm, "get_host_cpu_features", lambda: there)
    # Without what it remembers.
    monkeypatch.setattr(machine_code, "_target", machine_code._target.__wrapped__)
    monkeypatch.setenv(VARIABLE, "x86-64-v2")
    assert (target().cpu, target().width) == ("x86-64-v2", 4)
    monkeypatch.setenv(VARIABLE, "x86-64-v3")
    with pytest.raises(DeltaidError, match="cannot run") as caught:
        target()
    assert "use one of x86-64-v2, or unset it" in str(caught.value.cure)
