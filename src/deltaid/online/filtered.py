"""First-order filters of signals that are straight lines, or constant, between two samples.

    y' = K (x − y)

is solved exactly over a sample of length h: with a = e^(−Kh) and g = (1 − a) / (Kh),

    y_{k+1} = a y_k + (1 − g) x_{k+1} + (g − a) x_k     for straight lines,
    y_{k+1} = a y_k + (1 − a) x_k                       for x held from k to k + 1.

One number is kept for each signal, s_k = a y_k + (what x_k adds), so that
y_{k+1} = s_k + … x_{k+1}.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Lowpass:
    """A first-order filter at one rate.

    Attributes:
        a: what is left of its output after a sample.
        now, before: weights of a signal's samples at either end.
    """

    a: float
    now: float
    before: float

    @classmethod
    def lines(cls, corner: float, period: float) -> "Lowpass":
        """For signals that are straight between samples.

        Args:
            corner: K [1/s].
            period: h [s].
        """
        a = float(np.exp(-corner * period))
        g = -float(np.expm1(-corner * period)) / (corner * period)
        return cls(a, 1 - g, g - a)

    @classmethod
    def held(cls, corner: float, period: float) -> "Lowpass":
        """For signals that stay from one sample to the next."""
        a = float(np.exp(-corner * period))
        return cls(a, 0.0, 1 - a)

    def output(self, kept: ca.SX, x: ca.SX) -> ca.SX:
        """y of this sample, from what the last one kept."""
        return kept + self.now * x

    def keep(self, output: ca.SX, x: ca.SX) -> ca.SX:
        """What is kept for the next sample."""
        return self.a * output + self.before * x
