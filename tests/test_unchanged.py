"""Results that must not change when code moves: dynamics at random states, fits of recordings.

`tests/data/unchanged` was written by the version before the equations were derived in natural
coordinates: `python tests/test_unchanged.py FOLDER` writes such a folder with the version in use.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

import deltaid
from support import KINDS

DATA = Path(__file__).parent / "data" / "unchanged"
FITTED = ("clavel-delta3", "irb360-6-1600", "h4", "par4-linear")
# Shares that results may move by; ends of intervals come from a solver of its own tolerance, and
# filtered errors of torque are means over as many rows as are independent, of that time over all.
CLOSE = {"limits": 1e-4, "rms": np.array([1e-2, 1e-7])}
RATE, STEP = 500.0, 2 * np.pi / 2**20


def _some_slow(names: tuple[str, ...], *quick: str) -> list[object]:
    return [name if name in quick else pytest.param(name, marks=pytest.mark.slow) for name in names]


def states(dynamics: deltaid.Dynamics, seed: int) -> tuple[np.ndarray, ...]:
    """q, q̇, q̈ and p at four random states about home."""
    rng, robot = np.random.default_rng(seed), dynamics.robot
    half = np.append(robot.workspace.inner_box[1], np.full(dynamics.dof - 3, 0.3))
    z = dynamics.kinematics.home + rng.uniform(-0.7, 0.7, (4, dynamics.dof)) * half
    q = dynamics.kinematics.inverse(z)
    p = deltaid.prior_parameters(robot)
    p = p * np.exp(0.2 * rng.normal(size=p.size))
    return q, rng.normal(size=q.shape), 10 * rng.normal(size=q.shape), p


def evaluated(name: str) -> dict[str, np.ndarray]:
    """Dynamics of a catalogue robot at these states."""
    dynamics = deltaid.Dynamics(deltaid.load_robot(name))
    q, qd, qdd, p = states(dynamics, 3)
    forward = deltaid.ForwardDynamics(dynamics.robot)
    tau = dynamics.inverse_dynamics(q, qd, qdd, p)
    terms = dynamics.terms(q, qd, p)
    return {
        "torque": tau,
        "regressor": dynamics.regressor(q, qd, qdd),
        "M": terms.M,
        "C": terms.C,
        "g": terms.g,
        "acceleration": forward.drive_acceleration(q, qd, 0.5 * tau, p),
        "forces": deltaid.ConstraintForces(dynamics.robot).evaluate(
            dynamics.kinematics.forward(q), qd, qdd, p
        ),
    }


def write_recording(counts: np.ndarray, tau: np.ndarray, path: Path) -> None:
    """A recording of encoder counts and torques as CSV."""
    time = np.arange(len(counts)) / RATE
    dof = counts.shape[1]
    names = ["t", *(f"q{i + 1}" for i in range(dof)), *(f"tau{i + 1}" for i in range(dof))]
    rows = np.column_stack([time, counts * STEP, tau.astype(float)])
    np.savetxt(path, rows, fmt="%.17g", delimiter=",", header=",".join(names), comments="")


def fitted(name: str, recording: Path) -> dict[str, np.ndarray]:
    """What identification makes of a recording."""
    # Of that time, nothing was excluded, no causes were weighed, and intervals counted no constant
    # of friction that laws lack.
    keep = deltaid.Settings(keep_all=True, effects="none", friction="described")
    exact = {"lengths": 0.0, "homing": 0.0, "mounting": 0.0}  # nor had geometry tolerances
    robot = deltaid.load_robot(name).changed(tolerances=exact)
    result = deltaid.identify(robot, [recording], settings=keep)
    parameters, base = result.model.parameters, result.model.base_parameters
    # Of that time, priors of bodies had normal intervals without a floor.
    others = [each.determined_by not in ("prior", "consistency") for each in parameters]
    limits = np.array([(each.low, each.high) for each in parameters])
    return {
        "p": result.model.p,
        "limits": np.where(np.array(others)[:, None], limits, np.nan),
        "base": np.array([each.value for each in base]),
        "base limits": np.array([(each.low, each.high) for each in base]),
        "rms": np.array([result.model.fit.rms, result.model.fit.rms_unfiltered]),
    }


@pytest.mark.parametrize("name", _some_slow(KINDS, "linear-delta-45", "i4"))
def test_dynamics_are_those_of_before(name: str) -> None:
    expected = np.load(DATA / "dynamics.npz")
    for key, value in evaluated(name).items():
        reference = expected[f"{name}/{key}"]
        size = np.abs(reference).max()
        share = 1e-11 if key == "acceleration" else 1e-12
        np.testing.assert_allclose(value, reference, rtol=0, atol=share * size, err_msg=key)


@pytest.mark.parametrize("name", _some_slow(FITTED, "irb360-6-1600"))
def test_fits_are_those_of_before(name: str, tmp_path: Path) -> None:
    expected = np.load(DATA / f"{name}.npz")
    write_recording(expected["counts"], expected["tau"], tmp_path / "log.csv")
    for key, value in fitted(name, tmp_path / "log.csv").items():
        reference = expected[key]
        value = np.where(np.isnan(value), reference, value)
        scale = np.abs(reference).reshape(len(reference), -1).max(axis=1)
        scale = np.maximum(scale, 1e-3 * np.abs(reference).max())
        np.testing.assert_array_less(
            np.abs(value - reference).reshape(len(reference), -1).max(axis=1),
            CLOSE.get(key, 1e-7) * scale,
        )


def _write(folder: Path) -> None:
    """Reference results of this version."""
    from deltaid.motion.random_motion import random_motion
    from deltaid.motion.surrogate import SensorNoise, simulate_recording, surrogate_parameters

    folder.mkdir(parents=True, exist_ok=True)
    dynamics = {f"{n}/{k}": v for n in KINDS for k, v in evaluated(n).items()}
    np.savez_compressed(folder / "dynamics.npz", **dynamics)
    for name in FITTED:
        rng, model = np.random.default_rng(5), deltaid.Dynamics(deltaid.load_robot(name))
        truth = surrogate_parameters(model.robot, rng)
        motion = random_motion(model.kinematics, rng)
        noise = SensorNoise(torque=0.02, encoder_step=STEP)
        made = simulate_recording(model, truth, motion, rng, duration=6.0, rate=RATE, noise=noise)
        columns = made.to_numpy()[:, 1:]
        counts = np.round(columns[:, : model.dof] / STEP).astype(np.int32)
        tau = columns[:, model.dof :].astype(np.float32)
        write_recording(counts, tau, folder / "log.csv")
        found = fitted(name, folder / "log.csv")
        (folder / "log.csv").unlink()
        np.savez_compressed(folder / f"{name}.npz", counts=counts, tau=tau, **found)


if __name__ == "__main__":
    _write(Path(sys.argv[1]))
