"""Arrays that hold something else than real numbers are refused, wherever they are given."""

from collections.abc import Callable
from pathlib import Path

import h5py
import jaxtyping
import numpy as np
import polars as pl
import pytest
import scipy.io

import deltaid
from logs import names, recorded, refusal, write

NAME = "clavel-delta3"
FRAME = recorded(300)
T = FRAME["t"].to_numpy()
Q, TAU = (FRAME.select(names(key)).to_numpy() for key in ("q", "tau"))
DYNAMICS = deltaid.Dynamics(NAME)
KINEMATICS, P = DYNAMICS.kinematics, DYNAMICS.p
Z = KINEMATICS.forward(Q[:4])
MOTION = deltaid.random_motion(KINEMATICS, np.random.default_rng(0))
FORWARD = deltaid.ForwardDynamics(NAME)


def masked(x: np.ndarray) -> np.ma.MaskedArray:
    result = np.ma.masked_array(x, mask=np.zeros(x.shape, dtype=bool))
    result[(1,) * x.ndim] = np.ma.masked
    return result


KINDS = {
    "masked": (masked, "has masked values"),
    "complex": (lambda x: x + 1j, "holds complex128, not numbers"),
    "truth": (lambda x: x > 0, "holds bool, not numbers"),
    "object": (lambda x: x.astype(object), "holds object, not numbers"),
    "text": (lambda x: x.astype("U4"), "holds <U4, not numbers"),
    "durations": (lambda x: x.astype("m8[s]"), r"holds timedelta64[s], not numbers"),
}
# What is called with an array, and a good one.
CALLS: dict[str, tuple[np.ndarray, Callable]] = {
    "tau of a recording": (TAU, lambda x: deltaid.Recording.from_arrays(t=T, q=Q, tau=x)),
    "t of a recording": (T, lambda x: deltaid.Recording.from_arrays(t=x, q=Q, tau=TAU)),
    "inverse kinematics": (Z, KINEMATICS.inverse),
    "forward kinematics": (Q, KINEMATICS.forward),
    "torques of q": (Q, lambda x: DYNAMICS.inverse_dynamics(x, Q, Q)),
    "torques of p": (P, lambda x: DYNAMICS.inverse_dynamics(Q, Q, Q, x)),
    "terms of p": (P, lambda x: DYNAMICS.terms(Q, Q, x)),
    "regressor": (Q, lambda x: DYNAMICS.regressor(Q, Q, x)),
    "accelerations": (Z, lambda x: FORWARD.acceleration(Z, x, Z)),
    "times of a motion": (T, MOTION.evaluate),
    "a motion": (
        MOTION.sine,
        lambda x: deltaid.FourierMotion(MOTION.base_frequency, MOTION.centre, x, MOTION.cosine),
    ),
    "steps": (Z, lambda x: deltaid.step_through(FORWARD, P, x, 0 * Z, 0.01)),
    "solver": (Z, lambda x: deltaid.integrate(FORWARD, P, x, 0 * Z, T[:3])),
    "online": (Q, lambda x: deltaid.Online(NAME, rate=1000.0).run(x, Q, TAU)),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("call", CALLS)
def test_arrays_of_other_things_are_refused(call: str, kind: str) -> None:
    (good, function), (other, message) = CALLS[call], KINDS[kind]
    with pytest.raises((deltaid.DeltaidError, jaxtyping.TypeCheckError)) as caught:
        function(other(good))
    if isinstance(caught.value, deltaid.DeltaidError):  # pytest --shapes may refuse it before
        assert message in str(caught.value)


def frame(key: str, values: object) -> dict[str, object]:
    return {"t": T} | {name: FRAME[name].to_numpy() for name in names("q", "tau")} | {key: values}


@pytest.mark.parametrize("key", ["q1", "tau2"])
def test_truth_values_and_durations_are_no_drives(tmp_path: Path, key: str) -> None:
    truths = FRAME[key].to_numpy() > 0
    scipy.io.savemat(tmp_path / "log.mat", frame(key, truths))
    with h5py.File(tmp_path / "log.h5", "w", userblock_size=512) as file:
        for name, values in frame(key, truths.astype(np.uint8)).items():
            file[name] = values
            kind = "logical" if name == key else "double"
            file[name].attrs["MATLAB_class"] = np.bytes_(kind)
    with (tmp_path / "log.h5").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    tables = {
        "MATLAB 7.3": tmp_path / "log.h5",
        "dictionary": frame(key, truths),
        "polars": FRAME.with_columns(pl.Series(key, truths)),
        "Parquet": write(tmp_path / "a.parquet", FRAME.with_columns(pl.Series(key, truths))),
        "MATLAB": tmp_path / "log.mat",
    }
    for name, table in tables.items():
        message = refusal(deltaid.check, NAME, table)
        assert f"column {key} holds truth values, not numbers" in message, name
    lasting = pl.Series(key, np.round(1e6 * FRAME[key].to_numpy()).astype(int))
    message = refusal(deltaid.check, NAME, FRAME.with_columns(lasting.cast(pl.Duration("us"))))
    assert f"column {key} holds durations, which no drive measures" in message


def test_truth_values_of_pandas_that_are_missing() -> None:
    pandas = pytest.importorskip("pandas")
    truths = pandas.array([True, None] * 150, dtype="boolean")
    message = refusal(deltaid.check, NAME, pandas.DataFrame(frame("tau1", truths)))
    assert "column tau1 holds truth values, not numbers" in message


def test_half_precision_and_integers_are_numbers() -> None:
    for kind in (np.float16, np.int8):
        tau = np.round(TAU).astype(kind)
        (rows,) = deltaid.Recording.from_arrays(t=T, q=Q, tau=tau).table.rows(["tau1"])
        np.testing.assert_array_equal(np.asarray(rows.numbers[0]), np.round(TAU[:, 0]))


ZERO = 0 * Z[:1]
WRONG: dict[str, Callable] = {
    "a name with NUL": lambda: deltaid.check(NAME, "a\0b"),
    "no name": lambda: deltaid.load_robot(None),  # pyright: ignore[reportArgumentType]
    "no folder": lambda: deltaid.fleet("f.yaml", None),  # pyright: ignore[reportArgumentType]
    "no worker": lambda: deltaid.fleet("f.yaml", "out", workers=0),
    "no duration": lambda: deltaid.simulate_recording(
        DYNAMICS, P, MOTION, np.random.default_rng(0), duration=-1
    ),
    "no rate": lambda: deltaid.simulate_recording(
        DYNAMICS, P, MOTION, np.random.default_rng(0), rate=0
    ),
    "steps back": lambda: deltaid.step_through(FORWARD, P, Z[:1], ZERO, -1),
    "few parameters": lambda: deltaid.step_through(FORWARD, P[:3], Z[:1], ZERO, 0.01),
    "shapes of a motion": lambda: deltaid.FourierMotion(1.0, Z[0], np.zeros((3, 2)), Z),
    "frequency of a motion": lambda: deltaid.FourierMotion(0.0, Z[0], Z[:3], Z[:3]),
    "rows online": lambda: deltaid.Online(NAME, rate=1000.0).run(Q, Q[:9], TAU),
}


@pytest.mark.parametrize("call", WRONG)
def test_other_wrong_values_are_refused(call: str) -> None:
    with pytest.raises((deltaid.DeltaidError, jaxtyping.TypeCheckError)):
        WRONG[call]()
