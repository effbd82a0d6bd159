"""deltaid: physically consistent dynamic models of Delta-like robots, identified from recordings.

    robot = deltaid.load_robot("irb360-6-1600")         # or your own YAML file
    result = deltaid.identify(robot, ["log.csv"])
    result.model.save("model.yaml")

    dynamics = deltaid.Dynamics(robot)
    tau = dynamics.inverse_dynamics(q, qd, qdd, result.model.p)

Names are imported on first use, so `import deltaid` itself is fast.
"""

import re
from importlib import import_module
from pkgutil import get_data

from deltaid import forked as forked  # registers its fork handlers

# The module of each public name, from the stub that editors and type checkers read.
_STUB = (get_data(__name__, "__init__.pyi") or b"").decode()
_IMPORTS: list[tuple[str, str]] = re.findall(r"^from (\S+) import (\w+)", _STUB, re.MULTILINE)
_HOME = {name: module for module, name in _IMPORTS}
# Names of earlier versions and their present names.
_RENAMED = {"verdicts": "check", "write_export": "export"}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    if name == "__version__":
        return import_module("importlib.metadata").version("deltaid")
    name = _RENAMED.get(name, name)
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    if name.startswith("_"):  # probed by Python itself, which handles the AttributeError
        raise AttributeError(f"module 'deltaid' has no attribute '{name}'")
    errors = import_module("deltaid.errors")
    hint = errors.nearest(name, __all__, 0.5)
    raise errors.UnknownFunctionError(
        f"module 'deltaid' has no attribute '{name}'", cure=f"{hint}dir(deltaid) lists all names"
    )


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
