"""`deltaid calibrate`: geometry of a Delta from measured poses, and what stays undetermined."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import deltaid
from deltaid.cli.options import (
    YAML,
    AsJson,
    Full,
    Report,
    Robot,
    bounded,
    names,
    output_file,
    require_outputs,
    require_unset,
)
from deltaid.cli.output import print_found, print_json, print_written, progress, write_files
from deltaid.errors import DeltaidError
from deltaid.model.verdict import FEW

if TYPE_CHECKING:
    from deltaid.calibration.outlook import NextReadings


def calibrate(
    robot: Robot,
    points: Annotated[
        list[Path] | None,
        typer.Option(help="Points of a tracker or camera, in any frame. Repeatable."),
    ] = None,
    probe: Annotated[
        list[Path] | None,
        typer.Option(help="Touches of a plane, or of gauge blocks on it. Repeatable."),
    ] = None,
    distances: Annotated[
        list[Path] | None,
        typer.Option(help="Distances between two poses, by calliper or ballbar. Repeatable."),
    ] = None,
    torques: Annotated[
        list[Path] | None,
        typer.Option(help="Recordings of torques, which determine zeros. Repeatable."),
    ] = None,
    columns: Annotated[
        Path | None, typer.Option(help="File with columns, units and noise of the readings (YAML).")
    ] = None,
    output: Annotated[
        Path | None,
        output_file(
            "--output",
            "-o",
            help="Robot file to write, with the calibrated geometry (YAML).",
            endings=YAML,
        ),
    ] = None,
    klipper: Annotated[
        Path | None, output_file(help="File to write for Klipper: lines of a printer.cfg.")
    ] = None,
    marlin: Annotated[
        Path | None, output_file(help="File to write for Marlin: M665 and M666.")
    ] = None,
    reprap: Annotated[
        Path | None, output_file(help="File to write for RepRapFirmware: M665 and M666.")
    ] = None,
    lengths: Annotated[
        float | None,
        bounded(
            help="Standard deviation of lengths, m. Default: the robot's tolerances, or 0.001.",
            limits=(1e-7, 0.1),
        ),
    ] = None,
    angles: Annotated[
        float | None,
        bounded(
            help="Standard deviation of angles, rad. Default: the robot's tolerances, or 0.001.",
            limits=(1e-7, 0.3),
        ),
    ] = None,
    shared: Annotated[
        str, typer.Option(help="Numbers that are equal in all limbs, such as strut,upper_arm.")
    ] = "",
    hold: Annotated[
        str, typer.Option(help="Numbers to keep as described, such as tilt,limb1.zero.")
    ] = "",
    struts_apart: Annotated[
        bool,
        typer.Option(
            "--struts-apart",
            help="Calibrate the two struts of each limb separately; the platform may tilt.",
        ),
    ] = False,
    tool: Annotated[
        str,
        typer.Option(help="Tool relative to the platform point for --struts-apart, m: 0,0,-0.05."),
    ] = "0,0,0",
    following: Annotated[
        int,
        typer.Option(
            "--next",
            help="Number of next readings to plan with each instrument.",
            min=0,
            max=100,
        ),
    ] = 0,
    offers: Annotated[
        Path | None,
        typer.Option(
            "--sensors",
            help="List of instruments and prices for --next (YAML), instead of the built-in one.",
        ),
    ] = None,
    budget: Annotated[
        float | None,
        bounded(help="Largest price of an instrument of --next.", limits=(1e-9, 1e12)),
    ] = None,
    report: Report = None,
    full: Full = False,
    as_json: AsJson = False,
) -> None:
    """Estimate a robot's geometry from measured poses.

    The command also reports which numbers the readings do not determine.

    Readings come from a tracker, bed probe, gauge blocks, calliper or ballbar, in any combination.
    """
    from deltaid.exports.firmware import firmware_text
    from deltaid.sensors.planning.offers import shipped_offers
    from deltaid.view.calibration import (
        next_line,
        next_table,
        number_table,
        session_lines,
        summary,
    )

    configs = {"--klipper": klipper, "--marlin": marlin, "--reprap": reprap}
    files = [*(points or ()), *(probe or ()), *(distances or ()), *(torques or ()), columns, offers]
    require_outputs((robot, *files), {"--output": output, "--report": report, **configs})
    try:
        x, y, z = (float(part) for part in tool.split(","))
    except ValueError:
        raise DeltaidError(
            f"must be three numbers such as 0,0,-0.05, not {tool!r}", where="--tool"
        ) from None
    if not following:
        require_unset({"--sensors": offers is not None, "--budget": budget is not None}, "--next 6")
    if not struts_apart:
        require_unset({"--tool": any((x, y, z))}, "--struts-apart")
    shop = shipped_offers() if offers is None else deltaid.load_offers(offers)
    with progress(as_json) as say:
        say("fitting the geometry")
        result = deltaid.calibrate(
            robot, points=points, probe=probe, distances=distances, torques=torques,
            columns=columns, lengths=lengths, angles=angles, shared=names(shared),
            hold=names(hold), struts_apart=struts_apart, tool=(x, y, z), progress=say,
        )  # fmt: skip
    plans = (
        deltaid.next_readings(result, following, offers=shop, budget=budget) if following else ()
    )
    texts = {path: firmware_text(result, name[2:]) for name, path in configs.items() if path}
    printers = ((path, text) for path, (text, _) in texts.items())
    write_files(*printers, (output, result.save), (report, result.report))
    if as_json:
        print_json(_as_dictionary(result, plans, shop.currency))
        return
    said, open_ones = summary(result), len(result.open)
    print_found(
        [
            said.sentence,
            *session_lines(result),
            *said.lines[: min(open_ones, FEW)],
            *said.lines[open_ones:],
            *(f"Doubtful: {doubt}" for doubt in result.doubts),
        ],
        [next_table(result, plans, shop.currency) if plans else number_table(result)],
        details=said.lines[FEW:open_ones],
        full=full,
    )
    notes = [next_line(plan, shop.currency) for plan in plans[:1]]
    notes += [
        f"wrote {path}; its model of the printer leaves {1e3 * residual:.2g} mm"
        for path, (_, residual) in texts.items()
    ]
    notes += [f"{output} holds {text}" for text in result.unwritten if output]
    print_found(notes, full=True)
    print_written(output, report)


def _as_dictionary(
    result: "deltaid.Calibration", plans: "Sequence[NextReadings]" = (), currency: str = ""
) -> dict[str, Any]:
    return {
        "robot": result.described.name,
        "verdict": result.verdict,
        "doubts": list(result.doubts),
        "before": vars(result.before),
        "after": vars(result.after),
        "rank": result.rank,
        "numbers": result.to_frame().rename({"number": "name"}).to_dicts(),
        "not_known": [vars(direction) for direction in result.open],
        "not_seen": list(result.unseen),
        "readings": [vars(session) for session in result.sessions],
        "zeros": result.zeros,
        "scales": result.scales,
        "left": result.left,
        "next": [vars(plan) | {"currency": currency} for plan in plans],
    }
