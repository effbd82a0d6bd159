"""Tracking with what a drive does to it: rate, encoder, delay, limits; and its page."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

from deltaid.control.comparison import ControllerRun, compare
from deltaid.control.controllers import (
    CONTROLLERS,
    Controller,
    ControlModel,
    Desired,
    tuned,
)
from deltaid.control.infeasible import tracking_problems
from deltaid.control.plant import Plant
from deltaid.control.simulate import Conditions
from deltaid.control.tracking import Drives, Tracking, gains, track
from deltaid.control.trajectory import open_trajectory
from deltaid.dynamics.dynamics import compiled, compiled_as
from deltaid.dynamics.forward_dynamics import ForwardDynamics
from deltaid.dynamics.parameters import prior_parameters
from deltaid.errors import RecordingError
from deltaid.model.model import Model, load
from deltaid.robot.limits import NAMES, Task
from deltaid.robot.load import load_robot
from deltaid.view.page import Figure, Table, Text
from deltaid.view.tracking import comparison_page
from logs import recorded
from test_controllers import ROBOT, motion


@cache
def tracked(controller: str, drives: Drives, share: float = 1.0, duration: float = 0.3) -> Tracking:
    """A second on the robot whose masses the model knows to a share."""
    robot = load_robot(ROBOT)
    forward, p = compiled_as(ForwardDynamics, robot), prior_parameters(robot)
    known = p.copy()
    known[:30] *= share
    model = ControlModel(robot, known)
    trajectory = motion(forward, duration)
    mass = ControlModel(robot, p).mass_diagonal(trajectory.desired(np.linspace(0, 0.3, 50)).q)
    return track(Model(forward.robot, p), tuned(controller, mass, 10.0), model, trajectory, drives)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_the_exact_model_leaves_microns_and_a_wrong_one_more(controller: str) -> None:
    exact = tracked(controller, Drives(encoder_step=0.0)).error
    wrong = tracked(controller, Drives(encoder_step=0.0), share=0.8).error
    if controller == "pd":
        assert exact.platform_rms > 1e-3
        assert wrong.platform_rms == exact.platform_rms
    else:
        assert exact.platform_rms < 2e-5
        assert wrong.platform_rms > 10 * exact.platform_rms


def test_a_faster_drive_tracks_nearer_and_coarse_encoders_and_delay_do_not() -> None:
    def error(share: float, **changed: float) -> float:
        drives = Drives(**({"encoder_step": 0.0} | changed))
        return tracked("computed-torque", drives, share).error.platform_rms

    assert tracked("augmented-pd", Drives(rate=4000.0, encoder_step=0.0)).error.platform_rms < (
        0.5 * tracked("augmented-pd", Drives(rate=500.0, encoder_step=0.0)).error.platform_rms
    )
    assert error(1.0, encoder_step=1e-3) > 5 * error(1.0)
    assert error(0.8, delay=20) > 1.2 * error(0.8)


@dataclass
class Overheard:
    """A controller that remembers what it was told."""

    law: Controller
    received: list[tuple[np.ndarray, ...]] = field(default_factory=list)

    def torque(
        self, model: ControlModel, q: np.ndarray, qd: np.ndarray, desired: Desired
    ) -> np.ndarray:
        self.received.append((q[0], qd[0], desired.q[0], desired.qd[0]))
        return self.law.torque(model, q, qd, desired)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_law_receives_the_late_error_and_the_motion_in_the_middle_of_its_hold(delay: int) -> None:
    robot = load_robot(ROBOT)
    p, trajectory = prior_parameters(robot), motion(compiled_as(ForwardDynamics, robot), 0.1)
    drives = Drives(rate=400.0, encoder_step=0.0, delay=delay, velocity_cutoff=0.1)
    law = Overheard(
        tuned("pd", ControlModel(robot, p).mass_diagonal(trajectory.desired(np.zeros(1)).q), 8.0)
    )
    done = track(Model(robot, p), law, ControlModel(robot, p), trajectory, drives)
    q, qd, q_desired, qd_desired = (np.array(part) for part in zip(*law.received, strict=True))
    middle = trajectory.desired(done.time + 0.5 / drives.rate)
    np.testing.assert_array_equal(q_desired, middle.q)
    np.testing.assert_array_equal(qd_desired, middle.qd)
    # A first-order low-pass of 0.1 of the rate, on differences of the error.
    pole = np.exp(-2 * np.pi * 0.1)
    slopes = np.diff(done.drive_error, axis=0, prepend=done.drive_error[:1]) * drives.rate
    rates = lfilter([1 - pole], [1, -pole], slopes, axis=0)
    late = np.maximum(np.arange(len(q)) - delay, 0)
    np.testing.assert_allclose(q - q_desired, done.drive_error[late], atol=1e-12)
    np.testing.assert_allclose(qd - qd_desired, rates[late], atol=1e-9)
    assert np.abs(rates).max() > 0.01


def test_delay_beyond_the_phase_margin_loses_the_robot() -> None:
    result = tracked("computed-torque", Drives(delay=80), share=0.8, duration=1.0)
    assert result.ended is not None
    assert np.isnan(result.q[-1]).all()
    assert np.isfinite(result.error.platform_rms)


def test_torques_stay_within_the_limits() -> None:
    robot = load_robot(ROBOT)
    limits = {d: robot.drive_limits[d].changed(torque=12.0) for d in robot.drives}
    robot = robot.changed(drive_limits=limits)
    forward, p = ForwardDynamics(robot), prior_parameters(robot)
    model, trajectory = ControlModel(robot, p), motion(forward, 0.5)
    result = track(
        Model(forward.robot, p),
        Controller("computed-torque", bandwidth=60.0),
        model,
        trajectory,
        Drives(),
    )
    assert np.abs(result.tau).max() == 12.0
    assert 0 < result.saturated.mean() < 1
    assert np.array_equal(np.abs(result.tau) == 12.0, result.saturated)


def made_up(shift: float, turn: float, ended: float | None = None) -> Tracking:
    """A tracking of a 4-DOF robot that is this far off at all times, until it was lost."""
    time, still = np.linspace(0, 1, 11), np.zeros((11, 4))
    off = still + np.array([shift, 0, 0, turn])
    if ended is not None:
        off[time >= ended] = np.nan
    return Tracking(time, still, still, off, off, still, still > 0, ended, Task(NAMES), still)


def test_the_tools_turn_is_an_error_of_its_own() -> None:
    error = made_up(0.001, -0.2).error
    assert (error.platform_rms, error.platform_max) == pytest.approx((0.001, 0.001))
    assert (error.turn_rms, error.turn_max) == pytest.approx((0.2, 0.2))
    assert tracked("pd", Drives()).error.turn_rms is None


def test_page_of_a_comparison_counts_nobody_who_was_lost() -> None:
    robot, lost = load_robot("irb360-6-1600"), made_up(1e-9, 0.0, ended=0.2)
    runs = (
        ControllerRun("pd-feedforward", "prior", made_up(0.05, 0.1)),
        ControllerRun("pd-feedforward", "identified", made_up(0.0002, 0.003)),
        ControllerRun("computed-torque", "prior", lost, "", tracking_problems(load(robot), lost)),
        ControllerRun("computed-torque", "identified", made_up(0.001, 0.0)),
    )
    page = comparison_page(robot, runs, "a on b", Drives(delay=2), 12.0)
    facts = [(fact.label, fact.value) for fact in page.facts]
    assert facts == [
        ("least error of the platform", "0.2 mm"),
        ("pd-feedforward", "250 times nearer"),
    ]
    assert page.verdict.sentence == (
        "Good: pd-feedforward with the identified model follows best, within 0.2 mm (rms; 0.2 mm "
        "at most)."
    )
    (warning,) = page.verdict.lines
    assert warning.startswith(
        "computed-torque, prior: lost after 0.2 s, where a limb was stretched; likeliest cause:"
    )
    [table] = [block for block in page.sections[0].blocks if isinstance(block, Table)]
    assert [row[4] for row in table.rows] == ["5.73", "0.172", "0", "0"]
    [text] = [block for block in page.sections[0].blocks if isinstance(block, Text)]
    assert "12 Hz" in text.text
    assert "a delay of 2 samples" in text.text


def test_page_of_a_comparison_shows_a_model_whose_load_is_known() -> None:
    run = ControllerRun("pd-feedforward", "identified, load known", made_up(0.001, 0.0))
    page = comparison_page(load_robot("irb360-6-1600"), (run,), "a on b", Drives(), 12.0)
    [bars] = [b.figure for b in page.sections[0].blocks if isinstance(b, Figure)]
    assert [bar.name for bar in bars.data] == ["identified, load known"]


def test_all_controllers_are_tuned_with_the_mass_matrix_of_the_last_model() -> None:
    robot = load_robot(ROBOT)
    forward, p = compiled_as(ForwardDynamics, robot), prior_parameters(robot)
    trajectory, drives = motion(forward, 0.1), Drives(encoder_step=0.0)
    light, right = ControlModel(robot, 0.5 * p), ControlModel(robot, p)
    models = {"half": light, "right": right}
    plant = Model(forward.robot, p)
    on = Conditions(plant, Plant(plant), trajectory, "", drives, 10.0, None, ())
    runs = compare(on, models)
    law = gains("pd", right, trajectory, 10.0)
    alone = track(plant, law, right, trajectory, drives)
    pd = next(run.tracking for run in runs if run.controller == "pd")
    np.testing.assert_allclose(pd.error.platform_rms, alone.error.platform_rms, rtol=1e-9)


def test_a_file_whose_time_starts_again_is_no_motion_to_follow() -> None:
    table = recorded().with_columns(t=pl.col("t") % 1.0)
    with pytest.raises(RecordingError, match="starts again in 1 place, the first in row 1001"):
        open_trajectory(table, compiled(load_robot("clavel-delta3")).kinematics)
