"""`deltaid sample`: consistent models drawn from what a recording left open."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from deltaid.cli.options import AsJson, Full, UsePoor, bounded
from deltaid.cli.output import (
    print_json,
    print_written,
    progress,
    used,
)
from deltaid.cli.screen import print_found
from deltaid.errors import DeltaidError
from deltaid.files import require_new_folder, require_writable
from deltaid.model.options import SAMPLES_LIMITS, TOLERANCE_LIMITS

if TYPE_CHECKING:
    from deltaid.model.samples import Samples

Form = Literal["npz", "mjcf"]


def sample(
    model: Annotated[str, typer.Argument(help="A model saved by `deltaid identify`.")],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="File (.npz) or new folder (mjcf).", metavar="PATH"),
    ],
    n: Annotated[
        int, bounded("-n", "--number", help="How many models.", limits=SAMPLES_LIMITS)
    ] = 1000,
    seed: Annotated[
        int, bounded(help="The same one gives the same models.", limits=(0.0, 2.0**63))
    ] = 0,
    to: Annotated[
        Form, typer.Option(help="npz: all parameters in one file; mjcf: a file a model.")
    ] = "npz",
    limb_tolerance: Annotated[
        float,
        bounded(
            help="Scatter of masses from limb to limb, as a share (one sigma).",
            limits=TOLERANCE_LIMITS,
        ),
    ] = 0.0,
    force: UsePoor = False,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Draw consistent models from the posterior.

    They are what data, prior and physical consistency allow together.

    docs/posterior.md says what they are for: Monte Carlo of whatever follows from a model, and
    domain randomisation that no recording contradicts.
    """
    from deltaid.model.model import load
    from deltaid.view.models import sample_sentence, sample_table

    if to == "npz" and output.suffix.lower() != ".npz":
        raise DeltaidError("must end in .npz for --to npz", where=str(output))
    if to == "npz":
        require_writable(output, [Path(model)])
    else:
        require_new_folder(output)
    known = load(model)
    with used(known, force=force), progress(as_json) as say:
        say("drawing models")
        drawn = known.sample(n, seed, limb_tolerance)
        say(f"writing {output}")
        written = drawn.save(output) if to == "npz" else drawn.mjcf(output)
    if as_json:
        print_json(as_dictionary(drawn, written))
        return
    print_found([sample_sentence(drawn)], [sample_table(drawn)], full=full)
    print_written(written)


def as_dictionary(drawn: "Samples", written: Path) -> dict[str, Any]:
    """What was drawn as one JSON object."""
    return {
        "robot": drawn.robot.name,
        "models": len(drawn),
        "seed": drawn.seed,
        "limb_tolerance": drawn.limb_tolerance,
        "effective_size": float(drawn.ess.min()),
        "rhat": float(drawn.rhat.max()),
        "output": str(written),
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "mean": float(column.mean()),
                "std": float(column.std()),
                "effective_size": float(size),
                "rhat": float(factor),
            }
            for name, unit, column, size, factor in zip(
                drawn.names, drawn.units, drawn.p.T, drawn.ess, drawn.rhat, strict=True
            )
        ],
    }
