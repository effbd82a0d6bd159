"""Causes that what a fit leaves of the torques points at, each made by hand; clean has none."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from deltaid.checks.evidence import evidence, with_fit
from deltaid.checks.residual import checked_residual
from deltaid.identification.fit import FittedProblem
from deltaid.model.options import EffectsChoice
from deltaid.model.settings import Settings
from deltaid.model.verdict import Grade, Verdict
from deltaid.recording.recording import PreparedRecording
from deltaid.robot.load import load_robot
from logs import tabled
from sweeps import swept
from test_lag import DURATION, RATE, frame, moving

Added = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


@cache
def truth() -> tuple[np.ndarray, ...]:
    """t, z, q, q̇ and q̈ of the motion."""
    dynamics, _, motion = moving()
    t = np.arange(round(DURATION * RATE)) / RATE
    z, zd, zdd = motion.evaluate(t)
    return t, z, *dynamics.kinematics.drive_motion(z, zd, zdd)


def said(added: Added | None = None, late: float = 0.0, noise: float = 0.01) -> dict[str, Verdict]:
    """Verdicts on a recording to whose torques something is added, by key."""
    table = frame(np.full(3, late), noise=noise)
    if added is not None:
        t, _, q, qd, _ = truth()
        tau = table.select(["tau1", "tau2", "tau3"]).to_numpy()
        more = tau + added(t, q, qd, tau)
        table = table.with_columns(tabled(tau=more))
    verdicts = list(checked_residual(evidence(load_robot("clavel-delta3"), table)))
    assert len({v.key for v in verdicts}) == len(verdicts)
    return {v.key: v for v in verdicts}


def load(mass: float) -> np.ndarray:
    """Torques of a load in the middle of the platform."""
    (dynamics, p, _), (_, z, _, qd, qdd) = moving(), truth()
    heavier = p.copy()
    heavier[dynamics.layout.names.index("P.m")] += mass
    return dynamics.torque(z, qd, qdd, heavier) - dynamics.torque(z, qd, qdd, p)


def only(key: str, added: Added | None = None, late: float = 0.0) -> Verdict:
    """The only verdict that is not good, which is that of a key."""
    verdicts = said(added, late)
    bad = [name for name, v in verdicts.items() if v.grade in (Grade.DOUBTFUL, Grade.WRONG)]
    assert bad == [key]
    return verdicts[key]


def test_a_clean_recording_points_at_nothing() -> None:
    grades = {key: verdict.grade for key, verdict in said().items()}
    assert grades == dict.fromkeys(("torque-lag", "resonance", "residual"), Grade.GOOD)


def test_a_lag_is_reported_in_milliseconds_and_with_what_it_does() -> None:
    lag = only("torque-lag", late=3e-3)
    assert lag.number == pytest.approx(3.0, abs=0.2)
    assert "torque lags position by" in lag.seen
    assert "the inertia of drive" in lag.seen
    assert "-1.5 rows" in lag.cure


@pytest.mark.parametrize(("hidden", "why"), [(False, "--lag none"), (True, "may look like a lag")])
def test_a_lag_that_is_not_corrected_says_why_and_what_it_costs(hidden: bool, why: str) -> None:
    robot, settings = load_robot("clavel-delta3"), Settings(lag="estimate" if hidden else "none")
    record = evidence(robot, frame(np.full(3, 3e-3), noise=0.01), settings=settings)
    assert isinstance(record.fitted, FittedProblem)
    assert isinstance(record.surveyed, PreparedRecording)
    assert record.study is not None
    study = replace(record.study, hidden=hidden)
    (lag, *_) = checked_residual(with_fit(record, record.fitted, record.surveyed, study))
    cost = r"makes the inertia of drive\d [\d.]+ % too (small|large); not corrected: .*"
    assert re.search(cost + why, lag.seen), lag.seen


def test_friction_of_another_law_is_reported_by_its_joint() -> None:
    def stribeck(t, q, qd, tau) -> np.ndarray:
        knee = 0.1 * np.abs(qd).max(axis=0)
        return [0.0, 4.0, 0.0] * np.sign(qd) * np.exp(-np.abs(qd) / knee)

    verdict = only("friction-law", stribeck)
    assert verdict.subject == "drive2"
    assert "low speed" in verdict.seen


def test_a_ripple_over_the_position_is_cogging() -> None:
    verdict = only(
        "geometry-or-cogging",
        lambda t, q, qd, tau: 0.05 * tau.max(axis=0) * np.sin(2 * np.pi * 9 * q),
    )
    assert "ripple" in verdict.seen
    assert "cogging" in verdict.cause


def test_friction_that_falls_while_the_robot_warms_up_is_drift() -> None:
    def warm(t, q, qd, tau) -> np.ndarray:
        return 3.0 * np.exp(-t / 4.0)[:, None] * np.sign(qd)

    verdict = only("drift", warm)
    assert "warm" in verdict.cause


def test_a_load_is_reported_by_its_mass_and_times() -> None:
    change = only("load-change", lambda t, q, qd, tau: load(0.4) * ((t > 3.0) & (t < 7.0))[:, None])
    assert change.number == pytest.approx(0.4, rel=0.05)
    times = change.seen.split(" at ")[1].removesuffix(" s").split(", ")
    np.testing.assert_allclose([float(time) for time in times], [3.0, 7.0], atol=0.02)
    (proposal,) = change.proposals
    assert proposal.file == "mapping"
    named, (path, spans) = proposal.changes
    assert (named, path) == (("load.name", "load"), "load.spans")
    np.testing.assert_allclose(np.array(spans), [[3.0, 7.0]], atol=0.02)


def test_a_load_that_comes_and_goes_is_followed() -> None:
    change = only("load-change", lambda t, q, qd, tau: load(1.5) * (t % 0.6 > 0.3)[:, None])
    assert change.number == pytest.approx(1.5, rel=0.05)
    first, more = change.seen.split(" at ")[1].split(" s and ")
    switches = np.array([float(x) for x in first.split(", ")]) / 0.3
    np.testing.assert_allclose(switches, np.round(switches[0]) + np.arange(4), atol=0.2)
    assert int(more.split()[0]) == pytest.approx(35, abs=2)


@pytest.mark.parametrize("gain", swept([0.75, 1.15], 0.75))
def test_a_drive_whose_torque_constant_is_wrong_is_named(gain: float) -> None:
    verdict = only("drive-gain", lambda t, q, qd, tau: [0.0, 0.0, gain - 1] * tau)
    assert verdict.subject == "drive3"
    assert verdict.number == pytest.approx(100 * (gain - 1), rel=0.05)


def test_every_drive_whose_torque_constant_is_wrong_is_named_with_its_size() -> None:
    gain = only("drive-gain", lambda t, q, qd, tau: [0.08, -0.08, 0.04] * tau)
    percentages = dict(re.findall(r"(drive\d)'s \D*([\d.]+) %", gain.seen))
    mean = 1 + 0.04 / 3
    for name, factor in zip(("drive1", "drive2", "drive3"), (1.08, 0.92, 1.04), strict=True):
        assert float(percentages[name]) == pytest.approx(100 * abs(factor / mean - 1), abs=0.6)
    assert gain.number == pytest.approx(100 * (0.92 / mean - 1), abs=0.5)


@pytest.mark.parametrize("beta", [0.05, 0.15])
def test_a_torque_constant_that_falls_with_current_is_named_with_its_size(beta: float) -> None:
    def saturated(t, q, qd, tau) -> np.ndarray:
        largest = np.abs(tau).max(axis=0)
        return [0.0, beta, 0.0] * tau**3 / largest**2

    falls = only("torque-constant", saturated)
    assert falls.subject == "drive2"
    assert falls.number == pytest.approx(100 * beta, rel=0.15)
    assert "saturates" in falls.cause


def test_a_lag_that_does_nothing_is_left_unsaid() -> None:
    lag = said(late=0.3e-3)["torque-lag"]
    assert lag.grade is Grade.GOOD
    assert "too little to bias an inertia" in lag.seen


def test_something_that_rings_is_reported_by_its_frequency() -> None:
    def ringing(t, q, qd, tau) -> np.ndarray:
        rng = np.random.default_rng(0)
        phase = np.cumsum(rng.standard_normal(len(t))) * 0.1
        wave = np.sin(2 * np.pi * 41 * t + phase)
        return 0.05 * np.abs(tau[:, [1]]).max() * wave[:, None] * [0.0, 1.0, 0.0]

    verdict = only("resonance", ringing)
    assert verdict.number == pytest.approx(41, abs=1.5)
    assert verdict.subject == "drive2"


def test_what_follows_nothing_is_reported_as_such() -> None:
    def knocks(t, q, qd, tau) -> np.ndarray:
        rng = np.random.default_rng(4)
        places = rng.uniform(1, 11, 25)
        heights = rng.choice([-1, 1], (25, 3)) * 0.5 * np.abs(tau).max(axis=0)
        return sum(
            h * (np.abs(t - place) < 0.02)[:, None]
            for place, h in zip(places, heights, strict=True)
        )

    verdict = only("residual", knocks)
    assert (verdict.number or 0.0) > 3
    assert "short" in verdict.seen


def _scaled(x: np.ndarray) -> np.ndarray:
    return x / np.abs(x).max(axis=0)


@pytest.mark.parametrize(
    ("added", "words"),
    [
        (lambda t, q, qd, tau: np.cos(9 * _scaled(qd)), "it varies with the speed of drive2"),
        (lambda t, q, qd, tau: np.cos(8 * _scaled(tau)), "it varies with the torque of drive2"),
        (lambda t, q, qd, tau: np.sin(5 * t)[:, None], "it varies with neither speed, place"),
    ],
)
def test_what_no_effect_explains_is_unexplained(added: Added, words: str) -> None:
    own = np.array([0.0, 1.0, 0.0])
    verdicts = said(lambda *at: 0.03 * own * np.abs(at[3]).max(axis=0) * added(*at))
    verdict = verdicts["residual"]
    assert (verdict.grade, verdict.subject) == (Grade.DOUBTFUL, "drive2")
    assert verdict.seen.startswith("unexplained: ")
    assert words in verdict.seen
    assert 4 < (verdict.number or 0) < 8  # per cent of its rms torque


def test_noise_is_no_part_of_what_is_unexplained() -> None:
    def added(t, q, qd, tau) -> np.ndarray:
        return [0.0, 0.03, 0.0] * np.abs(tau).max(axis=0) * np.cos(9 * _scaled(qd))

    quiet, noisy = (said(added, noise=noise)["residual"].number for noise in (0.01, 0.03))
    assert noisy == pytest.approx(quiet, rel=0.06)


def test_torques_that_a_model_explains_without_any_noise_were_computed() -> None:
    verdict = said(noise=0.0)["residual"]
    assert (verdict.grade, verdict.subject) == (Grade.DOUBTFUL, "")
    assert verdict.seen.startswith("the model explains all torques to 0.00")
    assert "computed" in verdict.cause
    assert said(noise=0.001)["residual"].grade is Grade.GOOD  # as measured ones at their best


def test_one_column_of_computed_torques_is_named() -> None:
    verdict = said(lambda t, q, qd, tau: np.array([0.0, 0.0, 1.0]) * noise_of(tau), noise=0.0)
    assert verdict["residual"].subject == "drive1 and drive2"


@pytest.mark.parametrize(("effects", "is_in_doubt"), [("correct", True), ("none", False)])
@pytest.mark.parametrize(
    ("key", "words", "added"),
    [
        ("geometry-or-cogging", "cogging of the motor, or teeth of the gear",
         lambda q, tau: 3.0 * np.sin(2 * np.pi * 9 * q)),
        ("drive-gain", "a torque constant, rated torque or gear that differs from the mapping",
         lambda q, tau: [0.0, 0.0, 0.2] * tau),
    ],
)  # fmt: skip
def test_a_cause_that_was_not_corrected_may_be_something_else(
    key: str,
    words: str,
    added: Callable[[np.ndarray, np.ndarray], np.ndarray],
    effects: EffectsChoice,
    is_in_doubt: bool,
) -> None:
    """An identification corrects such causes, and leaves those that do not explain the torques."""
    table, (_, _, q, _, _) = frame(np.zeros(3), noise=0.01), truth()
    tau = table.select(["tau1", "tau2", "tau3"]).to_numpy()
    tau = tau + added(q, tau)
    robot, table = load_robot("clavel-delta3"), table.with_columns(tabled(tau=tau))
    record = evidence(robot, table, settings=Settings(effects=effects))
    before = {v.key: v.cause for v in checked_residual(record)}
    assert isinstance(record.fitted, FittedProblem)
    assert isinstance(record.surveyed, PreparedRecording)
    fitted = with_fit(record, record.fitted, record.surveyed, record.study)
    after = {v.key: v.cause for v in checked_residual(fitted)}
    assert before[key] == words
    assert ("something unknown that looks like it" in after[key]) == is_in_doubt


def noise_of(tau: np.ndarray) -> np.ndarray:
    noise = np.random.default_rng(0).standard_normal(tau.shape)
    return 0.01 * np.abs(tau).max(axis=0) * noise
