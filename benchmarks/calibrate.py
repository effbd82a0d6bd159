"""What instruments make of a Delta's geometry: predicted, and the errors of simulated machines.

    python benchmarks/calibrate.py [--machines 20]

A Delta with arms of 0.235, struts of 0.8, base 0.25 and platform 0.05 m, of which lengths are known
to 1 mm and angles to 1 mrad. Every row is a set of instruments: 60 poses for a tracker (20 µm), 30
touches a height of a bed (10 µm), 18 distances (20 µm) a height. Ranks count combinations of
numbers and of the bed's unknowns, singular values below 1e-6 of the largest being none. The error
is that of positions over the workspace after a rigid motion is taken out: predicted by the
covariance, and that of machines that are drawn from the prior, measured with noise and calibrated.
Machines come from `tests/oracle`, which shares no code with the package. The last columns are the
share of 95 % intervals that hold and the time of a calibration.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from _table import STATED, leave

import deltaid

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from oracle.measured_delta import BuiltDelta, built

ARM, STRUT, BASE, PLATFORM = 0.235, 0.8, 0.25, 0.05
RADIUS, LOW, HIGH = 0.3, -0.85, -0.65
TRACKER, TOUCH, CALLIPER = 2e-5, 1e-5, 2e-5
SETS = {
    "bed, one plane": ((0.0,), ()),
    "bed at two known heights": ((0.0, 0.15), ()),
    "one plane, 18 distances": ((0.0,), (0.0,)),
    "two heights, 18 distances": ((0.0, 0.15), (0.0,)),
    "two heights, 18 distances on each": ((0.0, 0.15), (0.0, 0.15)),
    "tracker": None,
}


def robot() -> deltaid.RobotDescription:
    """The described robot."""
    text = deltaid.load_robot("clavel-delta3")
    limbs = text.limbs.changed(
        base_radius=BASE, platform_radius=PLATFORM, upper_arm=ARM, strut=STRUT
    )
    space = {"shape": "cylinder", "radius": RADIUS, "z": (LOW, HIGH)}
    return text.changed(limbs=limbs, workspace=space)


def disc(rng: np.random.Generator, count: int, height: float) -> np.ndarray:
    """Points at a height."""
    r, a = RADIUS * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    return np.column_stack([r * np.cos(a), r * np.sin(a), np.full(count, height)])


class Study:
    """One machine, and what instruments read of it."""

    def __init__(self, described: deltaid.Kinematics, seed: int) -> None:
        self.kinematics, self.rng = described, np.random.default_rng(seed)
        self.machine: BuiltDelta = built(self.rng, [0, 120, 240], BASE, PLATFORM, ARM, STRUT)

    def real(self, commanded: np.ndarray) -> np.ndarray:
        """Where it stands."""
        q = self.kinematics.inverse(commanded)
        poses = zip(q, commanded, strict=True)
        return np.array([self.machine.tool_point(*pose) for pose in poses])

    def tracked(self) -> dict[str, np.ndarray]:
        """60 points over the workspace."""
        x = np.vstack([disc(self.rng, 1, z) for z in self.rng.uniform(LOW, HIGH, 60)])
        m = self.real(x) + self.rng.normal(0, TRACKER, x.shape)
        return dict(zip("xyz", x.T, strict=True)) | dict(zip(("px", "py", "pz"), m.T, strict=True))

    def touched(self, heights: tuple[float, ...]) -> dict[str, np.ndarray]:
        """30 touches a height."""
        place = np.vstack([disc(self.rng, 30, LOW + 0.01 + height) for height in heights])
        x = place.copy()
        for _ in range(5):
            x[:, 2] -= self.real(x)[:, 2] - place[:, 2]
        x[:, 2] += self.rng.normal(0, TOUCH, len(x))
        return dict(zip("xyz", x.T, strict=True)) | {"block": np.repeat(heights, 30)}

    def spans(self, heights: tuple[float, ...]) -> dict[str, np.ndarray]:
        """18 distances a height."""
        ends = [
            np.vstack([disc(self.rng, 18, LOW + 0.01 + height) for height in heights]) for _ in "ab"
        ]
        length = np.linalg.norm(self.real(ends[0]) - self.real(ends[1]), axis=1)
        columns = {
            f"{end}_{axis}": x[:, k]
            for end, x in zip("ab", ends, strict=True)
            for k, axis in enumerate("xyz")
        }
        return columns | {"distance": length + self.rng.normal(0, CALLIPER, len(length))}


def shape_error(x: np.ndarray, m: np.ndarray) -> float:
    """Root mean square of what no rigid motion explains."""
    a, b = x - x.mean(0), m - m.mean(0)
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1, 1, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    return float(np.sqrt(np.mean(np.sum((b - a @ R.T) ** 2, axis=1))))


def truth(machine: BuiltDelta) -> dict[str, float]:
    """The numbers of a machine by the package's names, to first order of small angles."""
    numbers = {}
    for i, limb in enumerate(machine.limbs):
        angle = 2 * np.pi * i / 3
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        off = limb.base - BASE * out
        across = np.array([-out[1], out[0], 0.0])
        each = {
            "base_out": off @ out, "base_across": off @ across, "base_up": off[2],
            "azimuth": -limb.along @ out, "tilt": limb.along[2], "upper_arm": limb.arm - ARM,
            "zero": limb.zero, "strut": limb.struts[0][0] - STRUT,
        }  # fmt: skip
        numbers |= {f"limb{i + 1}.{kind}": float(value) for kind, value in each.items()}
    return numbers


def row(name: str, kinematics: deltaid.Kinematics, machines: int) -> list[str]:
    """One set of instruments."""
    before, true, predicted, holds, seconds, ranks = [], [], [], [], [], set()
    for seed in range(machines):
        study = Study(kinematics, seed)
        sets = SETS[name]
        given = {"points": study.tracked()} if sets is None else {"probe": study.touched(sets[0])}
        if sets is not None and sets[1]:
            given["distances"] = study.spans(sets[1])
        start = time.perf_counter()
        found = deltaid.calibrate(kinematics.robot, lengths=1e-3, angles=1e-3, **given)
        seconds.append(time.perf_counter() - start)
        loops = found.fit.loops
        q = loops.inverse(found.places.x)
        m = study.real(found.places.x)
        before.append(shape_error(found.places.x, m))
        true.append(shape_error(loops.points(q, found.values, loops.start(q)).x, m))
        predicted.append(found.after.position)
        expected = truth(study.machine)
        holds += [
            abs(value - expected[number]) < 1.96 * std
            for number, value, std in zip(found.names, found.values, found.std, strict=True)
        ]
        unknown = 24 + sum(len(x.unknowns) for x in found.fit.instruments)
        ranks.add(f"{found.rank}/{unknown}")
    mm = [f"{1e3 * np.sqrt(np.mean(np.square(x))):.3g}" for x in (before, predicted, true)]
    held, took = f"{100 * np.mean(holds):.1f} %", f"{np.median(seconds):.2f} s"
    return [name, " ".join(sorted(ranks)), *mm, held, took]


def main() -> None:
    """Print the table, and leave it."""
    parser = argparse.ArgumentParser(description="instruments for a Delta's geometry")
    stated = STATED["calibrate"]["machines"]
    parser.add_argument("--machines", type=int, default=stated, help="how many are drawn")
    machines = parser.parse_args().machines
    kinematics = deltaid.Kinematics(robot())
    head = ["instruments", "rank", "before, mm", "predicted, mm", "true, mm", "95 % hold", "time"]
    rows = [row(name, kinematics, machines) for name in SETS]
    note = f"Errors of position of {machines} machines after calibration, rms."
    leave(head, rows, note, machines=machines)


if __name__ == "__main__":
    main()
