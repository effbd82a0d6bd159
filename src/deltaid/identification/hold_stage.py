"""Torques that drives hold between two updates are interpolated between these."""

from deltaid.identification.setup import Progress, Setup
from deltaid.model.corrections import Correction
from deltaid.recording.held import holds

_TEXT = (
    "drives update their torques so seldom and hold them in the rows between, which come late: "
    "torques there are interpolated between updates"
)


def holds_filled(setup: Setup, progress: Progress) -> Setup:
    """Recordings with torques between their updates; a stage."""
    if setup.settings.lag == "none":
        return setup
    progress("looking for repeated torques")
    corrections = list[Correction]()
    for recording in setup.recordings:
        log = recording.brief.log
        if not log.columns.torque:
            continue
        held = holds(log.segments(recording.motion_cutoff), log.columns, log.rate)
        if not any(held):
            continue
        setup = setup.repaired(recording, hold=held)
        alike = len({hold.rows for hold in held}) == 1
        corrections += (
            Correction(kind="hold", subject="" if alike else drive,
                       log=recording.path.name, value=hold.rows / log.rate, unit="s", text=_TEXT)
            for drive, hold in zip(setup.robot.drives, held, strict=True)
            if hold
        )  # fmt: skip
    return setup.reported(list(dict.fromkeys(corrections)), "hold")
