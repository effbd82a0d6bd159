"""Whether intervals of `identify` hold with a robot file that `calibrate` wrote.

    python benchmarks/calibrated_identify.py [--machines 8]

Clavel's Delta, lengths off by 1 mm and angles, zeros among them, by 5 mrad (one standard
deviation). Each machine is calibrated from 60 touches at two heights and 36 distances, or from 60
points of a tracker; then 8 s of its motion (500 Hz, 0.5 % torque noise) are identified with the
description, and with each calibrated file and its zeros in the mapping. Torques are MuJoCo's, of
the machine as it was built (`tests/calibrated.py`). Counted are 95 % intervals that hold the truth:
of parameters of bodies that data determines, of friction, and of base parameters.
"""

import sys
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

import _alone  # noqa: F401
from _table import STATED, leave
from _timing import options

import deltaid
from calibrated import KINDS, Held, machine

NAME, LENGTH, ANGLE, NOISE = "clavel-delta3", 1e-3, 5e-3, 0.005
FILES = {
    "as described": (),
    "two heights, 18 distances on each": ("probe", "distances"),
    "tracker": ("points",),
}


def main() -> None:
    machines = options(__doc__, machines=STATED["calibrated_identify"]["machines"]).machines
    found = {row: list[Held]() for row in FILES}
    for seed in range(machines):
        built = machine(NAME, seed, length=LENGTH, angle=ANGLE, noise=NOISE)
        for row, instruments in FILES.items():
            with TemporaryDirectory() as folder:
                file = Path(folder) / "robot.yaml"
                found[row].append(
                    built.calibrated(file, *instruments, length=LENGTH, angle=ANGLE)
                    if instruments
                    else built.held(built.robot, {}, deltaid.Settings())
                )
            print(seed, row, dict(found[row][-1].hold), flush=True, file=sys.stderr)
    rows = []
    for row, each in found.items():
        hold, every = (sum((getattr(x, key) for x in each), Counter()) for key in ("hold", "every"))
        rows.append([row, *(f"{hold[k]}/{every[k]} = {hold[k] / every[k]:.0%}" for k in KINDS)])
    note = f"95 % intervals of `identify` that hold the truth, of {machines} machines a row."
    leave(["robot file", "bodies", "friction", "base parameters"], rows, note, machines=machines)


if __name__ == "__main__":
    main()
