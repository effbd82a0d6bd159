"""Zeros and tilt once more, after a fit: beside what it has put right, and in its place.

Before a fit, rows are as recorded and friction as described: clipped torques, a lag or another law
of friction may look like a zero that is off; and a zero that is off looks like friction that
differs by direction or like a torque constant, which a fit then finds. So the columns of zeros and
tilt are compared with what is left of masked torques, beside all that the fit has put right and
beside the description alone.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from threadpoolctl import threadpool_limits

from deltaid.check.wiring.homing import Shifts
from deltaid.check.wiring.zeros import likeliest, seen
from deltaid.dynamics.parameters import parameter_layout
from deltaid.estimation.additions import extended
from deltaid.estimation.information import active_columns
from deltaid.estimation.span import Span
from deltaid.identification.fit import FittedProblem
from deltaid.identification.geometry import geometric_rows
from deltaid.recording.recording import Recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.tolerances import Tolerances

# What columns are made of [rad or m; rad], and singular values that count.
_SIZE = 1e-3
# Zeros and tilts beyond this [rad or m] are no likelier than another law of friction; smaller ones
# are believed unless the law explains more than chance: twice a logarithm of likelihoods, which
# noise that is not white raises several times.
_FAR, _CERTAIN = 0.05, 25.0


@threadpool_limits.wrap(limits=1, user_api="blas")  # for narrow matrices, threads only wait
def still_seen(problem: FittedProblem, recording: Recording, described: RobotDescription) -> bool:
    """Whether a zero or a tilt still explains what a fit leaves of a recording, or explains as
    much as what the fit has added to the description."""
    fitted = _shifts(_rows(problem, recording, frozenset()))
    if seen(fitted):
        return True
    known = {one.name for one in parameter_layout(described).parameters}
    added = {one.name for one in problem.dynamics.layout.parameters} - known
    gains = {one.name for one in problem.layout.parameters if one.kind == "gain"}
    repairs = replace(recording.repairs, gears=None, gain=())
    described_only = replace(recording, repairs=repairs)
    plain = _shifts(_rows(problem, described_only, frozenset(added | gains)))
    if not seen(plain):
        return False
    which = likeliest(plain)
    value, _ = plain.told(which)
    instead = plain.left * (1.0 - plain.gain(which))
    chance = plain.rows * np.log(max(instead, 1e-300) / max(fitted.left, 1e-300))
    return bool(np.linalg.norm(value) < _FAR and chance < _CERTAIN)


@dataclass(frozen=True, eq=False)
class _Rows:
    """Samples of a fit, one drive after the other.

    Attributes:
        Y: columns of the fit.
        tau: torques.
        D: slopes by zeros [N m/rad or N/m] and tilts; of what torques do not show they are zero.
        drives, angles: how many zeros and tilts.
    """

    Y: Float[np.ndarray, "rows columns"]
    tau: Float[np.ndarray, " rows"]
    D: Float[np.ndarray, "rows shifts"]
    drives: int
    angles: int


def _rows(problem: FittedProblem, recording: Recording, without: frozenset[str]) -> _Rows:
    """Rows of a recording, without the columns of some parameters."""
    dynamics, drives = problem.dynamics, problem.dynamics.robot.drives
    regressor = extended(dynamics, problem.additions)
    rows = geometric_rows(
        regressor,
        dynamics,
        recording,
        problem.p,
        np.sqrt(problem.information.drive_weights),
        Tolerances(lengths=0.0, homing=_SIZE, mounting=_SIZE),
    )
    tilts = [name for name in rows.names if name.startswith("tilt")]
    columns = dict(zip(rows.names, rows.D.T / _SIZE, strict=True))
    none = np.zeros(len(rows.tau))
    D = [columns.get(name, none) for name in (*(f"zero of {one}" for one in drives), *tilts)]
    names = [problem.layout.parameters[k].name for k in active_columns(regressor)]
    kept = np.array([name not in without for name in names])
    return _Rows(rows.Y[:, kept], rows.tau, np.stack(D, axis=1), len(drives), len(tilts))


def _shifts(rows: _Rows) -> Shifts:
    """What rows say of zeros and gravity beside their columns."""
    return Shifts.of(Span.of(rows.Y), rows.D, rows.tau, rows.drives, rows.angles)
