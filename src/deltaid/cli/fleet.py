"""`deltaid fleet`: hundreds of robots and all their recordings, from a manifest to tables."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

import deltaid
from deltaid.cli.gather import FalseAlarms, Limit, Since, drift_settings
from deltaid.cli.options import (
    AsJson,
    Compliance,
    Events,
    Force,
    KeepAll,
    Lag,
    bounded,
    output_file,
)
from deltaid.cli.output import SCREEN, console, print_json, progress, remark
from deltaid.errors import DeltaidError, quoted, shortened
from deltaid.files import require_writable, write_bytes
from deltaid.model.options import FrictionLaws, Period


def fleet(
    manifest: Annotated[
        str,
        typer.Argument(
            help="Manifest of robots, types and recordings (YAML, CSV or Parquet).",
            metavar="MANIFEST",
        ),
    ],
    output: Annotated[
        str,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="Folder, or address such as s3://bucket/fleet, of factor files and tables.",
        ),
    ],
    scheduler: Annotated[
        str | None,
        typer.Option(
            help="Address of a Dask cluster, such as tcp://10.0.0.5:8786. Default: this machine."
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes on this machine. Default: one per core.")
    ] = None,
    period: Annotated[
        Period | None,
        typer.Option(
            help="Period whose recordings are fitted together. Default: the manifest's, or week."
        ),
    ] = None,
    cutoff: Annotated[
        float | None,
        bounded(help="Low-pass cut-off, Hz. Default: from the first recording of each type."),
    ] = None,
    lag: Lag = "estimate",
    compliance: Compliance = "estimate",
    keep_all: KeepAll = False,
    events: Events = True,
    friction: Annotated[
        FrictionLaws,
        typer.Option(
            help="Friction laws: as described, or with additional terms that the "
            "recordings require."
        ),
    ] = "choose",
    prior_out: Annotated[
        Path | None,
        output_file(
            "--prior-out",
            help="Description of the next robot to write, with the fleet's knowledge as prior.",
        ),
    ] = None,
    limit: Limit = None,
    false_alarms: FalseAlarms = 0.1,
    since: Since = None,
    force: Force = False,
    retry: Annotated[
        bool, typer.Option("--retry", help="Try recordings and robots in quarantine again.")
    ] = False,
    drop_absent: Annotated[
        bool,
        typer.Option(
            "--drop-absent",
            help="Drop data of absent recordings that cannot be used with these options.",
        ),
    ] = False,
    regather: Annotated[
        bool,
        typer.Option(
            "--regather", help="Gather recordings again that were gathered with other options."
        ),
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Fit many robots, and monitor them for drift.

    The command gathers recordings in parallel, fits each robot in each period, and searches for
    drift.

    You may end it at any time: the same call continues. It puts an unusable recording or robot into
    quarantine with the reason, and continues with the others.
    """
    from deltaid.fleets import place
    from deltaid.fleets.fleet import find_fleet
    from deltaid.fleets.run_card import summary

    if scheduler is not None and workers is not None:
        raise DeltaidError(
            "is of this machine, and --scheduler has workers of its own",
            where="--workers",
            cure="leave one of both out; `dask worker` says how many there are",
        )
    settings = deltaid.Settings(
        cutoff=cutoff, lag=lag, compliance=compliance, keep_all=keep_all, events=events,
        friction=friction,
    )  # fmt: skip
    drift = drift_settings(limit, false_alarms, since)
    if prior_out is not None:
        require_writable(prior_out)
    try:
        with progress(as_json) as say:
            say("looking for recordings")
            robots = find_fleet(manifest, period)
            if prior_out is not None and len(robots.types) > 1:
                raise DeltaidError(
                    f"is one file, and the fleet has {len(robots.types)} types",
                    where="--prior-out",
                    cure="leave it out: the folder `types` of the fleet has a description of each",
                )
            run = deltaid.fleet(
                robots, output, settings=settings, drift=drift, scheduler=scheduler,
                workers=workers, force=force, retry=retry, drop_absent=drop_absent,
                regather=regather, progress=say,
            )  # fmt: skip
    except KeyboardInterrupt:
        kept = DeltaidError(
            "stopped; what has been gathered and fitted is kept",
            where=output,
            cure="the same command does the rest",
        )
        remark("error", kept)
        raise
    if prior_out is not None:
        folder, fits = place.Place.named(output), [fit for fit in run.types if not fit.reason]
        data = [folder.read(fit.job.file) for fit in fits]
        if not data or data[0] is None:
            raise DeltaidError(
                "there is nothing to write: no robot of the fleet could be used",
                where="--prior-out",
                cure="see quarantine.csv",
            )
        write_bytes(prior_out, data[0])
    used = [outcome for outcome in run.outcomes if outcome.file]
    fits = [fit for fit in run.fits if not fit.reason]
    site = f"{output}/{run.site}" if run.site else None
    if as_json:
        print_json(
            {
                "folder": output,
                "robots": len({outcome.recorded.robot for outcome in run.outcomes}),
                "recordings": len(run.outcomes),
                "gathered": run.computed[0],
                "used": len(used),
                "fits": len(fits),
                "fitted": run.computed[1],
                "site": site,
                "quarantine": [asdict(line) for line in run.quarantine],
            }
        )
    else:
        console.print(f"{summary(run)}; in {output}")
        if site:
            console.print(f"pages: {site}")
        if run.quarantine:
            remark("note", f"{len(run.quarantine)} in quarantine, see {output}/quarantine.csv")
        for line in run.quarantine[:SCREEN]:
            which = quoted(line.which)
            reason = line.reason.replace(line.which, which)
            reason = reason if which in reason else f"{which}: {reason}"
            remark("note", shortened(f"{line.what} of {line.robot}: {reason}"))
    if not fits:
        raise DeltaidError(
            "no robot could be fitted",
            where=manifest,
            cure="see what is in quarantine, and why" if run.quarantine else "list recordings",
        )
