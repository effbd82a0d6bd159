"""Compliances of gears that wind up, and what they are as corrections."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.effects.windings import Compliance, Groups
from deltaid.estimation.drive_rows import STRETCHES
from deltaid.estimation.scatter import quantile
from deltaid.model.corrections import Correction
from deltaid.robot.description import RobotDescription

# A compliance counts that is so many standard deviations, and looks like a lag from a correlation.
_SIGNIFICANT, _ALIKE = 5.0, 0.9

Sizes = Float[np.ndarray, " groups"]


@dataclass(frozen=True, eq=False)
class Windup:
    """Compliances of all gears."""

    values: Compliance  # s of every drive [rad/(N m) or m/N]
    groups: Groups  # which drives have each of the sizes that were searched, ones and zeros
    # sizes, covariance: of these
    sizes: Sizes
    covariance: Float[np.ndarray, "groups groups"]
    like_lag: Sizes  # how far the size of each correlates with its drives' lags, between 0 and 1
    p: Parameters  # parameters of the robot that go with them

    @property
    def deviation(self) -> Sizes:
        return np.sqrt(np.diag(self.covariance))

    @property
    def significant(self) -> Bool[np.ndarray, " groups"]:
        """Which sizes are none by chance."""
        return self.sizes > _SIGNIFICANT * self.deviation

    def estimated(self, deviation: Compliance) -> "Windup":
        """The same with compliances that were estimated elsewhere, drive by drive, those of which
        are 0 that are stated."""
        drives = np.flatnonzero((self.values > 0) & (deviation > 0))
        own = np.diag(deviation[drives] ** 2)
        groups, unlike = np.eye(len(self.values))[:, drives], np.zeros(len(drives))
        return replace(
            self, groups=groups, sizes=self.values[drives], covariance=own, like_lag=unlike
        )

    def corrections(self, robot: RobotDescription) -> list[Correction]:
        """One a drive whose gear winds up."""
        corrections = list[Correction]()
        wide = float(quantile(np.array([STRETCHES - 1.0]))[0])
        for i in np.flatnonzero(self.values):
            s, drive = float(self.values[i]), robot.drives[i]
            unit, inverse = ("m/N", "N/m") if robot.is_linear(drive) else ("rad/(N m)", "N m/rad")
            evidence, low, high = ", as stated", None, None
            for k in np.flatnonzero(self.groups[i]).tolist():
                half = wide * float(self.deviation[k])
                evidence, low, high = self._evidence(k), s - half, s + half
            text = (
                f"its gear winds up by what it carries over {1 / s:.3g} {inverse}{evidence}; "
                "positions are those of the link"
            )
            corrections.append(
                Correction(kind="compliance", subject=drive, value=s, low=low, high=high, unit=unit,
                           text=text)
            )  # fmt: skip
        return corrections

    def _evidence(self, k: int) -> str:
        """How the k-th size is known."""
        text = f", {self.sizes[k] / self.deviation[k]:.0f} standard deviations with a free lag"
        if self.groups[:, k].sum() > 1:
            text += ", one for all limbs"
        if self.like_lag[k] > _ALIKE:
            text += "; this motion hardly separates it from a lag of the torques "
            text += f"(correlation {self.like_lag[k]:.2f})"
        return text
