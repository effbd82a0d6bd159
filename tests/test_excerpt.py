"""Long recordings: what is decided on an excerpt, and what is seen outside it."""

import numpy as np
import pytest

from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import DeltaidError
from deltaid.identification.identify import identify
from deltaid.model.record import Settings
from deltaid.recording import log as surveyed
from deltaid.recording.opening import open_log
from deltaid.recording.recording import open_recordings
from logs import recorded as frame_of
from logs import write
from pushes import Force, moving, recorded, torques

CLAVEL = "clavel-delta3"
PLAIN = Settings(friction="described", lag="none")


@pytest.fixture
def short(monkeypatch) -> None:
    """Excerpts of some seconds."""
    monkeypatch.setattr(surveyed, "_WINDOWS", 0)
    monkeypatch.setattr(surveyed, "SECONDS", 3.2)


@pytest.mark.usefixtures("short")
@pytest.mark.parametrize("start", [None, 2.0, 7.7])
def test_a_push_is_found_wherever_it_is(start: float | None) -> None:
    """Within the excerpt and elsewhere."""
    setting = moving(CLAVEL)
    forces = () if start is None else (Force(start, start + 0.08, (0.0, 50.0, 90.0)),)
    result = identify(CLAVEL, recorded(setting, torques(setting, forces)), settings=PLAIN)
    recording = result.recordings[0]
    assert not recording.excerpt.whole
    assert recording.excerpt.stretches[-1][-1, 0] < 5.0
    events = [event for source in result.model.sources for event in source.events]
    assert [event.reason for event in events] == ["contact"] * len(forces)
    for event, force in zip(events, forces, strict=True):
        assert event.start < force.middle < event.end


def test_stretches_are_rows_of_the_log_and_end_where_it_has_holes() -> None:
    first, second = np.arange(900.0), np.arange(1000.0, 2100.0)

    def segments() -> list[list[np.ndarray]]:
        return [
            [np.tile(part[:, None], 4) for part in np.array_split(rows, 7)]
            for rows in (first, second)
        ]

    stretches = list(surveyed._cut(segments(), [100, 800, 1500], 300))
    ends = [(stretch[0, 0], stretch[-1, 0]) for stretch in stretches]
    assert ends == [(100, 399), (800, 899), (1000, 1199), (1600, 1899)]
    for stretch in stretches:
        np.testing.assert_array_equal(np.diff(stretch[:, 0]), 1.0)


@pytest.mark.usefixtures("short")
def test_an_excerpt_has_rows_of_its_log(clavel: Dynamics) -> None:
    (recording,) = open_recordings(recorded(moving(CLAVEL)), clavel.kinematics)
    brief = recording.excerpted().brief
    assert brief.log.held is not None
    (rows,) = (np.concatenate(list(segment)) for segment in brief.log.segments(None))
    (whole,) = (np.concatenate(list(segment)) for segment in recording.log.segments(None))
    at = np.searchsorted(whole[:, 0], rows[0, 0])
    np.testing.assert_array_equal(rows, whole[at : at + len(rows)])


@pytest.mark.parametrize("most", [0, 1 << 24])
def test_rows_that_are_kept_are_those_that_are_read(
    tmp_path, clavel: Dynamics, monkeypatch, most: int
) -> None:
    monkeypatch.setattr(surveyed, "_MOST_NUMBERS", most)
    path = write(tmp_path / "log.csv", frame_of(300, derivatives=True))
    log = open_log(path, clavel.kinematics)
    path.unlink()
    assert (log.kept is None) == (most == 0)
    if log.kept is None:
        with pytest.raises((OSError, DeltaidError)):
            list(log.batches())
        return
    bare = log.columns.without_rates
    (rows,), (all_rows,) = log.kept.read(bare), log.kept.read(log.columns)
    np.testing.assert_array_equal(rows, np.delete(all_rows, np.s_[4:10], axis=1))
