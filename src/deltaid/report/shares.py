"""What intervals come from: noise, the prior, geometry, or what torques do not show."""

from collections.abc import Sequence

import numpy as np

from deltaid.model.parameter_record import Parameter, Share
from deltaid.model.record import IdentifiedModel
from deltaid.report.table import Table

_SOURCES = ("noise", "prior", "geometry", "not shown")
# A source that makes so much of an interval decides it.
_DECIDES = 0.5


def share_table(model: IdentifiedModel) -> Table | None:
    """Shares of the intervals of all parameters that the data decided, and of base parameters.

    None for a model of an earlier version, which does not know them.
    """
    shown = [(p.name, p.share) for p in _decided(model.parameters)]
    shown += [(f"base: {b.representative}", b.share) for b in model.base_parameters]
    rows = tuple((name, *_percents(share)) for name, share in shown if share is not None)
    if not rows:
        return None
    return Table(
        ("interval of", *_SOURCES),
        rows,
        "How much of each interval, by its squared width, comes from the noise of the recordings, "
        "from how far the prior may be off, from lengths, zeros of drives and mounting within "
        "their tolerances, and from what torques do not show: there it ends where a body would no "
        "longer be possible. Longer recordings shrink the first only. Base parameters have noise "
        "and geometry alone; each is named by its first term.",
    )


def shares_sentence(model: IdentifiedModel) -> str:
    """The same in one sentence; empty for a model of an earlier version."""
    parts = [(p.name, p.share) for p in _decided(model.parameters) if p.share is not None]
    if not parts:
        return ""
    middle = np.mean([_numbers(share) for _, share in parts], axis=0)
    told = ", ".join(f"{100 * x:.0f} % {name}" for x, name in zip(middle, _SOURCES, strict=True))
    most = [name for name, share in parts if share.geometry > _DECIDES]
    rest = f"; mostly geometry: {', '.join(most)}" if most else ""
    return f"intervals come in the mean from: {told}{rest}"


def _decided(parameters: Sequence[Parameter]) -> list[Parameter]:
    return [p for p in parameters if p.determined_by == "data" and p.share is not None]


def _numbers(share: Share) -> list[float]:
    return [share.noise, share.prior, share.geometry, share.unseen]


def _percents(share: Share) -> list[str]:
    """In whole per cent; what is less is said to be."""
    return [f"{100 * x:.0f} %" if x >= 0.005 or x == 0 else "< 1 %" for x in _numbers(share)]
