"""Whether a recording stays on one branch of the forward kinematics: no singularity is crossed."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.regularity import Regularity, passages

# A step of the platform so many times longer than the drives' step can make it is a jump; steps of
# the drives below the resolution of an encoder [rad or m] prove nothing.
_JUMP, _STILL = 10.0, 1e-6

# Condition number of J beyond which a robot without a closed form may have gone on to another
# branch unseen: steps δ of an encoder turn a passage, where 1/cond is 0, into one of about √δ.
_LOST = 200.0

# A passage shows in two samples before it and two after it, so three are carried on.
_CARRIED = 3


@dataclass(frozen=True)
class _Stretch:
    """Consecutive samples: times, drives, poses, and how regular these are."""

    time: Float[np.ndarray, " rows"]
    q: Float[np.ndarray, "rows dof"]
    z: Float[np.ndarray, "rows dof"]
    regular: Regularity

    def after(self, other: "_Stretch") -> "_Stretch":
        """The samples of both, the other's first."""
        return _Stretch(
            np.concatenate([other.time, self.time]),
            np.concatenate([other.q, self.q]),
            np.concatenate([other.z, self.z]),
            Regularity(*map(np.concatenate, zip(other.fields, self.fields, strict=True))),
        )

    def last(self, count: int) -> "_Stretch":
        """The last samples."""
        regular = Regularity(*(values[-count:] for values in self.fields))
        return _Stretch(self.time[-count:], self.q[-count:], self.z[-count:], regular)

    @property
    def fields(self) -> tuple[Float[np.ndarray, " rows"], ...]:
        r = self.regular
        return r.condition, r.determinant, r.gain, r.hold


@dataclass
class BranchCheck:
    """Running check of consecutive samples."""

    kinematics: Kinematics
    carried: _Stretch | None = None

    def add(
        self,
        time: Float[np.ndarray, " rows"],
        q: Float[np.ndarray, "rows dof"],
        z: Float[np.ndarray, "rows dof"],
        regular: Regularity,
    ) -> tuple[int, str] | None:
        """The first sample that is not on the branch of the one before it, and what is wrong.

        With T = J⁻¹ a step Δq moves the platform by about T Δq. A determinant of J that changes its
        sign between two samples has been zero in between. Without a change of sign, z(q) may have
        turned back where the robot went on (`passages`), or may have where J is next to singular.
        The sample is counted from the first one of this call; it is negative if it lies before.
        """
        now = _Stretch(time, q, z, regular)
        carried = 0 if self.carried is None else len(self.carried.time)
        if self.carried is not None:
            now = now.after(self.carried)
        self.carried = now.last(_CARRIED)
        mechanism = self.kinematics.mechanism
        lost = _LOST if mechanism.forward is None else np.inf
        found = _first(now, np.array(mechanism.lengths), lost)
        return None if found is None else (found[0] - carried, found[1])

    @property
    def last_condition(self) -> float:
        """Condition number at the last sample that was added; 0 before the first."""
        return 0.0 if self.carried is None else float(self.carried.regular.worst[-1])


def _first(s: _Stretch, lengths: Float[np.ndarray, " dof"], lost: float) -> tuple[int, str] | None:
    sign = np.sign(s.regular.determinant)
    flipped = np.diff(sign, prepend=sign[0]) != 0
    flipped[passages(s.regular) + 1] = True
    moved = np.linalg.norm(np.diff(s.z * lengths, axis=0, prepend=s.z[:1] * lengths), axis=1)
    driven = np.linalg.norm(np.diff(s.q, axis=0, prepend=s.q[:1]), axis=1)
    jumped = moved > _JUMP * s.regular.gain * (driven + _STILL)
    near = s.regular.condition > lost
    bad = np.flatnonzero(flipped | jumped | near)
    if not bad.size:
        return None
    i = int(bad[0])
    if near[i] and not flipped[i]:
        return i, (
            f"the robot comes to a singular pose at {s.time[i]:.6g} s (condition number "
            f"{s.regular.condition[i]:.4g}), where it may have gone on to another branch"
        )
    if flipped[i]:
        between = f"between {s.time[i - 1]:.6g} s and {s.time[i]:.6g} s"
        return i, f"the robot passes through a singular pose {between}"
    return i, (
        f"the platform jumps by {moved[i]:.4g} m at {s.time[i]:.6g} s while the drives hardly "
        "move: the loops close on another branch there"
    )
