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
from deltaid.online.found import HeldLoad
from deltaid.online.rows import Replay
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
    clear = lag.interval * (_HIDDEN if study.hidden else _CLEAR)
    if not np.any(np.abs(lag.values - delay) > np.maximum(_LAG, clear)):
        return ()
    return (_told(lag.values, lag.interval, delay),)


def _told(
    lag: Float[np.ndarray, " drives"],
    half: Float[np.ndarray, " drives"],
    known: Delay,
) -> Doubt:
    alike = np.ptp(lag) == 0 and np.ptp(known) == 0
    found, put_right = (one[:1] if alike else one for one in (lag, known))
    given = ",".join(f"{1e3 * one:.2g}" for one in found)
    return Doubt(
        f"torques are {_in_words(found)} against positions (± {1e3 * float(half.max()):.1g} ms), "
        f"and {_in_words(put_right)} is put right: masses are wrong by a per cent or two for each "
        "ms between",
        cause="this recording was made another way than the model's, through another filter or bus",
        cure=f"record as the model's recordings were made, or give it by --lag={given}",
        key="torque-lag",
    )


def _in_words(lag: Float[np.ndarray, " _"]) -> str:
    """'2 ms late', or 'late by 2, 2, -1.5 ms'."""
    if len(lag) == 1:
        return f"{1e3 * abs(lag[0]):.2g} ms {'late' if lag[0] >= 0 else 'early'}"
    return f"late by {', '.join(f'{1e3 * one:.2g}' for one in lag)} ms"
