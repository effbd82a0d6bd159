"""What a fit makes of a recording of which parts are left out, and how these are told."""

from dataclasses import replace

import numpy as np
import pytest
from polars.testing import assert_frame_equal

import deltaid
from deltaid.dynamics.dynamics import compiled
from deltaid.errors import RecordingError
from deltaid.model.corrections import LeftOut, TimeSpan
from deltaid.recording.memory import Recording as RawRecording
from deltaid.recording.opening import open_log
from deltaid.recording.recording import PreparedRecording, open_recordings, with_filter
from deltaid.view.corrections import left_out_table
from interrupted import CLAVEL, IRB, Interrupted, cost_of_masks, interrupted, mass_error, opened
from poor_priors import PLAIN as MASKS  # nothing is corrected beside the masks
from sweeps import swept


@pytest.mark.parametrize("name", swept([CLAVEL, IRB], CLAVEL))
def test_what_is_left_gives_the_robot(name) -> None:
    """With everything at once M is as good as without; as it is taken it is far off."""
    rng = np.random.default_rng(11)
    rests = ((-1.0, 1.0), (4.0, 5.0), (9.0, 11.0))
    recording = interrupted(name, rng, seconds=10.0, rests=rests, ramp=0.3)
    recording = (
        recording.without_torque("on brakes", 4.2, 4.8).clipped(0.7).measured(rng, 17, 0.0, 20)
    )
    tau = recording.tau + 0.02 * np.abs(recording.tau).max(axis=0) * rng.standard_normal(
        recording.tau.shape
    )
    limit = 0.95 * np.abs(recording.tau).max(axis=0)
    recording = replace(recording, tau=np.clip(tau, -limit, limit))
    for row in range(1500, 3500, 200):
        recording = recording.stale(row, row + 3)
    found = deltaid.identify(name, recording.frame, settings=MASKS)
    taken = deltaid.identify(name, recording.frame, settings=MASKS.changed(keep_all=True))
    assert mass_error(recording, found.model.p) < 0.03
    assert mass_error(recording, taken.model.p) > 0.2
    (source,) = found.model.sources
    reasons = {stretch.reason for stretch in source.left_out}
    assert reasons >= {"standing still", "on brakes", "saturated torque", "stale rows", "reversal"}
    assert not taken.model.sources[0].left_out
    standing = next(stretch for stretch in source.left_out if stretch.reason == "standing still")
    assert standing.spans[0].start == 0
    assert standing.share == pytest.approx(0.24, abs=0.05)


def test_clean_recordings_lose_nothing() -> None:
    """Intervals are no wider for what is left out of a clean recording: reversals."""
    seeds = ((2, 200.0), (3, 1000.0))
    costs = [cost_of_masks(CLAVEL, rate, seed, MASKS) for seed, rate in seeds]
    for cost in costs:
        assert 0 < cost.lost < 0.02
        assert 1 <= cost.known_less.max() < 1.02
    assert np.mean([np.log(cost.widths).mean() for cost in costs]) < 0.02


def test_brakes_set_in_with_a_jump_of_acceleration() -> None:
    """The low-pass feels it a period ahead, and its spectrum is no motion's."""
    rng = np.random.default_rng(2)
    simulated = interrupted(
        CLAVEL, rng, seconds=8.0, rests=((3.0, 3.8), (6.0, 6.9)), ramp=0.4, braking=0.06
    )
    simulated = simulated.measured(rng, 16, 0.01)
    found = deltaid.identify(CLAVEL, simulated.frame, settings=MASKS)
    (recording,) = found.recordings
    assert mass_error(simulated, found.model.p) < 0.006
    stops = [mask for mask in recording.log.masks if mask.reason == "emergency stop"]
    before = [mask for mask in recording.log.masks if mask.reason == "before a stop"]
    for ahead, stop in zip(before, stops, strict=True):
        assert ahead.last == stop.first - 1
        assert stop.start - ahead.start == pytest.approx(1 / recording.motion_cutoff, abs=2e-3)
        assert ahead.end == pytest.approx(stop.start - 1e-3)
    # Found again, not found twice.
    assert with_filter(recording.log, recording.cutoff).log.masks == recording.log.masks
    taken = open_recordings(simulated.frame, simulated.dynamics.kinematics, keep_all=True)[0]
    assert taken.motion_cutoff > 2 * recording.motion_cutoff
    late = replace(recording.log, masks=tuple(stops))
    felt = [
        _error_at(simulated, PreparedRecording(log, recording.low_pass))
        for log in (late, recording.log)
    ]
    assert felt[1] < 0.5 * felt[0]


def _error_at(simulated: Interrupted, recording: PreparedRecording) -> float:
    """Torque error of the true robot, at its worst."""
    (window,) = recording.windows(simulated.dynamics.kinematics)
    drives = np.arange(simulated.dynamics.dof)

    def error(w) -> np.ndarray:
        return w.weighted(
            (w.tau - simulated.dynamics.torque(w.z, w.qd, w.qdd, simulated.truth)).T, drives
        )

    return float(np.abs(window.filtered(error)).max())


def test_a_direction_that_is_not_known_does_not_count(tmp_path) -> None:
    """Rows in which a drive or the slide turns round are left out; masks see each drive alone."""
    simulated = interrupted(IRB, np.random.default_rng(4), seconds=4.0)
    recording = with_filter(opened(simulated, tmp_path))
    (window,) = recording.windows(simulated.dynamics.kinematics)
    inner = window.inner
    passive = simulated.dynamics.kinematics.passive_friction
    slide = passive.rates(inner.z, inner.qd, inner.qdd).speed[:, 0]
    turns = [np.flatnonzero(np.diff(np.sign(x))) for x in (*inner.qd.T, slide)]
    out = inner.weights == 0
    for i in range(4):
        own_and_slide = np.concatenate([turns[i], turns[4]]) if i < 3 else turns[i]
        for row in own_and_slide:
            assert out[row : row + 2, i].any()
        assert out[:, i].sum() <= 4 * len(own_and_slide)
    assert passive.moved_by.tolist() == [[True, True, True, False]]
    np.testing.assert_array_equal(window.turning, out.sum(axis=0))
    everything = PreparedRecording(replace(recording.log, keep_all=True), recording.low_pass)
    (window,) = everything.windows(simulated.dynamics.kinematics)
    assert np.all(window.inner.weights == 1)


def test_passive_joints_move_as_differences_say() -> None:
    dynamics = compiled(deltaid.load_robot("h4"))
    kinematics, h = dynamics.kinematics, 1e-5
    rng = np.random.default_rng(0)
    z = kinematics.home + 0.03 * rng.standard_normal((1, 4))
    zd, zdd = rng.standard_normal((2, 1, 4))
    at = [z + k * h * zd + 0.5 * (k * h) ** 2 * zdd for k in (-1, 0, 1)]
    speeds = [zd + k * h * zdd for k in (-1, 0, 1)]
    motions = [kinematics.drive_motion(a, b, zdd) for a, b in zip(at, speeds, strict=True)]
    passive = kinematics.passive_friction
    rates = [passive.rates(a, m[1], m[2]) for a, m in zip(at, motions, strict=True)]
    for name in passive.names:
        k = passive.names.index(name)
        change = (rates[2].speed[0, k] - rates[0].speed[0, k]) / (2 * h)
        assert rates[1].acceleration[0, k] == pytest.approx(change, rel=1e-5)
        slope = rates[1].slope[0, k] @ motions[1][1][0]
        assert slope == pytest.approx(rates[1].speed[0, k], rel=1e-9)


def test_nothing_left_is_refused(tmp_path) -> None:
    rng = np.random.default_rng(9)
    recording = interrupted(CLAVEL, rng, seconds=8.0, rests=((-1, 7.9),)).measured(
        rng, 17, 0.02, 20
    )
    with pytest.raises(RecordingError, match=r"left for drive1: .* % standing still") as caught:
        opened(recording, tmp_path)
    assert "--keep-all" in str(caught.value)
    assert not opened(recording, tmp_path, keep_all=True).masks


def test_table_names_reason_drives_share_and_times() -> None:
    spans = tuple(TimeSpan(start=float(k), end=k + 0.25) for k in range(4))
    clipped = LeftOut(
        reason="saturated torque",
        why="the channel ends",
        drives=("drive2", "drive3"),
        share=0.125,
        spans=spans,
        more=7,
    )
    turning = LeftOut(reason="reversal", why="turns", drives=("drive1",), share=0.01)
    table = left_out_table([("a.csv", (clipped, turning))])
    first, second = table.rows
    assert first[:3] == ("saturated torque", "2, 3", "12 %")
    assert first[3] == "0.000–0.250, 1.000–1.250, 2.000–2.250 and 8 more"
    assert second == ("reversal", "1", "1.0 %", "")
    assert left_out_table([("a.csv", (turning,))]) is None
    several = left_out_table([("a.csv", (clipped,)), ("b.csv", (clipped,))])
    assert [row[0] for row in several.rows] == ["a.csv", "b.csv"]


def test_arrays_in_memory_stay_as_they_are() -> None:
    """Bridges are built in a copy."""
    rng = np.random.default_rng(3)
    recording = interrupted(CLAVEL, rng, seconds=2.0).measured(rng, 17, 0.02, 20).stale(900, 903)
    table = recording.frame
    before = table.clone()
    time = table["t"].to_numpy()
    raw = RawRecording.from_arrays(t=time, q=recording.q, tau=recording.tau)
    log = open_log(raw, recording.dynamics.kinematics)
    rows = np.concatenate(list(log.batches()))
    assert not np.array_equal(rows[900:904, 1:4], recording.q[900:904])
    assert_frame_equal(table, before)
