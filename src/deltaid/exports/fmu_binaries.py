"""Shared libraries of a functional mock-up unit, for all supported systems.

The compiler of Zig, installed as a wheel, links for other systems, so one export covers them all,
including much older versions of Linux. Any other compiler makes the library of this machine.

FMI 2 defines folder names for x86 only; the others are those of FMI 3. Some tools look into
`darwin64` on both kinds of Macs, so its library has code for both.
"""

import os
import platform
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from deltaid.errors import Doubt
from deltaid.exports.options import FmiVersion
from deltaid.parallel import ordered
from deltaid.progress import Progress

# No fused multiply-add, so that results agree between processors except in `math.h`.
_OPTIONS = ("-std=c99", "-O1", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden")
# Without Zig's traps for undefined behaviour, and without a stack probe on Windows, which a stack
# of some kilobytes does not need.
_OF_ZIG = ("-fno-sanitize=undefined", "-mno-stack-arg-probe")
# An empty entry point on Windows replaces the system's start-up code, which Zig would compile for a
# minute.
_START_ON_WINDOWS = """
int __stdcall DllMainCRTStartup(void *library, unsigned long reason, void *reserved)
{
    (void)library;
    (void)reason;
    (void)reserved;
    return 1;
}
"""
_OF_WINDOWS = tuple(f"-lapi-ms-win-crt-{x}-l1-1-0" for x in ("math", "private", "string", "heap"))


@dataclass(frozen=True)
class System:
    """A platform: operating system and processor.

    Attributes:
        name: in words.
        folder: of its library in FMI 3, and in FMI 2 unless `folder_2` is given.
        suffix: of its libraries.
        target: its name for Zig, with the oldest supported C library.
        needs: libraries that all such machines have.
    """

    name: str
    folder: str
    suffix: str
    target: str
    needs: tuple[str, ...]
    folder_2: str = ""


SYSTEMS = (
    System(
        "Linux x86-64", "x86_64-linux", ".so", "x86_64-linux-gnu.2.17", ("-lm", "-lc"), "linux64"
    ),
    System("Windows x86-64", "x86_64-windows", ".dll", "x86_64-windows-gnu", _OF_WINDOWS, "win64"),
    System("macOS x86-64", "x86_64-darwin", ".dylib", "x86_64-macos", ("-lSystem",), "darwin64"),
    System("macOS ARM", "aarch64-darwin", ".dylib", "aarch64-macos", ("-lSystem",)),
    System("Linux ARM", "aarch64-linux", ".so", "aarch64-linux-gnu.2.17", ("-lm", "-lc")),
)


@dataclass(frozen=True)
class Compiler:
    """A compiler of shared libraries.

    Attributes:
        command: beginning of its command line.
        systems: platforms that it compiles for.
        is_zig: whether it compiles for any platform, and needs the target as an option.
    """

    command: tuple[str, ...]
    systems: tuple[System, ...]
    is_zig: bool = False

    def library(self, system: System, name: str, sources: Mapping[str, str]) -> bytes:
        """A shared library from C files.

        Raises:
            OSError: the compiler failed; with the first line of its messages.
        """
        library, files = f"{name}{system.suffix}", dict(sources)
        if self.is_zig and system.suffix == ".dll":
            files["windows-start.c"] = _START_ON_WINDOWS
        with tempfile.TemporaryDirectory() as folder:
            work = Path(folder)
            for path, text in files.items():
                (work / path).write_text(text, encoding="utf-8")
            code = [path for path in files if path.endswith(".c")]
            if self.is_zig:
                self._zig(work, system, library, code)
            else:
                self._run(work, *_OPTIONS, "-shared", "-o", library, *code, "-lm")
            return (work / library).read_bytes()

    def _zig(self, work: Path, system: System, library: str, code: Sequence[str]) -> None:
        target = ("-target", system.target)
        for path in code:
            self._run(work, "-c", *target, *_OPTIONS, *_OF_ZIG, "-o", f"{path}.o", path)
        own_name = [f"-Wl,-install_name,@rpath/{library}"] * ("macos" in system.target)
        link = ("-shared", "-nostdlib", "-s", *own_name, "-o", library)
        self._run(work, *target, *link, *(f"{path}.o" for path in code), *system.needs)

    def _run(self, work: Path, *arguments: str) -> None:
        done = subprocess.run(
            [*self.command, *arguments],
            cwd=work,
            env=os.environ
            | {"SOURCE_DATE_EPOCH": "315532800"},  # the modification time of files in the unit
            capture_output=True,
            check=False,
        )
        if done.returncode:
            words = done.stderr.decode(errors="replace").strip().split("\n", 1)[0]
            raise OSError(words[:200] or f"code {done.returncode}")


def found_compiler() -> Compiler | None:
    """Zig for all platforms, else this machine's own compiler; None if neither is installed."""
    if find_spec("ziglang") is not None:
        return Compiler((sys.executable, "-m", "ziglang", "cc"), SYSTEMS, is_zig=True)
    return own_compiler()


def own_compiler() -> Compiler | None:
    """This machine's own compiler."""
    command = next(filter(None, map(shutil.which, ("cc", "gcc", "clang"))), None)
    kind = {"AMD64": "x86_64", "arm64": "aarch64"}.get(platform.machine(), platform.machine())
    systems = tuple(s for s in SYSTEMS if s.folder == f"{kind}-{sys.platform}")
    return None if command is None else Compiler((command,), systems)


def binaries(
    name: str,
    sources: Mapping[str, str],
    version: FmiVersion,
    compiler: Compiler | None,
    progress: Progress,
) -> tuple[dict[str, bytes], str]:
    """Libraries by their path in the unit, and a warning that names systems without one."""
    if compiler is None:
        return {}, _missing((), "no C compiler was found (Zig, cc, gcc or clang)")
    if not compiler.systems:
        return {}, _missing((), "binaries for this machine are not known to FMI")

    def attempt(system: System) -> bytes | str:
        try:
            return compiler.library(system, name, sources)
        except OSError as error:
            return f"{Path(compiler.command[0]).name} failed ({error})"

    results, total = ordered(attempt, compiler.systems), len(compiler.systems)
    libraries = dict[System, bytes | str]()
    for k, system in enumerate(compiler.systems, start=1):
        progress(f"compiling {k} of {total}, {system.name}")
        libraries[system] = next(results)
    made = {system: library for system, library in libraries.items() if isinstance(library, bytes)}
    failed = next((why for why in libraries.values() if isinstance(why, str)), "")
    return _placed(name, made, version), _missing(tuple(made), failed)


def _placed(name: str, made: Mapping[System, bytes], version: FmiVersion) -> dict[str, bytes]:
    """Libraries by path; FMI 2's darwin64 holds the code for both kinds of Macs."""
    libraries = {
        f"binaries/{(system.folder_2 if version == '2' else '') or system.folder}/"
        f"{name}{system.suffix}": library
        for system, library in made.items()
    }
    macs = [library for system, library in made.items() if system.suffix == ".dylib"]
    if version == "2" and macs:
        libraries[f"binaries/darwin64/{name}.dylib"] = universal(macs) if macs[1:] else macs[0]
    return libraries


def universal(libraries: Sequence[bytes]) -> bytes:
    """One Mach-O file with the code of several processors.

    The head has big-endian words: a magic number and the number of processors; for each processor
    its type and subtype, copied from the library's head, then offset, size, and alignment of
    offsets as a power of two.
    """
    power = 14  # pages of 16 KiB, as on ARM
    offset, head, body = 1 << power, struct.pack(">II", 0xCAFEBABE, len(libraries)), b""
    for library in libraries:
        kind, subkind = struct.unpack_from("<II", library, 4)
        head += struct.pack(">IIIII", kind, subkind, offset + len(body), len(library), power)
        body += library + bytes(-len(library) % (1 << power))
    return head + bytes(offset - len(head)) + body


def _missing(made: Sequence[System], why: str) -> str:
    """A warning that names platforms without a library; empty if there are none."""
    if not (missing := [system.name for system in SYSTEMS if system not in made]):
        return ""
    seen = "the unit holds sources only"
    if made:
        there, others = ", ".join(system.name for system in made), ", ".join(missing)
        seen = f"the unit runs as it is on {there}, and from its sources on {others}"
    cure = (
        "let the importing tool compile them, as `fmpy compile` does, or export again with Zig's "
        "compiler (pip install ziglang)"
    )
    return Doubt(seen, cause=why, cure=cure)
