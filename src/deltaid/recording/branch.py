"""Whether a recording stays on one branch of the forward kinematics: no singularity is crossed."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.mechanism.kinematics import Kinematics, Regularity

# A step of the platform so many times longer than the drives' step can make it is a jump; steps of
# the drives below the resolution of an encoder [rad or m] prove nothing.
_JUMP, _STILL = 10.0, 1e-6


@dataclass
class BranchCheck:
    """Running check of consecutive samples."""

    kinematics: Kinematics
    last: tuple[float, np.ndarray, np.ndarray, float] | None = None

    def add(
        self,
        time: Float[np.ndarray, " rows"],
        q: Float[np.ndarray, "rows dof"],
        z: Float[np.ndarray, "rows dof"],
        regular: Regularity,
    ) -> tuple[int, str] | None:
        """The first sample that is not on the branch of the one before it, and what is wrong.

        With T = J⁻¹ a step Δq moves the platform by about T Δq. A determinant of J that changes its
        sign between two samples has been zero in between.
        """
        sign = np.sign(regular.determinant)
        if self.last is None:
            self.last = float(time[0]), q[0], z[0], float(sign[0])
        t0, q0, z0, sign0 = self.last
        self.last = float(time[-1]), q[-1], z[-1], float(sign[-1])
        flipped = np.diff(sign, prepend=sign0) != 0
        lengths = np.array(self.kinematics.mechanism.lengths)
        moved = np.linalg.norm(np.diff(z * lengths, axis=0, prepend=z0[None] * lengths), axis=1)
        driven = np.linalg.norm(np.diff(q, axis=0, prepend=q0[None]), axis=1)
        jumped = moved > _JUMP * regular.gain * (driven + _STILL)
        bad = np.flatnonzero(flipped | jumped)
        if not bad.size:
            return None
        i = int(bad[0])
        before = float(time[i - 1]) if i else t0
        what = (
            f"the robot passes through a singular pose between {before:.6g} s and {time[i]:.6g} s"
            if flipped[i]
            else f"the platform jumps by {moved[i]:.4g} m at {time[i]:.6g} s while the drives "
            f"hardly move: the loops close on another branch there"
        )
        return i, what
