"""Distance of poses from singularities, and motions that pass through one."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from deltaid.errors import KinematicsError
from deltaid.shown import Shown

# cond(J) of a singular pose. J mixes rad/m and rad/rad, so a good pose of a metre-sized robot has
# cond(J) below 10; at 1e6 the last six digits of every torque are lost.
SINGULAR_CONDITION = 1e6


@dataclass(frozen=True, repr=False)
class Regularity(Shown):
    """Distance of poses from singularities; J = ∂q/∂z with ψ scaled to a length.

    Attributes:
        condition: ‖J‖_F ‖J⁻¹‖_F / δ.
        determinant: of J; it changes sign across a singularity.
        gain: ‖J⁻¹‖_F, how far the platform moves for a step of the drives.
        hold: how well the platform's parts are kept parallel (`Mechanism.hold_condition`).
    """

    condition: Float[np.ndarray, "*samples"]
    determinant: Float[np.ndarray, "*samples"]
    gain: Float[np.ndarray, "*samples"]
    hold: Float[np.ndarray, "*samples"]

    @property
    def worst(self) -> Float[np.ndarray, "*samples"]:
        """The larger of both conditions; NaN where either is."""
        return np.asarray(np.maximum(self.condition, self.hold))

    def require(self, z: Float[np.ndarray, "samples dof"], *, linear: bool) -> None:
        """Raise KinematicsError when one of the poses z is singular.

        Args:
            linear: whether the robot has linear drives.
        """
        loose = np.flatnonzero(~(self.hold < SINGULAR_CONDITION))
        if loose.size and np.isfinite(self.condition[loose[0]]):
            raise KinematicsError(
                f"the pose z = {written(z[loose[0]])} is singular: a part of the platform can turn "
                "with all drives locked, because the parallelograms do not keep it parallel",
                where=f"sample {loose[0]}",
                cure="arrange the limbs of each part less symmetrically (docs: mechanisms)",
            )
        bad = np.flatnonzero(~(self.condition < SINGULAR_CONDITION))
        if bad.size:
            i = bad[0]
            edge = "struts square to a rail" if linear else "an arm and its struts in line"
            raise KinematicsError(
                f"the pose z = {written(z[i])} is singular: drives and platform lose their "
                f"one-to-one relation ({edge}, or the struts coplanar)",
                where=f"sample {i}",
                cure="keep the motion away from the edge of the workspace",
            )

    def part(self, which: slice) -> "Regularity":
        """A subset of the poses."""
        return Regularity(*(x[which] for x in vars(self).values()))


def passages(regular: Regularity) -> Int[np.ndarray, " passages"]:
    """Samples i such that the motion passes through a singularity between i and i + 1.

    The distance d = 1/cond J falls to zero there and rises again with a kink: from either side, the
    line through the last two samples reaches zero before the next sample.
    """
    d = 1 / regular.condition
    falls = 2 * d[1:-2] < d[:-3]
    rises = 2 * d[2:-1] < d[3:]
    return np.flatnonzero(falls & rises) + 1


def written(x: Float[np.ndarray, " n"]) -> str:
    """Coordinates as text for a message."""
    return "[" + ", ".join(f"{value:.4g}" for value in x) + "]"
