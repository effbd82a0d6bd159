"""What gears carry where torques tell a rotor and its link by their sum only."""

from dataclasses import replace

import numpy as np

from deltaid.identification.friction_options import of_load
from deltaid.identification.friction_rows import FrictionRows

# Shares of a rotor's inertia that may be its link's; below zero the other way.
_SHARES = (0.0, -1.0, -0.5, 0.25, 0.5, 0.75, 1.0)


def rotors_parted(rows: FrictionRows) -> FrictionRows:
    """Rows whose gears carry the inertia, taken from the rotors, with which losses by load explain
    most."""
    names, dof = rows.dynamics.layout.names, rows.dynamics.dof
    joints = [(one.drive, one) for one in rows.joints
              if one.drive is not None and f"rotor.{one.name}" in names]  # fmt: skip
    if not joints:
        return rows
    rotors = np.zeros(dof)
    for drive, one in joints:
        rotors[drive] = rows.p[names.index(f"rotor.{one.name}")]
    gains = []
    for share in _SHARES:
        tried = replace(rows, moved=share * rotors)
        columns = rows.bare(tried.columns([(one, of_load) for _, one in joints]))
        u = np.maximum(columns.T @ rows.left, 0.0)  # of losses, not of gains
        gains.append(u**2 / np.maximum(np.sum(columns**2, axis=0), 1e-300))
    moved = np.zeros(dof)
    for (drive, _), k in zip(joints, np.argmax(gains, axis=0), strict=True):
        moved[drive] = _SHARES[k] * rotors[drive]
    return replace(rows, moved=moved)
