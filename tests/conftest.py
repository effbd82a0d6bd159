"""Options of the tests, checks of shapes and types on request, robots that several files share."""

import functools
import gc
import inspect
import os
import pkgutil
import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import jaxtyping
import pytest
import threadpoolctl

import deltaid


def pytest_xdist_auto_num_workers() -> int:
    """One more than there are cores: tests of browsers, stores and processes wait half the time."""
    return (os.cpu_count() or 1) + 1


# On matrices as small as the tests' BLAS threads only wait for one another: one here, and one in
# the processes that tests start.
os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"
threadpoolctl.threadpool_limits(1, user_api="blas")

# glibc gives back at once what it has mapped, and keeps smaller pieces; from which size on it maps
# would grow to 32 MB. Workers of xdist are started after this.
os.environ |= {"MALLOC_MMAP_THRESHOLD_": str(1 << 17), "MALLOC_ARENA_MAX": "2"}

# What is started in the background ignores Ctrl-C, and so would the processes that tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# All but the writer of machine code: its methods run for every instruction of every graph and see
# no arrays; checking them would take a third of the tests' time.
_PARTS = [part.name for part in pkgutil.iter_modules(deltaid.__path__) if part.name != "kernel"]
_CHECKED = [f"deltaid.{name}" for name in (*_PARTS, "kernel.batch")]

# Of the calls that a test file makes of a function the first, second, fourth, eighth … are checked:
# its later tests count too, but not all thousands of a loop. A function within a function is made
# anew in every call of the outer one, and making its check takes a millisecond: so its calls count
# together, and its check is made when it is called.
_CALLS: Counter[object] = Counter()
_jaxtyped = jaxtyping.jaxtyped


def _some_calls_checked(**options: object):
    def decorate(part):
        if inspect.isclass(part):
            return _jaxtyped(part, **options)
        code, check = part.__code__, None

        @functools.wraps(part)
        def call(*arguments, **keywords):
            nonlocal check
            _CALLS[code] = number = _CALLS[code] + 1
            if number & (number - 1):  # no power of two
                return part(*arguments, **keywords)
            check = check or _jaxtyped(part, **options)
            return check(*arguments, **keywords)

        return call

    return decorate


# Where a float is wanted an integer will do, as it does for basedpyright.
_CHECKER = "beartype.beartype(conf=beartype.BeartypeConf(is_pep484_tower=True))"


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--shapes"):
        jaxtyping.jaxtyped = _some_calls_checked
        jaxtyping.install_import_hook(_CHECKED, _CHECKER)


# Files with a long test come first: no worker begins one when the others have nothing left to do.
_LONG = ("test_docs.py", "test_fleet.py", "test_reproduce.py", "test_studio_browser.py")


def pytest_addoption(parser: pytest.Parser) -> None:
    what = "run long sweeps, other programs and every page in the browser as well"
    parser.addoption("--slow", action="store_true", help=what)
    shapes = "check shapes and types as functions are called, which takes half as long again"
    parser.addoption("--shapes", action="store_true", help=shapes)
    parser.addoption("--renew", action="store_true", help="store today's words as snapshots")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: item.path.name not in _LONG)
    if not config.getoption("--slow"):
        slow = [item for item in items if item.get_closest_marker("slow")]
        items[:] = [item for item in items if item not in set(slow)]
        config.hook.pytest_deselected(items=slow)


def pytest_collection_finish() -> None:
    """What has been imported by now stays: the collections of garbage below pass it over."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def _forget_robots(request: pytest.FixtureRequest) -> Iterator[None]:
    """What a file keeps from test to test, robots with their compiled kernels, goes with it."""
    _CALLS.clear()
    yield
    for value in vars(request.module).values():
        if hasattr(value, "cache_clear"):
            value.cache_clear()
    gc.collect()


@pytest.fixture
def snapshot(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Compares words with those stored under the test's name; `pytest --renew` stores today's.

    What a program says is read as a whole, where it is stored, and not piece by piece in a test.
    """
    name = f"{request.path.stem.removeprefix('test_')}-{request.node.name.removeprefix('test_')}"
    path = Path(__file__).with_name("snapshots") / f"{name}.txt"

    def compare(text: str) -> None:
        if request.config.getoption("--renew"):
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
        assert text == path.read_text(encoding="utf-8"), f"other words: see {path.name}, or --renew"

    return compare


@pytest.fixture(scope="session")
def irb360() -> deltaid.Dynamics:
    return deltaid.Dynamics(deltaid.load_robot("irb360-6-1600"))


@pytest.fixture(scope="session")
def clavel() -> deltaid.Dynamics:
    return deltaid.Dynamics(deltaid.load_robot("clavel-delta3"))


@pytest.fixture(scope="session")
def demonstration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `deltaid demo --keep` leaves, and the report of its fit, identify.html; only read it.

    All workers share what the first of them has made.
    """
    from command import run

    made, base = tmp_path_factory.mktemp("demo"), tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "demonstration"
    if not shared.exists():
        assert run("demo", "--keep", made).code == 0
        robot, log, verify = (made / name for name in ("robot.yaml", "identify.csv", "verify.csv"))
        page = made / "identify.html"
        assert run("identify", robot, log, "--verify", verify, "--report", page).code == 0
        with suppress(OSError):  # another worker was faster
            made.rename(shared)
    return shared


@pytest.fixture(scope="module")
def browser() -> Iterator[object]:
    """Chromium, as far as it is there."""
    from visit import chromium  # only where a browser is asked for

    with chromium() as chrome:
        yield chrome


@pytest.fixture(scope="session")
def opened(clavel: deltaid.Dynamics):
    """Opens a log, with a mapping if one is given, as one of Clavel's robot."""
    from deltaid.recording.opening import open_log  # only now: its checks are in place

    return lambda path, mapping=None: open_log(path, clavel.kinematics, mapping)
