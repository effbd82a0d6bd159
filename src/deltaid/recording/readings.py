"""What a drive's encoder and amplifier say, and what its position and torque are.

    q = (1 + r) q_m + q_0,    τ = τ_m (1 − β_2 u² − β_4 u⁴),   u = τ_m / τ_max

with a gear ratio that is off by r, a zero that is off by q_0, and a torque constant that falls with
current, so that the joint lacks the share β_2 + β_4 at τ_max.
"""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from deltaid.robot.part import Part

if TYPE_CHECKING:
    from deltaid.recording.columns import Columns

Rows = Float[np.ndarray, "_ _"]
Torque = Float[np.ndarray, "samples dof"]

# By what share of the torque for little current a motor's torque grows at least.
LEAST_SLOPE = 0.1
# Steps of Newton's method.
_ROUNDS = 12


class Readings(Part):
    """Of all drives; empty tuples where nothing is off.

    Attributes:
        zero: q_0 [rad or m].
        ratio: r.
        falling: β_2 and β_4.
        largest: τ_max [N m or N].
    """

    zero: tuple[float, ...] = ()
    ratio: tuple[float, ...] = ()
    falling: tuple[tuple[float, float], ...] = ()
    largest: tuple[float, ...] = ()

    @property
    def are_right(self) -> bool:
        """Whether nothing is off."""
        return not (self.zero or self.ratio or self.falling)

    def corrected(self, rows: Rows, columns: "Columns") -> Rows:
        """Rows with positions and torques as they are."""
        rows = rows.copy()
        if self.ratio:
            motion = rows[:, columns.motion_places]
            motion *= np.tile(1.0 + np.array(self.ratio), motion.shape[1] // len(self.ratio))
        if self.zero:
            rows[:, 1 : 1 + len(self.zero)] += self.zero
        if self.falling:
            torque = rows[:, columns.torque_places]
            torque *= self._share(torque)[0]
        return rows

    def recorded(self, torque: Torque) -> Torque:
        """τ_m of torques τ, none beyond τ_max, by Newton's method."""
        if not self.falling:
            return torque
        out, highest = torque, np.array(self.largest)
        for _ in range(_ROUNDS):
            share, slope = self._share(out)
            step = (out * share - torque) / np.maximum(slope, LEAST_SLOPE)
            out = np.clip(out - step, -highest, highest)
        return out

    def _share(self, torque: Torque) -> tuple[Torque, Torque]:
        """τ / τ_m, and dτ / dτ_m."""
        squared = (torque / np.array(self.largest)) ** 2
        second, fourth = np.array(self.falling).T
        share = 1.0 - second * squared - fourth * squared**2
        return share, share - 2.0 * second * squared - 4.0 * fourth * squared**2
