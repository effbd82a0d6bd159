"""Positions of motors behind gears that wind up, turned back to those of the links.

A gear of compliance s lets its motor go ahead by s τ_g, τ_g the torque that it carries:

    q = q_motor − s τ_g,   τ_g = τ − viscous q̇ − coulomb sign(q̇) − rotor q̈

the *measured* torque without the motor's own friction and rotor, low-passed. (With the torque of a
model, which follows from q̈, the iteration diverges.) Friction and rotor see the motor's motion; a
model of rigid gears has but the link's. So torques become those of a motor that moves as the link
does: friction of the motor's speed is taken out of them, that of the link's put in.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter1d

from deltaid.recording.columns import Columns, Rows
from deltaid.recording.filter import LowPass, design_low_pass
from deltaid.recording.table import AT_ONCE, recut

Values = Float[np.ndarray, "samples drives"]

# Rows put right at once are so many times the filter's length at least.
_LONG = 4
# Periods of the cut-off after which 3 % is left of what the second derivative makes of a step.
_PERIODS = 2


@dataclass(frozen=True)
class Gears:
    """Gears of all drives.

    Attributes:
        compliance: s [rad/(N m) or m/N]; 0 for a stiff one.
        viscous, coulomb, rotor: of the motors, on their own side of the gears.
        cutoff: of the low-pass over what gears carry [Hz].
    """

    compliance: tuple[float, ...]
    viscous: tuple[float, ...]
    coulomb: tuple[float, ...]
    rotor: tuple[float, ...]
    cutoff: float

    def low_pass(self, rate: float) -> LowPass:
        """The filter of what gears carry, in one stage."""
        return design_low_pass(self.cutoff, rate, single=True)

    def of_motor(self, qd: Values, qdd: Values) -> Values:
        """Torques of the motors' own friction and rotors."""
        friction = np.array(self.viscous) * qd + np.array(self.coulomb) * np.sign(qd)
        return friction + np.array(self.rotor) * qdd

    def less(self, qd: Values, qdd: Values, ahead: Values, faster: Values) -> Values:
        """How much more a motor takes than one that moves as the link does.

        Args:
            qd, qdd: of the motor.
            ahead, faster: its speed and acceleration less those of the link.
        """
        return self.of_motor(qd, qdd) - self.of_motor(qd - ahead, qdd - faster)

    def turned_back(self, segment: Iterable[Rows], columns: Columns, rate: float) -> Iterator[Rows]:
        """Rows of a segment with the links' motion, in constant memory; fewer at both ends.

        Args:
            segment: evenly spaced rows in blocks: `columns`, then a weight a drive.
            columns: what stands where.
            rate: samples per second.
        """
        low_pass = self.low_pass(rate)
        lost = 2 * low_pass.margin
        size = max(AT_ONCE, _LONG * len(low_pass.first))
        for wide in recut(segment, size, 2 * lost):
            if len(wide) > 2 * lost:
                yield self._rows(wide, columns, low_pass)

    def _rows(self, wide: Rows, columns: Columns, low_pass: LowPass) -> Rows:
        """All rows but those that the filters take at both ends."""
        dof, lost = len(self.compliance), low_pass.margin
        q, inner = wide[:, 1 : 1 + dof], slice(lost, len(wide) - lost)
        qd, qdd = convolved(low_pass.first, q), convolved(low_pass.second, q)
        tau = wide[inner, columns.torque_places] - self.of_motor(qd, qdd)
        out = wide[2 * lost : len(wide) - 2 * lost].copy()
        wound = [self.compliance * convolved(taps, tau)
                 for taps in (low_pass.level, low_pass.first, low_pass.second)]  # fmt: skip
        recorded = (columns.position, columns.velocity, columns.acceleration)
        kept = [by for by, channels in zip(wound, recorded, strict=True) if channels]
        out[:, columns.motion_places] -= np.hstack(kept)
        motion = [x[lost : len(x) - lost] for x in (qd, qdd)]
        out[:, columns.torque_places] -= self.less(*motion, *wound[1:])
        # While a robot rests or brakes hold it, gears need not carry what its drives exert.
        idle, reach = (
            wide[:, -dof:].max(axis=1) == 0.0,
            round(_PERIODS * low_pass.rate / self.cutoff),
        )
        unknown = maximum_filter1d(idle, 2 * reach + 1)
        out[unknown[2 * lost : len(wide) - 2 * lost], -dof:] = 0.0
        return out


def convolved(taps: Float[np.ndarray, " taps"], x: Values) -> Float[np.ndarray, "fewer drives"]:
    """Convolution of each column where the taps fit entirely, by Fourier transform."""
    count = len(x) - len(taps) + 1
    if count <= 0:
        return x[:0]
    size = 1 << (len(x) - 1).bit_length()
    product = np.fft.rfft(x, size, axis=0) * np.fft.rfft(taps, size)[:, None]
    return np.fft.irfft(product, size, axis=0)[len(taps) - 1 : len(x)]
