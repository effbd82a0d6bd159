"""What is believed of a load that nobody told: what it did to other estimates, and what is none."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from deltaid.online.changes import Change, Onset, estimate_after
from deltaid.online.cycle import step_graph
from deltaid.online.kalman import Estimate
from deltaid.online.settings import OnlineSettings
from online_runs import LOAD, outputs, robot, running

ONE, NONE = ca.SX(1), ca.SX(0)


@pytest.mark.parametrize("free", [0.0, 0.1], ids=["empty", "held"])
def test_other_estimates_are_those_of_a_filter_that_knew(free: float) -> None:
    """Friction that was blamed for a load is what it would be had the load been taken off.

    A load that was held before, known to a variance, took a part of the change already.
    """
    rng, noise, mass = np.random.default_rng(0), ca.SX(0.01), 2.0
    shown, friction = rng.uniform(0.2, 0.6, 60), 0.3
    start = Estimate(ca.SX.zeros(2), ca.diag(ca.SX([free, 1.0])))
    blamed = knew = start
    onset = Onset(ca.SX.zeros(2), NONE, NONE, NONE, NONE)
    for k, psi in enumerate(shown):
        row, load = ca.SX([[psi, 1.0]]), mass * psi * (k >= 30)
        y = friction + load + 0.1 * rng.standard_normal()
        blamed, told = blamed.measured(row, ca.SX(y), noise, ONE)
        knew, _ = knew.measured(row, ca.SX(y - load), noise, ONE)
        if k >= 30:
            onset = onset.measured(0, ca.SX(psi), told)
    other = Change(changed=ONE, held=ONE, told=NONE, seen=ONE, kept=())
    found = estimate_after(blamed, onset, other, 1)
    wrong, right, mended = (float(ca.evalf(one.x)[1]) for one in (blamed, knew, found))
    assert abs(wrong - right) > 0.1
    assert (abs(float(ca.evalf(blamed.x)[0])) > 0.2 * mass) == (free > 0)
    assert abs(mended - right) < 0.1 * abs(wrong - right)
    assert abs(float(ca.evalf(found.x)[0]) - mass) < 0.1 * mass


def test_what_is_lighter_than_empty_is_no_release() -> None:
    """Torques of less than the empty robot's are no load that was put down."""
    model, graph = robot("clavel-delta3")
    run, empty = running(model, 400, slice(200, 400)), running(model, 400, slice(0, 0))
    run.tau[:] = 2 * empty.tau - run.tau
    y = outputs(graph, run)
    assert y["change_score"].min() < -10
    assert not y["changed"].any()
    assert not y["held"].any()


def test_a_gripper_that_takes_time_is_waited_for() -> None:
    """And a signal that is gone before that time is none."""
    model, _ = robot("clavel-delta3")
    graph = step_graph(model, OnlineSettings(largest_mass=3.0, grip_time=0.05))
    run = running(model, 300, slice(150, 300))
    told = (np.arange(300) >= 100) | ((np.arange(300) >= 20) & (np.arange(300) < 60))
    held = outputs(graph, run, told)["held"][:, 0]
    assert not held[:149].any()
    assert held[151:].all()


def test_a_load_of_which_a_part_is_put_down_is_still_held() -> None:
    model, graph = robot("clavel-delta3")
    whole, part = (running(model, 900, slice(200, 900), 0.05, x * LOAD) for x in (2.0, 1.4))
    run = replace(whole, tau=np.where(np.arange(900)[:, None] < 550, whole.tau, part.tau))
    y = outputs(graph, run)
    assert y["held"][540, 0] == 1
    assert y["load"][540, 0] == pytest.approx(2.0, abs=0.2)
    assert y["held"][550:].all()
    assert y["load"][-1, 0] == pytest.approx(1.4, abs=0.15)
