"""The stream in Python, its feed-forward, and friction that is followed."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.errors import DeltaidError
from deltaid.model.model import Model
from deltaid.online.cycle import standard_parts, step_graph
from deltaid.online.graph import Field, Layout
from deltaid.online.online import CommandTorques
from deltaid.online.settings import OnlineSettings, knowledge
from online_runs import LOAD, QUIET, outputs, outputs_of, robot, running
from picking import picked

# How the names of columns begin that a cycle reads.
READ = ("q", "tau", "gripper")


@pytest.fixture(scope="module")
def online() -> deltaid.Online:
    return deltaid.Online("clavel-delta3", QUIET)


def test_steps_runs_and_the_graph_are_one(online: deltaid.Online) -> None:
    model, graph = robot("clavel-delta3")
    run = running(model, 320, slice(100, 320), noise=0.05)
    expected = outputs(graph, run, run.held)
    online.reset()
    whole = online.run(run.q, run.qd, run.tau, run.held.astype(float))
    for name, values in whole.outputs.items():
        np.testing.assert_allclose(values, expected[name], rtol=1e-8, atol=1e-9)
    online.reset()
    first = online.run(run.q[:311], run.qd[:311], run.tau[:311], run.held[:311].astype(float))
    steps = [online.step(run.q[k], run.qd[k], run.tau[k], gripper=True) for k in range(311, 320)]
    assert [float(step.mass) for step in steps] == whole.mass[311:].tolist()
    assert np.array_equal(first.mass, whole.mass[:311])
    low, high = steps[-1].mass_interval
    assert low <= 1.0 <= high


def test_differenced_speeds_have_no_lag() -> None:
    model, _ = robot("clavel-delta3")
    run = running(model, 400, slice(100, 400))
    graph = step_graph(model, replace(QUIET, speed="differenced"))
    load = outputs_of(graph, run.q, run.tau, run.held)["load"]
    assert np.abs(load[200:, 0] - 1.0).max() < 0.01


def test_feed_forward_is_what_drives_receive(monkeypatch: pytest.MonkeyPatch) -> None:
    """With the load and the friction; torques at the joints by the gains."""
    gains, (model, _) = np.array([1.2, 0.8, 1.5, 0.9]), robot("irb360-6-1600")
    known, run = knowledge(model, OnlineSettings()), running(model, 5, slice(0, 0))
    p, followed = model.with_load(LOAD).p.copy(), list(known.followed)
    p[followed] *= 1.2
    rows = run.q[2], run.qd[2], np.array([3.0, -2.0, 1.0, 8.0])
    expected = model.dynamics.inverse_dynamics(*rows, p) / gains
    monkeypatch.setattr(Model, "gains", property(lambda _: gains))
    found = CommandTorques(model, known)(*rows, LOAD[list(known.entries.shown)], p[followed])
    assert found == pytest.approx(expected, rel=1e-9)


def test_friction_that_changed_is_followed_within_its_bounds() -> None:
    model, graph = robot("clavel-delta3")
    run = running(model, 6000, slice(0, 0), noise=0.1)
    first = model.layout.friction.start
    names = model.layout.names[first : model.layout.friction.stop]
    more = model.p.copy()
    more[model.layout.friction] *= 1.15
    more[names.index("coulomb.drive1") + first] *= 2.0  # beyond what may be
    qdd = np.gradient(run.qd, 1e-3, axis=0)
    was, now = (model.dynamics.torque(run.z, run.qd, qdd, p) for p in (model.p, more))
    y = outputs(graph, replace(run, tau=run.tau + now - was), run.held)
    friction = y["friction"] / model.p[list(knowledge(model, QUIET).followed)]
    assert friction.min() >= 0.7 - 1e-12
    assert friction.max() <= 1.3 + 1e-12
    assert friction[-1, list(names).index("coulomb.drive1")] > 1.25
    assert np.abs(friction[-1, names.index("coulomb.drive2")] - 1.15) < 0.08


def test_friction_and_load_leave_the_model_passive() -> None:
    """M positive definite, and friction takes energy, with every estimate of a wild recording."""
    model, graph = robot("irb360-6-1600")
    run = running(model, 300, slice(100, 300))
    wild = run.tau + 8 * np.random.default_rng(3).standard_normal(run.tau.shape)
    y = outputs(graph, replace(run, tau=wild), run.held)
    known = knowledge(model, OnlineSettings(largest_mass=3.0))
    body = model.layout.body(known.entries.body).start
    for k in range(0, 300, 20):
        p = model.p.copy()
        p[list(known.followed)] = y["friction"][k]
        p[[body + i for i in known.entries.shown]] += y["load"][k]
        terms = model.dynamics.terms(run.q[k], run.qd[k], p)
        assert np.linalg.eigvalsh(terms.M).min() > 0
        assert terms.f @ run.qd[k] >= 0


def test_settings_that_cannot_be_are_refused(online: deltaid.Online) -> None:
    with pytest.raises(DeltaidError, match="corner"):
        OnlineSettings(rate=100.0, corner=200.0)
    with pytest.raises(DeltaidError, match="noise"):
        deltaid.Online("clavel-delta3", OnlineSettings(noise=(0.1,)))
    with pytest.raises(DeltaidError, match="body"):
        deltaid.Online("clavel-delta3", OnlineSettings(body="X"))
    with pytest.raises(DeltaidError, match="velocities"):
        online.step(np.zeros(3), None, np.zeros(3))


@pytest.mark.parametrize(
    ("changed", "what"),
    [
        ({"q": np.zeros(4), "tau": np.zeros(2)}, "q: expected arrays of shape"),
        ({"q": np.zeros((2, 3)), "qd": np.zeros((2, 3)), "tau": np.zeros((2, 3))}, "2 rows"),
        ({"tau": np.zeros((2, 3))}, "tau: has 2 samples"),
        ({"gripper": "yes"}, "gripper: holds"),
        ({"elapsed": [1e-3, 1e-3]}, "elapsed: has 2 values"),
    ],
)
def test_a_cycle_that_does_not_fit_the_robot_is_refused_by_name(
    online: deltaid.Online, changed: dict[str, object], what: str
) -> None:
    state, rest = online.state.copy(), dict.fromkeys(("q", "qd", "tau"), np.zeros(3))
    with pytest.raises(DeltaidError, match=what):
        online.step(**rest | changed)
    np.testing.assert_array_equal(online.state, state)


def test_a_layout_has_places_and_refuses_what_does_not_fit() -> None:
    a, b = Field("a", 2, "two", initial=(1.0, 2.0)), Field("b", 1, "one", initial=3.0)
    both = Layout(a, Field("none", 0, "nothing"), b)
    assert both.initial.tolist() == [1.0, 2.0, 3.0]
    assert both.split(np.arange(6.0).reshape(2, 3))["b"].tolist() == [[2.0], [5.0]]
    with pytest.raises(ValueError, match="one name"):
        Layout(a, a)


def test_a_stream_tells_of_contacts_where_the_model_is_identified() -> None:
    made = picked()
    q, tau, held = (made.table[:3700].select(pl.col(f"^{x}.*$")).to_numpy() for x in READ)
    online = deltaid.Online(made.model, OnlineSettings(speed="differenced", largest_mass=2.0))
    found = online.run(q, None, tau, held[:, 0] * 1.0)
    at = np.flatnonzero(found.contact)
    assert 3500 <= at[0] < 3520
    assert np.all(found.contact_limb[at[10:60]] == 0)
    force = found.contact_force[3560]
    assert force == pytest.approx([25.0, -15.0, 5.0], abs=4.0)
    prior = deltaid.Online("clavel-delta3").step(np.full(3, 0.4), np.zeros(3), np.zeros(3))
    with pytest.raises(DeltaidError, match="identify a model"):
        _ = prior.contact


def test_a_contact_is_timed_from_its_first_cycle_to_its_last() -> None:
    made, rows = picked(), slice(3300, 3800)
    graph = step_graph(made.model, OnlineSettings(largest_mass=2.0), standard_parts(made.model))
    q, tau, held = (made.table[rows].select(pl.col(f"^{x}.*$")).to_numpy() for x in READ)
    y = outputs_of(graph, q, np.gradient(q, 1e-3, axis=0), tau, held)
    time = graph.state.split(y["state"])["contact_time"].squeeze()
    expected, lasts = [], 0.0
    for touched in y["contact"].squeeze():
        lasts = lasts + 1e-3 if touched else 0.0
        expected.append(lasts)
    assert max(expected) > 0.05  # the push lasts 0.1 s
    np.testing.assert_allclose(time, expected, atol=1e-9)
