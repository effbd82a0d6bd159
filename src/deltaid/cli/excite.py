"""`deltaid excite`: a motion that makes parameters identifiable within the machine's limits."""

from collections.abc import Generator
from contextlib import contextmanager
from itertools import groupby
from pathlib import Path
from threading import Event
from typing import Annotated, Any

import typer

import deltaid
from deltaid.cli.options import (
    CSV,
    AsJson,
    Full,
    Report,
    Robot,
    UsePoor,
    bounded,
    output_file,
    require_outputs,
)
from deltaid.cli.output import (
    note_planned,
    print_outcome,
    progress,
    used,
    write_files,
)
from deltaid.errors import DeltaidError, counted, within
from deltaid.files import handling_signals, write_bytes
from deltaid.motion.excitation.settings import (
    VERIFICATION_OFFSET,
    CriterionName,
    ExcitationSettings,
    PurposeName,
)
from deltaid.view.numbers import number

# Values of each start of the search, for JSON.
_ACCOUNT = (
    "seed", "before", "after", "feasible", "evaluations", "seconds", "message", "judged"
)  # fmt: skip


def excite(
    robot: Robot,
    output: Annotated[
        Path | None,
        output_file("--output", "-o", help="CSV file to write, with the motion.", endings=CSV),
    ] = None,
    verify_out: Annotated[
        Path | None,
        output_file(
            help="CSV file to write, with a second motion to verify the model.", endings=CSV
        ),
    ] = None,
    criterion: Annotated[
        CriterionName, typer.Option(help="Optimality criterion.")
    ] = ExcitationSettings.criterion,
    by: Annotated[
        PurposeName,
        typer.Option(
            "--for",
            help="Measurements to plan for: torques, or also the sensors of the description.",
        ),
    ] = ExcitationSettings.by,
    weigh_prior: Annotated[
        bool,
        typer.Option("--weigh-prior", help="Weight parameters by the uncertainty of their priors."),
    ] = ExcitationSettings.weigh_prior,
    duration: Annotated[
        float,
        bounded(help="Approximate duration without the ramps, s.", limits=(0.1, 3600.0)),
    ] = ExcitationSettings.duration,
    harmonics: Annotated[
        int, typer.Option(help="Number of harmonics of the Fourier series.", min=1, max=20)
    ] = ExcitationSettings.harmonics,
    repeats: Annotated[
        int, typer.Option(help="Number of repetitions of the motion.", min=1, max=1000)
    ] = ExcitationSettings.repeats,
    velocity_weight: Annotated[
        float, typer.Option(help="Weight of speeds in the criterion.", min=0, max=1e6)
    ] = ExcitationSettings.velocity_weight,
    torque_noise: Annotated[
        float,
        bounded(
            help="Torque noise of the prediction, share of the largest torque.",
            limits=(1e-9, 10.0),
        ),
    ] = ExcitationSettings.torque_noise,
    rate: Annotated[
        float, bounded(help="Sampling rate of the file, Hz.", limits=(1.0, 1e5))
    ] = ExcitationSettings.rate,
    starts: Annotated[
        int, typer.Option(help="Number of starts of the search.", min=1, max=1000)
    ] = ExcitationSettings.starts,
    seed: Annotated[
        int, typer.Option(help="Seed of the search; the same seed gives the same motion.", min=0)
    ] = ExcitationSettings.seed,
    plot: Annotated[
        Path | None, output_file(help="Picture of the motion to write (.png or .svg).")
    ] = None,
    report: Report = None,
    full: Full = False,
    as_json: AsJson = False,
    force: UsePoor = False,
) -> None:
    """Optimise a motion for identification.

    The motion is at rest at both ends and stays within all limits.

    Ctrl-C ends the search and keeps the best feasible motion so far.
    """
    from deltaid.motion.excitation.plot import plot_run, require_matplotlib
    from deltaid.motion.excitation.run import LONGEST, MOST_ROWS
    from deltaid.view import excitation as view

    within("--duration times --repeats", duration * repeats, (0.0, LONGEST))
    within("rows (duration, repeats, rate)", duration * repeats * rate, (0.0, MOST_ROWS))
    picture = plot.suffix.lower().lstrip(".") if plot else ""
    if plot and picture not in ("png", "svg"):
        raise DeltaidError("must end in .png or .svg", where=f"--plot {plot}")
    if plot:
        require_matplotlib()
    settings = ExcitationSettings(
        criterion=criterion,
        harmonics=harmonics,
        duration=duration,
        repeats=repeats,
        velocity_weight=velocity_weight,
        weigh_prior=weigh_prior,
        torque_noise=torque_noise,
        rate=rate,
        starts=starts,
        seed=seed,
        by=by,
    )
    asked = {"--output": output, "--verify-out": verify_out, "--plot": plot, "--report": report}
    require_outputs([robot], asked)
    model = deltaid.load(robot)
    note_planned(model)
    with (
        used(model, force=force, as_prior=False),
        progress(as_json) as say,
        _stop_on_interrupt() as stop,
    ):
        say("preparing the robot")
        exciter = deltaid.Exciter(model, settings)
        say(f"optimising from {starts} starts, Ctrl-C keeps the best so far")
        result = exciter.optimise(
            stop, lambda done: say(f"start {done.seed}: {done.before:.3f} → {done.after:.3f}")
        )
        second = result  # unless another one is requested
        if verify_out is not None:
            say("optimising the verification motion")
            second = exciter.optimise(stop, offset=VERIFICATION_OFFSET)
    write_files(
        (output, result.save),
        (verify_out, second.save),
        (plot, lambda path: write_bytes(path, plot_run(exciter, result.run, picture))),
        (report, result.report),
    )
    exciter, run = result.exciter, result.run
    described = exciter.dynamics.robot
    units = described.drive_units.values()
    efforts = " and ".join(dict.fromkeys(f"{u.effort}s" for u in units))
    each = groupby(zip(result.torque_max, units, strict=True), key=lambda pair: pair[1].force)
    largest = ", ".join(
        f"{', '.join(f'{value:.3g}' for value, _ in group)} {unit}" for unit, group in each
    )
    print_outcome(
        as_json,
        _as_dictionary(result),
        [
            described.label,
            view.verdict(result).sentence,
            f"{exciter.settings.criterion} {number(result.criterion_before)} before, "
            f"{number(result.criterion_after)} after; "
            f"{counted(run.repeats, 'period')} of {run.motion.period:.3g} s between ramps "
            f"of {run.ramp:.3g} s, {run.duration:.4g} s in all",
            f"largest {efforts} at the prior: {largest}",
        ],
        [view.prediction_table(result)],
        [view.limit_table(result), view.start_table(result)],
        full=full,
        files=tuple(asked.values()),
    )


@contextmanager
def _stop_on_interrupt() -> Generator[Event, None, None]:
    """An event that Ctrl-C sets; a second Ctrl-C interrupts as usual."""
    stop = Event()

    def on_interrupt(number: int, frame: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    with handling_signals(on_interrupt, "SIGINT"):
        yield stop


def _as_dictionary(result: "deltaid.Excitation") -> dict[str, Any]:
    exciter, run, motion = result.exciter, result.run, result.run.motion
    return {
        "robot": exciter.dynamics.robot.name,
        "criterion": exciter.settings.criterion,
        "criterion_before": result.criterion_before,
        "criterion_after": result.criterion_after,
        "duration": run.duration,
        "period": motion.period,
        "ramp": run.ramp,
        "periods": run.repeats,
        "base_frequency": motion.base_frequency,
        "centre": motion.centre,
        "sine": motion.sine,
        "cosine": motion.cosine,
        "limits": {limit.name: limit.share for limit in result.limits},
        "torque_max": result.torque_max,
        "predictions": [
            {
                "parameter": p.formula,
                "prior": p.value,
                "prior_std": p.prior_std,
                "std": p.std,
                "unit": p.unit,
            }
            for p in result.predictions
        ],
        "starts": [
            {key: getattr(account, key) for key in _ACCOUNT} for account in result.optimum.accounts
        ],
    }
