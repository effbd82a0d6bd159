"""Every composition of drives, limbs and platforms against the MuJoCo oracle and mechanics."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from composed import (
    ComposedTwin,
    Make,
    body_names,
    dynamics,
    parameters,
    random_bodies,
    random_states,
    twin,
)
from deltaid.dynamics.dynamics import Dynamics
from deltaid.errors import KinematicsError
from deltaid.identification.generic_motion import random_motion_base
from deltaid.mechanism.kinematics import Kinematics
from support import assert_close, slope
from sweeps import swept

TILTED, INCLINED = (-15.0, 15.0), (15.0, 35.0)
MAKES = {
    "delta": Make(),
    "delta, tilted motors": Make(tilt=TILTED, struts=1),
    "delta, unequal limbs": Make(tilt=TILTED, unequal=True, own=True),
    "delta, an elbow inwards": Make(unequal=True, inwards=(1,)),
    "delta, rails": Make(linear=True),
    "delta, inclined rails": Make(linear=True, tilt=INCLINED, own=True),
    "delta above its carriages": Make(linear=True, inwards=(0, 1, 2)),
    "telescope": Make(telescope=True, unequal=True),
    "telescope, clockwise": Make(telescope=True, unequal=True, clockwise=True),
    "telescope, rails": Make(telescope=True, linear=True, tilt=INCLINED),
    "h4": Make("h4"),
    "h4, rails": Make("h4", linear=True, tilt=INCLINED),
    "h4, unequal limbs": Make("h4", tilt=TILTED, unequal=True, own=True),
    "par4": Make("par4"),
    "par4, rails": Make("par4", linear=True, unequal=True),
    "par4, unequal limbs": Make("par4", tilt=TILTED, unequal=True, struts=1),
    "i4": Make("i4"),
    "i4, rails": Make("i4", linear=True, tilt=INCLINED, own=True),
    "i4, unequal limbs": Make("i4", tilt=TILTED, unequal=True),
}
SOME = (
    "delta, unequal limbs", "delta, inclined rails", "telescope, clockwise", "telescope, rails",
    "h4, rails", "par4", "i4, unequal limbs",
)  # fmt: skip
every_make = pytest.mark.parametrize("name", swept(MAKES, *SOME))

# Base parameters of robots whose drives all have a rotor, and all joints friction and a spring.
RANKS = {
    "delta": 23, "delta, unequal limbs": 43, "delta, rails": 22, "telescope": 46,
    "telescope, rails": 43, "h4": 35, "h4, rails": 34, "par4": 35, "par4, rails": 35, "i4": 33,
    "i4, rails": 60,
}  # fmt: skip


@cache
def states(name: str, n: int = 12) -> tuple[np.ndarray, ...]:
    """z, q, q̇, q̈ of random states, from the oracle's geometry."""
    return random_states(twin(MAKES[name]).oracle, np.random.default_rng(1), n)


# --- against the oracle ---------------------------------------------------------------------------


@every_make
def test_inverse_kinematics_closes_the_loops(name: str) -> None:
    """Distances from arm tips or carriages to the platform's joints by the oracle's geometry."""
    oracle, (z, q, _, _) = twin(MAKES[name]).oracle, states(name)
    solved = dynamics(MAKES[name]).kinematics.inverse(z)
    np.testing.assert_allclose(solved, q, rtol=0, atol=1e-13)
    assert np.abs(oracle.gaps(z, solved)).max() < 1e-12


@every_make
def test_forward_kinematics_is_its_inverse(name: str) -> None:
    z, q, _, _ = states(name)
    kinematics = dynamics(MAKES[name]).kinematics
    np.testing.assert_allclose(kinematics.forward(q), z, rtol=0, atol=1e-12)
    solved, good = kinematics.forward_unchecked(q)
    assert good.all()
    np.testing.assert_array_equal(solved, kinematics.forward(q))


@every_make
def test_torques_and_mass_matrix(name: str) -> None:
    t, model = twin(MAKES[name]), dynamics(MAKES[name])
    z, q, qd, qdd = states(name)
    tau = t.oracle.inverse_dynamics(z, qd, qdd)
    assert_close(model.inverse_dynamics(q, qd, qdd, t.p), tau, 1e-11)
    M = np.array([t.oracle.mass_matrix(pose) for pose in z])
    assert_close(model.mass_matrix(q, t.p), M, 1e-11)


@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    telescope=st.booleans(),
    clockwise=st.booleans(),
    struts=st.integers(1, 2),
)
def test_any_delta(seed: int, telescope: bool, clockwise: bool, struts: int) -> None:
    t = twin(Make(telescope=telescope, clockwise=clockwise, struts=struts), seed)
    model, kinematics = Dynamics(t.robot), Kinematics(t.robot)
    z, q, qd, qdd = random_states(t.oracle, np.random.default_rng(seed), 10)
    np.testing.assert_allclose(kinematics.forward(q), z, rtol=0, atol=1e-12)
    np.testing.assert_allclose(kinematics.inverse(z), q, rtol=0, atol=1e-12)
    tau = t.oracle.inverse_dynamics(z, qd, qdd)
    assert_close(model.inverse_dynamics(q, qd, qdd, t.p), tau, 1e-11)
    M = np.array([t.oracle.mass_matrix(pose) for pose in z])
    assert_close(model.mass_matrix(q, t.p), M, 1e-11)


@every_make
def test_poses_of_all_bodies(name: str) -> None:
    """Link frames where the oracle's real joints put them."""
    t, (z, _, _, _) = twin(MAKES[name]), states(name)
    poses = dynamics(MAKES[name]).kinematics.poses(z)
    names = body_names(t.oracle)
    assert set(names) == {pose.name for pose in poses}
    for k, coordinates in enumerate(z):
        wanted = tree_poses(t, coordinates)
        assert len(wanted) == len(poses)
        for pose, (body, R, r) in zip(poses, wanted, strict=True):
            assert pose.name == body
            np.testing.assert_allclose(pose.R_WB[k], R, rtol=0, atol=1e-13)
            np.testing.assert_allclose(pose.r_WB[k], r, rtol=0, atol=1e-13)


def tree_poses(t: ComposedTwin, z: np.ndarray) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """The oracle's bodies in the package's order; struts and rods in the middle of each pair."""
    oracle = t.oracle
    tree, struts = oracle.body_poses(z), t.make.struts
    found = []
    for i, limb in enumerate(oracle.limbs):
        found.append((limb.driven, *tree[f"driven{i}"]))
        pair = [pose for key, pose in tree.items() if key.startswith(f"strut{i}")]
        assert len(pair) == struts
        found.append((limb.strut_body, pair[0][0], np.mean([r for _, r in pair], axis=0)))
    if t.make.kind == "rigid":
        found.append(("P", *tree["part0"]))
    else:
        part = body_names(oracle)[-2 if t.make.kind == "i4" else -3]
        R, r = tree["part1"]
        found += [(part, *tree["part0"]), (part, R @ np.diag([-1, -1, 1]), r)]
    if t.make.kind == "h4":
        found.append(("MB", *tree["bar"]))
    if t.make.kind == "par4":
        rods = [tree[f"rod{k}"][1] - oracle.corners[k] for k in range(2)]
        np.testing.assert_allclose(rods[0], rods[1], rtol=0, atol=1e-13)
        found.append(("R", tree["rod1"][0], rods[0]))
    if t.make.telescope:
        found += [("TU", *tree["TU"]), ("TL", *tree["TL"])]
    if "EE" in tree:
        found.append(("EE", *tree["EE"]))
    return found


# --- the equation's terms -------------------------------------------------------------------------

some_makes = pytest.mark.parametrize("name", SOME)


@some_makes
def test_terms_are_those_of_the_oracle(name: str) -> None:
    """Gravity and springs from a robot at rest, friction by leaving it out, C q̇ from the rest."""
    t, (z, q, qd, _) = twin(MAKES[name]), states(name)
    terms = dynamics(MAKES[name]).terms(q, qd, t.p)
    still = np.zeros_like(qd)
    free = replace(t.oracle, viscous=np.zeros(0), coulomb=np.zeros(0))
    g = t.oracle.inverse_dynamics(z, still, still)
    lossless = free.inverse_dynamics(z, qd, still)
    f = t.oracle.inverse_dynamics(z, qd, still) - lossless
    assert_close(terms.g, g, 1e-11)
    assert_close(terms.f, f, 1e-9)
    assert_close(np.einsum("sij,sj->si", terms.C, qd), lossless - g, 1e-10)


@some_makes
def test_terms_add_up_to_the_regressor(name: str) -> None:
    t, model, (z, q, qd, qdd) = twin(MAKES[name]), dynamics(MAKES[name]), states(name)
    Y = model.regressor(q, qd, qdd)
    for p in (np.random.default_rng(9).standard_normal(t.p.size), t.p):  # of no physical body, too
        terms = model.terms(q, qd, p)
        tau = np.einsum("sij,sj->si", terms.M, qdd) + np.einsum("sij,sj->si", terms.C, qd)
        assert_close(tau + terms.g + terms.f, Y @ p, 1e-12)
        assert_close(model.inverse_dynamics(q, qd, qdd, p), Y @ p, 1e-12)
    assert_close(model.torque(z, qd, qdd, t.p), Y @ t.p, 1e-12)
    assert_close(model.mass_matrix(q, t.p), terms.M, 1e-12)
    np.testing.assert_array_equal(model.terms(q, np.zeros_like(qd), t.p).f, 0.0)


@some_makes
def test_sparse_regressor_holds_the_nonzero_entries(name: str) -> None:
    model, (z, q, qd, qdd) = dynamics(MAKES[name]), states(name)
    Y, sparse = model.regressor(q, qd, qdd), model.sparse_regressor(z, qd, qdd)
    assert_close(sparse.values.T, Y[:, sparse.rows, sparse.columns], 1e-12)
    Y[:, sparse.rows, sparse.columns] = 0.0
    assert not Y.any()
    assert (np.diff(sparse.rows) >= 0).all()


@some_makes
def test_coriolis_matrix_is_that_of_the_christoffel_symbols(name: str) -> None:
    t, model, (_, q, qd, _) = twin(MAKES[name]), dynamics(MAKES[name]), states(name)
    dM = [slope(lambda q: model.mass_matrix(q, t.p), q, axis) for axis in np.eye(model.dof)]
    dM = np.stack(dM, axis=-1)  # samples, i, j, k: ∂M_ij/∂q_k
    christoffel = 0.5 * (
        np.einsum("sijk,sk->sij", dM, qd)
        + np.einsum("sikj,sk->sij", dM, qd)
        - np.einsum("sjki,sk->sij", dM, qd)
    )
    C = model.terms(q, qd, t.p).C
    assert np.abs(C - C.swapaxes(1, 2)).max() > 1e-3 * np.abs(C).max()
    assert_close(C, christoffel, 1e-8)


# --- base parameters ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", swept(RANKS, "delta, unequal limbs", "telescope, rails"))
def test_base_parameters(name: str) -> None:
    """The regressor is the oracle's, column by column, and so is the number of base parameters."""
    t, model, rank = twin(MAKES[name]), dynamics(MAKES[name]), RANKS[name]
    z, q, qd, qdd = states(name, 2 * rank // t.oracle.dof)
    some = slice(4)
    Y = oracle_regressor(t, z[some], qd[some], qdd[some])
    assert_close(model.regressor(q[some], qd[some], qdd[some]).reshape(Y.shape), Y, 1e-8)
    Y = model.regressor(q, qd, qdd).reshape(-1, t.p.size)
    lengths = np.linalg.norm(Y, axis=0)
    seen = lengths > 1e-7 * lengths.max()
    values = np.linalg.svd(Y[:, seen] / lengths[seen], compute_uv=False)
    assert values[rank - 1] > 1e-4 * values[0]
    assert values[rank:].max() < 1e-8 * values[0]
    assert random_motion_base(model).rank == rank


def oracle_regressor(t: ComposedTwin, z: np.ndarray, qd: np.ndarray, qdd: np.ndarray) -> np.ndarray:
    """Y, drives and samples in rows, from the torques of as many random robots as p has entries."""
    rng, oracle = np.random.default_rng(2), t.oracle
    p, tau = [], []
    for _ in range(t.p.size):
        joints = {k: rng.uniform(0, 1, oracle.viscous.size)
                  for k in ("viscous", "coulomb", "stiffness")}  # fmt: skip
        rotors = rng.uniform(0, 1, oracle.dof)
        bodies = random_bodies(oracle, rng)
        other = replace(oracle, bodies=bodies, rotor_inertia=rotors, **joints)
        p.append(parameters(other))
        tau.append(other.inverse_dynamics(z, qd, qdd).ravel())
    return np.linalg.solve(np.array(p), np.array(tau)).T


# --- symmetry -------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["h4", "par4", "i4"])
def test_the_whole_robot_turned_by_a_half_is_the_same_robot(kind: str) -> None:
    """Its home pose turns too: at ψ = 0 the turned H4 and Par4 are beyond singularities."""
    z, q, _, _ = states(kind)
    robot, k = twin(MAKES[kind]).robot, twin(MAKES[kind]).oracle.ratio
    half = {"azimuth_deg": tuple(angle + 180 for angle in robot.limbs.azimuth_deg)}
    if kind == "i4":
        k, turned = 0.0, {"direction_deg": robot.platform.direction_deg + 180}
    else:
        turned = {"angle_deg": tuple(angle + 180 * k for angle in robot.platform.angle_deg)}
    limbs = robot.limbs.changed(**half)
    platform = robot.platform.changed(**turned)
    kinematics = Kinematics(robot.model_copy(update={"limbs": limbs, "platform": platform}))
    at = np.column_stack([-z[:, 0], -z[:, 1], z[:, 2], z[:, 3] + k * np.pi])
    np.testing.assert_allclose(kinematics.inverse(at), q, rtol=0, atol=1e-13)
    np.testing.assert_allclose(kinematics.forward(q), at, rtol=0, atol=1e-12)


# --- errors ---------------------------------------------------------------------------------------


def test_what_a_rail_cannot_reach() -> None:
    """Struts square to the rail are the edge; beyond it the missing length is named."""
    t, kinematics = twin(MAKES["delta, rails"]), dynamics(MAKES["delta, rails"]).kinematics
    limb = t.oracle.limbs[1]
    outward = limb.base / np.linalg.norm(limb.base)
    edge = limb.base - limb.seat - limb.strut * outward - [0, 0, 0.8]
    with pytest.raises(KinematicsError, match="struts of limb 2 stand square to its rail"):
        kinematics.inverse(edge[None])
    beyond = edge - 0.01 * outward
    with pytest.raises(KinematicsError, match=r"limb 2 cannot reach .*: 0\.01 m are missing"):
        kinematics.inverse(beyond[None])
