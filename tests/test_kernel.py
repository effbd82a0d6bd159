"""The batch kernel against CasADi's own evaluator, operation by operation and bit by bit."""

from dataclasses import replace
from itertools import product

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from composed import Make, twin
from deltaid.dynamics.dynamics import Dynamics
from deltaid.kernel import batch, machine_code
from deltaid.kernel.batch import BatchKernel, Recurrence
from deltaid.kernel.llvm_ir import LIBM_BINARY, LIBM_UNARY, operations_unknown
from deltaid.kernel.machine_code import target
from support import assert_close

A, B, U = ca.SX.sym("a"), ca.SX.sym("b"), ca.SX.sym("u")

# IEEE 754 rounds these, or they are exact, so the kernel has no choice.
EXACT = {
    "neg": (-A, ca.OP_NEG),
    "sq": (A * A, ca.OP_SQ),
    "twice": (2 * A, ca.OP_TWICE),
    "inv": (1 / A, ca.OP_INV),
    "sqrt": (ca.sqrt(A), ca.OP_SQRT),
    "fabs": (ca.fabs(A), ca.OP_FABS),
    "floor": (ca.floor(A), ca.OP_FLOOR),
    "ceil": (ca.ceil(A), ca.OP_CEIL),
    "sign": (ca.sign(A), ca.OP_SIGN),
    "not": (ca.logic_not(A), ca.OP_NOT),
    "and": (ca.logic_and(A, B), ca.OP_AND),
    "or": (ca.logic_or(A, B), ca.OP_OR),
    "add": (A + B, ca.OP_ADD),
    "sub": (A - B, ca.OP_SUB),
    "mul": (A * B, ca.OP_MUL),
    "div": (A / B, ca.OP_DIV),
    "fmin": (ca.fmin(A, B), ca.OP_FMIN),
    "fmax": (ca.fmax(A, B), ca.OP_FMAX),
    "copysign": (ca.copysign(A, B), ca.OP_COPYSIGN),
    "lt": (A < B, ca.OP_LT),
    "le": (A <= B, ca.OP_LE),
    "eq": (A == B, ca.OP_EQ),
    "ne": (A != B, ca.OP_NE),
    "if_else_zero": (ca.if_else(A, B, 0), ca.OP_IF_ELSE_ZERO),
    "if_else": (ca.if_else(A > B, A, U), ca.OP_LT),
    "if_else of a number": (ca.if_else(A, B, U), ca.OP_IF_ELSE_ZERO),
}
LIBRARY = {
    "sin": (ca.sin(A), ca.OP_SIN),
    "cos": (ca.cos(A), ca.OP_COS),
    "tan": (ca.tan(A), ca.OP_TAN),
    "asin": (ca.asin(A), ca.OP_ASIN),
    "acos": (ca.acos(A), ca.OP_ACOS),
    "atan": (ca.atan(A), ca.OP_ATAN),
    "exp": (ca.exp(A), ca.OP_EXP),
    "expm1": (ca.expm1(A), ca.OP_EXPM1),
    "log": (ca.log(A), ca.OP_LOG),
    "log1p": (ca.log1p(A), ca.OP_LOG1P),
    "sinh": (ca.sinh(A), ca.OP_SINH),
    "cosh": (ca.cosh(A), ca.OP_COSH),
    "tanh": (ca.tanh(A), ca.OP_TANH),
    "asinh": (ca.asinh(A), ca.OP_ASINH),
    "acosh": (ca.acosh(A), ca.OP_ACOSH),
    "atanh": (ca.atanh(A), ca.OP_ATANH),
    "erf": (ca.erf(A), ca.OP_ERF),
    "atan2": (ca.atan2(A, B), ca.OP_ATAN2),
    "hypot": (ca.hypot(A, B), ca.OP_HYPOT),
    "fmod": (ca.fmod(A, B), ca.OP_FMOD),
    "remainder": (ca.remainder(A, B), ca.OP_REMAINDER),
    "pow": (A**B, ca.OP_POW),
    "pow of a uniform": (U**A, ca.OP_POW),
    "constpow": (A**2.5, ca.OP_CONSTPOW),
    "constpow odd": (A**3, ca.OP_CONSTPOW),
    "constpow negative": (A**-1.5, ca.OP_CONSTPOW),
}
OPERATIONS = EXACT | LIBRARY
# C leaves the sign of a zero open in fmin and fmax; the kernel's sign(−0) is 0; versions of libm's
# remainder by a subnormal number differ.
ZERO_OF_EITHER_SIGN = {"fmin", "fmax", "sign", "remainder"}

SPECIAL = [np.nan, np.inf, -np.inf, 0.0, -0.0, 5e-324, -5e-324, 2.2e-308, 1e308, -1e308]
ORDINARY = [1.0, -1.0, 0.5, -0.5, 2.0, 3.0, -2.5, 1e-9, -0.1, 7.0, 1e5, np.pi]


@pytest.fixture(scope="module", params=[1, 4, 8])
def operations(request: pytest.FixtureRequest) -> BatchKernel:
    """All operations at once, as scalars and with either width of vectors of any machine."""
    with pytest.MonkeyPatch.context() as patch:
        wide = replace(target(), width=request.param)
        patch.setattr(batch, "target", lambda: wide)
        expressions = [expression for expression, _ in OPERATIONS.values()]
        return BatchKernel(ca.vertcat(A, B), ca.vertcat(*expressions), uniform=U)


def by_casadi(kernel: BatchKernel, x: np.ndarray, uniform: np.ndarray) -> np.ndarray:
    """The same graph by CasADi's evaluator, one sample after the other."""
    columns = [np.array(kernel.function(column, uniform))[:, 0] for column in x.T]
    return np.array(columns).reshape(-1, kernel.n_out).T


def assert_as_casadi(operations: BatchKernel, x: np.ndarray, u: float) -> None:
    uniform = np.array([u])
    both = operations(x, uniform), by_casadi(operations, x, uniform)
    for name, actual, expected in zip(OPERATIONS, *both, strict=True):
        rtol = 0 if name in EXACT else 4e-16
        np.testing.assert_allclose(actual, expected, rtol=rtol, atol=0, err_msg=name)
        if name not in ZERO_OF_EITHER_SIGN:
            sound = ~np.isnan(expected)
            signs = np.signbit(actual[sound]) == np.signbit(expected[sound])
            assert signs.all(), f"{name} has a zero of the wrong sign"


def test_every_operation_is_on_trial(operations: BatchKernel) -> None:
    f = operations.function
    present = {f.instruction_id(k) for k in range(f.n_instructions())}
    assert {op for _, op in OPERATIONS.values()} <= present
    assert {*LIBM_UNARY, *LIBM_BINARY} <= present


@pytest.mark.parametrize("uniform", [3.0, -0.0, np.nan])
def test_operations_on_special_and_ordinary_numbers(
    operations: BatchKernel, uniform: float
) -> None:
    assert_as_casadi(operations, np.array(list(product(SPECIAL + ORDINARY, repeat=2))).T, uniform)


@settings(max_examples=50, deadline=None)
@given(x=arrays(float, st.tuples(st.just(2), st.integers(1, 30)), elements=st.floats(width=64)))
def test_operations_on_any_numbers(operations: BatchKernel, x: np.ndarray) -> None:
    assert_as_casadi(operations, x, 0.7)


def test_operations_mean_what_numpy_means(operations: BatchKernel) -> None:
    """CasADi and the kernel could share a mistake about the order of arguments."""
    (a, b), u = np.random.default_rng(0).uniform(0.1, 0.9, (2, 100)), 0.3
    out = dict(zip(OPERATIONS, operations(np.array([a, b]), np.array([u])), strict=True))
    meant = {
        "sub": a - b,
        "div": a / b,
        "atan2": np.arctan2(a, b),
        "fmod": np.fmod(a, b),
        "remainder": a - b * np.rint(a / b),
        "and": (a != 0) & (b != 0),
        "pow": a**b,
        "pow of a uniform": u**a,
        "constpow": a**2.5,
        "lt": a < b,
        "if_else": np.where(a > b, a, u),
        "if_else of a number": b,
        "fmin": np.minimum(a, b),
        "fmax": np.maximum(a, b),
        "copysign": a,
    }
    for name, values in meant.items():
        np.testing.assert_allclose(out[name], values, rtol=1e-14, err_msg=name)


def test_operation_without_vector_form_is_refused() -> None:
    assert operations_unknown(ca.Function("f", [A], [ca.erfinv(ca.sin(A))])) == ("erfinv",)
    with pytest.raises(NotImplementedError, match="CasADi's erfinv"):
        BatchKernel(A, ca.erfinv(A))


X = ca.SX.sym("x", 5)
P = ca.SX.sym("p", 3)


@pytest.fixture(scope="module")
def mixed() -> BatchKernel:
    """A function whose value tells where every entry of its inputs came from."""
    linear = ca.vertcat(X[0] + 10 * X[1], X[2] - 10 * X[3], X[4] * P[1])
    curved = ca.vertcat(ca.sin(X[0]) * P[0] + ca.sqrt(ca.fabs(X[1])), ca.exp(-X[2]) / P[2])
    return BatchKernel(X, ca.vertcat(linear, curved), uniform=P)


def mixed_by_numpy(x: np.ndarray, p: np.ndarray) -> np.ndarray:
    return np.array(
        [
            x[0] + 10 * x[1],
            x[2] - 10 * x[3],
            x[4] * p[1],
            np.sin(x[0]) * p[0] + np.sqrt(np.abs(x[1])),
            np.exp(-x[2]) / p[2],
        ]
    )


PARAMETERS = np.array([0.3, -1.7, 2.2])


@pytest.mark.parametrize("samples", [1, 3, 4, 7, 8, 9, 1999, 2000, 2001, 4001])
def test_any_number_of_samples(mixed: BatchKernel, samples: int) -> None:
    x = np.random.default_rng(samples).standard_normal((5, samples))
    out = mixed(x, PARAMETERS)
    np.testing.assert_allclose(out, mixed_by_numpy(x, PARAMETERS), rtol=1e-13, atol=1e-13)
    for i in {0, samples // 2, samples - 1}:  # a sample's bits do not depend on its neighbours
        np.testing.assert_array_equal(out[:, i], mixed(x[:, i : i + 1], PARAMETERS)[:, 0])


def test_no_samples(mixed: BatchKernel) -> None:
    assert mixed(np.zeros((5, 0)), PARAMETERS).shape == (5, 0)


@pytest.mark.parametrize("samples", [1, 2001, 9999])
def test_threads_change_no_bit(mixed: BatchKernel, samples: int) -> None:
    x = np.random.default_rng(1).standard_normal((5, samples))
    alone = mixed(x, PARAMETERS, threads=1)
    for threads in (2, 3, None):
        np.testing.assert_array_equal(mixed(x, PARAMETERS, threads=threads), alone)


@pytest.mark.parametrize(
    "view",
    [
        lambda x: np.asfortranarray(x),
        lambda x: x[::-1],
        lambda x: x[:, ::3],
        lambda x: x[:, ::-1],
        lambda x: np.broadcast_to(x[:, :1], (5, 2003)),
    ],
    ids=["Fortran", "rows backwards", "every third", "backwards", "one sample repeated"],
)
def test_inputs_need_not_be_contiguous(mixed: BatchKernel, view) -> None:
    x = view(np.random.default_rng(2).standard_normal((5, 7001)))
    expected = mixed(np.ascontiguousarray(x), PARAMETERS)
    np.testing.assert_array_equal(mixed(x, PARAMETERS), expected)
    shared = np.repeat(PARAMETERS, 2)[::2]
    assert not shared.flags.contiguous
    np.testing.assert_array_equal(mixed(x, shared), expected)


def test_inputs_are_left_alone(mixed: BatchKernel) -> None:
    x = np.random.default_rng(3).standard_normal((5, 2005))
    before, p = x.copy(), PARAMETERS.copy()
    mixed(x, p)
    np.testing.assert_array_equal(x, before)
    np.testing.assert_array_equal(p, PARAMETERS)


def test_outputs_that_are_inputs_constants_and_empty_places() -> None:
    """Entries come column by column, and what is structurally zero is zero."""
    matrix = ca.SX(3, 2)
    matrix[0, 0], matrix[2, 0], matrix[0, 1], matrix[1, 1] = A, U, 0.1, np.inf
    x = np.random.default_rng(4).standard_normal((2, 2003))
    out = BatchKernel(ca.vertcat(A, B), matrix, uniform=U)(x, np.array([np.pi]))
    rows = [x[0], 0 * x[0], 0 * x[0] + np.pi, 0 * x[0] + 0.1, 0 * x[0] + np.inf, 0 * x[0]]
    np.testing.assert_array_equal(out, rows)


@pytest.mark.parametrize("rows", [0, 4, 6])
def test_wrong_number_of_inputs(mixed: BatchKernel, rows: int) -> None:
    with pytest.raises(ValueError, match=f"5 inputs, not {rows}"):
        mixed(np.zeros((rows, 10)), PARAMETERS)


@pytest.mark.parametrize("uniform", [None, np.zeros(2), np.zeros(4)])
def test_wrong_number_of_uniform_inputs(mixed: BatchKernel, uniform: np.ndarray | None) -> None:
    with pytest.raises(ValueError, match="3 uniform inputs, not"):
        mixed(np.zeros((5, 10)), uniform)


def test_uniform_inputs_where_there_are_none() -> None:
    kernel = BatchKernel(A, ca.sin(A))
    with pytest.raises(ValueError, match="0 uniform inputs, not 1"):
        kernel(np.zeros((1, 10)), np.zeros(1))


def test_a_long_recurrence_is_compiled_at_once() -> None:
    """In one piece and optimised, the 56,000 instructions of an online cycle took five minutes."""
    x, u = ca.SX.sym("x", 300), ca.SX.sym("u", 300)
    following = x
    for _ in range(20):
        following = 0.5 * (ca.cos(following) + ca.vertcat(following[1:], following[:1]) * u)
    graph = ca.Function("f", [x, u], [following])
    assert graph.n_instructions() > machine_code._LONG
    state, inputs = np.linspace(-1.0, 1.0, 300), np.linspace(0.5, 0.9, 600).reshape(2, 300)
    last, outputs = Recurrence(x, u, following, following[:3])(state, inputs)
    first = np.array(graph(state, inputs[0]))[:, 0]
    second = np.array(graph(first, inputs[1]))[:, 0]
    assert_close(last, second, 1e-13)
    assert_close(outputs, np.array([first[:3], second[:3]]), 1e-13)


@pytest.mark.parametrize("telescope", [False, True])
def test_regressor_of_a_robot_by_casadi(telescope: bool) -> None:
    e = Dynamics(twin(Make(telescope=telescope)).robot).equations
    kernel = BatchKernel(ca.vertcat(e.z, e.qd, e.qdd), e.Y)
    rng, dof = np.random.default_rng(5), e.z.numel()
    z = np.tile([[0.05], [-0.1], [-0.95], [0.8]], 50)[:dof] + 0.1 * rng.standard_normal((dof, 50))
    x = np.vstack([z, rng.standard_normal((2 * dof, 50))])
    expected = by_casadi(kernel, x, np.zeros(0))
    assert np.isfinite(expected).all()
    assert_close(kernel(x), expected, 1e-14)
