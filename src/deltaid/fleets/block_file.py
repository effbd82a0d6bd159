"""A block of merged recordings as a file: arrays of NumPy, all else JSON, with a checksum."""

import json
from dataclasses import fields
from io import BytesIO
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from deltaid.checksum import is_intact, sealed_archive
from deltaid.fleets.block import RecordingBlock
from deltaid.fleets.drift_friction import FrictionSums
from deltaid.fleets.factor_record import FactorGroups
from deltaid.fleets.recording_brief import RecordingBrief

ENDING = ".block.npz"
# Version of the file. It counts up with anything that changes what is in it.
FORMAT = 1
_BRIEFS = TypeAdapter(tuple[RecordingBrief, ...])
_GROUPS = ("whole", "groups", "places", "geometry")
_ARRAYS = ("packed", "samples", "torque_max")


def block_bytes(block: RecordingBlock) -> bytes:
    """The file of a block."""
    arrays = {f"friction.{x.name}": getattr(block.friction, x.name) for x in fields(FrictionSums)}
    known: dict[str, Any] = {
        "fingerprint": block.fingerprint,
        "keys": block.keys,
        "counts": block.counts,
        "quantities": block.quantities,
    }
    for name in _GROUPS:
        if (groups := getattr(block, name)) is not None:
            known[name] = [groups.names, groups.sizes]
            arrays |= {f"{name}.{array}": getattr(groups, array) for array in _ARRAYS}
    texts = {"known": json.dumps(known).encode(), "briefs": _BRIEFS.dump_json(block.briefs)}
    return sealed_archive(
        **{name: np.frombuffer(text, dtype=np.uint8) for name, text in texts.items()}, **arrays
    )


def block_of(data: bytes | None) -> RecordingBlock | None:
    """The block of a file; None where there is none that is whole."""
    if not data or not is_intact(data):
        return None
    with np.load(BytesIO(data), allow_pickle=False) as file:
        arrays = dict(file)
    known = json.loads(arrays["known"].tobytes())
    groups: dict[str, Any] = {
        name: FactorGroups(
            tuple(known[name][0]),
            tuple(known[name][1]),
            *(arrays[f"{name}.{array}"] for array in _ARRAYS),
        )
        for name in _GROUPS
        if name in known
    }
    return RecordingBlock(
        known["fingerprint"],
        tuple(known["keys"]),
        _BRIEFS.validate_json(arrays["briefs"].tobytes()),
        FrictionSums(*(arrays[f"friction.{x.name}"] for x in fields(FrictionSums))),
        tuple(known["counts"]),
        *(groups[name] for name in ("whole", "groups", "places")),
        geometry=groups.get("geometry"),
        quantities=tuple(known["quantities"]),
    )
