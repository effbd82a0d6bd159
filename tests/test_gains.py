"""Torque constants that are off, found with a known load, and other columns beside a robot's."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from command import run
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.estimation.additions import Addition, Own, Values
from deltaid.estimation.reduction import Free
from deltaid.identification.fit import fit
from deltaid.identification.gains import Gains, gains, moves_of_scale
from deltaid.identification.identify import identify
from deltaid.identification.judgement import judged_base, judged_parameters
from deltaid.identification.prediction import validate
from deltaid.identification.setup import Setup
from deltaid.model.corrections import Correction
from deltaid.model.model import load
from deltaid.model.record import Settings
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.recording import PreparedRecording, open_recordings
from deltaid.recording.repairs import LeftSpan, Repairs
from deltaid.recording.windows import SampleBlock
from deltaid.robot.load import load_robot
from deltaid.robot.parameter import PriorParameter
from logs import tabled
from support import along
from sweeps import swept

RATE, DURATION, NOISE, MASS = 500.0, 16.0, 0.02, 1.0
HUM = 2 * np.pi * 3.1  # rad/s
STRONG = 0.21  # N m, one eighth of the prior's size


@dataclass(frozen=True, eq=False)
class Weight(Addition):
    """A known point mass at the platform, in one recording."""

    log: str

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return (PriorParameter("load", "weight", "m", "kg", 0.0, np.inf, MASS, MASS),)

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        drives, columns = self.dynamics.regressor_pattern
        mass = self.dynamics.layout.names.index("P.m")
        return drives[columns == mass], np.zeros(np.sum(columns == mass), dtype=int)

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        _, columns = self.dynamics.regressor_pattern
        mass = self.dynamics.layout.names.index("P.m")
        return own[columns == mass] * (str(recording.path) == self.log)

    @property
    def free(self) -> Free:
        return Free((), np.zeros((1, 0)), np.array([MASS]), ())

    @property
    def scale_reference(self) -> str:
        return "what the known load weighs"


def moving() -> tuple[Dynamics, np.ndarray]:
    dynamics = compiled(load_robot("clavel-delta3"))
    return dynamics, surrogate_parameters(dynamics.robot, np.random.default_rng(4))


def table(
    seed: int,
    gain: np.ndarray | float = 1.0,
    load: float = 0.0,
    *,
    hum: float = 0.0,
    duration: float = DURATION,
    noise: float = NOISE,
) -> pl.DataFrame:
    """What drives record whose torque constants are off, τ / c, with a hum at the second drive."""
    dynamics, p = moving()
    p = p.copy()
    p[dynamics.layout.names.index("P.m")] += load
    rng, t = np.random.default_rng(seed), np.arange(round(duration * RATE)) / RATE
    _, q, qd, qdd = along(dynamics.kinematics, rng, t, period=3.917)
    tau = dynamics.inverse_dynamics(q, qd, qdd, p) / gain
    tau += noise * np.abs(tau).max(axis=0) * rng.standard_normal(tau.shape)
    tau[:, 1] += hum * np.sin(HUM * t)
    return tabled(t=t, q=q, tau=tau)


def setup(gain: np.ndarray) -> Setup:
    dynamics, _ = moving()
    tables = [table(1, gain, 0.0), table(51, gain, MASS)]
    return Setup(dynamics.robot, tuple(open_recordings(tables, dynamics.kinematics)), Settings())


@pytest.mark.parametrize(
    "gain", swept([(1.07, 0.95, 1.02), (0.91, 0.9, 1.1), (1.0, 1.0, 1.0)], (1.07, 0.95, 1.02))
)
def test_gains_are_found_with_a_known_load_in_one_of_two_recordings(
    gain: tuple[float, ...],
) -> None:
    dynamics, p = moving()
    bare = setup(np.array(gain))
    weight = Weight(dynamics, str(bare.recordings[1].path))
    found = gains(bare.changed(additions=(weight,)), lambda _: None)
    last = found.additions[-1]
    assert isinstance(last, Gains)
    np.testing.assert_allclose(last.gain, gain, rtol=0.01)
    assert found.recordings[0].repairs.gain == tuple(last.gain.tolist())
    problem = fit(dynamics, found.recordings, Settings(), additions=found.additions)
    for c, correction in zip(
        gain, last.to_corrections(judged_parameters(problem)[-3:]), strict=True
    ):
        assert correction.low < c < correction.high
        assert correction.high - correction.low < 0.03
        assert "known load weighs" in correction.text
    home = dynamics.kinematics.inverse(dynamics.kinematics.home[None])
    M, true = (dynamics.mass_matrix(home, x)[0] for x in (problem.p, p))
    np.testing.assert_allclose(M, true, rtol=0, atol=0.015 * true.max())


def test_without_a_known_load_torques_stay_as_they_are() -> None:
    bare = setup(np.array([1.07, 0.95, 1.02]))
    assert gains(bare, lambda _: None) == bare or gains(bare, lambda _: None).additions == ()


def test_limbs_that_are_alike_tell_ratios_without_any_load() -> None:
    dynamics, p = moving()
    gain = np.array([1.06, 0.95, 1.02])
    only = Settings(events=False, friction="described")
    result = identify(dynamics.robot, table(1, gain, 0.0), settings=only)
    model, common = result.model, np.exp(np.mean(np.log(gain)))
    np.testing.assert_allclose(model.gains, gain / common, rtol=2e-3)
    corrections = [correction for correction in model.corrections if correction.kind == "gain"]
    assert [correction.subject for correction in corrections] == list(dynamics.robot.drives)
    for correction, true in zip(corrections, gain / common, strict=True):
        assert correction.low < true < correction.high
        assert "assumed correct" in correction.text
    assert not [correction for correction in model.corrections if correction.kind != "gain"]
    q = np.zeros((1, 3))
    ratio = dynamics.mass_matrix(q, model.p) / dynamics.mass_matrix(q, p)
    np.testing.assert_allclose(np.diag(ratio[0]), 1 / common, rtol=3e-3)
    # What all gains have in common is counted, as they scatter; stated tolerances take its place.
    values = result.base.combination()[:, : len(p)] @ p
    base = zip(model.base_parameters, values, strict=False)
    assert all(parameter.low <= value <= parameter.high for parameter, value in base)
    tolerances = dynamics.robot.tolerances.changed(torque_constants=0.01)
    stated = compiled(dynamics.robot.changed(tolerances=tolerances))
    (move,) = moves_of_scale(result.problem)
    (spread,) = [a.common_spread for a in result.problem.additions if isinstance(a, Gains)]
    assert list(move.values()) == pytest.approx((spread * result.problem.p).tolist())
    assert not moves_of_scale(replace(result.problem, dynamics=stated))


def test_where_one_drive_differs_from_others_that_agree_these_are_right() -> None:
    dynamics, p = moving()
    gain = np.array([1.0, 0.95, 1.0])
    only = Settings(events=False, friction="described")
    model = identify(dynamics.robot, table(1, gain, 0.0), settings=only).model
    np.testing.assert_allclose(model.gains, gain, rtol=2e-3)
    assert all("other limbs' drives, which agree" in correction.text
               for correction in model.corrections if correction.kind == "gain")  # fmt: skip
    q = np.zeros((1, 3))
    ratio = dynamics.mass_matrix(q, model.p) / dynamics.mass_matrix(q, p)
    np.testing.assert_allclose(np.diag(ratio[0]), 1.0, rtol=3e-3)


def test_a_load_that_is_always_there_tells_no_gains_and_that_is_said() -> None:
    dynamics, _ = moving()
    bare = setup(np.array([1.04, 1.04, 1.04]))
    loaded = bare.changed(recordings=bare.recordings[1:])
    weight = Weight(dynamics, str(loaded.recordings[0].path))
    found = gains(loaded.changed(additions=(weight,)), lambda _: None)
    problem = fit(dynamics, found.recordings, Settings(), additions=found.additions)
    for correction in found.additions[-1].to_corrections(judged_parameters(problem)[-3:]):
        assert correction.low < 1.04 < correction.high
        assert correction.high - correction.low > 0.15
        assert "hardly shows" in correction.text


def test_a_model_knows_its_gains_when_it_is_verified_and_when_it_commands(tmp_path: Path) -> None:
    dynamics, _ = moving()
    gain = np.array([1.07, 0.95, 1.02])
    plain = Settings(
        friction="described", lag="none", compliance="none", effects="none", events=False
    )
    bare = identify(dynamics.robot, table(1, np.ones(3), 0.0), settings=plain).model
    known = bare.changed(
        corrections=tuple(
            Correction(kind="gain", subject=f"drive{i + 1}", value=c, text="as weighed")
            for i, c in enumerate(gain.tolist())
        )
    )
    np.testing.assert_array_equal(load(known).gains, gain)
    unseen = table(9, gain, 0.0)
    with_gains, without = (validate(model, unseen)[0].nrmse for model in (known, bare))
    assert np.all(without > 1.5 * with_gains)
    log, model, planned = (tmp_path / name for name in ("log.csv", "model.yaml", "tau.csv"))
    unseen.write_csv(log)
    known.save(model)
    assert run("torque", model, log, "-o", planned).code == 0
    commanded = pl.read_csv(planned)
    recorded = unseen.join(commanded.drop_nulls(), on="t", suffix="_commanded")
    for i in range(3):
        measured, planned_torque = (
            recorded[f"tau{i + 1}{end}"].to_numpy() for end in ("", "_commanded")
        )
        slope = measured @ planned_torque / (planned_torque @ planned_torque)
        assert slope == pytest.approx(1.0, abs=0.02)


@dataclass(frozen=True, eq=False)
class Hum(Addition):
    """A torque sin ωt of unknown size at one drive of one recording."""

    drive: int
    log: str

    @property
    def parameters(self) -> tuple[PriorParameter, ...]:
        return (
            PriorParameter(
                "lag", f"drive{self.drive + 1}", "hum", "N*m", -np.inf, np.inf, 0.0, 1.7
            ),
        )

    @property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([self.drive]), np.array([0])

    def entries(self, w: SampleBlock, own: Own, recording: PreparedRecording) -> Values:
        here = str(recording.path) == self.log
        return np.sin(HUM * w.time)[None] * here


@cache
def recordings() -> tuple[PreparedRecording, ...]:
    dynamics, _ = moving()
    tables = [table(k, hum=hum, duration=8.0, noise=0.01) for k, hum in ((1, STRONG), (2, 0.0))]
    return tuple(open_recordings(tables, dynamics.kinematics))


def test_an_addition_is_fitted_in_the_recording_that_has_it_and_judged_like_the_rest() -> None:
    dynamics, p = moving()
    hum = Hum(dynamics, 1, str(recordings()[0].path))
    problem = fit(dynamics, recordings(), Settings(), additions=[hum])
    plain = fit(dynamics, recordings(), Settings())
    judged = judged_parameters(problem)[-1]
    assert judged.name == "hum.drive2"
    assert judged.determined_by == "data"
    assert judged.low < STRONG < judged.high
    assert judged.high - judged.low < 0.1 * STRONG
    assert len(problem.p) == len(p) == len(problem.values) - 1
    assert problem.noise < 0.9 * plain.noise
    assert problem.solution.duality_gap <= 1e-5 * problem.solution.objective
    names = [parameter.representative for parameter in judged_base(problem)]
    assert "hum.drive2" not in names
    assert names == [parameter.representative for parameter in judged_base(plain)]


def test_rows_that_are_excluded_by_time_do_not_count_and_no_others_do_less() -> None:
    dynamics, _ = moving()
    original = recordings()[0]
    spans = (LeftSpan(2.0, 2.5, "contact"), LeftSpan(4.0, 4.1, "spike", (2,)))
    repaired = replace(original, repairs=Repairs(left_out=spans))

    def weights(recording: PreparedRecording) -> tuple[np.ndarray, np.ndarray]:
        parts = [window.inner for window in recording.windows(dynamics.kinematics)]
        time = np.concatenate([w.time for w in parts])
        return time, np.concatenate([w.weights for w in parts])

    time, before = weights(original)
    _, after = weights(repaired)
    gone = np.zeros_like(after, dtype=bool)
    gone[(time >= 2.0) & (time <= 2.5)] = True
    gone[(time >= 4.0) & (time <= 4.1), 2] = True
    assert gone.any(axis=0).all()
    np.testing.assert_array_equal(after, np.where(gone, 0.0, before))
