"""`deltaid calibrate`: the geometry of a Delta from measured poses, and what they cannot know."""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.cli.options import AsJson, Report, Robot, bounded, output_file
from deltaid.cli.output import (
    console,
    print_json,
    print_verdict,
    print_written,
    progress,
    require_outputs,
    shown,
)

if TYPE_CHECKING:
    from deltaid.calibration.calibrate import Calibration
    from deltaid.calibration.next_readings import NextReadings

# Directions that readings do not know and that a screen shows.
_SHOWN = 3


def calibrate(
    robot: Robot,
    points: Annotated[
        list[Path] | None,
        typer.Option(help="3-D points of a tracker or camera, in any frame; may be repeated."),
    ] = None,
    probe: Annotated[
        list[Path] | None,
        typer.Option(help="Touches of a plane, bare or on gauge blocks; may be repeated."),
    ] = None,
    distances: Annotated[
        list[Path] | None,
        typer.Option(help="Distances between two poses, by calliper or ballbar; repeatable."),
    ] = None,
    columns: Annotated[
        Path | None, typer.Option(help="Columns, units and noise of the files (YAML).")
    ] = None,
    output: Annotated[
        Path | None, output_file("--output", "-o", help="Robot file with this geometry (YAML).")
    ] = None,
    klipper: Annotated[
        Path | None, output_file(help="Lines of a printer.cfg with this geometry.")
    ] = None,
    marlin: Annotated[Path | None, output_file(help="M665 and M666 of Marlin.")] = None,
    reprap: Annotated[Path | None, output_file(help="M665 and M666 of RepRapFirmware.")] = None,
    lengths: Annotated[
        float | None,
        bounded(
            help="How far lengths may be off, m. Default: the robot's tolerances, or 0.001.",
            limits=(1e-7, 0.1),
        ),
    ] = None,
    angles: Annotated[
        float | None,
        bounded(
            help="How far angles may be off, rad. Default: the tolerance, or 0.001.",
            limits=(1e-7, 0.3),
        ),
    ] = None,
    shared: Annotated[
        str, typer.Option(help="Numbers that all limbs share, such as strut,upper_arm.")
    ] = "",
    hold: Annotated[
        str, typer.Option(help="Numbers that are as described, such as tilt,limb1.zero.")
    ] = "",
    struts_apart: Annotated[
        bool,
        typer.Option("--struts-apart", help="Struts of a limb differ, so the platform tilts."),
    ] = False,
    tool: Annotated[
        str, typer.Option(help="Tool from the platform point, m, for --struts-apart: 0,0,-0.05.")
    ] = "0,0,0",
    following: Annotated[
        int, typer.Option("--next", help="Plan so many further readings.", min=0, max=100)
    ] = 0,
    report: Report = None,
    as_json: AsJson = False,
) -> None:
    """Find the geometry of a robot from measured poses.

    It says what they know of it, and what they cannot.

    Tracker, bed probe, gauge blocks, calliper and ballbar, in any mixture.
    """
    from deltaid.calibration.calibrate import calibrate as run
    from deltaid.calibration.firmware import firmware_text
    from deltaid.calibration.next_readings import next_readings
    from deltaid.errors import DeltaidError
    from deltaid.files import together, write_bytes
    from deltaid.view.calibration import calibration_page, next_line, number_table, session_lines
    from deltaid.view.html import write_page

    configs = {"--klipper": klipper, "--marlin": marlin, "--reprap": reprap}
    files = [*(points or ()), *(probe or ()), *(distances or ()), columns]
    require_outputs((robot, *files), {"--output": output, "--report": report, **configs})
    try:
        x, y, z = (float(part) for part in tool.split(","))
    except ValueError:
        raise DeltaidError(
            f"must be three numbers such as 0,0,-0.05, not {tool!r}", where="--tool"
        ) from None
    with progress(as_json) as say:
        say("fitting the geometry")
        found = run(
            robot,
            points=points,
            probe=probe,
            distances=distances,
            columns=columns,
            lengths=lengths,
            angles=angles,
            shared=_names(shared),
            hold=_names(hold),
            struts_apart=struts_apart,
            tool=(x, y, z),
        )
    texts = {
        path: firmware_text(found, option.strip("-")) for option, path in configs.items() if path
    }
    with together():
        for path, (text, _) in texts.items():
            write_bytes(path, text.encode())
        if output is not None:
            found.save(output)
        if report is not None:
            write_page(calibration_page(found), report)
    plans = next_readings(found, following) if following else ()
    if as_json:
        print_json(as_dictionary(found, plans))
        return
    print_verdict(found.verdict)
    lines = [*session_lines(found), *(f"not known: {part.words}" for part in found.open[:_SHOWN])]
    for line in lines:
        print_wrapped(line)
    if len(found.open) > _SHOWN:
        console.print(f"and {len(found.open) - _SHOWN} more, in --report and --json")
    console.print(shown(number_table(found)))
    for plan in plans:
        print_wrapped(next_line(plan))
    for doubt in found.doubts:
        console.print(f"doubtful: {doubt}")
    for path, (_, left) in texts.items():
        console.print(f"wrote {path}; its model of the printer leaves {1e3 * left:.2g} mm")
    print_written(output, report)


def print_wrapped(line: str) -> None:
    """A sentence in lines that fit, those after the first indented."""
    pieces = textwrap.wrap(
        line, console.width, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False
    )
    console.print("\n".join(pieces))


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(",") if name.strip())


def as_dictionary(found: "Calibration", plans: "Sequence[NextReadings]" = ()) -> dict[str, Any]:
    """The calibration as one JSON object, in m and rad."""
    return {
        "robot": found.described.name,
        "verdict": found.verdict,
        "doubts": list(found.doubts),
        "before": vars(found.before),
        "after": vars(found.after),
        "rank": found.rank,
        "numbers": [
            {
                "name": name,
                "value": value,
                "std": std,
                "before": number.spread,
                "unit": number.unit,
                "decided_by": decided,
            }
            for name, value, std, number, decided in zip(
                found.names, found.values.tolist(), found.std.tolist(), found.known.numbers,
                found.decided, strict=True,
            )
        ],
        "not_known": [vars(direction) for direction in found.open],
        "readings": [vars(session) for session in found.sessions],
        "zeros": found.zeros,
        "scales": found.scales,
        "left": found.left,
        "next": [
            {
                "kind": plan.kind,
                "position": plan.position,
                "poses": plan.poses.tolist(),
                "blocks": plan.blocks.tolist(),
            }
            for plan in plans
        ],
    }  # fmt: skip
