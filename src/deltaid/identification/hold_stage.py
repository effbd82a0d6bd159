"""Torques that drives hold between two updates are interpolated between these."""

from deltaid.identification.setup import Progress, Setup
from deltaid.model.corrections import Correction
from deltaid.recording.hold import held_rows

_TEXT = (
    "the drive updates its torque every so many seconds and repeats it in the rows between, which "
    "come late by half as much in the mean: torques there are interpolated between updates"
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
        hold = held_rows(log.segments(recording.motion_cutoff), log.columns)
        if not any(hold):
            continue
        setup = setup.repaired(recording, hold=hold)
        corrections += (
            Correction(kind="hold", subject="" if len(set(hold)) == 1 else drive,
                       log=recording.path.name, value=rows / log.rate, unit="s", text=_TEXT)
            for drive, rows in zip(setup.robot.drives, hold, strict=True)
            if rows
        )  # fmt: skip
    return setup.reported(list(dict.fromkeys(corrections)), "hold")
