"""Recordings whose columns tests connect wrongly, and what is said of them."""

from collections.abc import Iterable
from functools import cache

import numpy as np

from deltaid.checks.evidence import Evidence, evidence
from deltaid.checks.verdicts import changes, with_changes
from deltaid.checks.wiring.wiring import checked_wiring
from deltaid.dynamics.dynamics import compiled
from deltaid.model.verdict import Grade, Verdict
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.load import load_robot
from logs import tabled

Columns = dict[str, np.ndarray]
RATE = 250.0


@cache
def recorded(name: str, tilt: float = 0.0) -> Columns:
    """Ten seconds of a random motion with noise: t, q, qd, tau, of a base tilted about x."""
    robot, rng = load_robot(name), np.random.default_rng(4)
    described = compiled(robot)
    truth = surrogate_parameters(robot, rng)
    path = random_motion(described.kinematics, rng)
    gravity = (0.0, 9.81 * np.sin(tilt), -9.81 * np.cos(tilt))
    level = described if not tilt else compiled(robot.changed(gravity=gravity))
    table = simulate_recording(level, truth, path, rng, rate=RATE, noise=SensorNoise(torque=0.01))
    t, drives = table["t"].to_numpy(), range(1, described.dof + 1)
    q, tau = (table.select(f"{x}{i}" for i in drives).to_numpy() for x in ("q", "tau"))
    qd = described.kinematics.drive_motion(*path.evaluate(t))[1]
    return {"t": t, "q": q, "qd": qd, "tau": tau}


def evidence_of(name: str, columns: Columns, mapping: ColumnMapping | None = None) -> Evidence:
    return evidence(load_robot(name), tabled(**columns), mapping)


def bad(verdicts: Iterable[Verdict]) -> list[Verdict]:
    return [verdict for verdict in verdicts if verdict.grade in (Grade.WRONG, Grade.DOUBTFUL)]


def only_verdict(name: str, columns: Columns, *, cured: bool = True) -> Verdict:
    """The only verdict that is not good; the mapping that it proposes leaves none."""
    looked_at = evidence_of(name, columns)
    verdicts = bad(checked_wiring(looked_at))
    assert len(verdicts) == 1, verdicts
    if cured:
        wanted = changes(verdicts, "mapping")
        assert wanted
        data = with_changes(looked_at.written_mapping, wanted)
        again = evidence_of(name, columns, ColumnMapping.model_validate(data))
        assert not bad(checked_wiring(again))
    return verdicts[0]


def times(columns: Columns, **factors: object) -> Columns:
    return columns | {name: columns[name] * np.asarray(by) for name, by in factors.items()}


def without(columns: Columns, key: str) -> Columns:
    return {name: x for name, x in columns.items() if name != key}
