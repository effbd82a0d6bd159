"""Runs of `deltaid excite` for simulated robots, kept so that every machine has the same ones.

    python tests/drives/motions.py NAME …

An excitation has many local optima. Rounding decides in which one a search ends, so another CPU
gives another motion, and with it another recording. `motions.json` keeps those that tests and
benchmarks use; others are computed. The command computes the named ones anew and keeps them:
KIND-SEED of `drives.robots.machine`, or a robot of the catalogue as in `sensed.motion`.
"""

import json
import sys
from pathlib import Path

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.motion.excitation.excite import ExcitationSettings, Exciter
from deltaid.motion.excitation.run import Run
from deltaid.motion.fourier import FourierMotion
from deltaid.robot.description import RobotDescription

_FILE = Path(__file__).with_name("motions.json")
# Of each name: ω₀, centre, sine and cosine of the motion; phase, ramp and repeats of the run.
_KEPT: dict[str, list] = json.loads(_FILE.read_text()) if _FILE.exists() else {}


def excited(name: str, robot: RobotDescription, settings: ExcitationSettings) -> Run:
    """The run that is kept by this name, or a new one."""
    if name not in _KEPT:
        run = Exciter(compiled(robot), settings).optimise().run
        arrays = (run.motion.centre, run.motion.sine, run.motion.cosine)
        _KEPT[name] = [run.motion.base_frequency, *(array.tolist() for array in arrays),
                       run.phase, run.ramp, run.repeats]  # fmt: skip
    frequency, centre, sine, cosine, *rest = _KEPT[name]
    return Run(FourierMotion(frequency, np.array(centre), np.array(sine), np.array(cosine)), *rest)


def renew(names: list[str]) -> None:
    from drives.robots import KINDS, machine
    from sensed import motion

    for name in names:
        _KEPT.pop(name, None)
        kind, _, seed = name.removesuffix("-poor").partition("-")
        if kind in KINDS and seed.isdigit():
            machine(kind, int(seed), name.endswith("-poor"))
        else:
            motion(name)
        lines = [f"{json.dumps(key)}: {json.dumps(_KEPT[key])}" for key in sorted(_KEPT)]
        _FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[1]))
    import drives.motions  # as others import it: `__main__` is a second copy

    drives.motions.renew(sys.argv[1:])
