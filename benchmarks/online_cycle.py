"""Microseconds of a cycle of the exported online function, contact included.

    python benchmarks/online_cycle.py [ROBOT …]

Each robot is identified from a simulated recording, because a prior has no contacts; the export is
compiled with `gcc -O2` and replays a second of picks, over and over, in one thread. The first
figure is the mean over all cycles in the best of many rounds, the second the slowest cycle at the
best it took in any round, so neither counts what the operating system does in between. Leaves
`tables/online_cycle.md`.
"""

import _alone  # noqa: F401
import casadi as ca
import numpy as np
from _c_program import printed
from _pick_robots import production_of
from _table import leave
from _timing import options

from deltaid.exports.c_code import c_code
from deltaid.exports.text import DOUBLE, SINGLE, Precision
from deltaid.model.model import Model
from deltaid.online.cycle import contact_of, step_graph
from deltaid.online.graph import StepGraph
from deltaid.online.settings import OnlineSettings
from support import along

CYCLES, ROUNDS = 1000, 100
ROBOTS = {"clavel-delta3": 1.0, "irb360-6-1600": 3.0, "par4": 2.0, "h4": 2.0}
HEAD = (
    "robot", "operations", "numbers of state", "double: mean [µs]", "slowest cycle [µs]",
    "single: mean [µs]", "slowest cycle [µs]",
)  # fmt: skip
NOTE = (
    """A cycle of `…_online` in C with payload, friction and contact, `gcc -O2`, processor time."""
)
MAIN = """
int main(void)
{{
    static r_online_inputs u[{cycles}];
    static double least[{cycles}];
    r_online_state state;
    r_online_outputs y;
    double best = 1e9, worst = 0, clock = clock_cost();
    int i, k, bad = 0;
    FILE *file = fopen("data", "rb");
    if (!file || fread(u, sizeof u, 1, file) != 1)
        return 1;
    for (i = 0; i < {cycles}; ++i)
        least[i] = 1e9;
    for (k = 0; k < {rounds}; ++k) {{
        double t = -now();
        r_online_start(&state);
        for (i = 0; i < {cycles}; ++i)
            bad += r_online(&state, &u[i], &y) != R_OK;
        t += now();
        if (t < best)
            best = t;
        r_online_start(&state);
        for (i = 0; i < {cycles}; ++i) {{
            t = -now();
            bad += r_online(&state, &u[i], &y) != R_OK;
            t += now() - clock;
            if (t < least[i])
                least[i] = t;
        }}
    }}
    for (i = 0; i < {cycles}; ++i)
        if (least[i] > worst)
            worst = least[i];
    printf("%g %g\\n", best / {cycles}, worst);
    return bad > 2 * {rounds}; /* a pose that is iterated may take a cycle to come from home */
}}
"""


def operations(graph: StepGraph) -> int:
    f, ends = graph.function, {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST}
    return sum(f.instruction_id(k) not in ends for k in range(f.n_instructions()))


def main() -> None:
    rows = []
    for name in options(__doc__, robots=list(ROBOTS)).robots:
        production = production_of(name, ROBOTS.get(name, 1.0), 1, 0, recording=10.0)
        model = production.models[0]
        graph = step_graph(model, OnlineSettings(), (contact_of,))
        inputs = picks(model)
        times = [t for precision in (DOUBLE, SINGLE) for t in in_c(model, inputs, precision)]
        shown = (f"{t:.2f}" for t in times)
        rows.append((name, f"{operations(graph):,}", graph.state.size, *shown))
    leave(HEAD, rows, NOTE)


def picks(model: Model) -> np.ndarray:
    """Inputs of a second in which a load is lifted and put down, a row a cycle."""
    dynamics, rng = model.dynamics, np.random.default_rng(0)
    z, q, qd, qdd = along(dynamics.kinematics, rng, 1e-3 * np.arange(CYCLES))
    heavier = model.with_load(np.array([0.5, *np.zeros(3), *np.full(3, 5e-4), *np.zeros(3)]))
    lifted = (np.arange(CYCLES) // 250) % 2 == 1
    parts = (dynamics.torque(z, qd, qdd, p) for p in (heavier.p, model.p))
    tau = np.where(lifted[:, None], *parts)
    return np.column_stack([q, qd, tau, lifted, np.full(CYCLES, -1.0)])


def in_c(model: Model, inputs: np.ndarray, precision: Precision) -> tuple[float, float]:
    code = c_code(model, "r", precision, ("online",))
    main = MAIN.format(cycles=CYCLES, rounds=ROUNDS)
    ((mean, slowest),) = printed(code, main, inputs, precision, "-O2")
    return mean, slowest


if __name__ == "__main__":
    main()
