"""What scales, a force plate and gauges make of true values of bodies, as one table.

    pip install .
    python benchmarks/scales_and_sensors.py [ROBOT]

Standard deviation of some entries in per cent of their prior (prior 50 %, 20 s, 2 % of each drive's
largest torque, 200 independent samples a second), the mean over random motions; and, for the tared
plate, how well drives' gains come out without any known load.
"""

import sys

import numpy as np
from _table import STATED, leave

from deltaid.sensors.planning.offers import Offers
from deltaid.sensors.planning.plan import PlanSettings, SensorPlan, sensor_plan

SEEDS = STATED["scales_and_sensors"]["motions"]
ENTRIES = ("U.mcx", "U.Sxx", "S.m", "S.mcx", "S.Sxx", "P.m")
NOISE = {"force_noise": 1.0, "moment_noise": 0.3}
TARED = {"kind": "base-wrench", **NOISE, "force_bias": 0.0, "moment_bias": 0.0}
GAUGE = {"kind": "strut-force", "strut": "each", "at": "platform", "noise": 0.3}


def weigh(share: float, quantity: str = "mass", **more: object) -> dict[str, object]:
    """An offer that measures something of each body to a share of it."""
    measured = {"quantity": quantity, "of": "each", "share": share, **more}
    return {"title": f"{quantity} to {share}", "price": 1.0, "weigh": measured}


def sensor(**described: object) -> dict[str, object]:
    return {"title": "sensor", "price": 1.0, "sensors": {"one": described}}


OFFERS = Offers.model_validate({"offers": {
    "fine": weigh(0.002), "scale": weigh(0.005), "coarse": weigh(0.01),
    "edge": weigh(0.01, "first_moment", axis="along"),
    "tared": sensor(**TARED), "plate": sensor(kind="base-wrench", **NOISE),
    "zeroed": sensor(**GAUGE, bias=0.0), "gauges": sensor(**GAUGE),
}})  # fmt: skip
ROWS = (
    ("torque", ()),
    ("+ platform weighed (0.2 %)", ("fine:P",)),
    ("+ strut and platform weighed (0.5 %)", ("scale:S", "scale:P")),
    ("+ strut weighed and balanced (1 %)", ("coarse:S", "edge:S")),
    ("+ six-axis wrench under the base, tared", ("tared",)),
    ("+ the same, bias unknown", ("plate",)),
    ("+ tared wrench, arm weighed (0.5 %)", ("tared", "scale:U")),
    ("+ force at the platform joints, bias known", ("zeroed",)),
    ("+ the same, bias unknown", ("gauges",)),
    ("+ that (bias known), strut weighed (0.5 %)", ("zeroed", "scale:S")),
)


def plan(robot: str, seed: int, goal: str = "bodies") -> SensorPlan:
    """All rows of the table for one motion."""
    bought, settings = [names for _, names in ROWS if names], PlanSettings(seed=seed, steps=0)
    return sensor_plan(robot, offers=OFFERS, goal=goal, combinations=bought, settings=settings)


def main() -> None:
    robot = sys.argv[1] if len(sys.argv) > 1 else "clavel-delta3"
    plans = [plan(robot, seed) for seed in range(SEEDS)]
    entries = [name for name in ENTRIES if name in plans[0].unknowns.names]
    shares = []
    for planned in plans:
        at = [planned.entry(name) for name in entries]
        shares.append([each.shares[at] for each in (planned.torques, *planned.combinations)])
    means = 100 * np.mean(shares, axis=0)
    rows = [
        (words, *(f"{value:.2g}" for value in row))
        for (words, _), row in zip(ROWS, means, strict=True)
    ]
    gains = [plan(robot, seed, "gains") for seed in range(SEEDS)]
    names = [name for name in gains[0].unknowns.names if name.startswith("gain.")]
    at = [gains[0].entry(name) for name in names]
    tared = next(k for k, use in enumerate(gains[0].uses) if use.name == "tared")
    prior_shares = 100 * np.mean([gain.uses[tared].shares[at] for gain in gains], axis=0)
    said = ", ".join(
        f"{name} {value:.2g} %" for name, value in zip(names, prior_shares, strict=True)
    )
    note = (
        f"Standard deviation of entries of {robot} in % of their prior, mean of {SEEDS} motions. "
        f"Gains that are unknown to 10 %, with the tared wrench: {said}."
    )
    leave(("information", *entries), rows, note, motions=SEEDS)


if __name__ == "__main__":
    main()
