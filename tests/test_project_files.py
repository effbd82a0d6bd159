"""Files of the project beside its code, and rooms that import only from those above them.

Also tables of benchmarks: each is as large as its benchmark states.
"""

import ast
import importlib.util
import re
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest
from ruamel.yaml import YAML

import deltaid
from links import PAGES, ROOT

sys.path.append(str(ROOT / "benchmarks"))
import _table
from _drifting_fleet import CASES

FORMS = sorted(
    path for path in (ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml") if path.stem != "config"
)
SCHEMAS = {
    "citation-file-format": [ROOT / "CITATION.cff"],
    "github-issue-config": [ROOT / ".github" / "ISSUE_TEMPLATE" / "config.yml"],
    "github-issue-forms": FORMS,
    "github-workflows": sorted((ROOT / ".github" / "workflows").glob("*.yml")),
}
URL = "https://example.org/deltaid"


@pytest.fixture(scope="module")
def hook() -> ModuleType:
    """What writes the project's address into a package."""
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("schema", SCHEMAS)
def test_files_keep_their_schema(schema: str) -> None:
    assert SCHEMAS[schema]
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", f"vendor.{schema}"]
    done = subprocess.run([*command, *SCHEMAS[schema]], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


def test_the_workflow_runs_what_the_package_allows_and_the_readme_says() -> None:
    """All versions of Python that are declared, and README's test line."""
    workflow = YAML(typ="safe").load(ROOT / ".github" / "workflows" / "tests.yml")
    tried = workflow["jobs"]["readme"]["strategy"]["matrix"]["python"]
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    declared = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', project)
    assert tried == declared
    assert f'requires-python = ">={declared[0]}"' in project
    lines = [step.get("run") for job in workflow["jobs"].values() for step in job["steps"]]
    assert "python -m pytest -n auto" in lines
    assert "python -m pytest -n auto\n" in (ROOT / "README.md").read_text(encoding="utf-8")
    assert ".ci/run" in lines


def test_citation_and_package_agree() -> None:
    citation = YAML(typ="safe").load(ROOT / "CITATION.cff")
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    for name, value in (
        ("version", citation["version"]),
        ("license", citation["license"]),
        ("authors", citation["authors"][0]["name"]),
    ):
        assert re.search(rf'^{name} = .*"{re.escape(str(value))}"', project, re.M), name


def test_project_address_is_one_variable(hook: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    build = hook.ProjectUrl(str(ROOT), {})
    monkeypatch.delenv(hook.VARIABLE, raising=False)
    build.update(without := {})
    assert without["urls"] == {}
    assert without["readme"]["text"] == (ROOT / "README.md").read_text(encoding="utf-8")
    monkeypatch.setenv(hook.VARIABLE, URL + "/")
    build.update(given := {})
    assert set(given["urls"]) == {"Source", "Documentation", "Issues", "Changelog"}
    assert all(address.startswith(URL) for address in given["urls"].values())
    text = given["readme"]["text"]
    targets = re.findall(r'\]\(([^)]+)\)|(?:src|srcset)="([^"]+)"', text)
    assert len(targets) > 20
    for target in map("".join, targets):
        assert target.startswith("https://"), target
    assert f"({URL}/raw/main/docs/images/terminal.svg)" in text
    assert f"({URL}/blob/main/docs/tutorial.md)" in text


def test_no_other_file_names_an_address() -> None:
    for name in ("pyproject.toml", "mkdocs.yml", "CITATION.cff", "hatch_build.py"):
        text = (ROOT / name).read_text(encoding="utf-8")
        assert not re.findall(r"https?://\S", text), name


# A line that installs names what is in the folder ('.'), or a package that an index has.
ELSEWHERE = {
    "build", "twine",
    "drake", "h5py", "jax", "matplotlib", "nicegui", "pandas", "rosbags", "viser", "viser==1.1.1",
    "ziglang", "zstandard",
}  # fmt: skip


def test_lines_that_install_work_today() -> None:
    sources = [*PAGES, *(ROOT / "src").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]
    found = 0
    for path in sources:
        for line in re.findall(r"\bpip install ([^`\n]+)", path.read_text(encoding="utf-8")):
            words = re.split(r"\s*(?:&&|;|,|#|\||\)|\")", line.replace('".', "'."))[0].split()
            for word in (word.strip("'\"") for word in words):
                if word in ("or", "and", "in"):
                    break
                own = word.startswith((".", "-", "{"))
                assert own or word in ELSEWHERE, f"{path.name}: pip install {line}"
                found += 1
    assert found > 20
    assert deltaid.__name__ not in ELSEWHERE


SOURCE = ROOT / "src" / "deltaid"


@cache
def rooms() -> list[str]:
    """Names in the table of rooms, in its order."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    listed = [row.split("|")[1] for row in rows if row.count("|") == 4 and "(" not in row[:40]]
    return [name for cell in listed for name in re.findall(r"`([\w/]+)(?:/|\.py)`", cell)]


def room(path: str) -> str:
    """The innermost listed folder of a path such as 'sensors/rows'; its first part if none is."""
    inside = [name for name in rooms() if f"{path}/".startswith(f"{name}/")]
    return max(inside, key=len, default=path.split("/")[0])


def path_in_package(path: Path) -> str:
    return path.relative_to(SOURCE).with_suffix("").as_posix()


MODULES = [p for p in sorted(SOURCE.rglob("*.py")) if p != SOURCE / "__init__.py"]
# Names that say nothing of what a variable of a loop holds.
EMPTY = {"one", "own", "some", "it", "told", "found"}


def test_variables_of_loops_are_named_after_what_they_hold() -> None:
    bad = [
        f"{path_in_package(path)}: {name.id}"
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.For | ast.comprehension)
        for name in ast.walk(node.target)
        if isinstance(name, ast.Name) and name.id in EMPTY
    ]
    assert bad == []


def test_a_class_has_a_name_of_its_own() -> None:
    names = [
        node.name
        for path in MODULES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    assert sorted(set(names)) == sorted(names)


def test_every_room_is_in_the_table() -> None:
    assert set(rooms()) == {room(path_in_package(path)) for path in MODULES}


def test_a_room_imports_only_from_those_above_it() -> None:
    order = rooms()
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        here = order.index(room(path_in_package(path)))
        for other in set(re.findall(r"^\s*from deltaid\.([\w.]+)", text, re.M)):
            assert order.index(room(other.replace(".", "/"))) <= here, f"{path} imports {other}"


def test_a_fleet_on_one_machine_needs_no_library_of_an_extra() -> None:
    """A module that imports one refuses what needs it; all others come with the package."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    come = {re.match(r"[\w-]+", line)[0].replace("-", "_") for line in project["dependencies"]}
    for path in (path for path in MODULES if room(path_in_package(path)).startswith("fleets")):
        text = path.read_text(encoding="utf-8")
        steps = list(ast.walk(ast.parse(text)))
        names = [step.module or "" for step in steps if isinstance(step, ast.ImportFrom)]
        names += [
            name.name for step in steps if isinstance(step, ast.Import) for name in step.names
        ]
        used = {name.partition(".")[0] for name in names}
        extra = used - come - sys.stdlib_module_names - {"deltaid"}
        assert not extra or "require(" in text, f"{path} imports {extra}"


TABLES = {path.stem: path.read_text(encoding="utf-8") for path in _table.TABLES.glob("*.md")}


def rows_of(text: str) -> list[str]:
    """First cells of the last table of a text."""
    tables = [part for part in text.split("\n\n") if part.startswith("| ")]
    return [line.split("|")[1].strip() for line in tables[-1].splitlines()[2:]]


@pytest.mark.parametrize("name", _table.STATED)
def test_tables_are_as_large_as_their_benchmarks_state(name: str) -> None:
    """Sizes in the table, its rows, and what a smaller one is known to be behind by."""
    text, stated = TABLES[name], _table.STATED[name]
    size = _table.read_size(text)
    assert text.endswith(_table.size_line(name, size) + "\n")
    assert size["rows"] == len(rows_of(text))
    if name in _table.BEHIND:
        assert size == _table.BEHIND[name]
        assert _table.short_of(size, stated), "full: its entry in BEHIND can go"
    else:
        assert not _table.short_of(size, stated)


def test_every_table_states_its_size_and_drift_has_all_fleets() -> None:
    assert TABLES.keys() == _table.STATED.keys()
    assert rows_of(TABLES["drift"]) == [case.name for case in CASES]


@pytest.mark.parametrize(
    ("counts", "rows", "folder"),
    [
        ({"robots": 200}, 10, "tables"),
        ({"robots": 300}, 12, "tables"),
        ({"robots": 5}, 10, "smaller"),
        ({"robots": 200}, 4, "smaller"),
        ({}, 10, "smaller"),
    ],
)
def test_a_smaller_run_replaces_no_table(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    counts: dict[str, int],
    rows: int,
    folder: str,
) -> None:
    monkeypatch.setattr(_table, "TABLES", tmp_path / "tables")
    monkeypatch.setattr(_table, "SMALLER", tmp_path / "smaller")
    monkeypatch.setattr(sys, "argv", ["benchmarks/drift.py", "5"])
    path = _table.leave(("fleet",), [("a",)] * rows, "Note.", **counts)
    assert path == tmp_path / folder / "drift.md"
    assert list(tmp_path.rglob("*.md")) == [path]
    assert _table.read_size(path.read_text(encoding="utf-8")) == {"rows": rows, **counts}
    assert (str(path) in capsys.readouterr().err) == (folder == "smaller")
