"""A model as functions of JAX, where it has a wheel: same numbers, derivatives, many samples."""

import runpy
from collections.abc import Iterator

import casadi as ca
import numpy as np
import pytest

import deltaid
from composed import Make
from deltaid.errors import KinematicsError
from deltaid.exports.jax_functions import JaxFunctions
from exports import COMPOSED, OF_ONE, OF_TWO, model, states, subject, the, title, with_friction
from sessions import ROOT
from support import assert_close
from sweeps import swept

jax = pytest.importorskip("jax", reason="JAX is not installed")

CASES = swept(["clavel-delta3", "h4", COMPOSED[0]], "clavel-delta3")


@pytest.fixture(scope="module", autouse=True)
def doubles() -> Iterator[None]:
    """JAX computes in single precision unless it is told otherwise."""
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)


@pytest.fixture(autouse=True)
def compiled_code_is_dropped() -> Iterator[None]:
    """It takes 50 MB a test."""
    yield
    jax.clear_caches()


@pytest.fixture(scope="module")
def delta() -> JaxFunctions:
    return deltaid.jax_functions(subject("clavel-delta3"))


@pytest.mark.parametrize("case", CASES, ids=title)
def test_the_same_numbers(case: str | Make) -> None:
    """Also where z(q) has to be iterated (H4), with springs, rotors and friction."""
    chosen = the(case)
    f, (z, q, qd, qdd) = deltaid.jax_functions(chosen), states(chosen, 1)
    want, kinematics = model(chosen, z, qd, qdd), chosen.dynamics.kinematics
    z, q, qd, qdd = z[0], q[0], qd[0], qdd[0]
    with jax.disable_jit():  # the same operations one by one: nothing to compile
        tau = f.inverse_dynamics(q, qd, qdd)
        assert_close(np.asarray(tau), want.tau[0], 1e-12)
        wanted = chosen.forward.drive_acceleration(q, qd, want.tau[0], chosen.p)
        assert_close(np.asarray(f.forward_dynamics(q, qd, tau)), wanted, 1e-11)
        assert_close(np.asarray(f.forward_kinematics(q)), z, 1e-12)
        assert_close(np.asarray(f.inverse_kinematics(z)), q, 1e-12)
        assert_close(np.asarray(f.mass_matrix(z)), want.M[0], 1e-12)
        assert_close(np.asarray(f.bias(z, qd)), want.bias[0], 1e-12)
        assert_close(np.asarray(f.gravity(z)), want.g[0], 1e-12)
        J = kinematics.jacobian(z)
        assert_close(np.asarray(f.jacobian(z)), J, 1e-12)
        assert_close(np.asarray(f.task_velocity(z, qd)), np.linalg.solve(J, qd), 1e-11)


@pytest.mark.slow
def test_compiled_for_many_samples(delta: JaxFunctions) -> None:
    chosen = subject("clavel-delta3")
    z, q, qd, qdd = states(chosen, 50)
    tau = jax.jit(jax.vmap(delta.inverse_dynamics))(q, qd, qdd)
    assert_close(np.asarray(tau), model(chosen, z, qd, qdd).tau, 1e-12)
    found = jax.jit(jax.vmap(delta.forward_dynamics_at))(z, qd, tau)
    assert_close(np.asarray(found), qdd, 1e-10)


def test_friction_that_depends_on_load() -> None:
    chosen = with_friction("drive2", load=0.1)
    f, (z, _, qd, qdd) = deltaid.jax_functions(chosen), states(chosen, 1)
    with jax.disable_jit():
        tau = f.inverse_dynamics_at(z[0], qd[0], qdd[0])
        assert_close(np.asarray(tau), model(chosen, z, qd, qdd).tau[0], 1e-12)
        assert_close(np.asarray(f.forward_dynamics_at(z[0], qd[0], tau)), qdd[0], 1e-10)


@pytest.mark.slow
def test_derivatives_by_parameters_are_the_regressor(delta: JaxFunctions) -> None:
    chosen = subject("clavel-delta3")
    z, q, qd, qdd = (x[0] for x in states(chosen, 1))
    want = chosen.dynamics.regressor(q, qd, qdd)
    with jax.disable_jit():
        Y = jax.jacrev(delta.inverse_dynamics_at, argnums=3)(z, qd, qdd, delta.p)
        assert_close(np.asarray(Y), want, 1e-11)
        doubled = delta.inverse_dynamics_at(z, qd, qdd, p=2 * chosen.p)
        assert_close(np.asarray(doubled), 2 * want @ chosen.p, 1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clavel-delta3", "h4"])
def test_forward_kinematics_has_derivatives_of_any_order(name: str) -> None:
    """However it is found: by closed form, or by Newton's method."""
    chosen = subject(name)
    f, (z, q, _, _) = deltaid.jax_functions(chosen), states(chosen, 1)
    jacobian, h = chosen.dynamics.kinematics.jacobian, 1e-5 * np.eye(len(q[0]))[0]
    with jax.disable_jit():
        T = jax.jacfwd(f.forward_kinematics)(q[0])
        bend = jax.jacfwd(jax.jacfwd(f.forward_kinematics))(q[0])
        ends = [np.asarray(f.forward_kinematics(x)) for x in (q[0] + h, q[0] - h)]
    assert_close(np.asarray(T), np.linalg.inv(jacobian(z[0])), 1e-10)
    ahead, behind = (np.linalg.inv(jacobian(end)) for end in ends)
    assert_close(np.asarray(bend)[:, :, 0], (ahead - behind) / 2e-5, 1e-6)


def test_what_closes_no_loop_is_nan(delta: JaxFunctions) -> None:
    kinematics = subject("clavel-delta3").dynamics.kinematics
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, 3))
    want, good = kinematics.forward_unchecked(q)
    assert 0 < good.sum() < len(q)
    np.testing.assert_allclose(jax.vmap(delta.forward_kinematics)(q), want, atol=1e-12)
    assert np.isnan(delta.inverse_kinematics(np.array([5.0, 0.0, -1.0]))).any()
    whole = np.asarray(delta.inverse_kinematics(np.array([0, 0, -1])))
    assert_close(whole, kinematics.inverse(np.array([0.0, 0.0, -1.0])), 1e-12)


@pytest.mark.slow
def test_poses_found_by_iteration_are_on_the_branch_of_home() -> None:
    """Of drives anywhere, whole turns of arms more or less: closed, in mode, nearest turn of ψ."""
    chosen = subject("par4")
    mechanism, home = chosen.dynamics.kinematics.mechanism, chosen.home
    find = jax.jit(jax.vmap(deltaid.jax_functions(chosen).forward_kinematics))
    z, q, *_ = states(chosen, 20)
    rng = np.random.default_rng(0)
    anywhere = np.tile(q, (200, 1)) + rng.uniform(-1, 1, (4000, 4))
    turns = 2 * np.pi * rng.integers(-2, 3, q.shape)
    found = np.asarray(find(np.vstack([q + turns, anywhere])))
    assert_close(found[:20], z, 1e-11)
    good = np.isfinite(found[20:, 0])
    assert 0.05 < good.mean() < 0.95
    sizes = ca.vertcat(
        mechanism.closure, mechanism.modes, ca.det(ca.jacobian(mechanism.closure, mechanism.z))
    )
    judged = ca.Function("judged", [mechanism.z, mechanism.q_symbols], [sizes])
    side = np.sign(float(judged(home, chosen.dynamics.kinematics.inverse(home))[8]))
    poses, drives = found[20:][good], anywhere[good]
    gaps, modes, slope = np.split(np.asarray(judged.map(len(poses))(poses.T, drives.T)), (4, 8))
    assert np.abs(gaps).max() < 1e-11
    assert modes.min() > -1e-8
    assert (side * slope > 0).all()
    assert np.abs(poses[:, 3] - home[3]).max() <= 0.5 * mechanism.period
    jax.config.update("jax_enable_x64", False)
    try:
        single = np.asarray(jax.vmap(deltaid.jax_functions(chosen).forward_kinematics)(q))
    finally:
        jax.config.update("jax_enable_x64", True)
    assert single.dtype == np.float32
    assert_close(single.astype(float), z, 1e-4)


def test_arrays_that_are_no_sample_are_reported(delta: JaxFunctions) -> None:
    """JAX reads an array's last entry beyond its end, and would say nothing."""
    three, four = np.zeros(3), np.zeros(4)
    with pytest.raises(KinematicsError, match=r"argument 1: has shape \(4,\).* shape \(3,\)"):
        delta.inverse_dynamics(four, three, three)
    with pytest.raises(KinematicsError, match="argument 3"):
        delta.forward_dynamics_at(three, three, four)
    with pytest.raises(KinematicsError, match="argument 4"):
        delta.inverse_dynamics_at(three, three, three, delta.p[:-1])
    with pytest.raises(KinematicsError, match=r"(?s)shape \(5, 3\).*jax\.vmap"):
        delta.inverse_dynamics(*np.zeros((3, 5, 3)))
    with pytest.raises(KinematicsError, match=r"(?s)takes 3 arrays.*q, qd, qdd"):
        delta.inverse_dynamics(three, three)


@pytest.mark.slow
def test_every_operation_of_a_kernel() -> None:
    from deltaid.exports.jax_graph import _OPERATIONS, as_jax

    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    values = [f(a) for f in OF_ONE] + [f(a, b) for f in OF_TWO] + [a + b, a - b, a * b, a / b]
    values += [ca.acosh(a + 2), a**2, 2 * a, 1 / a]
    out = ca.vertcat(*values, ca.if_else(a > b, a, b), -a, ca.constpow(a, 3))
    graph, function = ca.Function("f", [a, b], [out]), as_jax([a, b], out)
    used = {graph.instruction_id(k) for k in range(graph.n_instructions())}
    left = set(_OPERATIONS) - used
    assert left <= {ca.OP_ASSIGN, ca.OP_CONSTPOW, ca.OP_IF_ELSE_ZERO}
    for x, y in ((0.3, 0.7), (0.8, -0.4), (0.5, 0.5), (0.7, 0.4), (0.3, 0.0)):
        want = np.array(graph(x, y)).ravel()
        np.testing.assert_allclose(function(np.array([x]), np.array([y])), want, rtol=1e-14)


@pytest.mark.slow
def test_single_precision_unless_stated_otherwise(delta: JaxFunctions) -> None:
    chosen = subject("clavel-delta3")
    z, q, qd, qdd = states(chosen, 1)
    jax.config.update("jax_enable_x64", False)
    try:
        tau = delta.inverse_dynamics(q[0], qd[0], qdd[0])
    finally:
        jax.config.update("jax_enable_x64", True)
    assert tau.dtype == np.float32
    assert_close(np.asarray(tau, float), model(chosen, z, qd, qdd).tau[0], 1e-4)


@pytest.mark.slow
def test_the_example_descends(capsys: pytest.CaptureFixture[str]) -> None:
    scope = runpy.run_path(str(ROOT / "examples" / "in_jax.py"))
    assert scope["loss"](scope["p"]) < 0.05 * scope["before"]
    assert "N m after" in capsys.readouterr().out
