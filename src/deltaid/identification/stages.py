"""All steps that correct recordings and description before they are fitted, in their order."""

from deltaid.errors import RecordingError
from deltaid.identification.compliance import gears_turned_back
from deltaid.identification.contest_stage import contested
from deltaid.identification.events import without_events
from deltaid.identification.friction_choice import chosen_friction
from deltaid.identification.friction_rows import cutoff_of
from deltaid.identification.gains import gains
from deltaid.identification.lag_stage import lags_corrected
from deltaid.identification.loads import declared_loads
from deltaid.identification.sensor_stage import sensors_included, sensors_settled
from deltaid.identification.setup import Progress, Setup, Stage
from deltaid.identification.undeclared_loads import undeclared_loads
from deltaid.identification.velocity_stage import holds_filled, late_rates_left_out
from deltaid.identification.warmth import changing_friction


def recordings_studied(setup: Setup, progress: Progress) -> Setup:
    """Which causes the residual of each recording has, before lags and friction are corrected."""
    progress("looking at what the description leaves")
    return setup.studied()


def sharpened(setup: Setup, progress: Progress) -> Setup:
    """Rows that friction laws were chosen by, where a law has a term for friction near rest.

    Stribeck's lasts some milliseconds at each reversal; rows that keep no more than the motion asks
    for confuse it with Coulomb's. The last stage: all others judge by the rows before.
    """
    laws = setup.robot.friction.values()
    if setup.settings.cutoff is not None or not any(law.stribeck or law.hess_soom for law in laws):
        return setup
    try:
        # Links behind gears that wind up have the torques' noise, more of it the faster.
        recordings = (
            recording.changed(cutoff_of(recording))
            if recording.low_pass and recording.repairs.gears is None
            else recording
            for recording in setup.recordings
        )
        return setup.changed(recordings=tuple(recordings))
    except RecordingError:
        return setup  # too short for a filter of that length


STAGES: tuple[Stage, ...] = (
    sensors_included,
    holds_filled,
    late_rates_left_out,
    declared_loads,
    without_events,
    recordings_studied,
    gains,
    lags_corrected,
    gears_turned_back,
    undeclared_loads,
    contested,
    changing_friction,
    chosen_friction,
    changing_friction,
    lags_corrected,
    gains,
    sensors_settled,
    sharpened,
)


def prepared(setup: Setup, progress: Progress) -> Setup:
    """A setup after all stages; one without effect is skipped until something has changed."""
    idle: dict[Stage, Setup] = {}
    for stage in STAGES:
        if stage in idle and setup.poses_as(idle[stage]):
            continue
        before, setup = setup, stage(setup, progress)
        if setup.poses_as(before):
            idle[stage] = setup
    return setup
