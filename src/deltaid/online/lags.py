"""Whether torques lag by what is put right, as far as a recording shows it.

It is looked for as an identification does, parameters free, so that a model which is a little off
makes no lag; loads that are held are taken out, as the gripper told of them or as they were found.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from deltaid.errors import Doubt, RecordingError
from deltaid.identification.loads import declared_loads
from deltaid.identification.setup import Setup
from deltaid.identification.study import studied
from deltaid.model.model import Model
from deltaid.model.settings import Settings
from deltaid.model.words import listed
from deltaid.online.found import HeldLoad
from deltaid.online.replay import Replay
from deltaid.recording.carried import Load
from deltaid.recording.recording import with_filter

# A lag that the model has not is told beyond this [s], and beyond so many half widths of its
# interval, or so many where other causes explain more.
_LAG, _CLEAR, _HIDDEN = 3e-4, 2.0, 4.0

Delay = Float[np.ndarray, " drives"]


def judged_lag(
    model: Model, replay: Replay, delay: Delay, loads: Sequence[HeldLoad]
) -> tuple[Doubt, ...]:
    """Lags of the torques that are not those that are put right.

    None where the recording is too short, or hardly moves, so that none shows.

    Args:
        delay: by how much torques are taken to come late [s].
        loads: that were found, for a recording in which nothing told of them.
    """
    log, study = replace(replay.log, masks=replay.masks), None
    if loads and not replay.is_told:
        spans = tuple((one.start, one.end or log.clock.last + 1.0) for one in loads)
        log = replace(log, columns=replace(log.columns, loads=(Load(spans=spans),)))
    with suppress(RecordingError):  # too short to be filtered
        setup = Setup(model.robot, (with_filter(log),), Settings())
        (recording,) = declared_loads(setup, lambda _: None).recordings
        study = studied(model.dynamics, recording, model.p)
    if study is None:
        return ()
    lag = study.common if study.alike else study.each
    surely = lag.interval * (_HIDDEN if study.hidden else _CLEAR)
    clear = np.abs(lag.values - delay) > np.maximum(_LAG, surely)
    if not clear.any():
        return ()
    return (_told(np.where(clear, lag.values, delay), lag.interval, delay, model.robot.drives),)


def _told(found: Delay, half: Delay, known: Delay, drives: Sequence[str]) -> Doubt:
    off: list[int] = np.flatnonzero(found != known).tolist()
    alike = np.ptp(found) == 0 and np.ptp(known) == 0
    if alike:
        said = f"torques are {_in_words(found[0], half[0])}"
    else:
        each = [f"{drives[i]}'s torque is {_in_words(found[i], half[i])}" for i in off]
        said = listed(each)
    given = ",".join(f"{1e3 * one:.2g}" for one in (found[:1] if alike else found))
    words = [_in_words(known[i]) for i in (off[:1] if alike else off)]
    put_right = listed(words) if known.any() else "no lag"
    return Doubt(
        f"{said} against positions, and {put_right} is put right: masses are wrong by a per cent "
        "or two for each ms between",
        cause="this recording was made another way than the model's, through another filter or bus",
        cure=f"record as the model's recordings were made, or give it by --lag={given}",
        key="torque-lag",
    )


def _in_words(lag: float, half: float | None = None) -> str:
    """'2 ± 0.2 ms late'."""
    about = "" if half is None else f" ± {1e3 * half:.1g}"
    return f"{1e3 * abs(lag):.2g}{about} ms {'late' if lag >= 0 else 'early'}"
