"""Damage to files that people write: lines, cells and keys, and what may lie in a file's place."""

import copy
import gzip
import io
import itertools
import json
import random
import zipfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from damage import damaged

_WORDS = ["", "nan", ".inf", "-1", "0", "1e308", "-1e-308", "9" * 400, "x", "true", "null", "1,5",
          "2 rpm", "3 inch", "0x1F", "1_000", "１２", "\x00", "\x1b[31m", "é☃", "&a", "*a", "!!x 1",
          "2026-01-31", "12:30:45", "a" * 5000, "'", '"', "%", "../../x", "- ", "{"]  # fmt: skip
_VALUES: list[Any] = [None, True, "", "x", float("nan"), float("inf"), -1, 0, 1e308, -1e308, 1e-308,
                      10**400, 5, [], {}, [1, 2, 3], {"a": 1}, "é☃", "a" * 5000, "\x00", "2 rpm",
                      "3 inch", "1.5", [[[]]], {"x": {"y": [{}]}}]  # fmt: skip


def damage_input(path: Path, rng: random.Random) -> None:
    """Put something else in the place of a good file: damaged, replaced or gone."""
    data, others = path.read_bytes(), sorted(p for p in path.parent.iterdir() if p.is_file())
    path.unlink()
    match rng.randrange(40):
        case 0:
            path.write_bytes(b"")
        case 1:
            path.mkdir()
        case 2:
            return
        case 3:
            other = rng.choice(others)
            path.write_bytes(data if other == path else other.read_bytes())
        case 4:
            path.write_bytes(_bomb(path.suffix))
        case _:
            path.write_bytes(_changed(data, path.suffix, rng))


def _changed(data: bytes, suffix: str, rng: random.Random) -> bytes:
    if suffix not in (".yaml", ".csv", ".py", ".txt") or rng.random() < 0.2:
        return _blocks(data, rng) if rng.random() < 0.1 else damaged(data, rng)
    text = data.decode()
    if suffix == ".yaml" and rng.random() < 0.6:
        return _keys(text, rng)
    if suffix == ".csv" and rng.random() < 0.5:
        return _cells(text, rng)
    return _lines(text, rng)


def _bomb(suffix: str) -> bytes:
    """What is small and becomes large, or says so."""
    if suffix == ".npz":
        buffer, head = io.BytesIO(), b"{'descr': '<f8', 'fortran_order': False, 'shape': (10**12,)}"
        head = head.replace(b"10**12", b"1000000000000").ljust(117) + b"\n"
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            for name in ("t.npy", "q.npy", "p.npy"):
                entry = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head
                archive.writestr(name, entry + bytes(1 << 24))
        return buffer.getvalue()
    if suffix == ".yaml":  # each line is nine times the one before
        names = "abcdefghij"
        lines = [f"{names[0]}: &{names[0]} [x, x, x, x, x, x, x, x, x]"]
        for before, name in itertools.pairwise(names):
            lines.append(f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]")
        return "\n".join(lines).encode()
    return gzip.compress(b"t,q1,q2,q3,tau1,tau2,tau3\n" + b"0,0,0,0,0,0,0\n" * (1 << 20), 9)


def _blocks(data: bytes, rng: random.Random) -> bytes:
    """A block twice, or the end before the beginning."""
    first, last = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    if rng.random() < 0.5:
        return data[:last] + data[first:]
    return data[first:] + data[:first]


def _lines(text: str, rng: random.Random) -> bytes:
    """Lines swapped, doubled, lost, joined or long; another encoding."""
    lines = text.splitlines(keepends=True)
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    encoding = "utf-8"
    match rng.randrange(12):
        case 0:
            lines[i], lines[j] = lines[j], lines[i]
        case 1:
            lines.insert(j, lines[i])
        case 2:
            del lines[i]
        case 3:
            lines[i] = lines[i].rstrip("\n")
        case 4:
            lines[i] = lines[i].rstrip("\n") + rng.choice(("9", " ", "x", "[")) * 100_000 + "\n"
        case 5:
            lines[i] = "  " * rng.randrange(1, 4) + lines[i]
        case 6:
            encoding = rng.choice(("utf-16", "utf-32", "utf-8-sig", "utf-7"))
        case 7:
            return text.replace("\n", "\r").encode()
        case 8:
            lines.insert(i, rng.choice("[{") * 3000 + "\n")
        case 9:
            return text.encode("cp1252", "replace") + b"\xe9\xff\x00"
        case _:
            words = lines[i].split(" ")
            words[rng.randrange(len(words))] = rng.choice(_WORDS)
            lines[i] = " ".join(words) + "\n"
    return "".join(lines).encode(encoding)


def _cells(text: str, rng: random.Random) -> bytes:
    """Cells of a table changed, and columns renamed, swapped, lost or in another unit."""
    rows = [line.split(",") for line in text.splitlines()]
    i, k = rng.randrange(len(rows)), rng.randrange(len(rows[0]))
    match rng.randrange(7):
        case 0:
            rows[0][k] = rng.choice(_WORDS)
        case 1:
            rows[0][k] = rows[0][rng.randrange(len(rows[0]))]
        case 2:
            rows = [row[:k] + row[k + 1 :] for row in rows]
        case 3:
            factor = rng.choice((-1.0, 57.29578, 1e3, 1e-3, 0.0, 1e30))
            for row in rows[1:]:
                row[k] = _times(row[k], factor)
        case _:
            rows[i][min(k, len(rows[i]) - 1)] = rng.choice(_WORDS)
    return ("\n".join(map(",".join, rows)) + "\n").encode()


def _times(cell: str, factor: float) -> str:
    try:
        return repr(float(cell) * factor)
    except ValueError:
        return cell


def _keys(text: str, rng: random.Random) -> bytes:
    """One key of a YAML file missing, unknown, of another type, size, sign or unit, or deep."""
    tree = copy.deepcopy(_tree(text))
    places = _places(tree)
    if not places:
        return _lines(text, rng)
    parent, key = rng.choice(places)
    match rng.randrange(9):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[rng.choice((f"{key}x", "", "a" * 5000, "1", "é"))] = parent.pop(key)
        case 2 if isinstance(parent, dict):
            parent[rng.choice(("unknown", "name", "unit"))] = rng.choice(_VALUES)
        case 3:
            value: Any = rng.choice(_VALUES)
            for _ in range(rng.choice((1, 50, 400))):
                value = [value] if rng.random() < 0.7 else {"a": value}
            parent[key] = value
        case 4:
            other, name = rng.choice(places)
            parent[key] = json.loads(json.dumps(other[name], default=str))
        case 5 if isinstance(parent[key], int | float):
            parent[key] *= rng.choice((-1, 1e3, 1e-3, 57.3, 1e6, 1e-9, 25.4, 0))
        case 6 if isinstance(parent[key], list) and parent[key]:
            parent[key] = parent[key] * rng.choice((2, 1000))
        case 7:
            parent[key] = str(parent[key])
        case _:
            parent[key] = rng.choice(_VALUES)
    # Without indentation, as lines of models are known by.
    dumped = json.dumps(tree, default=str, ensure_ascii=rng.random() < 0.5, indent=0)
    return dumped.replace("NaN", ".nan").replace("Infinity", ".inf").encode()


@cache
def _tree(text: str) -> Any:
    return YAML(typ="safe", pure=True).load(text)


def _places(tree: Any) -> Sequence[tuple[Any, Any]]:
    """All entries of a tree: the mapping or list that holds each, and its key."""
    found: list[tuple[Any, Any]] = []
    if not isinstance(tree, dict | list):
        return found
    for key, value in list(tree.items() if isinstance(tree, dict) else enumerate(tree)):
        found.append((tree, key))
        found += _places(value)
    return found
