"""All steps that correct recordings and description before they are fitted, in their order."""

from deltaid.errors import RecordingError
from deltaid.identification.compliance import gears_turned_back
from deltaid.identification.events import without_events
from deltaid.identification.friction_choice import chosen_friction
from deltaid.identification.friction_rows import cutoff_of
from deltaid.identification.gains import gains
from deltaid.identification.lag_stage import lags_put_right
from deltaid.identification.loads import declared_loads
from deltaid.identification.sensor_stage import sensors_settled, sensors_taken_in
from deltaid.identification.setup import Progress, Setup, Stage
from deltaid.identification.study import studied
from deltaid.identification.velocity_stage import late_rates_left_out
from deltaid.identification.warmth import changing_friction


def recordings_studied(setup: Setup, progress: Progress) -> Setup:
    """Which causes the residual of each recording has, before lags and friction are blamed."""
    progress("looking at what the description leaves")
    return setup.changed(studies=tuple(studied(setup.dynamics, one) for one in setup.recordings))


def sharpened(setup: Setup, progress: Progress) -> Setup:
    """Rows that friction laws were chosen by, where a law has a term for friction near rest.

    Stribeck's lasts some milliseconds at each reversal; rows that keep no more than the motion asks
    for confuse it with Coulomb's. The last stage: all others judge by the rows before.
    """
    laws = setup.robot.friction.values()
    if setup.settings.cutoff is not None or not any(x.stribeck or x.hess_soom for x in laws):
        return setup
    try:
        # Links behind gears that wind up have the torques' noise, more of it the faster.
        recordings = (
            one.changed(cutoff_of(one)) if one.low_pass and one.repairs.gears is None else one
            for one in setup.recordings
        )
        return setup.changed(recordings=tuple(recordings))
    except RecordingError:
        return setup  # too short for a filter of that length


STAGES: tuple[Stage, ...] = (
    sensors_taken_in,
    late_rates_left_out,
    declared_loads,
    without_events,
    recordings_studied,
    gains,
    lags_put_right,
    gears_turned_back,
    changing_friction,
    chosen_friction,
    changing_friction,
    lags_put_right,
    gains,
    sensors_settled,
    sharpened,
)


def prepared(setup: Setup, progress: Progress) -> Setup:
    """A setup after all stages; one that found nothing is left out until something has changed."""
    idle: dict[Stage, Setup] = {}
    for stage in STAGES:
        if stage in idle and setup.poses_as(idle[stage]):
            continue
        before, setup = setup, stage(setup, progress)
        if setup.poses_as(before):
            idle[stage] = setup
    return setup
