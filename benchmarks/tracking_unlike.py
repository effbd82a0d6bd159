"""What identification buys on robots that are not of the model's structure.

    pip install -e '.[test]'
    python benchmarks/tracking_unlike.py [--robot NAME] [--plants NAME,…] [--seeds N]

Each seed draws a robot: bodies and friction up to 30 % from the prior, as the demonstration does.
Each plant adds what no rigid-body model with viscous and Coulomb friction says; the last one all
of it. On that plant a planned motion is followed with the prior, which leaves the recording (torque
noise 1 %, encoder steps); from this alone a model is identified, and followed is another motion.
So the plant spoils the recording, the identification and the run. Leaves
`tables/tracking_unlike.md`, which `docs/simulation.md` explains.
"""

import sys
from dataclasses import dataclass

import _alone  # noqa: F401
import numpy as np
from _table import STATED, leave
from _timing import options

from deltaid.control.comparison import base_vector
from deltaid.control.controllers import Controller, ControlModel
from deltaid.control.plant import Plant
from deltaid.control.tracking import Drives, Tracking, gains, track
from deltaid.control.trajectory import MotionTrajectory
from deltaid.dynamics.parameters import prior_parameters, with_prior
from deltaid.errors import DeltaidError
from deltaid.identification.identify import identify
from deltaid.model.model import Model, load
from deltaid.motion.random_motion import random_motion, tamed
from deltaid.motion.surrogate import surrogate_parameters
from deltaid.recording.memory import Recording
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot

PLANTS = ("as the model", "friction", "ripple", "lengths", "current loop", "gears", "all")
CONTROLLERS = ("pd-feedforward", "computed-torque")
HEAD = (
    "plant", "controller", "prior", "base parameters", "identified", "prior, by the encoders",
    "identified, by the encoders", "lengths alone",
)  # fmt: skip
BANDWIDTH, SECONDS, NOISE = 10.0, 8.0, 0.01
# Of the plants: friction beyond the model, as shares of Coulomb's (Stribeck, at a speed) and of the
# load; ripple as a share of Coulomb's, waves a turn; lengths and their spread among limbs [m];
# current loop [Hz]; where a gear with its motor swings against the robot [N m/rad].
STRIBECK, SPEED, LOAD, RIPPLE, WAVES, LENGTH, LOOP, STIFF = 0.4, 0.2, 0.05, 0.3, 36, 1e-4, 200, 2e4
ROTOR = 0.3


@dataclass(frozen=True)
class Case:
    """One robot as it is, and the drives that move it."""

    plant: Plant
    drives: Drives


def case_of(name: str, robot: RobotDescription, rng: np.random.Generator) -> Case:
    robot = robot.changed(rotor_inertia=dict.fromkeys(robot.drives, ROTOR))
    robot = with_prior(robot, surrogate_parameters(robot, rng))

    def has(what: str) -> bool:
        return name in (what, "all")

    if has("friction"):
        robot = more_friction(robot)
    if has("lengths"):
        robot = other_lengths(robot, rng)
    if has("gears"):
        robot = robot.changed(gear_stiffness=STIFF)
    model = load(robot)
    coulomb = np.array([model.value(f"coulomb.{drive}") for drive in robot.drives])
    phase = rng.uniform(0, 2 * np.pi, len(coulomb))

    def ripple(q: np.ndarray) -> np.ndarray:
        return RIPPLE * coulomb * np.sin(WAVES * q + phase)

    plant = Plant(model, elastic=has("gears"), ripple=ripple if has("ripple") else None)
    return Case(plant, Drives(current_loop=LOOP if has("current loop") else np.inf))


def more_friction(robot: RobotDescription) -> RobotDescription:
    """Stribeck's term, and a share of what gears carry."""
    friction = robot.model_dump(mode="json", exclude_none=True)["friction"]
    for drive in robot.drives:
        more = {"coefficient": STRIBECK * friction[drive]["coulomb"], "speed": SPEED}
        friction[drive] |= {"stribeck": more, "load": LOAD}
    return robot.changed(friction=friction)


def other_lengths(robot: RobotDescription, rng: np.random.Generator) -> RobotDescription:
    """All lengths of the limbs off, for all alike and for each by as much again."""
    limbs, n = robot.limbs.model_dump(mode="json", exclude_none=True), len(robot.drives)
    for key in ("base_radius", "platform_radius", "upper_arm", "strut"):
        if key in limbs:
            off = LENGTH * (rng.standard_normal() + rng.standard_normal(n))
            limbs[key] = list(np.asarray(limbs[key]) + off)
    return robot.changed(limbs=limbs)


def recorded(run: Tracking, rng: np.random.Generator) -> Recording:
    noise = NOISE * np.abs(run.tau).max(axis=0) * rng.standard_normal(run.tau.shape)
    return Recording.from_arrays(t=run.time, q=run.q, tau=run.tau + noise)


def controller_errors(name: str, robot: RobotDescription, seed: int) -> dict[str, list[float]]:
    """Errors [mm] of each controller on one plant, in the order of the table's columns."""
    rng = np.random.default_rng(seed)
    case = case_of(name, robot, rng)
    known = load(robot)
    truth, kinematics = case.plant.model, known.dynamics.kinematics
    motions = [tamed(truth.dynamics, truth.p, random_motion(kinematics, rng)) for _ in range(2)]
    first, second = (MotionTrajectory(kinematics, motion, SECONDS) for motion in motions)
    prior = ControlModel(robot, prior_parameters(robot))
    law = gains("pd-feedforward", prior, first, BANDWIDTH)
    log = recorded(track(case.plant, law, prior, first, case.drives), rng)
    model = identify(robot, log).model
    found = load(model)
    identified = ControlModel(found.robot, found.p)
    base = ControlModel(found.robot, base_vector(model))
    errors = {}
    for controller in CONTROLLERS:
        law = gains(controller, identified, second, BANDWIDTH)

        def run(by: ControlModel, law: Controller = law) -> Tracking:
            return track(case.plant, law, by, second, case.drives)

        first_run, last = run(prior), run(identified)
        of_base = rms(run(base).platform_error) if controller == "pd-feedforward" else np.nan
        errors[controller] = [
            rms(first_run.platform_error), of_base, rms(last.platform_error),
            rms(off(known, first_run.q, first_run)), rms(off(known, last.q, last)),
            rms(off(truth, last.q_desired, last)),
        ]  # fmt: skip
    return errors


def off(model: Model, q: np.ndarray, run: Tracking) -> np.ndarray:
    """Distance of the platform from where it should be, by a model's lengths and coordinates."""
    z = model.dynamics.kinematics.forward(q)
    return np.linalg.norm((z - run.z_desired)[:, run.task.moves], axis=1)


def rms(x: np.ndarray) -> float:
    """In millimetres."""
    return 1e3 * float(np.sqrt((x**2).mean()))


def main() -> None:
    seeds = STATED["tracking_unlike"]["robots"]
    chosen = options(__doc__, robot="clavel-delta3", plants=",".join(PLANTS), seeds=seeds)
    robot = load_robot(chosen.robot)
    robot = robot.changed(rotor_inertia=dict.fromkeys(robot.drives, 1.3 * ROTOR))
    rows = []
    for name in chosen.plants.split(","):
        found: dict[str, list[list[float]]] = {controller: [] for controller in CONTROLLERS}
        refused = ""
        for seed in range(chosen.seeds):
            try:
                errors = controller_errors(name, robot, seed)
            except DeltaidError as error:
                refused = f" (seed {seed}: {str(error).splitlines()[0][:60]})"
                continue
            for controller, values in errors.items():
                found[controller].append(values)
        for controller, seeds in found.items():
            cells = [spread(column) for column in zip(*seeds, strict=True)]
            rows.append((name + refused, controller, *cells))
            print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
    leave(HEAD, rows, f"{chosen.robot}: distance of the platform from where it should be, rms in "
          f"mm: median of {chosen.seeds} robots, and the worst.", robots=chosen.seeds)  # fmt: skip


def spread(values: tuple[float, ...]) -> str:
    """Median and worst."""
    if np.isnan(values).any():
        return "–" if np.isnan(values).all() else "lost"
    return f"{np.median(values):.3f}, {np.max(values):.3f}"


if __name__ == "__main__":
    main()
