"""What a cycle makes of measured signals: speeds from positions, gains, friction by load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from deltaid.dynamics.parameters import prior_parameters
from deltaid.model.model import Model
from deltaid.online.cycle import step_graph
from deltaid.online.estimates import friction_bounds
from deltaid.online.knowledge import knowledge
from deltaid.online.online import FeedForward
from deltaid.online.settings import OnlineSettings
from deltaid.robot.load import load_robot
from online_runs import outputs, robot, running

QUIET = OnlineSettings(noise=(0.1,) * 3, unmodelled=(0.1,) * 3, largest_mass=3.0)


def left(torque: str, rate: float) -> float:
    """What of the model's own torques, differenced speeds leave unexplained, largest [N m]."""
    model = robot("clavel-delta3")[0].without_friction()
    n = round(0.2 * rate)
    run = running(model, n + 1, slice(0, 0), rate=rate)
    # What is held from one position to the next is the torque in their middle.
    tau = 0.5 * (run.tau[1:] + run.tau[:-1]) if torque == "held" else run.tau[:n]
    settings = replace(QUIET, rate=rate, speed="differenced", torque=torque)
    graph = step_graph(model, settings)
    u = np.column_stack([run.q[:n], tau, np.zeros(n)])
    y = np.array(graph.function.mapaccum(n)(graph.state.initial, u.T)[1]).T
    return float(np.abs(graph.outputs.split(y)["residual"][20:]).max())


@pytest.mark.parametrize("torque", ["sampled", "held"])
def test_differenced_speeds_positions_and_torques_are_of_one_instant(torque: str) -> None:
    """The middle between two cycles: what differs is of second order in the period."""
    coarse, fine = left(torque, 1000.0), left(torque, 2000.0)
    assert coarse < 0.01
    assert fine < 0.3 * coarse


def test_friction_that_depends_on_load_is_explained() -> None:
    """Of gears that lose a tenth of what they carry nothing is left while they move."""
    described = load_robot("clavel-delta3")
    laws = {
        drive: type(law)(viscous=2.0, coulomb=1e-6, load=0.1)
        for drive, law in described.friction.items()
    }
    losing = described.model_copy(update={"friction": laws})
    model = Model(losing, prior_parameters(losing), "losing")
    run = running(model, 400, slice(0, 0))
    left = np.abs(outputs(step_graph(model, QUIET), run, run.held)["residual"])
    # Where a drive has moved for so long that what its filter knows of a slower one is forgotten.
    slow = np.cumsum(np.abs(run.qd) < 0.3, axis=0)
    moved = np.vstack([np.zeros((60, 3), bool), slow[60:] == slow[:-60]])
    assert moved.sum() > 300
    assert left[moved].max() < 0.02


def test_torques_are_what_drives_report_times_their_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    gains, (model, _) = np.array([1.2, 0.8, 1.5]), robot("clavel-delta3")
    run = running(model, 300, slice(100, 300))
    monkeypatch.setattr(Model, "gains", property(lambda _: gains))
    y = outputs(step_graph(model, QUIET), replace(run, tau=run.tau / gains), run.held)
    assert y["load"][-1, 0] == pytest.approx(1.0, abs=0.02)


def test_feed_forward_is_what_drives_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """Torques at the joints by the gains."""
    gains, (model, _) = np.array([1.2, 0.8, 1.5]), robot("clavel-delta3")
    known, run = knowledge(model, QUIET), running(model, 3, slice(0, 0))
    none, friction = np.zeros(len(known.entries.shown)), model.p[list(known.followed)]
    rows = run.q[1], run.qd[1], np.array([1.0, -2.0, 3.0])
    expected = model.dynamics.inverse_dynamics(*rows, model.p) / gains
    monkeypatch.setattr(Model, "gains", property(lambda _: gains))
    assert FeedForward(model, known)(*rows, none, friction) == pytest.approx(expected, rel=1e-9)


def test_an_offset_of_friction_near_zero_may_change_its_sign() -> None:
    """It moves by its deviations; coefficients of one sign by a share of themselves."""
    described = load_robot("clavel-delta3")
    law = described.friction["drive2"].changed(offset=0.01)
    offset = described.model_copy(update={"friction": described.friction | {"drive2": law}})
    model = Model(offset, prior_parameters(offset), "offset")
    known = knowledge(model, QUIET)
    low, high = friction_bounds(model, known, 0.3)
    for k, std, down, up in zip(known.followed, known.friction_std, low, high, strict=True):
        value = model.p[k]
        lowest, highest = value + std * down, value + std * up
        if model.layout.names[k] == "offset.drive2":
            assert lowest < -std
            assert highest > std
        else:
            assert (lowest, highest) == pytest.approx((0.7 * value, 1.3 * value))
    assert "offset.drive2" in [model.layout.names[k] for k in known.followed]
