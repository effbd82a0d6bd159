"""Libraries of units for other systems: that they are there, and what they show and ask for."""

import io
import re
import shutil
import struct
import zipfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest

from command import accepted
from deltaid.exports import fmu_binaries
from deltaid.exports.fmu import fmu
from deltaid.exports.fmu_binaries import SYSTEMS, Compiler, System, found_compiler, universal
from exports import needs_compiler, subject

needs_zig = pytest.mark.skipif(
    find_spec("ziglang") is None, reason="Zig's compiler is not here: pip install ziglang"
)
slow = pytest.mark.slow


# Nothing else is asked of a system, but for what a Mac's loader brings.
KNOWN = {
    "atan2", "ceil", "cos", "sin", "sqrt", "tanh", "memcpy", "memset", "strcmp", "strcpy", "strlen",
    "dyld_stub_binder", "memset_pattern16", "calloc", "free", "malloc",
}  # fmt: skip


@cache
def functions() -> set[str]:
    """Those of FMI 2, by the standard's own header."""
    import fmpy

    header = Path(fmpy.__file__).parent / "c-code" / "fmi2Functions.h"
    found = re.findall(r"^\s*FMI2_Export fmi2\w+TYPE\s+(fmi2\w+);", header.read_text("utf-8"), re.M)
    return set(found)


@cache
def exported_unit() -> zipfile.ZipFile:
    """A unit of the smallest kind with all libraries."""
    export = fmu(subject("linear-delta"), "unit", forward=False)
    assert export.warnings == ()
    return zipfile.ZipFile(io.BytesIO(export.parts[".fmu"]))


@slow
@needs_zig
@pytest.mark.parametrize(
    ("path", "kind", "machine"),
    [
        ("linux64/unit.so", "ELF", "X86_64"),
        ("aarch64-linux/unit.so", "ELF", "AARCH64"),
        ("win64/unit.dll", "PE", "AMD64"),
        ("aarch64-darwin/unit.dylib", "MachO", "ARM64"),
    ],
)
def test_a_library_has_the_functions_of_the_standard(path: str, kind: str, machine: str) -> None:
    import lief

    found = lief.parse(exported_unit().read(f"binaries/{path}"))
    assert isinstance(found, getattr(lief, kind).Binary)
    check(found, machine)


def check(found: object, machine: str) -> None:
    """All functions of FMI are shown, nothing unknown is asked for."""
    import lief

    header = found.header
    machine_type = getattr(header, "machine_type", None) or getattr(header, "machine", None)
    assert str(machine_type or header.cpu_type).endswith(machine)
    mac = isinstance(found, lief.MachO.Binary)
    shown = {f.name.removeprefix("_") if mac else f.name for f in found.exported_functions}
    assert shown >= functions()
    assert len(functions()) > 40
    assert not {name for name in shown - functions() if not name.startswith("_")}
    asked = {f.name.removeprefix("_") if mac else f.name for f in found.imported_functions}
    assert asked <= KNOWN
    if mac:
        assert found.has_code_signature == (machine == "ARM64")  # Apple's processors insist on it


@slow
@needs_zig
def test_a_library_for_both_kinds_of_mac() -> None:
    import lief

    fat = exported_unit().read("binaries/darwin64/unit.dylib")
    both = lief.MachO.parse(list(fat))
    assert [str(part.header.cpu_type).rpartition(".")[2] for part in both] == ["X86_64", "ARM64"]
    for part, machine in zip(both, ("X86_64", "ARM64"), strict=True):
        check(part, machine)
    arm = exported_unit().read("binaries/aarch64-darwin/unit.dylib")
    offset, size = struct.unpack_from(">II", fat, 8 + 20 + 8)
    assert fat[offset : offset + size] == arm


@slow
@needs_zig
def test_libraries_need_no_newer_system() -> None:
    """The C library of 2012 will do."""
    import lief

    for path in ("linux64", "aarch64-linux"):
        found = lief.parse(exported_unit().read(f"binaries/{path}/unit.so"))
        versions = {
            tuple(map(int, aux.name.removeprefix("GLIBC_").split(".")))
            for needed in found.symbols_version_requirement
            for aux in needed.get_auxiliary_symbols()
        }
        assert versions
        assert max(versions) <= (2, 17)


@slow
@needs_zig
def test_the_same_library_for_windows_again() -> None:
    """Its head has a time of its own."""
    compiler, library = found_compiler(), exported_unit().read("binaries/win64/unit.dll")
    assert compiler
    sources = {
        name.removeprefix("sources/"): exported_unit().read(name).decode()
        for name in exported_unit().namelist()
        if name.startswith("sources/")
    }
    assert compiler.library(SYSTEMS[1], "unit", sources) == library


@slow
@needs_zig
@needs_compiler
def test_the_library_of_zig_computes_what_that_of_this_machine_does(tmp_path: Path) -> None:
    import fmpy

    from units import content

    path = tmp_path / "zig.fmu"
    path.write_bytes(exported_unit().fp.getvalue())
    other = tmp_path / "own.fmu"
    other.write_bytes(content(subject("linear-delta"), "fmu-inverse"))
    start = {"q1": 0.1, "qd1": 0.5, "qdd2": 1.0}
    outs = [
        fmpy.simulate_fmu(str(file), stop_time=0.01, start_values=start, fmi_type="CoSimulation")
        for file in (path, other)
    ]
    for name in ("tau1", "tau2", "tau3", "z"):
        assert outs[0][name] == pytest.approx(outs[1][name], rel=1e-12)


def test_folders_of_either_version(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a system fails, the others are there, and the warning names it."""

    def library(_: Compiler, system: System, name: str, sources: dict[str, str]) -> bytes:
        if system.folder == "x86_64-windows":
            raise OSError("no such option")
        return struct.pack("<IIII", 0xFEEDFACF, 7, 3, len(system.folder))

    monkeypatch.setattr(Compiler, "library", library)
    compiler, messages = Compiler(("zig", "cc"), SYSTEMS, is_zig=True), list[str]()
    for version, x86, mac in (("2", "linux64", "darwin64"), ("3", "x86_64-linux", "x86_64-darwin")):
        files, warning = fmu_binaries.binaries("a", {}, version, compiler, messages.append)
        assert set(files) == {
            f"binaries/{x86}/a.so", f"binaries/{mac}/a.dylib",
            "binaries/aarch64-darwin/a.dylib", "binaries/aarch64-linux/a.so",
        }  # fmt: skip
        assert "macOS ARM, Linux ARM, and from its sources on Windows x86-64" in warning
        assert "no such option" in warning
    assert messages[:2] == ["compiling 1 of 5, Linux x86-64", "compiling 2 of 5, Windows x86-64"]
    assert len(messages) == 10


def test_parts_of_a_universal_library_begin_at_pages() -> None:
    parts = [struct.pack("<III", 0xFEEDFACF, kind, 3) + b"x" * 20000 for kind in (7, 12)]
    fat = universal(parts)
    for i, part in enumerate(parts):
        kind, _, offset, size, power = struct.unpack_from(">IIIII", fat, 8 + 20 * i)
        assert (kind, offset % (1 << power)) == ((7, 12)[i], 0)
        assert fat[offset : offset + size] == part


@pytest.mark.parametrize(
    ("options", "sources"),
    [((), {"fmi2.c"}), (("--fmi", "3"), {"fmi3.c", "buildDescription.xml"})],
    ids=["FMI 2", "FMI 3"],
)
def test_without_any_compiler_the_sources_are_there(
    options: tuple[str, ...], sources: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_: None)
    monkeypatch.setattr(fmu_binaries, "find_spec", lambda _: None)
    path = tmp_path / "a.fmu"
    outcome = accepted("export", "linear-delta", "--to", "fmu", *options, "-o", path, width=400)
    assert "no C compiler was found" in outcome.err
    with zipfile.ZipFile(path) as archive:
        written = {f"sources/{name}" for name in sources | {"a.h", "a.c"}}
        assert set(archive.namelist()) == {
            "modelDescription.xml",
            "documentation/index.html",
            *written,
        }
