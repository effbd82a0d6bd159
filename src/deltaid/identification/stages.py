"""All steps that put recordings and description right before they are fitted, in their order."""

from deltaid.identification.compliance import gears_turned_back
from deltaid.identification.events import without_events
from deltaid.identification.friction_choice import chosen_friction
from deltaid.identification.gains import gains
from deltaid.identification.lag_stage import lags_put_right
from deltaid.identification.loads import declared_loads
from deltaid.identification.sensor_stage import sensors_settled, sensors_taken_in
from deltaid.identification.setup import Progress, Setup, Stage
from deltaid.identification.sharpness import sharpened
from deltaid.identification.study import studied
from deltaid.identification.velocity_stage import late_rates_left_out
from deltaid.identification.warmth import changing_friction


def recordings_studied(setup: Setup, progress: Progress) -> Setup:
    """Which causes the residual of each recording has, before lags and friction are blamed."""
    progress("looking at what the description leaves")
    return setup.changed(studies=tuple(studied(setup.dynamics, one) for one in setup.recordings))


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
