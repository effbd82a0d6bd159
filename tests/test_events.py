"""What acts on a robot beside its drives is found, told with time, place and force, left out."""

from dataclasses import replace

import numpy as np
import pytest

from deltaid.dynamics.dynamics import compiled
from deltaid.identification.events import events, on_time
from deltaid.identification.expectation_source import ExplainedRecording
from deltaid.identification.identify import Identification, identify
from deltaid.identification.outliers import detected_outliers
from deltaid.model.corrections import Event
from deltaid.model.record import IdentifiedModel, Settings
from deltaid.recording import windows
from deltaid.recording.columns import Columns
from deltaid.recording.masks.masks import Mask
from deltaid.recording.memory import Recording as RawRecording
from deltaid.recording.recording import open_recordings
from deltaid.recording.repairs import LeftSpan, Repairs
from deltaid.robot.load import load_robot
from deltaid.view.corrections import event_table
from faults.case import Setting
from pushes import Force, moving, places, recorded, spans_left_out, torques
from support import largest_mass_error
from sweeps import swept

CLAVEL, IRB, LINEAR = "clavel-delta3", "irb360-6-1600", "linear-delta"
PLAIN = Settings(friction="described", lag="none", compliance="none", effects="none")

PUSHES = (
    Force(1.02, 1.07, (60.0, -20.0, 40.0)),
    Force(2.50, 2.62, (0.0, 30.0, -45.0)),
    Force(4.33, 4.36, (-150.0, 100.0, 200.0)),
    Force(4.80, 4.90, (90.0, 0.0, 10.0)),
    Force(7.70, 7.78, (0.0, 0.0, 70.0)),
)


ONE_AFTER_ANOTHER = (2.0, 3.0, 4.5, 5.5, 7.0, 8.2)


def mass_error(result: Identification, setting: Setting) -> float:
    """Largest error of M over some poses, as a share of the diagonal, and the true one."""
    q = setting.truth.q[:: len(setting.truth.q) // 20]
    parameters = result.model.p, setting.plant.p
    return largest_mass_error(*(result.problem.dynamics.mass_matrix(q, p) for p in parameters))


# Contacts


@pytest.mark.parametrize(("name", "lag"), [(CLAVEL, 0.0), (LINEAR, -4e-3), (IRB, 4e-3)])
def test_contacts_are_found_with_time_place_and_force(name: str, lag: float) -> None:
    """Against forces that statics of the oracle turn into torques, late or not."""
    setting = moving(name)
    spans = spans_left_out(name, recorded(setting, torques(setting, PUSHES), lag))
    assert [span.reason for span in spans] == ["contact"] * len(PUSHES)
    for span, pushed in zip(spans, PUSHES, strict=True):
        assert span.first < pushed.start + lag + 0.012
        assert pushed.end + lag - 0.012 < span.last
        assert span.first > pushed.start + lag - 0.03
        assert span.last < pushed.end + lag + 0.03
        push = span.push
        assert abs(push.time - pushed.middle) < 0.015
        place = places(setting, np.array([push.time]))[0, :3]
        np.testing.assert_allclose(push.place, place, atol=2e-3)
        size = np.linalg.norm(push.force)
        np.testing.assert_allclose(push.force, pushed.force, atol=0.15 * size + 3.0)
        assert (push.moment is None) == (name != IRB)


def test_a_fit_without_contacts_is_that_of_a_clean_recording(tmp_path) -> None:
    setting = moving(CLAVEL)
    log = recorded(setting, torques(setting, PUSHES))
    robot = load_robot(CLAVEL)
    without, with_all = (
        identify(robot, log, settings=PLAIN.changed(events=events)) for events in (True, False)
    )
    assert mass_error(without, setting) < 2e-3 < 0.02 < mass_error(with_all, setting)
    (source,) = without.model.sources
    assert len(source.events) == len(PUSHES)
    assert [stretch.reason for stretch in source.left_out].count("contact") == 1
    (contact_correction,) = [
        correction for correction in without.model.corrections if correction.kind == "contact"
    ]
    assert contact_correction.value == pytest.approx(
        sum(e.end - e.start for e in source.events), rel=1e-6
    )
    assert "5 times" in contact_correction.text
    assert "4.34" in contact_correction.text
    (all_of_it,) = with_all.model.sources
    assert not all_of_it.events
    assert not with_all.recordings[0].repairs.left_out
    without.model.save(tmp_path / "model.yaml")
    (kept,) = IdentifiedModel.load(tmp_path / "model.yaml").sources
    assert kept.events == source.events
    assert {event.drives for event in kept.events} == {("drive1", "drive2", "drive3")}


def test_what_ends_where_the_robot_stands_still_is_a_stop(monkeypatch) -> None:
    """Also where all events recur at changes of sign."""
    setting, dynamics = moving(CLAVEL), compiled(load_robot(CLAVEL))
    log = recorded(setting, torques(setting, PUSHES))
    (recording,) = open_recordings(log, dynamics.kinematics)
    row = round((PUSHES[1].end + 0.06) * setting.rate)
    start, end = row / setting.rate, (row + 1) / setting.rate
    still = Mask("standing still", (0, 1, 2), row, row + 1, start, end)
    masked = replace(recording, log=replace(recording.log, masks=(still,)))
    expected = on_time(ExplainedRecording(dynamics, (), masked))
    assert expected is not None
    reasons = [span.reason for span in events(expected)]
    assert reasons == ["contact", "stop", "contact", "contact", "contact"]
    monkeypatch.setattr(
        "deltaid.identification.events.at_changes",
        lambda _, stretches, __: np.ones(len(stretches), dtype=bool),
    )
    other = "change of sign"
    assert [span.reason for span in events(expected)] == [other, "stop", other, other, other]


# What is no contact


@pytest.mark.parametrize("name", [CLAVEL, IRB])
@pytest.mark.parametrize("noise", [1e-4, 0.05])
def test_a_clean_recording_keeps_all(name: str, noise: float) -> None:
    assert spans_left_out(name, recorded(replace(moving(name), noise=noise))) == ()


def test_a_spike_is_one_of_a_channel() -> None:
    setting = moving(IRB)
    more = torques(setting, PUSHES[:1])
    more[2000, 1] += 60.0
    more[3100:3102, 3] -= 2.0
    spans = spans_left_out(IRB, recorded(setting, more))
    assert [(span.reason, span.drives) for span in spans] == [
        ("contact", ()),
        ("torque spike", (1,)),
        ("torque spike", (3,)),
    ]
    for span, (first, last) in zip(spans[1:], ((2000, 2000), (3100, 3101)), strict=True):
        assert span.push is None
        assert span.first <= setting.time[first]
        assert setting.time[last] <= span.last
        assert span.last - span.first < 5 / setting.rate


@pytest.mark.parametrize("held", swept([(5.0, 10.0), ONE_AFTER_ANOTHER], ONE_AFTER_ANOTHER))
def test_a_load_is_no_event(held: tuple[float, ...]) -> None:
    """0.6 kg as a force of gravity for half of the time."""
    setting = moving(CLAVEL)
    weights = tuple(
        Force(a, b, (0.0, 0.0, -6.0)) for a, b in zip(held[::2], held[1::2], strict=True)
    )
    spans = spans_left_out(CLAVEL, recorded(setting, torques(setting, weights)))
    assert sum(span.last - span.first for span in spans) < 0.05


def test_stribeck_friction_is_left_to_the_choice_of_laws() -> None:
    setting = moving(CLAVEL)
    v = setting.truth.qd
    knee = 0.05 * np.abs(v).max(axis=0)
    coulomb = setting.plant.friction[1, :3]
    more = 0.8 * coulomb * np.sign(v) * np.exp(-((v / knee) ** 2))
    assert spans_left_out(CLAVEL, recorded(setting, more)) == ()


def test_play_in_gears_is_excluded_where_torques_change_their_sign() -> None:
    setting = replace(moving(IRB, rate=1000.0), duration=12.0)
    gear = setting.truth.tau - setting.plant.friction[1, :4] * np.sign(setting.truth.qd)
    play = np.deg2rad(0.05) * np.tanh(gear / (0.01 * setting.scale))
    columns = setting.sensed()
    log = RawRecording.from_arrays(t=columns["t"], q=columns["q"] + 0.5 * play, tau=columns["tau"])
    spans = spans_left_out(IRB, log)
    reasons = [span.reason for span in spans]
    assert reasons.count("backlash") > 0.9 * len(reasons) > 20
    # All turns of a drive whose play is told are left out, whether they stand out or not.
    loose = sorted({span.gear for span in spans if span.gear is not None})
    assert len(loose) >= 2
    sign = np.signbit(gear[:, loose])
    turns = setting.time[1:][np.any(sign[1:] != sign[:-1], axis=1)]
    turns = turns[turns > 0.2]  # before that there are no filtered rows
    inside = [any(span.first <= t <= span.last for span in spans) for t in turns]
    assert len(turns) > 10
    assert np.mean(inside) > 0.9


# Passes and tables


def test_nothing_depends_on_how_windows_are_cut(monkeypatch) -> None:
    setting = moving(CLAVEL)
    log = recorded(setting, torques(setting, PUSHES))
    whole = spans_left_out(CLAVEL, log)
    dynamics = compiled(load_robot(CLAVEL))
    (recording,) = open_recordings(log, dynamics.kinematics)
    expected = on_time(ExplainedRecording(dynamics, (), recording))
    assert expected is not None
    monkeypatch.setattr(windows, "WINDOW", 1100)
    cut = events(expected)
    np.testing.assert_allclose(
        [(stretch.first, stretch.last) for stretch in cut],
        [(stretch.first, stretch.last) for stretch in whole],
        atol=4e-3,
    )
    # What is kept of a recording of any length keeps no samples alive.
    arrays = [
        x
        for stretch in detected_outliers(expected).stretches
        for x in (stretch.z, stretch.speed, stretch.left)
    ]
    assert arrays
    assert all(x.base is None for x in arrays)


def test_weights_of_many_spans() -> None:
    rng = np.random.default_rng(0)
    starts = rng.uniform(0, 100, 400)
    spans = tuple(
        LeftSpan(a, a + b, "contact", which)
        for a, b, which in zip(
            starts, rng.uniform(0, 0.2, 400), [(), (0,), (1, 2), (2,)] * 100, strict=True
        )
    )
    time = np.arange(0, 100, 0.01)
    rows = np.column_stack([time, np.zeros((len(time), 6)), np.ones((len(time), 3))])
    blocks = np.array_split(rows, 7)
    columns = _columns(3)
    weights = np.vstack(list(Repairs(left_out=spans).apply(iter(blocks), columns, 100.0)))[:, -3:]
    expected = np.ones((len(time), 3))
    for span in spans:
        inside = (time >= span.first) & (time <= span.last)
        expected[np.ix_(inside, span.drives or (0, 1, 2))] = 0.0
    np.testing.assert_array_equal(weights, expected)
    np.testing.assert_array_equal(rows[:, -3:], 1.0)


def _columns(drives: int) -> Columns:
    dynamics = compiled(load_robot(CLAVEL))
    (recording,) = open_recordings(recorded(moving(CLAVEL)), dynamics.kinematics)
    assert len(recording.log.columns.torque) == drives
    return recording.log.columns


def test_a_table_of_many_events_shows_the_largest_in_their_order() -> None:
    log = [
        Event(reason="contact", start=k, end=k + 0.5, drives=("drive1",), time=k + 0.2,
              place=(0.0, 0.1, -0.9), force=(0.0, 0.0, float(k % 7)))
        for k in range(500)
    ]  # fmt: skip
    table = event_table([("log.csv", log)], 20)
    assert len(table.rows) == 20
    times = [float(row[1]) for row in table.rows]
    assert times == sorted(times)
    assert {row[-1] for row in table.rows} == {"6"}
    assert "20 largest of 500" in table.caption
    assert event_table([("log.csv", [])], 20).rows == ()
