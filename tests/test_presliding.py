"""Friction that yields over a distance before it slips."""

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import deltaid
from deltaid.effects.point import TracePoint
from deltaid.effects.presliding import Presliding
from deltaid.identification.study import studied_trace
from deltaid.model.parameter_record import Parameter
from deltaid.model.verdict import Grade
from drives import case
from drives.identify import identified
from drives.judge import judge
from identified import identified as clean

RATE = 1000.0
TIME = np.arange(0, 6, 1 / RATE)
SHARES = (0.001, 0.003, 0.01, 0.03)


def motion(drive: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, q̇ and q̈ of a drive that turns often, near the ends of its range and within it."""
    rng = np.random.default_rng(drive)
    waves = 2 * np.pi * rng.uniform(0.2, 1.5, 4)
    sizes, phases = rng.uniform(0.1, 0.3, 4), rng.uniform(0, 2 * np.pi, 4)
    angles = waves * TIME[:, None] + phases
    return (
        np.sin(angles) @ sizes,
        np.cos(angles) @ (waves * sizes),
        -np.sin(angles) @ (waves**2 * sizes),
    )


def columns(q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, stroke: float) -> np.ndarray:
    effect = Presliding(deltaid.load("clavel-delta3").dynamics, (1,), (1.0,) * 4, (1 / stroke,))
    return effect.of_drive(0, q, qd, qdd)


@pytest.mark.parametrize("drive", [0, 1, 2])
def test_columns_solve_dahls_equation(drive: int) -> None:
    q, qd, qdd = motion(drive)
    stroke = float(np.ptp(q))
    z = columns(q, qd, qdd, stroke) + np.sign(qd)

    def rate(t: float, z: np.ndarray) -> np.ndarray:
        v = np.interp(t, TIME, qd)
        return v * (1 - np.sign(v) * z) / (np.array(SHARES) * stroke)

    exact = solve_ivp(rate, (0, TIME[-1]), z[:, 0], t_eval=TIME, max_step=2e-4, rtol=1e-6)
    assert np.abs(z - exact.y).max() < 0.02
    assert np.abs(z).max() <= 1.0


def test_a_block_begins_with_the_turn_before_it() -> None:
    q, qd, qdd = motion(0)
    whole = columns(q, qd, qdd, 1.0)
    turns = np.flatnonzero(np.diff(np.sign(qd)) != 0)
    for turn in turns[2:6]:
        after = slice(turn + 40, turn + 80)  # 40 ms after the turn
        part = columns(q[after], qd[after], qdd[after], 1.0)
        before = slice(turn - 20, turn)
        assert np.abs(whole[2:, after]).max() > 0.1
        assert part == pytest.approx(whole[:, after], abs=0.08)
        assert np.abs(columns(q[before], qd[before], qdd[before], 1.0)).max() < 1e-9


def test_a_drive_at_rest_keeps_its_friction() -> None:
    q = np.concatenate([np.linspace(0, 1, 101), np.full(50, 1.0), np.linspace(1, 0.5, 51)])
    qd = np.concatenate([np.full(101, 1.0), np.zeros(50), np.full(51, -1.0)])
    z = columns(q, qd, np.zeros_like(q), 1.0) + np.sign(qd)
    assert z[:, 101:151] == pytest.approx(np.ones((4, 50)))
    assert z[:, 151] == pytest.approx(np.ones(4))  # the swing back begins
    assert z[:, -1] == pytest.approx(-np.ones(4), abs=1e-6)
    assert not columns(q[:0], qd[:0], qd[:0], 1.0).size
    assert not columns(q, 0 * q, 0 * q, 1.0).any()


def test_friction_that_is_higher_after_a_turn_is_another_cause() -> None:
    result = clean("clavel-delta3").result
    trace = studied_trace(result.problem.dynamics, result.recordings[0], result.model.p)
    assert trace is not None
    point = TracePoint(trace, result.model.p)
    effect = Presliding.along(point)
    strokes = np.ptp(point.q, axis=0)
    assert effect.addition.orders == pytest.approx(1 / strokes)
    assert effect.columns(point).shape[2] == 12
    falling, covariance = np.array([0.2, -0.5, 0.1, 0.1]), 0.01 * np.eye(12)  # -0.1 ± 0.2
    for change, possible in ((0.0, True), (-0.2, True), (-0.4, False)):
        values = np.concatenate([-falling, falling + change / 4, 2 * np.ones(4)])
        assert effect.is_possible(values, covariance) == possible


@pytest.mark.parametrize(("sign", "words"), [(1, "builds up over 3.2°"), (-1, "an average or")])
def test_friction_that_falls_after_a_turn_is_not_said_to_yield(sign: int, words: str) -> None:
    dynamics, stroke = deltaid.load("clavel-delta3").dynamics, 2.0
    effect = Presliding(dynamics, (1,), (1.0,) * 4, (1 / stroke,))
    judged = [
        Parameter(name=name, value=sign * value, std=0.1, low=sign * value - 0.2,
                  high=sign * value + 0.2, unit="N m", prior=0.0, determined_by="data")
        for name, value in (("1", -0.1), ("3", 0.0), ("10", 0.1), ("30", 0.9))
    ]  # fmt: skip
    (correction,) = effect.to_corrections(judged)
    assert correction.value == pytest.approx(sign * 0.9)
    assert words in correction.text  # 3.2° is (0.1 · 1 % + 0.9 · 3 %) of 2 rad
    assert ("yield before they slip" in correction.text) == (sign > 0)


def test_check_names_friction_before_slip() -> None:
    yielding = case("presliding", "delta3", 0)
    verdicts = deltaid.check(yielding.robot, yielding.logs[0])
    (named,) = (verdict for verdict in verdicts if verdict.key == "presliding")
    assert named.grade != Grade.GOOD
    assert "builds up over 0.3 % of the stroke" in named.sentence
    assert not {"friction-law", "geometry-or-cogging", "torque-lag"} & {
        verdict.key for verdict in verdicts if verdict.grade != Grade.GOOD
    }


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "seed"), [("delta4", 1), ("par4", 1), ("linear", 0)])
def test_friction_before_slip_is_named(kind: str, seed: int, tmp_path: Path) -> None:
    yielding = case("presliding", kind, seed)
    result = identified(yielding)
    judged = judge(yielding, result)
    assert dict(judged.said)["presliding"] == len(yielding.robot.drives)
    others = {"contact", "lag", "filter", "compliance", "length", "friction"}
    assert not others & set(dict(judged.said))
    assert judged.M < 0.004
    assert judged.friction_shape < 0.01
    assert np.mean(judged.base) > 0.8
    named = [c for c in result.model.corrections if c.kind == "presliding"]
    true = yielding.happenings[0].friction.coulomb
    held = [c.low < coulomb < c.high for c, coulomb in zip(named, true.tolist(), strict=True)]
    assert all(held)
    result.model.save(tmp_path / "model.yaml")
    bare = result.model.changed(effects=())
    models = (tmp_path / "model.yaml", bare)
    kept, lost = (deltaid.validate(model, yielding.logs[0]).error.rms for model in models)
    assert np.all(kept < 0.8 * lost)
