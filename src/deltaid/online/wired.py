"""Whether a recording's columns are what they are taken for, as far as that shows before it runs.

Signs, order and units are judged as an identification judges them, and what is wrong is refused as
there.
"""

from deltaid.check.evidence import evidence
from deltaid.check.verdict import Grade
from deltaid.check.wiring.wiring import checked_wiring
from deltaid.errors import Doubt, RecordingError
from deltaid.model.model import Model
from deltaid.recording.mapping import ColumnMapping
from deltaid.recording.memory import RecordingLike

# What is judged elsewhere: the size of torques by the run, as the model knows it better than the
# prior does, and velocities with what comes of it (`speeds`).
_ELSEWHERE = {"torque-unit", "velocity"}


def judged_wiring(
    model: Model, log: RecordingLike, mapping: ColumnMapping, where: str
) -> tuple[Doubt, ...]:
    """What looks wrong of units, signs and order of columns.

    Raises:
        RecordingError: what surely is.
    """
    found = checked_wiring(evidence(model.robot, log, mapping))
    told = [one for one in found if one.key not in _ELSEWHERE]
    for one in told:
        if one.grade is Grade.WRONG:
            raise RecordingError(
                one.finding, where=where, cure=f"{one.cure}; `deltaid check` tells more"
            )
    doubtful = (one for one in told if one.grade is Grade.DOUBTFUL)
    return tuple(Doubt(one.finding, cause="", cure=one.cure, key=one.key) for one in doubtful)
