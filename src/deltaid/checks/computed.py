"""Check for torques that a model computed: measured ones are never explained so well."""

import numpy as np

from deltaid.identification.study import Study
from deltaid.model.verdict import Fault, Verdict, listed, percent

# Residual as a share of a drive's largest torque that no measured torque falls below.
_EXACT = 1e-4
_COMPUTED = Fault(
    "residual",
    "%",
    "the column holds a computed torque, a feed-forward or a simulation without noise: what is "
    "identified is the model behind it, and not the robot",
    "record the torque that the drives measure",
)


def computed_torques(study: Study) -> Verdict | None:
    """A verdict on torques that the model explains better than any measured ones; None without
    such torques."""
    model, drives = study.fit.model, np.array(study.fit.drives)
    left = study.fit.rows.of_drives(study.account.left)
    largest, moves = np.abs(model).max(axis=1), model.any(axis=1)
    shares = np.sqrt(np.mean(left**2, axis=1)) / np.where(moves, largest, 1.0)
    exact = moves & (shares < _EXACT)
    if not exact.any():
        return None
    subject = "" if np.array_equal(exact, moves) else listed(drives[exact].tolist())
    share = float(shares[exact].max())
    seen = (
        f"the model explains {f'the torque of {subject}' if subject else 'all torques'} to "
        f"{percent(share)} of the largest; measured ones have noise of 0.3 to 3 %"
    )
    return _COMPUTED.judged(seen, subject, 100 * share)
