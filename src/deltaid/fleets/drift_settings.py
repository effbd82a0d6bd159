"""Settings of drift."""

from dataclasses import dataclass
from datetime import datetime
from typing import Literal

from deltaid.errors import DeltaidError


@dataclass(frozen=True)
class DriftSettings:
    """Settings of the search for drift.

    Attributes:
        limit: friction that is too much, as a share of what it was before the change (1.5) or as a
            mean torque [N m or N]; None if not given.
        limit_is: which of both.
        false_alarms: a robot may have so many a year, over all of its drives.
        since: earlier recordings are excluded, such as those before a repair.
    """

    limit: float | None = None
    limit_is: Literal["share", "torque"] = "share"
    false_alarms: float = 0.1
    since: datetime | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that cannot be.

        Raises:
            DeltaidError: a limit that is passed already, or no false alarm at all.
        """
        lowest = 1.0 if self.limit_is == "share" else 0.0
        if self.limit is not None and not self.limit > lowest:
            raise DeltaidError(
                f"must be above {lowest:g}, not {self.limit:g}",
                where="limit",
                cure="give a share of the friction before the change, such as 1.5, or a torque",
            )
        if not 0.0 < self.false_alarms <= 10.0:
            raise DeltaidError(
                f"must be above 0 and at most 10, not {self.false_alarms:g}",
                where="false_alarms",
                cure="give how many false alarms a robot may have in a year, such as 0.1",
            )
