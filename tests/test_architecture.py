"""The house as docs/architecture.md draws it: every room is listed, and imports run one way."""

import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
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


def test_every_room_is_in_the_table() -> None:
    assert set(rooms()) == {room(path_in_package(path)) for path in MODULES}


def test_a_room_imports_only_from_those_above_it() -> None:
    order = rooms()
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        here = order.index(room(path_in_package(path)))
        for other in set(re.findall(r"^\s*from deltaid\.([\w.]+)", text, re.M)):
            assert order.index(room(other.replace(".", "/"))) <= here, f"{path} imports {other}"
