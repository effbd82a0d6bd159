"""Torques that come later or earlier than their motion: put beside it in every cycle."""

from dataclasses import replace

import casadi as ca
import numpy as np
import polars as pl
import pytest

import deltaid
from deltaid.errors import DeltaidError
from deltaid.exports.structured_text import plc_program
from deltaid.exports.text import DOUBLE
from deltaid.model.model import Model, load
from deltaid.online.graph import CycleFields, Field, Layout
from deltaid.online.instant import Waits, line, waits
from deltaid.online.replay import open_replay
from deltaid.online.settings import OnlineSettings
from deltaid.online.watch import watch
from online_runs import RATE, running
from picking import MASS, assert_as_it_was, picked
from st_program import Program

# Two drives whose torques come late, one whose torques come early [s].
DELAY = (1.4e-3, 1.4e-3, -0.6e-3)
READ = Layout(
    Field("q", 1, "position"), Field("tau", 2, "torques"), Field("gripper", 1, "it", initial=-1.0)
)


def ran(rows: np.ndarray, each: Waits) -> np.ndarray:
    """What comes out row by row; a row with NaN breaks the line."""
    goes_on, u = ca.SX.sym("goes_on"), READ.symbols("in")
    finite = ca.SX.sym("finite")
    fields = CycleFields()
    waited = line(fields, READ, u, each.of_inputs(READ), goes_on, finite)
    step = ca.Function(
        "step", [fields.before["waiting"], READ.vector(u), goes_on, finite],
        [fields.following["waiting"], READ.vector(waited)],
    )  # fmt: skip
    state, out, before = np.zeros(fields.before["waiting"].numel()), [], False
    for row in rows:
        good = bool(np.isfinite(row).all())
        following, y = step(state, row, before, good)
        state, before = np.array(following).ravel(), good
        assert np.isfinite(state).all()
        out.append(np.array(y).ravel())
    return np.array(out)


def test_all_is_of_one_instant_once_the_line_is_full() -> None:
    # A torque 1.4 cycles late, one 0.85 cycles early.
    t = np.arange(12.0)
    rows = np.column_stack([t, 10 + 2 * (t - 1.4), 7 - 3 * (t + 0.85), t])
    each = Waits(1.4, (0.0, 2.25))
    out = ran(rows, each)
    assert each.cycles == 3
    for then, row in zip(t[3:] - 1.4, out[3:], strict=True):
        np.testing.assert_allclose(row[:3], [then, 10 + 2 * then, 7 - 3 * then], atol=1e-12)
    assert out[3:, 3].tolist() == (t[3:] - 1).tolist()


def test_behind_a_bad_cycle_nothing_of_before_is_left() -> None:
    t = np.arange(9.0)
    rows = np.column_stack([t, t, t, t])
    rows[4] = np.nan
    out = ran(rows, Waits(2.0, (0.0, 1.0)))
    assert out[5].tolist() == [5.0, 5.0, 5.0, 5.0]
    assert out[8].tolist() == [6.0, 8.0, 7.0, 6.0]


def test_lags_are_those_of_the_model_unless_others_are_stated() -> None:
    lagging = with_delay(picked().model, DELAY)
    assert waits(lagging, OnlineSettings()).motion == pytest.approx(1.4)
    assert waits(lagging, OnlineSettings()).torque == pytest.approx((0, 0, 2.0))
    assert waits(lagging, OnlineSettings(delay=0.0)) == Waits(0.0, (0.0, 0.0, 0.0))
    assert waits(lagging, OnlineSettings(delay=-1e-3)) == Waits(0.0, (1.0, 1.0, 1.0))
    assert waits(lagging, OnlineSettings(rate=4000.0, delay=2e-3)) == Waits(8.0, (0.0, 0.0, 0.0))


@pytest.mark.parametrize("delay", [0.06, (-0.03, 0.03, 0.0), float("nan"), (1e-3, 1e-3)])
def test_lags_that_cannot_be_are_refused(delay: float | tuple[float, ...]) -> None:
    with pytest.raises(DeltaidError, match=r"delay: (makes signals wait|has 2 numbers)"):
        waits(load("clavel-delta3"), OnlineSettings(delay=delay))
    fast = OnlineSettings(rate=40_000.0, delay=0.02)
    with pytest.raises(DeltaidError, match="800 cycles"):
        waits(load("clavel-delta3"), fast)


def test_without_a_lag_nothing_waits() -> None:
    assert "waiting" not in deltaid.Online(picked().model).graph.state.places


@pytest.mark.slow
def test_structured_text_lets_signals_wait_too() -> None:
    """Numbers that move on by one must not overwrite each other where the state is one array."""
    model, cycles = load("clavel-delta3"), 30
    settings = OnlineSettings(delay=(2.4e-3, 1e-3, -1.5e-3))
    run = running(model, cycles, slice(10, cycles))
    run.tau[17] = np.nan
    online = deltaid.Online(model, settings)
    expected = online.run(run.q, run.qd, run.tau, run.held.astype(float)).outputs
    program = Program(plc_program(model, "rob", DOUBLE, ("online",), settings).text)
    block = program.units["rob_online"]()
    for k in range(cycles):
        row = {"q": run.q[k].tolist(), "qd": run.qd[k].tolist(), "tau": run.tau[k].tolist()}
        _, y = block(**row, gripper=float(run.held[k]), elapsed=-1.0, reset=False)
        np.testing.assert_allclose(y["residual"], expected["residual"][k], atol=1e-9)
        assert y["held"] == expected["held"][k, 0]


def with_delay(model: Model, delay: tuple[float, ...]) -> Model:
    known = model.identified
    sources = tuple(source.changed(delay=delay) for source in known.sources)
    return load(known.changed(sources=sources))


def late() -> pl.DataFrame:
    """The recording with each torque late by `DELAY`."""
    t = picked().table["t"].to_numpy()
    columns = {
        f"tau{i + 1}": np.interp(t - delay, t, picked().table[f"tau{i + 1}"].to_numpy())
        for i, delay in enumerate(DELAY)
    }
    return picked().table.with_columns(**columns)


def test_loads_and_contacts_are_those_without_a_lag() -> None:
    settings = OnlineSettings(largest_mass=2.0)
    lagging = with_delay(picked().model, DELAY)
    replay = open_replay(lagging, late(), gripper="gripper")
    found = watch(lagging, replay, settings)
    assert_as_it_was(found)
    assert not found.doubts
    wrong = replace(settings, delay=tuple(-delay for delay in DELAY))
    assert any("against positions" in doubt for doubt in watch(lagging, replay, wrong).doubts)


def test_a_stream_with_a_lag_is_the_replay() -> None:
    lagging, t = with_delay(picked().model, DELAY), late()[:3000]
    q, tau = (t.select([f"{name}{i}" for i in (1, 2, 3)]).to_numpy() for name in ("q", "tau"))
    online = deltaid.Online(
        lagging, OnlineSettings(rate=RATE, speed="differenced", largest_mass=2.0)
    )
    now = online.run(q, None, tau, t["gripper"].to_numpy().astype(float))
    assert float(now.mass[-1]) == pytest.approx(MASS, abs=0.05)
    assert int(np.argmax(now.held)) == 2001
