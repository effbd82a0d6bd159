"""Progress of long work, shown in a terminal or a notebook, or reported to a function."""

import html
import re
import sys
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from datetime import timedelta
from typing import TYPE_CHECKING, Any

from deltaid.errors import visible

if TYPE_CHECKING:
    from rich.console import Console

# Called with a sentence before each stage.
Progress = Callable[[str], None]
# A function that is called; True or False to show progress or not; None to show it in interactive
# sessions.
Watch = Progress | bool | None

_BAR = (
    '<div style="font-size:.9em;opacity:.8"><progress style="width:8em;vertical-align:middle"'
    "{value}></progress> {text}</div>"
)


@contextmanager
def watched(watch: Watch, title: str) -> Generator[Progress, None, None]:
    """A function to call with each stage, which shows it as `watch` says.

    A stage such as "start 3 of 8" moves the bar; one without numbers only shows activity. The
    display disappears at the end, also after a failure.
    """
    if callable(watch):
        yield watch
    elif watch is False or (watch is None and not (_in_notebook() or _at_prompt())):
        yield lambda _: None
    elif _in_notebook():
        yield from _shown_in_notebook(title)
    else:
        from rich.console import Console

        yield from shown_in_terminal(Console(stderr=True), f"{title}: ")


def _shell() -> Any:
    """IPython's shell if this runs in one, without importing IPython."""
    ipython = sys.modules.get("IPython")
    return ipython.get_ipython() if ipython is not None else None


def _in_notebook() -> bool:
    """Whether output goes to a notebook: IPython's shell has a kernel."""
    return hasattr(_shell(), "kernel")


def _at_prompt() -> bool:
    """Whether this is an interactive session in a terminal, of Python or IPython."""
    return (hasattr(sys, "ps1") or _shell() is not None) and sys.stderr.isatty()


def share_of(text: str) -> float | None:
    """Progress from a text such as '3 of 8', as a share; None if it has no such numbers."""
    stated = re.search(r"(?<!\S)(\d+) of (\d*[1-9]\d*)(?!\S)", text)
    return int(stated[1]) / int(stated[2]) if stated else None


def _shown_in_notebook(title: str) -> Generator[Progress, None, None]:
    """An HTML progress bar, updated at each stage: those of rich and tqdm need ipywidgets."""
    from IPython.display import display

    def bar(text: str) -> dict[str, str]:
        said, share = f"{title}: {text}", share_of(text)
        value = "" if share is None else f' value="{share:.3f}"'
        shown = _BAR.format(value=value, text=html.escape(said))
        return {"text/plain": said, "text/html": shown}

    handle: Any = display(bar("starting"), raw=True, display_id=True)
    try:
        yield lambda text: handle.update(bar(text), raw=True)
    finally:
        handle.update({"text/plain": "", "text/html": ""}, raw=True)


def shown_in_terminal(console: "Console", title: str = "") -> Generator[Progress, None, None]:
    """A progress bar with the time since the start, the time left where stages have numbers, and
    the stage after a title."""
    from rich.progress import BarColumn, Task, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars
    from rich.text import Text

    begin = time.monotonic()

    class Times(TimeRemainingColumn):
        """Time since the start, and the time left of a stage where it is known."""

        def render(self, task: Task) -> Text:
            passed = Text(str(timedelta(seconds=int(time.monotonic() - begin))))
            if task.time_remaining:
                passed.append(" ").append(super().render(task)).append(" left")
            return passed

    columns = BarColumn(bar_width=16), Times(), TextColumn("{task.description}", markup=False)
    with Bars(*columns, console=console, transient=True) as bars:
        task, stage = bars.add_task(f"{title}starting", total=None), ""

        def say(text: str, /) -> None:
            nonlocal task, stage
            word, share = text.partition(" ")[0], share_of(text)
            is_new = word != stage
            said = visible(f"{title}{text}")
            if is_new:  # time left is estimated from this stage alone
                bars.remove_task(task)
                task, stage = bars.add_task(said, total=None if share is None else 1.0), word
            bars.update(task, description=said, completed=share or 0.0, refresh=is_new)

        yield say
