"""Every error says where it is and how to mend it."""

import ast
import copy
from pathlib import Path

import deltaid
from deltaid import errors
from deltaid.errors import RecordingError

ERRORS = [name for name in vars(errors) if name.endswith("Error")]


def _raised() -> list[tuple[str, set[str], str]]:
    """Place, keywords and text of all errors that reading, writing and commands may raise."""
    found, package = [], Path(deltaid.__file__).parent
    for path in sorted(package.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ERRORS and node.args:
                keywords = {keyword.arg or "" for keyword in node.keywords}
                found.append((f"{path.name}:{node.lineno}", keywords, ast.unparse(node.args[0])))
    return found


OF_A_FIT = ("base_parameters.py", "conic.py", "fit.py")


def test_every_error_says_where_and_how_to_mend_it() -> None:
    """The cure may be in the sentence itself: what must be, or what to give instead."""
    raised = _raised()
    assert len(raised) > 80
    for place, keywords, what in raised:
        named = "where" in keywords or "called '" in what
        # `fit` tells the recordings of what goes wrong in it.
        assert named or place.split(":")[0] in OF_A_FIT, place
        assert "cure" in keywords or "must " in what or "give " in what, place


def test_errors_come_back_whole_from_another_process() -> None:
    error = RecordingError("is empty", where="log.csv", cure="record again")
    again = copy.copy(error)  # as pickle takes it apart and puts it together
    assert (type(again), str(again)) == (RecordingError, str(error))
