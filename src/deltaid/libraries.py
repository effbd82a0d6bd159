"""Optional libraries that only some commands need."""

from importlib.util import find_spec

from deltaid.errors import DeltaidError


def require(module: str, *, by: str, name: str, install: str) -> None:
    """Check that a library is installed, without importing it.

    Args:
        module: its name in Python.
        by: the command or option that needs it.
        name: its name in words.
        install: the command that installs it.
    Raises:
        DeltaidError: the library is not installed.
    """
    if find_spec(module) is None:
        raise DeltaidError(f"needs {name}, which is not installed", where=by, cure=install)
