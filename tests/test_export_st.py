"""The export to structured text, read by other people's parsers and run, against the package."""

import re
from functools import cache
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np
import pytest

from c_library import BAD_INPUT, FURTHER, NOT_CLOSED, OK, OTHER_MODE, OUT_OF_REACH, SINGULAR
from deltaid.errors import DeltaidError
from deltaid.exports.st_statements import StructuredText
from deltaid.exports.straight_line import Array, body
from deltaid.exports.structured_text import plc_program
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.model.model import Model
from exports import floats, model, states, subject, towards_singularities
from st_program import Program
from support import KINDS, assert_close
from sweeps import slow, swept


@cache
def text(name: str, precision: Precision = DOUBLE, further: tuple[str, ...] = ()) -> str:
    return plc_program(subject(name), "rob", precision, further).text


@cache
def program(name: str, precision: Precision = DOUBLE, further: tuple[str, ...] = ()) -> Program:
    return Program(text(name, precision, further))


def newton(subject: Model) -> bool:
    return subject.dynamics.kinematics.mechanism.forward is None


def assert_same(program: Program, subject: Model, share: float, at: tuple[np.ndarray, ...]) -> None:
    """Every function against the package."""
    z, q, qd, qdd = at
    expected, J = model(subject, z, qd, qdd), subject.dynamics.kinematics.jacobian(z)
    for i in range(len(z)):
        pose = {"z": z[i]}
        wanted = {
            "inverse_kinematics": (pose, q[i]),
            "inverse_dynamics_at": (pose | {"qd": qd[i], "qdd": qdd[i]}, expected.tau[i]),
            "forward_dynamics": (pose | {"qd": qd[i], "tau": expected.tau[i]}, qdd[i]),
            "jacobian": (pose, J[i]),
            "mass_matrix": (pose, expected.M[i]),
            "bias": (pose | {"qd": qd[i]}, expected.bias[i]),
            "gravity": (pose, expected.g[i]),
        }
        start = {"z_start": z[i] + 0.003} if newton(subject) else {}
        wanted["forward_kinematics"] = ({"q": q[i]} | start, z[i])
        for name, (inputs, value) in wanted.items():
            status, outputs = program.call(f"rob_{name}", **inputs)
            assert status == OK, name
            [found] = outputs.values()
            wider = 10 if name == "forward_dynamics" else 1  # M⁻¹ of a torque with rounding
            assert_close(found, value.ravel(), wider * share)


@pytest.mark.parametrize("name", swept(KINDS, "irb360-6-1600", "h4"))
def test_all_functions_of_the_catalogue(name: str) -> None:
    assert_same(program(name), subject(name), 1e-12, states(subject(name), 2))


@pytest.mark.parametrize("name", swept(["clavel-delta3", "h4"], "clavel-delta3"))
def test_single_precision(name: str) -> None:
    """At the same floats, one pose in the workspace and one each to a condition of 30 and 100."""
    chosen = Model(subject(name).robot, floats(subject(name).p), name)
    z = towards_singularities(chosen, 1)
    moving = floats(np.random.default_rng(0).standard_normal((2, *z.shape)))
    q = chosen.dynamics.kinematics.inverse(z)
    assert_same(program(name, SINGLE), chosen, 1e-5, (z, q, *moving))
    assert "LREAL" not in text(name, SINGLE)


def test_further_functions() -> None:
    chosen, further = subject("irb360-6-1600"), program("irb360-6-1600", DOUBLE, FURTHER)
    z, q, qd, qdd = states(chosen, 2)
    dynamics, forces = chosen.dynamics, ConstraintForces(chosen.robot)
    F = forces.evaluate(z, qd, qdd, chosen.p)
    Y = dynamics.regressor(q, qd, qdd, dynamics.carried(z, qd, qdd, chosen.p))
    joints = dynamics.kinematics.passive_joints(z, qd)
    for i in range(2):
        moving = {"z": z[i], "qd": qd[i]}
        status, outputs = further.call("rob_constraint_forces", **moving, qdd=qdd[i])
        assert status == OK
        assert_close(outputs["f"], F[i], 1e-12)
        status, outputs = further.call("rob_regressor", **moving, qdd=qdd[i])
        assert status == OK
        assert_close(outputs["y"], Y[i].ravel(), 1e-12)
        status, outputs = further.call("rob_passive_joints", **moving)
        assert status == OK
        assert_close(outputs["x"], joints.position[i], 1e-12)
        assert_close(outputs["xd"], joints.velocity[i], 1e-12)
    notes = text("irb360-6-1600", DOUBLE, FURTHER)
    assert f"[0] {forces.names[0]}, {forces.units[0]} *)" in notes


@pytest.mark.parametrize("name", ["clavel-delta3", "h4"])
def test_the_block_keeps_its_pose(name: str) -> None:
    """Along a way from home; a cycle with a wrong input leaves torque and pose as they were."""
    chosen, block = subject(name), program(name).units["rob_inverse_dynamics"]()
    z, _, qd, qdd = states(chosen, 1)
    way = chosen.home + np.linspace(0, 1, 30)[:, None] * (z[0] - chosen.home)
    q = chosen.dynamics.kinematics.inverse(way)
    expected = model(chosen, way, np.tile(qd, (30, 1)), np.tile(qdd, (30, 1))).tau
    moving = {"qd": list(qd[0]), "qdd": list(qdd[0])}
    for i in range(30):
        _, outputs = block(q=list(q[i]), **moving)
        assert outputs["status"] == OK
        assert_close(np.array(outputs["tau"]), expected[i], 1e-12)
        assert_close(np.array(outputs["z"]), way[i], 1e-12)
        _, spoilt = block(q=list(q[i] * np.nan), **moving)
        assert spoilt["status"] == BAD_INPUT
        assert (spoilt["tau"], spoilt["z"]) == (outputs["tau"], outputs["z"])


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1.1e6])
def test_no_input_that_is_no_number_passes(wrong: float) -> None:
    chosen, run = subject("h4"), program("h4")
    z, q, qd, qdd = (x[0] for x in states(chosen, 1))
    at = {"z": z, "q": q, "qd": qd, "qdd": qdd, "tau": qdd, "z_start": z}
    for name, inputs in {
        "inverse_kinematics": "z",
        "forward_kinematics": "q z_start",
        "inverse_dynamics_at": "z qd qdd",
        "forward_dynamics": "z qd tau",
        "jacobian": "z",
        "bias": "z qd",
    }.items():
        good = {key: at[key] for key in inputs.split()}
        for k, key in enumerate(good):
            spoilt = good[key].copy()
            spoilt[k] = wrong
            status, outputs = run.call(f"rob_{name}", **good | {key: spoilt})
            assert status == BAD_INPUT
            assert all((out == 0).all() for out in outputs.values())


@pytest.mark.parametrize(
    ("name", "precision"),
    [("clavel-delta3", SINGLE), ("h4", DOUBLE), slow("h4", SINGLE)],
    ids=["clavel-delta3-REAL", "h4-LREAL", "h4-REAL"],
)
def test_nothing_stops_the_controller(name: str, precision: Precision) -> None:
    """Poses and drives anywhere: no division by zero, no root of what is negative, no overflow."""
    run, chosen, rng = program(name, precision), subject(name), np.random.default_rng(0)
    dof, met = chosen.dynamics.dof, set[int]()
    for k in range(150):
        size = (0.3, 1.0, 30.0, 1e4, 1e6)[k % 5] if k else 0.0
        z, v, a = size * rng.uniform(-1, 1, (3, dof))
        start = {"z_start": z} if newton(chosen) else {}
        for inputs in (
            {"rob_inverse_kinematics": {"z": z}},
            {"rob_forward_kinematics": {"q": v} | start},
            {"rob_inverse_dynamics_at": {"z": z, "qd": v, "qdd": a}},
            {"rob_forward_dynamics": {"z": z, "qd": v, "tau": a}},
        ):
            [(function, arrays)] = inputs.items()
            status, outputs = run.call(function, **arrays)
            met.add(status)
            assert status == OK or all((out == 0).all() for out in outputs.values())
    assert {OK, OUT_OF_REACH, SINGULAR} <= met
    assert met & {NOT_CLOSED, OTHER_MODE}


def test_text_is_what_controllers_read() -> None:
    written = text("h4", DOUBLE, FURTHER)
    assert written.isascii()
    assert max(map(len, written.splitlines())) <= 110
    for forbidden in ("//", "**", "ATAN2(", "__", "SEL(", "\t", "VAR_GLOBAL", "VAR_EXTERNAL"):
        assert forbidden not in written
    without_types = re.sub(r"^TYPE.*?^END_TYPE", "", written, flags=re.MULTILINE | re.DOTALL)
    assert "ARRAY" not in without_types  # inputs and outputs need types with names
    literals = re.findall(r"\b\d+\.\d+(?:E-?\d+)?\b", written)
    sizes = np.array([float(literal) for literal in literals])
    real = np.finfo(np.float32)  # MATIEC takes no other ones, for LREAL neither
    assert ((sizes == 0) | ((sizes >= real.tiny) & (sizes <= real.max))).all()
    for unit in re.findall(r"^FUNCTION.*?^END_FUNCTION", written, re.MULTILINE | re.DOTALL):
        declared = re.findall(r"^ +([a-vx-z]\w*) : ", unit, re.MULTILINE | re.IGNORECASE)
        declared += re.findall(r"\bw\d+\b", unit[: unit.rindex("END_VAR")])
        names = [name.lower() for name in declared]
        assert len(names) == len(set(names))  # letters' case does not tell names apart


@pytest.mark.slow
def test_another_parser_reads_it_too() -> None:
    """blark's grammar is TwinCAT's. It is slow, so every form of a line is there once."""
    blark = pytest.importorskip("blark.parse", reason="blark is not installed")
    seen, lines = set[str](), []
    whole = text("h4")
    units = re.findall(r"^FUNCTION.*?^END_FUNCTION\w*$", whole, re.MULTILINE | re.DOTALL)
    start = whole[: whole.index("FUNCTION")].splitlines()
    some = "\n".join([*start, *units[:4], units[5], units[7]])
    for line in some.splitlines():
        form = re.sub(r"\bw\d+", "w", re.sub(r"\(?-?\d+\.\d+(E-?\d+)?\)?", "0.0", line))
        form = re.sub(r"\[\d+\]", "[0]", form)
        step = re.match(r" *(w|found|IF .* END_IF;$)", form) and "[i" not in form
        if not step or form not in seen:
            lines.append(line)
        seen.add(form)
    parsed = blark.parse_source_code("\n".join(lines))
    kinds = [type(item).__name__ for item in parsed.transform().items]
    types = whole.count("END_TYPE")
    assert kinds == [*types * ["DataTypeDeclaration"], *5 * ["Function"], "FunctionBlock"]


def test_what_is_imported_is_the_same_text() -> None:
    """PLCopen's XML: the same units, variables, starts and statements."""
    found = plc_program(subject("h4"), "rob")
    root, space = ET.fromstring(found.xml), "{http://www.plcopen.org/xml/tc6_0200}"
    names = []
    for pou in root.iter(f"{space}pou"):
        name, result = pou.get("name"), pou.find(f".//{space}returnType")
        kind = "FUNCTION" if pou.get("pouType") == "function" else "FUNCTION_BLOCK"
        head = f"{kind} {name}" + ("" if result is None else f" : {result[0].tag[len(space) :]}")
        [body] = pou.findall(f"{space}body/{space}ST/")
        unit = found.text[found.text.index(f"\n{head}\n") :].partition(f"END_{kind}\n")[0]
        assert unit.endswith(f"END_VAR\n{body.text}\n")
        declared = [variable.get("name") for variable in pou.iter(f"{space}variable")]
        texts = unit[: unit.rindex("END_VAR")]
        assert all(re.search(rf"\b{name}\b", texts) for name in declared)
        assert len(declared) == len(re.findall(r"^ +\w+ : |\bw\d+\b", texts, re.MULTILINE))
        names.append(str(name).lower())
    assert names == list(program("h4").units)
    for listed in root.iter(f"{space}dataType"):
        [dimension] = listed.iter(f"{space}dimension")
        size = program("h4").sizes[str(listed.get("name")).lower()]
        assert (dimension.get("lower"), dimension.get("upper")) == ("0", str(size - 1))


def of_graph(output: ca.SX, **inputs: ca.SX) -> Program:
    """A function f of scalars, each an array of one entry."""
    arrays = [Array(name, symbol) for name, symbol in inputs.items()]
    lines, slots, _ = body(arrays, "out", output, StructuredText(DOUBLE, "rob"))
    whole = [
        "FUNCTION f : INT", "VAR_INPUT", *(f"{x} : ARRAY [0..0] OF LREAL;" for x in inputs),
        "END_VAR", "VAR_OUTPUT", f"out : ARRAY [0..{output.numel() - 1}] OF LREAL;", "END_VAR",
        "VAR", f"{', '.join(slots)} : LREAL;", "END_VAR", *lines, "END_FUNCTION",
    ]  # fmt: skip
    return Program(text("clavel-delta3").partition("(* q(z). *)")[0] + "\n".join(whole))


def test_every_operation_of_a_kernel_that_structured_text_has() -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    unary = [ca.sin, ca.cos, ca.asin, ca.acos, ca.atan, ca.exp, ca.log, ca.sqrt, ca.fabs, ca.sign]
    binary = [ca.atan2, ca.power, ca.fmin, ca.fmax, ca.copysign, ca.logic_and, ca.logic_or]
    binary += [ca.lt, ca.le, ca.eq, ca.ne]
    values = [f(a) for f in unary] + [f(a, b) for f in binary]
    values += [ca.if_else(a > b, a, b), 1 / a, -a, a * a, a + a, a**2.5, a**3, a / b]
    values.append(ca.logic_not(b))
    output = ca.vertcat(*values)
    run, function = of_graph(output, a=a, b=b), ca.Function("f", [a, b], [output])
    for x, y in ([0.3, 0.7], [0.7, 0.3], [0.25, 0.25], [0.5, -0.4]):
        expected = np.array(function(x, y)).ravel()
        found_values = run.call("f", a=[x], b=[y])[1]["out"]
        np.testing.assert_allclose(found_values, expected, rtol=1e-15)
    with pytest.raises(DeltaidError, match="no function for CasADi's"):
        of_graph(ca.erf(a), a=a)


def test_what_is_not_chosen_stops_nothing() -> None:
    """Both sides of a choice are computed; the one that is left is there because it cannot be."""
    a = ca.SX.sym("a")
    output = ca.vertcat(ca.if_else(a > 0, ca.sqrt(a) / a, 1 - a), ca.if_else(a > 0, a, -a))
    run = of_graph(output, a=a)
    for x in (0.0, -4.0, 4.0):
        expected = [x**-0.5, x] if x > 0 else [1 - x, -x]
        assert run.call("f", a=[x])[1]["out"] == pytest.approx(expected)


@pytest.mark.parametrize("prefix", ["", "3d", "a b", "_x", "x_", "a__b", "a" * 21])
def test_names_that_structured_text_cannot_have(prefix: str) -> None:
    with pytest.raises(DeltaidError, match="cannot begin the names"):
        plc_program(subject("linear-delta"), prefix)


def test_a_title_cannot_end_the_comment() -> None:
    chosen = subject("linear-delta")
    robot = chosen.robot.model_copy(update={"title": "*) x := 1; (* ü ((*)"})
    Program(plc_program(Model(robot, chosen.p, "a.yaml"), "rob").text)  # which has no errors
