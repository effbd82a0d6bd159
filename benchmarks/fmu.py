"""Processor time of a unit in co-simulation, without what an importing tool adds.

    pip install -e '.[test]'
    python benchmarks/fmu.py [ROBOT …]

A C program has the unit's sources in it and calls `fmi2SetReal`, `fmi2DoStep` (1 ms) and
`fmi2GetReal` as an importing tool does, with torques that swing the drives through rest; seconds of
processor time for a second of simulation, the best of twenty, compiled with -O1 as the units are.
"""

import io
import re
import shutil
import subprocess
import tempfile
import zipfile
from pathlib import Path

import numpy as np
from _timing import machine, options

from deltaid.exports.fmu import fmu
from deltaid.exports.fmu_binaries import own_compiler
from deltaid.model.model import load

ROBOTS = ["irb360-6-1600", "clavel-delta3", "h4", "par4-linear"]
MAIN = """
#define _POSIX_C_SOURCE 200809L
#include "fmi2.c"
#include <stdio.h>
#include <time.h>
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
int main(void)
{
    const double held[DOF] = {HELD}, swing[DOF] = {SWING};
    const Callbacks callbacks = {0, calloc, free, 0, 0};
    double tau[DOF], out[DOF], best = 1e9;
    unsigned inputs[DOF], outputs[DOF];
    int i, k, round, rests = 0;
    for (i = 0; i < DOF; ++i) {
        inputs[i] = TAU + i;
        outputs[i] = QD + i;
    }
    for (round = 0; round < 20; ++round) {
        Component c = fmi2Instantiate("unit", 1, "TOKEN", "", &callbacks, 0, 0);
        double t;
        if (!c || fmi2ExitInitializationMode(c) != OK)
            return 1;
        t = -now();
        for (k = 0; k < 1000; ++k) {
            for (i = 0; i < DOF; ++i)
                tau[i] = held[i] + swing[i] * sin(0.04 * k + i);
            if (fmi2SetReal(c, inputs, DOF, tau) != OK || fmi2DoStep(c, 1e-3 * k, 1e-3, 1) != OK
                || fmi2GetReal(c, outputs, DOF, out) != OK)
                return 2;
            rests += fabs(out[0]) < 1e-9;
        }
        t += now();
        if (t < best)
            best = t;
        fmi2FreeInstance(c);
    }
    printf("%.9g %d\\n", best, rests / 20);
    return 0;
}
"""


def seconds(name: str) -> tuple[float, int]:
    """Of processor time for one of simulation, and at how many of its samples drive 1 rests."""
    model, compiler = load(name), own_compiler()
    unit = fmu(model, "unit", forward=True, compiler=compiler)
    home = np.asarray(model.dynamics.kinematics.inverse(model.home[None]))
    held = model.dynamics.inverse_dynamics(home, 0 * home, 0 * home)[0]
    swing = 2.0 * np.array([max(model.value(f"coulomb.{d}"), 0.1) for d in model.robot.drives])
    with tempfile.TemporaryDirectory() as folder:
        with zipfile.ZipFile(io.BytesIO(unit.parts[".fmu"])) as archive:
            archive.extractall(folder)
        work = Path(folder) / "sources"
        token = re.search(r'strcmp\(guid, "([^"]+)"', (work / "fmi2.c").read_text())
        main = MAIN.replace("TOKEN", token[1] if token else "")
        main = main.replace("HELD", ", ".join(map(repr, held.tolist())))
        (work / "main.c").write_text(main.replace("SWING", ", ".join(map(repr, swing.tolist()))))
        command = [shutil.which("gcc") or "cc", "-std=c99", "-O1", "-ffp-contract=off"]
        subprocess.run([*command, "main.c", "unit.c", "-o", "run", "-lm"], cwd=work, check=True)
        fields = subprocess.run([work / "run"], capture_output=True, check=True).stdout.split()
    return float(fields[0]), int(fields[1])


def main() -> None:
    robots = options(__doc__, robots=ROBOTS).robots
    print(machine(), "\n")
    print(f"{'seconds a second':<18}{'co-simulation':>15}{'drive 1 rests':>15}")
    for name in robots:
        time, rests = seconds(name)
        print(f"{name:<18}{time:>15.4f}{f'{rests / 10:.0f} %':>15}")


if __name__ == "__main__":
    main()
