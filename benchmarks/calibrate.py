"""What instruments make of a Delta's geometry: predicted, and the errors of simulated machines.

    python benchmarks/calibrate.py [--machines 40]
    python benchmarks/calibrate.py --times

First a Delta, a row a set of instruments: 60 poses for a tracker (20 µm), 60 touches of a bed
(10 µm), half of them on a gauge block of 0.1 m where there are two heights, 18 distances (20 µm) a
height. Then robots of the catalogue, 60 poses under a tracker. Lengths are known to 1 mm, angles to
1 mrad, scales of rails to 0.1 %; struts that are apart also differ within a limb. Ranks count
combinations of numbers and of the instrument's unknowns that readings know better than before.
Errors are of positions over the workspace after a rigid motion is taken out: predicted, and of
machines drawn and measured by `tests/oracle`, which shares no code with the package. The last
columns are the share of 95 % intervals that hold and the time of a calibration.

`--times` leaves processor time of one calibration of 42 numbers, the robot with its struts apart,
from 60 and 10,000 points, in the first call of a process and in later ones.
"""

import sys
import time
from pathlib import Path

import numpy as np
from _table import STATED, leave
from _timing import options

import deltaid
from deltaid.calibration.outlook import drawn
from deltaid.estimation.scatter import NORMAL

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from measured_poses import real, spans, touched, tracked
from oracle.measured_delta import DRAWINGS, THREE, TOOL, Drawing, built, shape_error

ARM, STRUT, BASE, PLATFORM = 0.235, 0.8, 0.25, 0.05
RADIUS, LOW, HIGH, BLOCK = 0.35, -0.85, -0.6, 0.1
DRAWING = Drawing(
    THREE, BASE, PLATFORM, ARM, STRUT, (-RADIUS, -RADIUS, LOW), (RADIUS, RADIUS, HIGH)
)
TOUCH = 1e-5
SETS = {
    "bed, one plane": ((0.0,), ()),
    "bed at two known heights": ((0.0, BLOCK), ()),
    "one plane, 18 distances": ((0.0,), (0.0,)),
    "two heights, 18 distances": ((0.0, BLOCK), (0.0,)),
    "two heights, 18 distances on each": ((0.0, BLOCK), (0.0, BLOCK)),
    "tracker": None,
}
TIMED = (60, 10_000)
MM = ("before", "predicted", "true")


def robot() -> deltaid.RobotDescription:
    text = deltaid.load_robot("clavel-delta3")
    lengths = {"base_radius": BASE, "platform_radius": PLATFORM, "upper_arm": ARM, "strut": STRUT}
    space = {"shape": "cylinder", "radius": RADIUS, "z": (LOW, HIGH)}
    return text.changed(limbs=text.limbs.changed(**lengths), workspace=space)


def disc(rng: np.random.Generator, count: int, height: float) -> np.ndarray:
    """Points at a height."""
    r, a = RADIUS * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([r * np.cos(a), r * np.sin(a), np.full(count, height)])


class Study:
    """One machine, and what instruments read of it."""

    def __init__(self, described: deltaid.Kinematics, drawing: Drawing, seed: int) -> None:
        self.kinematics, self.rng = described, np.random.default_rng(seed)
        scale = 1e-3 if drawing.arm is None else 0.0
        self.machine = built(self.rng, drawing, scale=scale)

    def tracked(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Points at commanded ones."""
        m = real(self.machine, self.kinematics, x)
        return tracked(self.kinematics, x, m, self.rng, np.eye(3))

    def touched(self, heights: tuple[float, ...]) -> dict[str, np.ndarray]:
        """60 touches in all."""
        count = 60 // len(heights)
        places = np.vstack([disc(self.rng, count, LOW + 0.01 + height) for height in heights])
        return touched(self.machine, self.kinematics, places, TOUCH, self.rng)

    def spans(self, heights: tuple[float, ...]) -> dict[str, np.ndarray]:
        """18 distances a height."""
        a, b = (
            np.vstack([disc(self.rng, 18, LOW + 0.01 + height) for height in heights]) for _ in "ab"
        )
        return spans(self.machine, self.kinematics, a, b, self.rng)

    def measured(self, name: str) -> dict[str, dict[str, np.ndarray]]:
        sets = SETS.get(name)
        if sets is None:
            x = self.machine.drawing.poses(self.rng, 60)
            if name in SETS:
                x = np.vstack([disc(self.rng, 1, z) for z in self.rng.uniform(LOW, HIGH, 60)])
            return {"points": self.tracked(x)}
        probe = {"probe": self.touched(sets[0])}
        return probe | ({"distances": self.spans(sets[1])} if sets[1] else {})


def row(name: str, kinematics: deltaid.Kinematics, drawing: Drawing, machines: int) -> list[str]:
    before, true, predicted, holds, seconds, ranks = [], [], [], [], [], set()
    apart = drawing.spacing is not None
    for seed in range(machines):
        study = Study(kinematics, drawing, seed)
        given = study.measured(name)
        start = time.perf_counter()
        found = deltaid.calibrate(
            kinematics.robot, lengths=1e-3, angles=1e-3, struts_apart=apart, tool=TOOL, **given
        )
        seconds.append(time.perf_counter() - start)
        loops = found.fit.loops
        q = drawn(loops.kinematics, loops.limbs)
        nominal = loops.points(q, np.zeros(len(found.values))).x
        m = study.machine.tool_points(q, loops.start(q)[:, :3])
        before.append(shape_error(nominal, m))
        true.append(shape_error(loops.points(q, found.values).x, m))
        predicted.append(found.after.position)
        expected = study.machine.numbers()
        holds += [
            abs(value - expected[number]) < NORMAL * std
            for number, value, std in zip(found.names, found.values, found.std, strict=True)
        ]
        unknown = len(found.names) + sum(len(x.instrument.unknowns) for x in found.fit.readings)
        ranks.add(f"{found.rank}/{unknown}")
    mm = [f"{1e3 * np.sqrt(np.mean(np.square(x))):.3g}" for x in (before, predicted, true)]
    held, took = f"{100 * np.mean(holds):.1f} %", f"{np.median(seconds):.2f} s"
    return [name, " ".join(sorted(ranks)), *mm, held, took]


def times() -> None:
    name, rows = "abb-irb360-1-1130", list[list[str]]()
    drawing = DRAWINGS[name]
    study = Study(deltaid.Kinematics(name), drawing, 0)
    for poses in TIMED:
        given, seconds = study.tracked(drawing.poses(study.rng, poses)), list[float]()
        for _ in range(4):
            start = time.process_time()
            found = deltaid.calibrate(
                name, points=given, lengths=1e-3, angles=1e-3, struts_apart=True, tool=TOOL
            )
            seconds.append(time.process_time() - start)
        first, later = seconds[0], float(np.median(seconds[1:]))
        rows.append([f"{poses:,}", str(len(found.values)), f"{first:.2f} s", f"{later:.2f} s"])
    note = "Processor time of one calibration from points."
    leave(["poses", "unknowns", "first", "later"], rows, note, name="calibrate_times")


def main() -> None:
    given = options(__doc__, machines=STATED["calibrate"]["machines"], times=False)
    if given.times:
        times()
        return
    machines = given.machines
    delta = deltaid.Kinematics(robot())
    head = ["instruments, or robot", "rank", *(f"{what}, mm" for what in MM), "95 % hold", "time"]
    kinds = [(name, delta, DRAWING) for name in SETS]
    kinds += [(name, deltaid.Kinematics(name), drawing) for name, drawing in DRAWINGS.items()]
    rows = [row(*kind, machines) for kind in kinds]
    note = f"Errors of position of {machines} machines a row after calibration, rms."
    leave(head, rows, note, machines=machines)


if __name__ == "__main__":
    main()
