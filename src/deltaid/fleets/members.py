"""What a robot says of its type as a small file, so that it is worked out once."""

import json
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np

from deltaid.errors import RecordingError
from deltaid.fleets.member import Fact, Member

_ARRAYS = ("rows", "values", "shared")


def packed(member: Member) -> bytes:
    """A member as an archive of NumPy."""
    known = {
        "name": member.name,
        "names": member.names,
        "quantities": member.quantities,
        "freedom": member.freedom,
        "facts": [
            {"key": one.key, "coefficients": one.coefficients.tolist(), "value": one.value,
             "std": one.std}
            for one in member.facts
        ],
        "widened": None if member.widened is None else dict(member.widened),
        "recordings": member.recordings,
    }  # fmt: skip
    buffer = BytesIO()
    arrays: dict[str, Any] = {key: getattr(member, key) for key in _ARRAYS}
    np.savez_compressed(buffer, known=np.array(json.dumps(known)), **arrays)
    return buffer.getvalue()


def unpacked(data: bytes, where: str) -> Member:
    """The member of an archive.

    Raises:
        RecordingError: it is damaged.
    """
    try:
        with np.load(BytesIO(data), allow_pickle=False) as file:
            known: Mapping[str, Any] = json.loads(str(file["known"]))
            arrays = {key: file[key] for key in _ARRAYS}
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise RecordingError(
            f"is damaged: {error}", where=where, cure="remove it; it is made again"
        ) from None
    facts = tuple(
        Fact(one["key"], np.array(one["coefficients"]), one["value"], one["std"])
        for one in known["facts"]
    )
    return Member(
        known["name"],
        tuple(known["names"]),
        arrays["rows"],
        arrays["values"],
        arrays["shared"],
        tuple(known["quantities"]),
        known["freedom"],
        facts,
        known["widened"],
        known["recordings"],
    )
