"""Structured text through MATIEC, the compiler of OpenPLC and Beremiz, then a C compiler, and run.

    python benchmarks/st_matiec.py PATH/OF/matiec [--single] [ROBOT …]

PATH is the folder with `iec2c` and `lib` (https://github.com/beremiz/matiec). Of every robot of the
catalogue all functions and blocks, those of choice too, in LREAL or REAL, with MATIEC's strict
rules (no option). The C that it makes runs functions and the block at random states; figures are
the largest difference from Python, as a share of the largest entry of a result, with REAL given the
same floats.
"""

import argparse
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import casadi as ca
import numpy as np

from deltaid.exports.model_functions import DEFAULT, online_cycle
from deltaid.exports.options import FURTHER
from deltaid.exports.st_units import Unit
from deltaid.exports.structured_text import plc_program
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.joint_forces.constraint_forces import ConstraintForces
from deltaid.model.model import Model, load
from deltaid.robot.load import catalogue

STATES = 20
# Largest differences that count as equal, and those of functions that solve for accelerations.
EQUAL = {"LREAL": 1e-12, "REAL": 1e-5}
# Arrays by their names, one state after the other: what a function reads and writes.
Arrays = Mapping[str, np.ndarray]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("matiec", type=Path)
    parser.add_argument("robots", nargs="*", default=list(catalogue()))
    parser.add_argument("--single", action="store_true")
    given = parser.parse_args()
    precision = SINGLE if given.single else DOUBLE
    for name in given.robots:
        print(name, precision.st_type, flush=True)
        compare(load(name), precision, given.matiec.resolve())


def compare(model: Model, precision: Precision, matiec: Path) -> None:
    """Every function of a model against the package; prints, and stops where they differ."""
    if precision is SINGLE:
        model = Model(model.robot, np.float32(model.p).astype(float), model.source)
    program = plc_program(model, "rob", precision, FURTHER)
    units = {unit.name.removeprefix("rob_"): unit for unit in program.units}
    cases = dict(expected(model, precision))
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "rob.st").write_text(program.text)
        run([matiec / "iec2c", "-I", matiec / "lib", "rob.st"], place)
        (place / "main.c").write_text(_main([units[name] for name in cases], precision))
        library = matiec / "lib" / "C"
        run(["gcc", "-w", "-O1", "-I", library, "main.c", "-o", "main", "-lm"], place)
        for number, (name, (inputs, outputs)) in enumerate(cases.items()):
            unit = units[name]
            rows = np.hstack([inputs[v.name] for v in unit.inputs if v.name in inputs])
            text = "\n".join(" ".join(map(repr, row)) for row in rows.tolist())
            done = run([place / "main", str(number), str(len(rows))], place, text)
            found = np.array([line.split() for line in done.splitlines()], dtype=float)
            if found[:, 0].any():
                raise SystemExit(f"  {name}: status {found[:, 0].max():g}")
            wanted = np.hstack([outputs[v.name] for v in unit.outputs if v.name in outputs])
            largest = np.abs(wanted).max(axis=1, keepdims=True)
            error = float(np.max(np.abs(found[:, 1:] - wanted) / largest))
            wider = 10 if name in ("forward_dynamics", "online_step") else 1
            print(f"  {name}: {error:.1e}", flush=True)
            if not error <= wider * EQUAL[precision.st_type]:
                raise SystemExit("  differs")


def expected(model: Model, precision: Precision) -> list[tuple[str, tuple[Arrays, Arrays]]]:
    """Names of units with states that they are called with, and what the package says there."""
    dynamics, kinematics, p = model.dynamics, model.dynamics.kinematics, model.p
    rng = np.random.default_rng(0)
    centre, half = model.robot.workspace.inner_box
    turn = model.robot.turn
    way = np.linspace(0, 1, STATES)[:, None]  # from home, as a pose is kept from call to call
    end = np.append(centre + 0.5 * half, 0.5 * turn.high * np.ones(kinematics.dof - 3))
    z = _rounded(model.home + way * (end - model.home), precision)
    q = kinematics.inverse(z)
    qd, qdd = _rounded(rng.standard_normal((2, *z.shape)) * [[[2.0]], [[10.0]]], precision)
    tau = dynamics.torque(z, qd, qdd, p)
    start = z + 0.003
    joints, forces = kinematics.passive_joints(z, qd), ConstraintForces(model.robot)
    terms = dynamics.equations
    equations = ca.Function(
        "f",
        [terms.z, terms.qd, terms.p],
        [terms.C @ terms.qd + terms.g + terms.f, ca.vec(terms.M.T), terms.g],
    )
    h, M, g = (
        np.hstack([np.array(x) for x in part]).T
        for part in zip(*(equations(*row, p) for row in zip(z, qd, strict=True)), strict=True)
    )
    Y = dynamics.regressor(q, qd, qdd, dynamics.carried(z, qd, qdd, p))
    moving = {"z": z, "qd": qd}
    cases: list[tuple[str, tuple[Arrays, Arrays]]] = [
        ("inverse_kinematics", ({"z": z}, {"q": q})),
        ("forward_kinematics", ({"q": q, "z_start": start}, {"z": z})),
        ("inverse_dynamics_at", (moving | {"qdd": qdd}, {"tau": tau})),
        ("forward_dynamics", (moving | {"tau": tau}, {"qdd": qdd})),
        ("jacobian", ({"z": z}, {"J": kinematics.jacobian(z).reshape(STATES, -1)})),
        ("mass_matrix", ({"z": z}, {"M": M})),
        ("bias", (moving, {"h": h})),
        ("gravity", ({"z": z}, {"g": g})),
        ("inverse_dynamics", ({"q": q, "qd": qd, "qdd": qdd}, {"tau": tau, "z": z})),
        ("constraint_forces", (moving | {"qdd": qdd}, {"F": forces.evaluate(z, qd, qdd, p)})),
        ("passive_joints", (moving, {"x": joints.position, "xd": joints.velocity})),
        ("regressor", (moving | {"qdd": qdd}, {"Y": Y.reshape(STATES, -1)})),
    ]
    if precision is DOUBLE:  # of one cycle more than a float's digits are lost
        cycle = online_cycle(model, DEFAULT)
        cases.append((f"{cycle.name}_step", _cycle(cycle.graph, q, tau)))
    return cases


def _rounded(x: np.ndarray, precision: Precision) -> np.ndarray:
    return x.astype(np.float32).astype(float) if precision is SINGLE else x


def _cycle(graph, q: np.ndarray, tau: np.ndarray) -> tuple[Arrays, Arrays]:
    """Steps of a cycle one after the other, by CasADi."""
    step = ca.Function("step", [graph.x, graph.u], [graph.following, graph.y])
    state, rows = graph.state.initial, []
    for k in range(len(q)):
        u = np.zeros(graph.inputs.size)
        for name, value in (("q", q[k]), ("tau", tau[k])):
            u[graph.inputs.places[name]] = value
        after, y = (np.array(x).ravel() for x in step(state, u))
        rows.append((state, u, after, y))
        state = after
    x, u, after, y = map(np.array, zip(*rows, strict=True))
    return {"x": x, "u": u}, {"after": after, "y": y}


def _main(units: Sequence[Unit], precision: Precision) -> str:
    """A C program: the number of a unit and of states; inputs come in, status and outputs go."""
    branches = []
    for number, unit in enumerate(units):
        block = unit.kind == "FUNCTION_BLOCK"
        name, lines = unit.name.upper(), list[str]()
        size = {v.name: v.size for v in (*unit.inputs, *unit.outputs) if v.size}
        if block:
            lines.append(f"static {name} b; if (k == 0) {name}_init__(&b, 0);")
        for v in unit.inputs:
            place = f"b.{v.name.upper()}.value" if block else f"in_{v.name}"
            lines.append("" if block else f"__ARRAY_OF_{precision.st_type}_{size[v.name]} {place};")
            lines.append(f"read({place}.table, {size[v.name]});")
        outputs = [v for v in unit.outputs if v.size]
        if block:
            lines.append(f"{name}_body__(&b); status = b.STATUS.value;")
        else:
            types = (f"__ARRAY_OF_{precision.st_type}_{size[v.name]}" for v in outputs)
            lines += [f"{t} out_{v.name};" for t, v in zip(types, outputs, strict=True)]
            passed = [f"&in_{v.name}" for v in unit.inputs] + [f"&out_{v.name}" for v in outputs]
            lines.append(f"status = {name}(1, NULL, {', '.join(passed)});")
        lines.append('printf("%d", status);')
        for v in outputs:
            place = f"b.{v.name.upper()}.value" if block else f"out_{v.name}"
            lines.append(f"print({place}.table, {size[v.name]});")
        branches.append("\n".join([f"case {number}: {{", *lines, "break; }"]))
    real = precision.st_type
    return f"""
#include <stdio.h>
#include <stdlib.h>
#include "POUS.h"
#include "POUS.c"
TIME __CURRENT_TIME; BOOL __DEBUG;
static void read({real} *x, int n)
{{
    double v;
    for (int i = 0; i < n; ++i) {{ if (scanf("%lf", &v) != 1) exit(1); x[i] = ({real})v; }}
}}
static void print(const {real} *x, int n)
{{
    for (int i = 0; i < n; ++i) printf(" %.17g", (double)x[i]);
}}
int main(int count, char **words)
{{
    int status = 0;
    for (int k = 0; k < atoi(words[2]); ++k) {{
        switch (atoi(words[1])) {{
        {"".join(branches)}
        }}
        puts("");
    }}
    return 0;
}}
"""


def run(command: Sequence[str | Path], place: Path, text: str = "") -> str:
    """What a program prints; its complaint where it fails."""
    done = subprocess.run(command, cwd=place, input=text, capture_output=True, encoding="utf-8")
    if done.returncode:
        raise SystemExit(f"{command[0]} failed:\n{(done.stdout + done.stderr)[:2000]}")
    return done.stdout


if __name__ == "__main__":
    main()
