"""A recording under the columns that explain it best, which all verdicts on wiring look at."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deltaid.check.evidence import Evidence
from deltaid.check.wiring.candidate import SLIDING, TURNING, Candidate
from deltaid.check.wiring.cures import Entries
from deltaid.check.wiring.motion import Motion
from deltaid.check.wiring.residual import Map
from deltaid.check.wiring.scale import overall, ratios, unit_of
from deltaid.check.wiring.velocity import Rate, rates
from deltaid.model.words import listed, percent
from deltaid.recording.mapping import Quantity

# Torques so many times larger or smaller than the prior's are in another unit, or may be.
WRONG_SCALE, DOUBTFUL_SCALE = 4.0, 2.5
# Correlation with the prior's torque of a drive whose own scale is worth asking for.
_GOES = 0.6


@dataclass(frozen=True, eq=False)
class Case:
    """A recording under the columns that explain it best.

    Attributes:
        motion: the stretch that was looked at.
        good: the hypotheses that explain it equally well, the simplest first.
        entries: of the mapping.
    """

    evidence: Evidence
    motion: Motion
    good: tuple[Candidate, ...]
    entries: Entries

    @property
    def best(self) -> Candidate:
        return self.good[0]

    @property
    def names(self) -> tuple[str, ...]:
        return self.evidence.robot.drives

    @property
    def along(self) -> float:
        """Least correlation of a moving drive's torque with that of the prior."""
        return float(self.best.along[~self.best.residual.still].min(initial=1.0))

    @cached_property
    def ratios(self) -> np.ndarray:
        """Torques over those of the prior, by drive and component."""
        return ratios(self.evidence.dynamics, self.motion, self.best)

    @property
    def untied(self) -> list[int]:
        """Drives that no limb ties to others: of a telescope if its torque goes with its motion."""
        last = len(self.names) - 1
        if last == 0:
            return [0]
        turns = self.evidence.robot.telescope is not None and bool(self.best.loose[last])
        return [last] if turns and self.best.along[last] > _GOES else []

    @cached_property
    def units(self) -> dict[int, float]:
        """Factors of units that only the prior tells, of drives that nothing ties to others."""
        found = {i: unit_of(self.ratios[i], self._beyond(i), self.named(i)) for i in self.untied}
        return {i: unit for i, unit in found.items() if unit != 1}

    def _beyond(self, i: int) -> float:
        """How many times a drive goes beyond what is described of its speed or workspace."""
        robot, scale = self.evidence.robot, abs(self.best.map.scale[i])
        limits = robot.drive_limits.get(self.names[i])
        top = limits.top_speed if limits else None
        fast = scale * float(np.abs(self.motion.qd[:, i]).max()) / top if top else 0.0
        if len(self.names) > 1 or not self.linear(i):
            return fast
        _, half = robot.within(0.0)
        return max(fast, scale * float(np.ptp(self.motion.q[:, i]) / (2 * half[0])))

    @property
    def map(self) -> Map:
        """Of the positions, with these units."""
        map = self.best.map
        for i, unit in self.units.items():
            map = map.times(unit, [i])
        return map

    def linear(self, drive: int) -> bool:
        return self.evidence.robot.is_linear(self.names[drive])

    def named(self, drive: int) -> dict[float, str]:
        """Units that its positions may be in, by factor."""
        return SLIDING if self.linear(drive) else TURNING

    def whose(self, drives: list[int]) -> str:
        """A subject: empty for all drives."""
        return "" if len(drives) == len(self.names) else ", ".join(self.names[i] for i in drives)

    def all_or(self, drives: list[int]) -> str:
        """The drives in a sentence."""
        every = len(drives) == len(self.names) > 1
        return "all drives" if every else listed([self.names[i] for i in drives])

    @property
    def fits(self) -> str:
        """How well the best hypothesis explains the recording."""
        return f"leaves {percent(self.best.left)} of the torques unexplained"

    @cached_property
    def _rates(self) -> tuple[Rate, ...]:
        return rates(self.motion, Map.identity(len(self.names)))

    def follow(self, drives: list[int]) -> tuple[Quantity, ...]:
        """Positions; and velocities, where they are their derivatives as mapped, and so change
        with them."""
        own = (0.8 < rate.scale < 1.25 for rate in self._rates if rate.drive in drives)
        return ("position", "velocity") if self._rates and all(own) else ("position",)

    def of_motors(self, factor: float) -> bool:
        """Whether torques are too small by the gear that positions are too large by."""
        size = overall(self.ratios)
        return size < 1 / DOUBTFUL_SCALE and 0.25 < size / factor < 4
