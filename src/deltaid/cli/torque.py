"""`deltaid torque`: the torques a model predicts along a recording."""

from pathlib import Path
from typing import Annotated

import typer

from deltaid.cli.options import Columns, ModelOrRobot, UsePoor, output_file
from deltaid.cli.output import console, print_warnings, progress, require_outputs, used
from deltaid.files import written_whole


def torque(
    model: ModelOrRobot,
    log: Annotated[Path, typer.Argument(help="A recording or a planned motion, of any kind.")],
    output: Annotated[Path, output_file("--output", "-o", help="CSV file to write.")],
    columns: Columns = None,
    force: UsePoor = False,
) -> None:
    """Write the drive torques that a model predicts: columns t, tau1, tau2, … in s and N m (N).

    Where the identification found gains of the drives, these are the torques that the drives must
    be commanded for what the joints need; all other numbers of a model are torques at the joints.
    Without recorded velocities and accelerations the positions are filtered and differentiated,
    and as many rows as the filter is long are missing at either end.
    """
    from deltaid.identification.loads import as_known
    from deltaid.identification.sources import model_filtered
    from deltaid.identification.torque_error import predict, prediction_csv
    from deltaid.model.model import load
    from deltaid.recording.mapping import as_mapping
    from deltaid.recording.opening import open_log

    require_outputs((model, log, columns), {"--output": output})
    known = load(model)
    dynamics = known.dynamics
    mapping = as_mapping(columns)
    rows = 0
    with used(known, force=force), progress(False) as say:
        say(f"checking {log}")
        surveyed = open_log(log, dynamics.kinematics, mapping, need_torque=False)
        recording = as_known(model_filtered(known, surveyed), known)
        print_warnings([f"{log}: {text}" for text in recording.log.warnings])
        say(f"predicting torques along {log}")
        with written_whole(output) as file:
            for part in predict(dynamics, known.p, recording):
                file.write(prediction_csv(part, known.gains, header=rows == 0))
                rows += len(part.time)
    cutoff = recording.motion_cutoff
    filtered = f", positions low-passed at {cutoff:.3g} Hz" if cutoff else ""
    console.print(f"wrote {rows} of {surveyed.samples} samples to {output}{filtered}")
