"""The chapter of a page on all that an identification put right, found and left out."""

from deltaid.model.record import IdentifiedModel
from deltaid.view.page import Section
from deltaid.view.put_right import put_right_tables

# Events that a page lists.
_EVENTS = 200


def put_right_sections(model: IdentifiedModel | None) -> tuple[Section, ...]:
    """The chapter of a page on it; none where nothing was put right."""
    tables = put_right_tables(model, _EVENTS) if model else ()
    return (
        (Section("Corrections", tables, "what was found, put right and left out"),)
        if tables
        else ()
    )
