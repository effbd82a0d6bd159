"""What decided a number: torques, sensors, measured values, prior, geometry, effects, nothing."""

from collections.abc import Sequence

import numpy as np

from deltaid.model.parameter_record import Parameter, Share
from deltaid.model.record import IdentifiedModel
from deltaid.view.table import Table

_SOURCES = {
    "noise": "torques",
    "sensors": "sensors",
    "measured": "measured values",
    "prior": "prior",
    "geometry": "geometry and effects",
    "unseen": "not shown",
}
# Left out where a model has nothing of it.
_BESIDE = ("sensors", "measured")
# A source that makes so much of an interval decides it.
_DECIDES = 0.5


def share_table(model: IdentifiedModel) -> Table | None:
    """Shares of the intervals of all parameters that the data decided, and of base parameters.

    None for a model of an earlier version, which does not know them.
    """
    shown = [(p.name, p.share) for p in _decided(model.parameters)]
    shown += [(f"base: {b.representative}", b.share) for b in model.base_parameters]
    known = [(name, share) for name, share in shown if share is not None]
    if not known:
        return None
    keys = _keys([share for _, share in known])
    beside = [_SOURCES[key] for key in keys if key in _BESIDE]
    more = f", of {' and of '.join(beside)}" if beside else ""
    return Table(
        ("what decided", *(_SOURCES[key] for key in keys)),
        tuple((name, *_percents(share, keys)) for name, share in known),
        f"How much of each interval, by its squared width, comes from the noise of torques{more}, "
        "from how far the prior may be off, from lengths, zeros of drives, mounting and torque "
        "constants within their tolerances and effects that rows do not decide, and from what "
        "nothing shows: there it ends where a body would no longer be possible. Of several "
        "sources with noise, each has the share that it has in the value too. Longer recordings "
        "shrink the noise of torques and sensors only. Base parameters have no prior; each is "
        "named by its first term.",
    )


def shares_sentence(model: IdentifiedModel) -> str:
    """The same in one sentence; empty for a model of an earlier version."""
    parts = [(p.name, p.share) for p in _decided(model.parameters) if p.share is not None]
    if not parts:
        return ""
    keys = _keys([share for _, share in parts])
    middle = np.mean([_numbers(share, keys) for _, share in parts], axis=0)
    told = ", ".join(
        f"{100 * x:.0f} % {_SOURCES[key]}" for x, key in zip(middle, keys, strict=True)
    )
    most = [name for name, share in parts if share.geometry > _DECIDES]
    rest = f"; mostly geometry and effects: {', '.join(most)}" if most else ""
    return f"intervals come in the mean from: {told}{rest}"


def _decided(parameters: Sequence[Parameter]) -> list[Parameter]:
    known = ("data", "measured")
    return [p for p in parameters if p.determined_by in known and p.share is not None]


def _keys(shares: Sequence[Share]) -> list[str]:
    """The sources that are told of."""
    return [
        key for key in _SOURCES if key not in _BESIDE or any(getattr(one, key) for one in shares)
    ]


def _numbers(share: Share, keys: Sequence[str]) -> list[float]:
    return [getattr(share, key) for key in keys]


def _percents(share: Share, keys: Sequence[str]) -> list[str]:
    """In whole per cent; what is less is said to be."""
    return [f"{100 * x:.0f} %" if x >= 0.005 or x == 0 else "< 1 %" for x in _numbers(share, keys)]
