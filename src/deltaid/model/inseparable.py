"""Pairs of causes that recordings do not separate."""

from deltaid.model.verdict import listed
from deltaid.robot.part import Part


class Inseparable(Part):
    """Two causes of the same torques, of which the recordings may have either, or some of both.

    Attributes:
        causes: the one that the model has, and the other.
        subjects: drives that they are of; empty for the robot.
        is_counted: whether intervals count both; else they take the second as described.
    """

    causes: tuple[str, str]
    subjects: tuple[str, ...] = ()
    is_counted: bool = True

    @property
    def text(self) -> str:
        """The pair as a sentence."""
        whose = f" ({listed(list(self.subjects))})" if self.subjects else ""
        kept, other = self.causes
        counted = "intervals count both" if self.is_counted else f"intervals rest on {other}"
        return f"The recordings do not separate {kept} from {other}{whose}; {counted}."
