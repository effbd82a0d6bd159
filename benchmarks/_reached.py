"""A pytest plugin: which test files reach which lines, at next to no cost (Python 3.12 or later).

    python -m pytest -p _reached …      with PYTHONPATH=benchmarks

`REACHED_LINES` names a file with the lines asked for (`path:line`, one a row), `REACHED_OUT` a
folder that gets one JSON file a worker: for each line the tests that reached it, for each test its
seconds, and which tests failed. What a fixture of the session reaches counts for every test that
uses it.
"""

import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import CodeType

import pytest

_TOOL = sys.monitoring.COVERAGE_ID
_events = sys.monitoring.events


class Reached:
    def __init__(self, asked: set[tuple[str, int]], out: Path) -> None:
        self.asked, self.out = asked, out
        self.files = {path for path, _ in asked}
        self.lines: set[str] = set()
        self.tests: dict[str, list[str]] = {}
        self.seconds: dict[str, float] = {}
        self.fixtures: dict[str, set[str]] = {}
        self.failed: list[str] = []
        sys.monitoring.use_tool_id(_TOOL, "reached")
        sys.monitoring.register_callback(_TOOL, _events.LINE, self._line)
        sys.monitoring.set_events(_TOOL, _events.LINE)

    def _line(self, code: CodeType, line: int) -> object:
        _, found, name = code.co_filename.partition("/src/")
        if found and name in self.files and (name, line) in self.asked:
            self.lines.add(f"{name}:{line}")
        return sys.monitoring.DISABLE

    @pytest.hookimpl(hookwrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[object], request: pytest.FixtureRequest
    ) -> Iterator[None]:
        if fixturedef.scope != "session":
            yield
            return
        before, self.lines = self.lines, set()
        sys.monitoring.restart_events()
        yield
        self.fixtures[fixturedef.argname] = self.lines
        self.lines = before | self.lines

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(
        self, item: pytest.Item, nextitem: pytest.Item | None
    ) -> Iterator[None]:
        sys.monitoring.restart_events()
        self.lines = set()
        start = time.perf_counter()
        yield
        self.seconds[item.nodeid] = time.perf_counter() - start
        for name in getattr(item, "fixturenames", ()):
            self.lines |= self.fixtures.get(name, set())
        for line in self.lines:
            self.tests.setdefault(line, []).append(item.nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed.append(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        if self.seconds:
            worker = os.environ.get("PYTEST_XDIST_WORKER", "main")
            text = json.dumps({"tests": self.tests, "seconds": self.seconds, "failed": self.failed})
            (self.out / f"{worker}.json").write_text(text)


def pytest_configure(config: pytest.Config) -> None:
    rows = Path(os.environ["REACHED_LINES"]).read_text().splitlines()
    asked = {(path, int(line)) for path, line in (row.rsplit(":", 1) for row in rows)}
    config.pluginmanager.register(Reached(asked, Path(os.environ["REACHED_OUT"])))
