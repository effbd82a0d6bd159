"""Structured text through a compiler: STruC++, where the command `strucpp` is, then g++.

It comes as a package of Node.js: https://github.com/Autonomy-Logic/STruCpp
"""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from deltaid.exports.structured_text import plc_program
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from exports import model, states, subject
from support import assert_close

STRUCPP = os.environ.get("DELTAID_STRUCPP") or shutil.which("strucpp")
MAIN = """
#include "rob.hpp"
#include <cstdio>
using namespace strucpp;
typedef Array1D<{real}, 0, {last}> V;
typedef Array1D<{real}, 0, {last2}> S;
static V read()
{{
    V v{{}};
    for (int i = 0; i <= {last}; ++i) {{
        double x;
        if (std::scanf("%lf", &x) != 1)
            return v;
        v[i] = ({number})x;
    }}
    return v;
}}
template <class T> static void print(const char *name, int status, T &v, int n, bool end = false)
{{
    std::printf("\\"%s\\": [%d", name, status);
    for (int i = 0; i < n; ++i)
        std::printf(", %.17g", (double)({number})v[i]);
    std::printf(end ? "]}}\\n" : "], ");
}}
int main()
{{
    V z = read(), q = read(), qd = read(), qdd = read(), near = read(), out{{}};
    S M{{}};
    int n = {last} + 1, status;
    std::printf("{{");
    status = (int)ROB_INVERSE_KINEMATICS(z, out);
    print("inverse_kinematics", status, out, n);
    status = (int)ROB_FORWARD_KINEMATICS(q{near}, out);
    print("forward_kinematics", status, out, n);
    status = (int)ROB_MASS_MATRIX(z, M);
    print("mass_matrix", status, M, n * n);
    status = (int)ROB_BIAS(z, qd, out);
    print("bias", status, out, n);
    status = (int)ROB_INVERSE_DYNAMICS_AT(z, qd, qdd, out);
    print("tau", status, out, n);
    status = (int)ROB_FORWARD_DYNAMICS(z, qd, out, out);
    print("forward_dynamics", status, out, n, true);
    return 0;
}}
"""


@pytest.mark.skipif(
    STRUCPP is None or shutil.which("g++") is None,
    reason="there is no strucpp (DELTAID_STRUCPP is its path), or no g++",
)
@pytest.mark.parametrize("precision", [DOUBLE, SINGLE], ids=["LREAL", "REAL"])
@pytest.mark.parametrize("name", ["clavel-delta3", "irb360-6-1600", "h4"])
def test_compiled(name: str, precision: Precision, tmp_path: Path) -> None:
    chosen, share = subject(name), 1e-12 if precision is DOUBLE else 1e-5
    text = plc_program(chosen, "rob", precision).text
    (tmp_path / "rob.st").write_text(text)
    command = ["node", STRUCPP] if str(STRUCPP).endswith(".js") else [STRUCPP]
    made = subprocess.run([*command, "rob.st", "-o", "rob.cpp"], cwd=tmp_path, capture_output=True)
    assert made.returncode == 0, made.stdout + made.stderr
    z, q, qd, qdd = (x[0] for x in states(chosen, 1))
    newton = chosen.dynamics.kinematics.mechanism.forward is None
    dof = chosen.dynamics.dof
    kinds = {"real": f"IEC_{precision.st_type}", "number": precision.c_type}
    sizes = {"last": dof - 1, "last2": dof * dof - 1, "near": ", near" if newton else ""}
    (tmp_path / "main.cpp").write_text(MAIN.format(**kinds, **sizes))
    headers = Path(str(STRUCPP)).resolve().parents[2] / "src" / "runtime" / "include"
    build = ["g++", "-std=c++17", f"-I{headers}", "rob.cpp", "main.cpp", "-o", "run"]
    done = subprocess.run(build, cwd=tmp_path, capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    numbers = "\n".join(repr(float(x)) for part in (z, q, qd, qdd, z + 0.003) for x in part)
    ran = subprocess.run([tmp_path / "run"], input=numbers, capture_output=True, encoding="utf-8")
    found = json.loads(ran.stdout)
    expected = model(chosen, z[None], qd[None], qdd[None])
    wanted = {
        "inverse_kinematics": q,
        "forward_kinematics": z,
        "mass_matrix": expected.M[0].ravel(),
        "bias": expected.bias[0],
        "tau": expected.tau[0],
        "forward_dynamics": qdd,
    }
    for function, value in wanted.items():
        status, *entries = found[function]
        assert status == 0, function
        wider = 10 if function == "forward_dynamics" and precision is DOUBLE else 1
        assert_close(np.array(entries), value, wider * share)
