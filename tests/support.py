"""Robots of random geometry and bodies, described for the package and for the MuJoCo oracle."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deltaid.dynamics.dynamics import compiled
from deltaid.mechanism.user_code import use_mechanism
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import load_robot
from oracle.delta import Body, DeltaOracle, random_oracle
from plants import Truth

# The catalogue's robots that stand for a mechanism each; tests that take long run on these alone.
# Its machines (tests/test_catalogue.py) are of the same mechanisms, with other numbers.
KINDS = (
    "clavel-delta3", "h4", "h4-linear", "i4", "i4-linear", "irb360-6-1600", "linear-delta",
    "linear-delta-45", "par4", "par4-linear",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Twin:
    """The same robot twice: as the package and as the oracle describe it, with parameters p."""

    robot: RobotDescription
    oracle: DeltaOracle
    p: np.ndarray


def twin(oracle: DeltaOracle) -> Twin:
    """The package's description and parameters of an oracle's robot."""
    return Twin(describe(oracle), oracle, parameters(oracle))


def random_twin(seed: int, *, telescope: bool, clockwise: bool = False) -> Twin:
    """Generic geometry, bodies, friction, rotors and gravity; limbs at uneven azimuths."""
    rng = np.random.default_rng(seed)
    oracle = random_oracle(rng, telescope=telescope)
    turned = oracle.azimuths + rng.uniform(-np.pi, np.pi)
    generic = {
        "azimuths": -turned if clockwise else turned,
        "struts_per_limb": int(rng.integers(1, 3)),
        "gravity": np.array([0.0, 0.0, -9.81]) + rng.uniform(-5, 5, 3),
        "telescope_base": rng.uniform(-0.05, 0.05, 3) if telescope else np.zeros(3),
    }
    return twin(replace(oracle, **generic))


def describe(oracle: DeltaOracle) -> RobotDescription:
    """What a user would write about the oracle's robot."""
    joints = [f"drive{i + 1}" for i in range(oracle.dof)]
    joints += ["slide"] if oracle.has_telescope else []
    friction = zip(joints, oracle.viscous, oracle.coulomb, strict=True)
    data = {
        "name": "twin",
        "gravity": tuple(oracle.gravity),
        "limbs": {
            "azimuth_deg": tuple(np.rad2deg(oracle.azimuths)),
            "struts_per_limb": oracle.struts_per_limb,
            **{
                name: getattr(oracle, name)
                for name in ("base_radius", "platform_radius", "upper_arm", "strut")
            },
        },
        "bodies": {name: {"prior": explicit_body(body)} for name, body in oracle.bodies.items()},
        "friction": {j: {"viscous": v, "coulomb": c} for j, v, c in friction if v > 0},
        "rotor_inertia": {
            j: i for j, i in zip(joints, oracle.rotor_inertia, strict=False) if i > 0
        },
        "workspace": load_robot("clavel-delta3").workspace,
    }
    if oracle.has_telescope:
        data["telescope"] = {"base_joint": tuple(oracle.telescope_base)}
    return RobotDescription.model_validate(data)


def parameters(oracle: DeltaOracle) -> np.ndarray:
    """The oracle's parameters in the order of p: bodies, viscous, Coulomb, rotors."""
    names = ("U", "S", "P") + (("TU", "TL", "EE") if oracle.has_telescope else ())
    lossy, rotors = oracle.viscous > 0, oracle.rotor_inertia
    parts = [body_parameters(oracle.bodies[name]) for name in names]
    parts += [oracle.viscous[lossy], oracle.coulomb[lossy], rotors[rotors > 0]]
    return np.concatenate(parts)


def body_parameters(body: Body) -> np.ndarray:
    """m, first moment, and the inertia tensor's entries xx yy zz xy yz xz."""
    I = np.asarray(body.inertia)
    return np.array([body.m, *body.mc, *np.diag(I), I[0, 1], I[1, 2], I[0, 2]])


def explicit_body(body: Body) -> dict:
    values = body_parameters(body)
    inertia = dict(zip(("xx", "yy", "zz", "xy", "yz", "xz"), values[4:], strict=True))
    return {"mass": body.m, "first_moment": tuple(body.mc), "inertia": inertia}


def random_states(oracle: DeltaOracle, rng: np.random.Generator, n: int) -> tuple[np.ndarray, ...]:
    """z, q, q̇, q̈ of n random states well inside the workspace, one a row."""
    states = [oracle.random_state(rng) for _ in range(n)]
    return tuple(np.array(part) for part in zip(*states, strict=True))


def example(name: str) -> RobotDescription:
    """A robot of the examples whose mechanism is a Python file."""
    folder = Path(__file__).resolve().parents[1] / "examples" / name
    use_mechanism(folder / "mechanism.py")
    return load_robot(folder / "robot.yaml")


# Central differences of fourth order: steps and weights of f'(0) h.
_STEPS, _WEIGHTS = (-2, -1, 1, 2), (1 / 12, -8 / 12, 8 / 12, -1 / 12)


def slope(f, x: np.ndarray, along: np.ndarray, h: float = 1e-4) -> np.ndarray:
    """Derivative of f at x in the direction `along`, by central differences of fourth order."""
    terms = [w * f(x + s * h * along) for s, w in zip(_STEPS, _WEIGHTS, strict=True)]
    return np.sum(terms, axis=0) / h


def assert_close(actual: np.ndarray, expected: np.ndarray, share: float) -> None:
    """Every entry within a share of the largest one."""
    np.testing.assert_allclose(actual, expected, rtol=0, atol=share * np.abs(expected).max())


def assert_torques(
    robot: RobotDescription, truth: Truth, p: np.ndarray, since: float = -np.inf
) -> None:
    """The package has the truth's torques from a time on, while all joints move."""
    moving = np.all(truth.rates != 0, axis=1) & (truth.time > since)
    q, qd, qdd, tau = (x[moving] for x in (truth.q, truth.qd, truth.qdd, truth.tau))
    assert_close(compiled(robot).inverse_dynamics(q, qd, qdd, p), tau, 1e-5)
