"""Results that are a few arrays and numbers: their shapes, or all of what is small."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from deltaid.view.card import Card

# Arrays of up to so many numbers are written out; longer text is cut.
_WRITTEN, _CHARACTERS = 16, 60


def card(value: Any) -> Card:
    """Every field of a data class, or of a part of a description."""
    names = (
        [one.name for one in fields(value)] if is_dataclass(value) else [*type(value).model_fields]
    )
    facts = [(name, _said(getattr(value, name))) for name in names if not name.startswith("_")]
    return Card(type(value).__name__, (), "", tuple(facts), apart=True)


def _said(value: object) -> str:
    """Numbers, or how many of them there are."""
    if isinstance(value, np.ndarray):
        if value.size > _WRITTEN:
            return f"array of shape {value.shape}"
        return " ".join(np.array2string(value, precision=4, separator=", ").split())
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, dict | tuple | list) and len(repr(value)) > _CHARACTERS:
        few = ", ".join(str(one) for one in list(value)[:4] if isinstance(one, str))
        return f"{len(value)} entries" + (f": {few}, …" if few else "")
    text = str(value)
    return text if len(text) <= _CHARACTERS else f"{text[: _CHARACTERS - 1]}…"
