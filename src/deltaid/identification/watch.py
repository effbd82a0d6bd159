"""Looking out for what stands out of long recordings, in passes over them that are made anyway.

Whether a recording has contacts at all is decided by its excerpt. One that an excerpt does not show
is seen here, in the pass that gathers what the fit needs; then all rows are looked at closely.
"""

from dataclasses import dataclass, field, replace

from deltaid.identification.expectation import Expectation, expect
from deltaid.identification.expectation_source import Source
from deltaid.identification.outstanding import stands_out
from deltaid.identification.setup import Setup
from deltaid.recording.windows import Window


@dataclass(frozen=True, eq=False)
class Watch:
    """Takes down windows out of which something stands.

    Attributes:
        expected: torques.
        seen: when those windows begin [s].
    """

    expected: Expectation
    seen: list[float] = field(default_factory=list[float])

    def __call__(self, window: Window) -> None:
        if len(window.own.time) and stands_out(self.expected, window):
            self.seen.append(float(window.own.time[0]))


def watched(setup: Setup) -> Setup:
    """The same with an eye on recordings of which nothing but an excerpt has been looked at."""
    for k, first in setup.glanced:
        one = setup.recordings[k]
        source = Source(setup.dynamics, setup.additions, one)
        expected = first if _same(first.source, source) else expect(source)
        if expected is not None:
            setup = setup.with_recording(k, replace(one, watch=Watch(expected)))
    return setup


def _same(one: Source, other: Source) -> bool:
    """Whether nothing has been put right since."""
    rows = one.recording.repairs == other.recording.repairs
    return rows and one.dynamics is other.dynamics and one.additions == other.additions


def unwatched(setup: Setup) -> tuple[Setup, bool]:
    """The same without, and whether anything was seen."""
    watches = [one.watch for one in setup.recordings]
    seen = any(isinstance(one, Watch) and one.seen for one in watches)
    without = tuple(replace(one, watch=None) for one in setup.recordings)
    return setup.changed(recordings=without), seen
