"""The online cycle in C and in structured text against the stream in Python."""

import ctypes
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from c_library import BAD_INPUT, OK, Library, build
from command import accepted, refused
from deltaid.errors import DeltaidError
from deltaid.exports.files import Written, export
from deltaid.exports.structured_text import plc_program
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.model.model import load
from deltaid.online.graph import Field
from deltaid.online.online import Online
from deltaid.online.settings import OnlineSettings
from exports import needs_compiler
from st_program import Program
from support import along
from sweeps import swept

ROBOT, CYCLES, LIFTED = "clavel-delta3", 120, 60
SPOILT = (30, 31)
# A row that is not new, one that cannot be, and from when on rows have stamps.
STALE, ABSURD, STAMPED = 95, 80, 70
PRECISIONS = pytest.mark.parametrize(
    "precision", swept([DOUBLE, SINGLE], DOUBLE), ids=["double", "single"]
)


@cache
def recording(precision: Precision) -> tuple[Online, np.ndarray, np.ndarray]:
    """The stream behind a motion in which a load is lifted, its inputs, in floats where C has such,
    and its outputs; two cycles have NaN and infinite inputs, two rows are to be skipped."""
    model = load(ROBOT)
    dynamics, online = model.dynamics, Online(model)
    z, q, qd, qdd = along(dynamics.kinematics, np.random.default_rng(0), 1e-3 * np.arange(CYCLES))
    heavier = model.p.copy()
    heavier[model.layout.names.index("P.m")] += 0.02
    lifted = np.arange(CYCLES) >= LIFTED
    tau = np.where(lifted[:, None], *(dynamics.torque(z, qd, qdd, p) for p in (heavier, model.p)))
    elapsed = 1e-3 + 1e-4 * np.sin(np.arange(CYCLES))
    elapsed[:STAMPED], elapsed[STALE] = -1.0, 0.0
    inputs = np.ascontiguousarray(np.column_stack([q, qd, tau, lifted, elapsed]))
    inputs[STALE, :9], inputs[ABSURD, 6] = inputs[STALE - 1, :9], 1e6
    inputs[SPOILT[0]], inputs[SPOILT[1], 2] = np.nan, np.inf
    inputs = inputs.astype(float if precision is DOUBLE else np.float32).astype(float)
    found = online.run(*np.split(inputs[:, :9], 3, axis=1), *inputs[:, 9:].T)
    assert found.held.any()
    assert np.flatnonzero(~found.good).tolist() == [*SPOILT, ABSURD, STALE]
    return online, inputs, np.column_stack([found.outputs[f.name] for f in fields(online)])


def fields(online: Online) -> list[Field]:
    return [field for field in online.graph.outputs.fields if field.name != "status"]


def assert_outputs(found: np.ndarray, expected: np.ndarray, precision: Precision) -> None:
    """Each field to a share of its largest entry; what is left of torques, of the torques, and a
    score, of the one that counts."""
    online, inputs, _ = recording(precision)
    # Positions of stamped rows are second differences, which single numbers hold less well.
    share = 1e-12 if precision is DOUBLE else 2e-5
    torque, at = np.abs(np.delete(inputs, (*SPOILT, ABSURD), axis=0)[:, 6:9]).max(), 0
    for field in fields(online):
        place, at = slice(at, at + field.size), at + field.size
        whole = {"residual": torque, "unexplained": torque, "change_score": online.settings.alarm}
        least = whole.get(field.name, 1.0)
        size = max(np.abs(expected[:, place]).max(initial=0.0), least)
        np.testing.assert_allclose(
            found[:, place], expected[:, place], rtol=0, atol=share * size, err_msg=field.name
        )


@needs_compiler
@PRECISIONS
def test_c_is_the_stream_of_python(precision: Precision, tmp_path: Path) -> None:
    online, inputs, expected = recording(precision)
    library = build(load(ROBOT), tmp_path, precision=precision, further=("online",))
    graph, number = online.graph, library.type
    state, out = np.full(graph.state.size, 7, number), np.empty(graph.outputs.size, number)
    start = library.library.delta_online_start
    start(ctypes.c_void_p(state.ctypes.data))
    assert (state == graph.state.initial.astype(number)).all()
    codes, found = [], []
    for row in np.ascontiguousarray(inputs, number):
        codes.append(call(library, state, row, out))
        found.append(out[:-1].copy())
    assert [k for k, code in enumerate(codes) if code != OK] == list(SPOILT)
    assert {codes[k] for k in SPOILT} == {BAD_INPUT}
    assert_outputs(np.array(found), expected, precision)
    header = (tmp_path / "delta.h").read_text()
    assert "} delta_online_state;" in header
    assert f"    {precision.c_type} held; /* 1 while a load is held */" in header


def call(library: Library, *arrays: np.ndarray) -> int:
    return library.library.delta_online(*(ctypes.c_void_p(x.ctypes.data) for x in arrays))


@PRECISIONS
def test_structured_text_is_the_stream_of_python(precision: Precision) -> None:
    online, inputs, expected = recording(precision)
    program = Program(plc_program(load(ROBOT), "rob", precision, ("online",)).text)
    block, number = program.units["rob_online"](), np.float32 if program.single else float
    codes, found = [], []
    for row in inputs:
        numbers = [number(x) for x in row]
        parts = {"q": numbers[:3], "qd": numbers[3:6], "tau": numbers[6:9]}
        parts |= {"gripper": numbers[9], "elapsed": numbers[10]}
        _, outputs = block(**parts, reset=False)
        codes.append(outputs["status"])
        found.append(np.hstack([outputs[field.name.lower()] for field in fields(online)]))
    assert [k for k, code in enumerate(codes) if code != OK] == list(SPOILT)
    assert_outputs(np.array(found, float), expected, precision)
    first = {"q": list(map(number, inputs[0, :3])), "qd": list(map(number, inputs[0, 3:6]))}
    first["tau"] = list(map(number, inputs[0, 6:9]))
    _, again = block(**first, gripper=number(0), elapsed=number(-1), reset=True)
    assert_outputs(
        np.hstack([again[field.name.lower()] for field in fields(online)])[None].astype(float),
        expected[:1],
        precision,
    )


def test_a_prior_has_no_contacts_and_says_so(tmp_path: Path) -> None:
    written = export(load(ROBOT), "st", tmp_path / "rob.st", functions=["online"])
    assert "no contacts" in written.warnings[0]


def test_settings_without_the_function(tmp_path: Path) -> None:
    for option in ("--rate", "--payload-max", "--false-alarms"):
        asked = ("export", ROBOT, "--to", "c", "-o", tmp_path / "r.c", option, "500")
        refusal = refused(*asked, folder=tmp_path)
        assert f"{option}: is of the function online, which is not asked for" in refusal
    with pytest.raises(DeltaidError, match="has no further function"):
        export(ROBOT, "c", tmp_path / "r.c", functions=["on-line"])


def test_what_the_command_says_of_the_cycle(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rate that is the usual one changes nothing; a slow one moves the filter's corner too."""
    taken: list[OnlineSettings | None] = []

    def take(*_: object, online: OnlineSettings | None, **__: object) -> Written:
        taken.append(online)
        return Written((), ())

    monkeypatch.setattr("deltaid.exports.files.export", take)
    asked = ("export", ROBOT, "--to", "c", "-o", tmp_path / "r.c", "--with", "online")
    for options in ([], ["--rate", "1000"], ["--rate", "100", "--payload-max", "2"],
                    ["--false-alarms", "5"]):  # fmt: skip
        accepted(*asked, *options)
    usual = OnlineSettings()
    slow = OnlineSettings(rate=100.0, corner=20.0, largest_mass=2.0)
    assert taken == [None, usual, slow, OnlineSettings(false_alarms=5.0)]
