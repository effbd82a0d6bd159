"""C programs that time an export: what they share, and how they are built and run."""

import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from deltaid.exports.text import DOUBLE, Export, Precision

# Processor time [µs], and what reading it takes.
_HEAD = """
#define _POSIX_C_SOURCE 200809L
#include "r.h"
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}
static double clock_cost(void)
{
    double least = 1e9;
    int i;
    for (i = 0; i < 10000; ++i) {
        const double t = -now(), d = t + now();
        if (d < least)
            least = d;
    }
    return least;
}
"""


def printed(
    code: Export, main: str, data: np.ndarray, precision: Precision, *options: str
) -> list[list[float]]:
    """Numbers that a program prints, line by line.

    Args:
        code: an export called `r`.
        main: the rest of the program; has `now()` and `clock_cost()`, and reads the file `data`.
        options: of the compiler.
    """
    compiler = shutil.which("gcc") or shutil.which("cc") or "cc"
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        (work / "r.h").write_text(code.text(".h"))
        (work / "r.c").write_text(code.text(".c"))
        (work / "main.c").write_text(_HEAD + main)
        data.astype(np.float64 if precision is DOUBLE else np.float32).tofile(work / "data")
        command = [compiler, "-std=c99", *options, "r.c", "main.c", "-o", "run", "-lm"]
        subprocess.run(command, cwd=work, check=True)
        done = subprocess.run([work / "run"], cwd=work, capture_output=True, check=True)
    return [list(map(float, line.split())) for line in done.stdout.decode().splitlines()]
