"""`deltaid reproduce irb360` over seeds and processors: what each model leaves of drive 4's torque.

    pip install -e '.[test]'
    python benchmarks/slow_drive4.py [--seeds N] [--quick]

Another seed is another motion and other noise; another kernel of OpenBLAS is another motion too,
since a search whose numbers are rounded otherwise ends elsewhere. Each kernel has a process of its
own, one after the other. Leaves `tables/slow_drive4.md`.
"""

import json
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import _alone  # noqa: F401
import numpy as np
from _table import STATED, leave
from _timing import options

from deltaid.reproduce.irb360 import (  # fmt: skip
    BASE,
    CHOSEN,
    GEOM,
    QUICK,
    RETUNED_4,
    SIMPLE,
    Irb360,
    reproduce_irb360,
)
from deltaid.reproduce.surrogate import RecordingSettings
from deltaid.reproduce.table_one import RMS_BASE, RMS_IDENTIFIED, RMS_RETUNED
from deltaid.robot.friction_terms import law_in_words

CORES = ("Prescott", "Haswell", "SkylakeX", "Zen", "Sapphirerapids")
NOISE = "noise alone"
# What is compared, in the words of the table, with what the paper has for it.
MODELS: dict[str, tuple[str, float | None]] = {
    BASE: ("base parameters", RMS_BASE[3]),
    GEOM: ("identified, viscous + Coulomb", RMS_IDENTIFIED[3]),
    RETUNED_4: ("drive 4 retuned by hand for the slow motion", RMS_RETUNED),
    CHOSEN: ("law chosen by the recording", None),
    NOISE: ("noise alone", None),
}
HEAD = (
    "drive 4 [N m]", "the paper, slow", *(f"slow: {core}" for core in CORES), "slow: all",
    "fast: all",
)  # fmt: skip
NOTE = """\
Root mean square of the residual of drive 4's torque on the slow and on the fast verification
motion: smallest to largest of {seeds} seeds of {example},
by kernel of OpenBLAS and over all {runs} runs; of the law that the recording chose also by seed.
Kernels whose columns are equal share their code.

The chosen law left less than retuning by hand in {better} of {runs} runs, {times} times what
viscous and Coulomb friction leave. It has a power of speed in {power} of them (exponent {exponent})
and a Stribeck term in {stribeck}. On stretches that the fit has not seen, all drives together,
viscous and Coulomb friction leave {plain} % of the largest torque (median {middle_plain} %)
and the chosen law {chosen} % (median {middle_chosen} %). Of the other three drives the consistent
fits leave at most {consistent} times the noise, base parameters at most {base} times. Drive 4's
largest speed and acceleration are {speed} °/s and {acceleration} °/s² to identify,
{slow_speed} °/s and {slow_acceleration} °/s² to verify."""


def run(settings: RecordingSettings) -> dict[str, Any]:
    result = reproduce_irb360(settings)
    chosen = result.models[CHOSEN]
    choice, law = chosen.friction_choice, chosen.robot.friction.get("drive4")
    assert choice is not None
    return {
        "slow": residuals(result, "slow"),
        "fast": residuals(result, "fast"),
        "base": others(result, BASE),
        "consistent": max(others(result, name) for name in (SIMPLE, GEOM, CHOSEN)),
        "law": law_in_words(law) if law else "",
        "exponent": law.power.exponent if law and law.power else None,
        "stribeck": bool(law and law.stribeck),
        "plain": 100 * choice.plain_error,
        "chosen": 100 * choice.chosen_error,
        "speeds": [*fastest(result, "identify"), *fastest(result, "slow")],
    }


def residuals(result: Irb360, motion: str) -> dict[str, float]:
    """What each model leaves of drive 4's torque [N m]."""
    rms = {name: float(result.tracks[motion].rms[name][3]) for name in MODELS if name != NOISE}
    return rms | {NOISE: float(result.tracks[motion].noise[3])}


def others(result: Irb360, name: str) -> float:
    """What a model leaves of the other drives' torques, in multiples of the noise, at most."""
    return max(
        float(np.max(track.rms[name][:3] / track.noise[:3])) for track in result.tracks.values()
    )


def fastest(result: Irb360, motion: str) -> tuple[float, float]:
    """Largest speed [°/s] and acceleration [°/s²] of drive 4 on a motion."""
    moved = result.runs[motion]
    z, zd, zdd = moved.evaluate(np.arange(0, moved.duration, 1 / result.settings.rate))
    _, qd, qdd = result.dynamics.kinematics.drive_motion(z, zd, zdd)
    return float(np.rad2deg(np.abs(qd[:, 3]).max())), float(np.rad2deg(np.abs(qdd[:, 3]).max()))


def on(core: str, seeds: Sequence[int]) -> list[dict[str, Any]]:
    """All runs of this command with a kernel of OpenBLAS, in a process of their own."""
    command = [sys.executable, __file__, *sys.argv[1:], "--runs"]
    environment = os.environ | {"OPENBLAS_CORETYPE": core}
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    found = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    for seed, run in zip(seeds, found, strict=True):
        rest = "other drives {consistent:.3g} and {base:.3g} times the noise".format(**run)
        unseen = "unseen stretches {plain:.2g} % and {chosen:.2g} %".format(**run)
        left = f"{run['slow'][CHOSEN]:.3g} N m"
        print(core, f"seed {seed}", left, run["law"], rest, unseen, sep="; ", flush=True)
    return found


def short(value: float, digits: int = 2) -> str:
    """A positive number with so many digits."""
    after = max(0, digits - 1 - math.floor(math.log10(value)))
    return f"{float(f'{value:.{digits}g}'):.{after}f}"


def span(values: Sequence[float], digits: int = 2) -> str:
    """Smallest to largest."""
    low, high = short(min(values), digits), short(max(values), digits)
    return low if low == high else f"{low} to {high}"


def rows(found: dict[str, list[dict[str, Any]]], seeds: Sequence[int]) -> list[list[str]]:
    every, table = [run for runs in found.values() for run in runs], []
    for name, (words, paper) in MODELS.items():
        own = [span([run["slow"][name] for run in runs]) for runs in found.values()]
        both = [span([run[motion][name] for run in every]) for motion in ("slow", "fast")]
        table.append([words, "–" if paper is None else f"{paper:.2f}", *own, *both])
        for k, seed in enumerate(seeds if name == CHOSEN else ()):
            slow, fast = ([runs[k][motion][name] for runs in found.values()]
                          for motion in ("slow", "fast"))  # fmt: skip
            singles = [span([run]) for run in slow]
            table.append([f"– seed {seed}", "", *singles, span(slow), span(fast)])
    return table


def note(every: list[dict[str, Any]], seeds: int, example: str) -> str:
    """What the runs have in common."""
    chosen, by_hand, plain = (
        np.array([run["slow"][name] for run in every]) for name in (CHOSEN, RETUNED_4, GEOM)
    )
    speed, acceleration, slow_speed, slow_acceleration = (
        span(values, 3) for values in zip(*(run["speeds"] for run in every), strict=True)
    )
    exponents = [run["exponent"] for run in every if run["exponent"] is not None]
    unseen = {law: [run[law] for run in every] for law in ("plain", "chosen")}
    spans = {law: span(errors) for law, errors in unseen.items()}
    middles = {f"middle_{law}": short(float(np.median(x))) for law, x in unseen.items()}
    most = {x: short(max(run[x] for run in every), 3) for x in ("consistent", "base")}
    return NOTE.format(
        seeds=seeds, runs=len(every), example=example, better=int(np.sum(chosen < by_hand)),
        times=span((chosen / plain).tolist()), power=len(exponents),
        exponent=span(exponents) if exponents else "–",
        stribeck=sum(run["stribeck"] for run in every), speed=speed, acceleration=acceleration,
        slow_speed=slow_speed, slow_acceleration=slow_acceleration, **spans, **middles, **most,
    )  # fmt: skip


def main() -> None:
    asked = options(__doc__, seeds=STATED["slow_drive4"]["seeds"], quick=False, runs=False)
    settings = QUICK if asked.quick else RecordingSettings()
    # Each start of a search has a seed of its own, from the run's seed on: no run has another's.
    seeds = range(0, asked.seeds * settings.starts, settings.starts)
    if asked.runs:
        for seed in seeds:
            print(json.dumps(run(replace(settings, seed=seed))), flush=True)
        return
    found = {core: on(core, seeds) for core in CORES}
    every = [run for runs in found.values() for run in runs]
    example = "the quick example" if asked.quick else "the full example, as it is without `--quick`"
    text, seconds = note(every, asked.seeds, example), int(settings.duration)
    leave(HEAD, rows(found, seeds), text, seeds=asked.seeds, seconds=seconds)


if __name__ == "__main__":
    main()
