"""`identify` with a robot file of `calibrate`: intervals hold the truth of the machine as built."""

from pathlib import Path

from calibrated import KINDS, Held, machine
from poor_priors import PLAIN

LENGTH, ANGLE = 1e-3, 5e-3
SIMPLE = PLAIN.model_dump()


def share(*found: Held) -> float:
    """Of intervals that hold."""
    return sum(x.hold[k] for x in found for k in KINDS) / sum(
        x.every[k] for x in found for k in KINDS
    )


def test_intervals_hold_with_a_calibrated_robot_file(tmp_path: Path) -> None:
    """`benchmarks/calibrated_identify.py` counts more machines, with all that `identify` does."""
    files = tmp_path / "tracker.yaml", tmp_path / "probe.yaml"
    first, second = (
        machine("clavel-delta3", seed, length=LENGTH, angle=ANGLE, noise=0.005) for seed in (0, 1)
    )
    size = {"length": LENGTH, "angle": ANGLE}
    tracker = first.calibrated(files[0], "points", **size, **SIMPLE)
    probe = second.calibrated(files[1], "probe", "distances", **size, **SIMPLE)
    # of some 27 a machine, correlated: of 95 % three standard deviations may be missing
    assert share(tracker, probe) > 0.84
    assert share(first.held(first.robot, {}, PLAIN)) < share(tracker) - 0.1
