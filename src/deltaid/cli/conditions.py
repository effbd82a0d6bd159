"""What a simulated robot does that its model does not say: options of commands that simulate."""

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deltaid.errors import DeltaidError

if TYPE_CHECKING:
    from deltaid.control.plant import Payload
    from deltaid.control.tracking import Drives, Tracking

PayloadText = Annotated[
    str | None,
    typer.Option(
        "--payload",
        help="Load at the tool of the robot that is moved, kg: 1.5, or 1.5±0.1 (or 1.5+-0.1).",
        metavar="MASS[±STD]",
    ),
]
PayloadKnown = Annotated[
    bool, typer.Option("--payload-known", help="The controller is told of MASS.")
]
CurrentLoop = Annotated[
    float | None,
    typer.Option(help="Bandwidth of the drives' current loop, Hz. Default: torques at once."),
]
ElasticGears = Annotated[
    bool,
    typer.Option("--elastic-gears", help="Gears wind up by the plant's gear_stiffness."),
]

_NUMBER = r"[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?"
_PAYLOAD = re.compile(rf"({_NUMBER})(?:\s*(?:±|\+-|\+/-)\s*({_NUMBER}))?\s*(?:kg)?")
# Kilograms, beyond which it is another unit.
_HEAVY = 1000.0


def drives_of(
    rate: float,
    bandwidth: float,
    encoder: float | None,
    delay: int,
    current_loop: float | None = None,
) -> "Drives":
    """The drives' electronics from the options.

    Raises:
        DeltaidError: a rate, a bandwidth or an encoder's step is out of bounds.
    """
    from deltaid.control.tracking import ENCODER_STEP, Drives
    from deltaid.errors import positive

    positive("--rate", rate, (10.0, 1e5))
    positive("--bandwidth", bandwidth, (0.01, rate / 10))
    if encoder:
        positive("--encoder", encoder, (0.0, 1.0))
    positive("--current-loop", current_loop, (1.0, 1e5))
    step = ENCODER_STEP if encoder is None else encoder
    return Drives(rate, step, delay, current_loop=current_loop or math.inf)


def drives_dictionary(drives: "Drives", bandwidth: float) -> dict[str, Any]:
    """Settings for JSON."""
    return {
        "bandwidth_hz": bandwidth,
        "rate_hz": drives.rate,
        "encoder_step": drives.encoder_step,
        "delay": drives.delay,
        "current_loop_hz": drives.current_loop if math.isfinite(drives.current_loop) else None,
    }


def payload_of(text: str | None, known: bool) -> "Payload | None":
    """What `--payload` says.

    Raises:
        DeltaidError: it is no mass, or `--payload-known` stands without one.
    """
    if text is None:
        if known:
            cure = "give --payload MASS too"
            raise DeltaidError("there is no load to know", where="--payload-known", cure=cure)
        return None
    found = _PAYLOAD.fullmatch(text.strip())
    if found is None:
        cure = "give kilograms, with a standard deviation or without: 1.5 or 1.5±0.1"
        raise DeltaidError(f"'{text[:40]}' is no mass", where="--payload", cure=cure)
    mass, std = float(found[1]), float(found[2] or 0.0)
    if not 0 < mass < _HEAVY or not std <= mass:
        cure = "give kilograms; the standard deviation is no more than the mass"
        raise DeltaidError(f"'{text[:40]}' is no load of a robot", where="--payload", cure=cure)
    from deltaid.control.plant import Payload

    return Payload(mass, std)


def payload_dictionary(
    payload: "Payload | None", known: bool, ends: "Sequence[tuple[float, Tracking]]"
) -> dict[str, Any]:
    """What is held, for JSON, and errors at both ends of what it may be."""
    if payload is None:
        return {"payload": None}
    at = [
        {
            "mass": mass,
            "platform_rms": result.error.platform_rms,
            "platform_max": result.error.platform_max,
            "ended": result.ended,
        }
        for mass, result in ends
    ]
    return {"payload": {"mass": payload.mass, "std": payload.std, "known": known, "ends": at}}


def condition_lines(
    payload: "Payload | None",
    known: bool,
    ends: "Sequence[tuple[float, Tracking]]",
    elastic_gears: bool,
) -> list[str]:
    """What is held, and whether gears wind up, in words."""
    lines = ["gears wind up, with the encoders on the motors"] * elastic_gears
    if payload is None:
        return lines
    told = f"{payload.mass:.4g} kg" if known else "nothing"
    lines.append(f"with a load of {payload.mass:.4g} kg, of which the controller knows {told}")
    for mass, result in ends:
        lost = "" if result.ended is None else f", and lost after {result.ended:.3g} s"
        lines.append(
            f"with {mass:.4g} kg (two standard deviations off): "
            f"{1e3 * result.error.platform_rms:.3g} mm rms and "
            f"{1e3 * result.error.platform_max:.3g} mm at most{lost}"
        )
    return lines
