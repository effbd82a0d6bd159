"""Rows that keep what friction near rest does, where a law has a term for it.

Stribeck's term is gone at a few per cent of a drive's speed, which takes some milliseconds at each
reversal. Rows that keep no more than the motion asks for hardly show it, and what they show of it
they confuse with Coulomb's.
"""

from deltaid.errors import RecordingError
from deltaid.identification.friction_rows import cutoff_of
from deltaid.identification.setup import Progress, Setup


def sharpened(setup: Setup, progress: Progress) -> Setup:
    """Rows of all recordings as those that friction laws were chosen by.

    The last stage: what it takes for lags, gears and events is judged by the rows before.
    """
    laws = setup.robot.friction.values()
    if setup.settings.cutoff is not None or not any(x.stribeck or x.hess_soom for x in laws):
        return setup
    found = []
    for one in setup.recordings:
        try:
            # Links behind gears that wind up have the torques' noise, more of it the faster.
            stiff = one.repairs.gears is None
            found.append(one.changed(cutoff_of(one)) if one.low_pass and stiff else one)
        except RecordingError:
            return setup  # too short for a filter of that length
    return setup.changed(recordings=tuple(found))
