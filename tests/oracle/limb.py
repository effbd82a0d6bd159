"""One limb of a composed robot: arm or carriage, strut, and the drive that holds a point.

It leaves in direction e_r at its azimuth, e_t = e_z x e_r. Body frames, in metres and radians:

U        at `base`, y the motor axis e_t cos(tilt) + e_z sin(tilt), x along the arm; angle 0 along
         e_r, positive about y
C        at `base` + q rail with rail = e_r sin(tilt) - e_z cos(tilt); axes e_r, e_t, e_z
S        at the arm's tip or at C, x along the strut, z = unit(x cross y), y of U or C
"""

from dataclasses import dataclass

import numpy as np

from oracle.tree import EZ, Array, rot_z


@dataclass(frozen=True, eq=False)
class LimbShape:
    """One limb: angles in rad, points in the world (`seat` from its part's point), lengths in m.

    `arm` is None for a linear drive. `driven` and `strut_body` name bodies.
    """

    azimuth: float
    tilt: float
    base: Array
    seat: Array
    arm: float | None
    strut: float
    outwards: bool
    driven: str
    strut_body: str

    @property
    def axes(self) -> Array:
        """Columns x, y, z: of U at angle 0, or of C."""
        R = rot_z(self.azimuth)
        if self.arm is None:
            return R
        y = np.cos(self.tilt) * R[:, 1] + np.sin(self.tilt) * EZ
        return np.column_stack([R[:, 0], y, np.cross(R[:, 0], y)])

    @property
    def rail(self) -> Array:
        """Direction of a positive q."""
        return np.sin(self.tilt) * rot_z(self.azimuth)[:, 0] - np.cos(self.tilt) * EZ

    def position(self, point: Array) -> float:
        """Drive coordinate that holds a point (world); NaN out of reach."""
        way = point - self.base
        with np.errstate(invalid="ignore"):
            if self.arm is None:
                along = way @ self.rail
                rest = np.sqrt(self.strut**2 - np.sum((way - along * self.rail) ** 2))
                return along - rest if self.outwards else along + rest
            x, y, z = self.axes.T @ way
            square = x**2 + y**2 + z**2 + self.arm**2 - self.strut**2
            swing = np.arccos(square / (2 * self.arm * np.hypot(x, z)))
        angle = np.arctan2(-z, x) - (swing if self.outwards else -swing)
        middle = 0.0 if self.outwards else 0.5 * np.pi  # an arm folded inwards passes 180°
        return float(middle + np.arctan2(np.sin(angle - middle), np.cos(angle - middle)))

    def tip(self, q: float) -> Array:
        """Upper end of the strut in the world."""
        if self.arm is None:
            return self.base + q * self.rail
        return self.base + self.axes @ [self.arm * np.cos(q), 0.0, -self.arm * np.sin(q)]
