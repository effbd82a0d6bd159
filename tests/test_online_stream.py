"""The stream in Python, its feed-forward, and friction that is followed."""

import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.errors import DeltaidError
from deltaid.online.cycle import standard_parts, step_graph
from deltaid.online.graph import Field, Layout
from deltaid.online.online import CommandTorques
from deltaid.online.settings import OnlineSettings, knowledge
from online_runs import LOAD, outputs, robot, running
from picking import picked

SETTINGS = OnlineSettings(noise=(0.1,) * 3, unmodelled=(0.1,) * 3, largest_mass=3.0)


@pytest.fixture(scope="module")
def online() -> deltaid.Online:
    return deltaid.Online("clavel-delta3", SETTINGS)


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
    settings = OnlineSettings(
        noise=(0.1,) * 3, unmodelled=(0.1,) * 3, largest_mass=3.0, speed="differenced"
    )
    graph = step_graph(model, settings)
    u = np.column_stack([run.q, run.tau, run.held, np.full(400, -1.0)])
    y = np.array(graph.function.mapaccum(400)(graph.state.initial, u.T)[1]).T
    load = graph.outputs.split(y)["load"][:, 0]
    assert np.abs(load[200:] - 1.0).max() < 0.01


def test_feed_forward_has_the_load_and_the_friction() -> None:
    model, _ = robot("irb360-6-1600")
    known = knowledge(model, OnlineSettings())
    ahead, run = CommandTorques(model, known), running(model, 5, slice(0, 0))
    shown = LOAD[list(known.entries.shown)]
    p = model.with_load(LOAD).p.copy()
    friction = 1.2 * model.p[list(known.followed)]
    p[list(known.followed)] = friction
    qdd = np.array([3.0, -2.0, 1.0, 8.0])
    expected = model.dynamics.inverse_dynamics(run.q[2], run.qd[2], qdd, p)
    assert np.allclose(ahead(run.q[2], run.qd[2], qdd, shown, friction), expected, atol=1e-9)


def test_friction_that_changed_is_followed_within_its_bounds() -> None:
    model, graph = robot("clavel-delta3")
    run = running(model, 6000, slice(0, 0), noise=0.1)
    first = model.layout.friction.start
    names = model.layout.names[first : model.layout.friction.stop]
    more = model.p.copy()
    more[model.layout.friction] *= 1.15
    more[names.index("coulomb.drive1") + first] *= 2.0  # beyond what may be
    _, qd, qdd = (run.z, run.qd, np.gradient(run.qd, 1e-3, axis=0))
    tau = run.tau + model.dynamics.torque(run.z, qd, qdd, more)
    tau -= model.dynamics.torque(run.z, qd, qdd, model.p)
    y = outputs(graph, type(run)(run.z, run.q, qd, tau, run.held), run.held)
    friction = y["friction"] / model.p[list(knowledge(model, SETTINGS).followed)]
    assert friction.min() >= 0.7 - 1e-12
    assert friction.max() <= 1.3 + 1e-12
    assert friction[-1, list(names).index("coulomb.drive1")] > 1.25
    assert np.abs(friction[-1, names.index("coulomb.drive2")] - 1.15) < 0.08


def test_friction_and_load_leave_the_model_passive() -> None:
    """M positive definite, and friction takes energy, with every estimate of a wild recording."""
    model, graph = robot("irb360-6-1600")
    run = running(model, 300, slice(100, 300))
    wild = run.tau + 8 * np.random.default_rng(3).standard_normal(run.tau.shape)
    y = outputs(graph, type(run)(run.z, run.q, run.qd, wild, run.held), run.held)
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


def test_a_layout_has_places_and_refuses_what_does_not_fit() -> None:
    a, b = Field("a", 2, "two", initial=(1.0, 2.0)), Field("b", 1, "one", initial=3.0)
    both = Layout(a, Field("none", 0, "nothing"), b)
    assert both.initial.tolist() == [1.0, 2.0, 3.0]
    assert both.split(np.arange(6.0).reshape(2, 3))["b"].tolist() == [[2.0], [5.0]]
    with pytest.raises(ValueError, match="one name"):
        Layout(a, a)


def test_a_stream_tells_of_contacts_where_the_model_is_identified() -> None:
    made = picked()
    q, tau = (
        np.column_stack([made.table[f"{name}{i}"].to_numpy() for i in (1, 2, 3)])
        for name in ("q", "tau")
    )
    online = deltaid.Online(made.model, OnlineSettings(speed="differenced", largest_mass=2.0))
    found = online.run(q[:3700], None, tau[:3700], made.table["gripper"].to_numpy()[:3700] * 1.0)
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
    table = made.table[rows]
    q, tau = (table.select(pl.col(f"^{name}[1-3]$")).to_numpy() for name in ("q", "tau"))
    held = table["gripper"].to_numpy().astype(float)
    u = np.column_stack([q, np.gradient(q, 1e-3, axis=0), tau, held, np.full(len(q), -1.0)])
    states, outputs = graph.function.mapaccum(len(u))(graph.state.initial, u.T)
    time = graph.state.split(np.array(states).T)["contact_time"].squeeze()
    contact = graph.outputs.split(np.array(outputs).T)["contact"].squeeze()
    expected, lasts = [], 0.0
    for found in contact:
        lasts = lasts + 1e-3 if found else 0.0
        expected.append(lasts)
    assert max(expected) > 0.05  # the push lasts 0.1 s
    np.testing.assert_allclose(time, expected, atol=1e-9)
