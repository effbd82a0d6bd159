"""`deltaid torque`: the torques a model predicts along a recording."""

from pathlib import Path
from typing import Annotated

import typer

from deltaid.cli.options import Columns, ModelOrRobot, UsePoor, output_file
from deltaid.cli.output import console, print_warnings, progress, require_outputs, used


def torque(
    model: ModelOrRobot,
    log: Annotated[Path, typer.Argument(help="A recording or a planned motion, of any kind.")],
    output: Annotated[Path, output_file("--output", "-o", help="CSV file to write.")],
    columns: Columns = None,
    periodic: Annotated[
        bool, typer.Option("--periodic", help="The motion goes on as it begins.")
    ] = False,
    force: UsePoor = False,
) -> None:
    """Write the drive torques that a model predicts.

    Columns t, tau1, tau2, … in s and N m (N).

    Where the identification found gains of the drives, these are the torques that the drives must
    be commanded for what the joints need; all other numbers of a model are torques at the joints.
    Without velocities and accelerations the positions are filtered and differentiated. A motion
    that rests at an end, or is --periodic, has torques in every row; at an end that moves, as many
    rows as the filter is long are written without.
    """
    from deltaid.identification.prediction import torque as run
    from deltaid.model.model import load

    require_outputs((model, log, columns), {"--output": output})
    known = load(model)
    with used(known, force=force), progress(False) as say:
        result = run(known, log, columns=columns, periodic=periodic, progress=say)
        print_warnings(result.warnings)
        say(f"predicting torques along {log}")
        result.save(output)
    cutoff = result.recording.motion_cutoff
    filtered = f", positions low-passed at {cutoff:.3g} Hz" if cutoff else ""
    samples = result.recording.log.samples
    console.print(f"wrote {result.rows} of {samples} samples to {output}{filtered}")
