"""Readings of a live view as a small table: drives, condition, and how much of each limit is used.

It colours itself with the page around it, light or dark.
"""

from functools import cache

from jinja2 import Environment, PackageLoader, Template

from deltaid.view import style
from deltaid.view.at_pose import View

_COLORS = {"good": style.RESIDUAL, "near": "#b59400", "over": style.LIMIT}
_DECIMALS = {"deg": 1, "m": 4, "N": 1}


def panel(view: View) -> str:
    """HTML of a view's readings."""
    return _template().render(view=view, colors=_COLORS)


@cache
def _template() -> Template:
    environment = Environment(
        loader=PackageLoader("deltaid", "view"), autoescape=True, trim_blocks=True
    )
    environment.filters["reading"] = _reading
    return environment.get_template("panel.html.jinja")


def _reading(value: float, unit: str = "") -> str:
    """A number that does not jump: as many decimals whatever its size, and no zero with a sign."""
    digits = _DECIMALS.get(unit, 2)
    return f"{round(value, digits) + 0.0:.{digits}f} {unit}".rstrip()
