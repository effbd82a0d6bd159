"""Errors of an identification against the truth of its case, and what it reports."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from deltaid.checks.identify import Judged as Identified
from deltaid.model.corrections import Correction
from deltaid.model.record import IdentifiedModel
from deltaid.model.verdict import Grade, Verdict
from deltaid.robot.inertia import INERTIA_NAMES
from drives.errors import (
    curves_held,
    friction_error,
    friction_shape_error,
    mass_matrix_error,
    mass_matrix_shape_error,
)
from drives.happening import Contact, Happening, Span, within
from drives.rows import Case

# Time before and after a contact in which excluded spans belong to it (s).
_NEAR = 0.05
_SECONDS = {"s": 1.0, "ms": 1e-3, "µs": 1e-6}


@dataclass(frozen=True)
class Contacts:
    """Detection of contacts.

    Attributes:
        strong, weak: whether each contact of at least 100 N, and each other, overlaps an excluded
            span.
        elsewhere: excluded time farther than 50 ms from any contact, as a share of the recording.
    """

    strong: tuple[bool, ...]
    weak: tuple[bool, ...]
    elsewhere: float


@dataclass(frozen=True)
class Changes:
    """What the verdicts report of a load that comes and goes.

    Attributes:
        late: error of the first reported change (s); None if no times are reported.
        right: share of the time with the right reported state; None if no states are reported.
    """

    late: float | None
    right: float | None


@dataclass(frozen=True)
class Judged:
    """An identification compared with the truth.

    Attributes:
        M, M_shape, friction, friction_shape: errors (`errors.py`).
        friction_as_measured: error of friction with torque constants and offsets as recorded.
        curves: share of points of each drive's friction curve whose intervals contain the truth.
        lag: largest error of a drive's lag (s); None if no lag is reported.
        load: relative error of the load's mass; None if none is reported.
        changes: reported changes of an undeclared load; None if none are reported.
        gains: relative errors, one for each drive.
        gains_held: whether each gain's interval contains the truth.
        contacts: detection of contacts, if the case has any.
        bodies, base: whether intervals contain the truth, of bodies' entries that data determine,
            and of base parameters.
        said: kinds of corrections, each once, with their number.
        verdicts: keys of doubtful and wrong verdicts.
        texts: of corrections and warnings.
    """

    M: float
    M_shape: float
    friction: float
    friction_as_measured: float
    friction_shape: float
    curves: tuple[float, ...] = ()
    lag: float | None = None
    load: float | None = None
    changes: Changes | None = None
    gains: tuple[float, ...] = ()
    gains_held: tuple[bool, ...] = ()
    contacts: Contacts | None = None
    bodies: tuple[bool, ...] = ()
    base: tuple[bool, ...] = ()
    said: tuple[tuple[str, int], ...] = ()
    verdicts: tuple[str, ...] = ()
    texts: tuple[str, ...] = field(default=(), repr=False)


def judge(case: Case, result: Identified) -> Judged:
    """Compare an identification with the truth."""
    model, happening, sensors = result.model, case.happenings[0], case.sensors[0]
    corrections = model.corrections
    kinds = [correction.kind for correction in corrections]
    offset = np.asarray(sensors.offset) * np.abs(happening.truth.tau).max(axis=0)
    link = happening.carried
    return Judged(
        M=mass_matrix_error(case, result),
        M_shape=mass_matrix_shape_error(case, result),
        friction=friction_error(happening, model, link, 1.0, 0.0),
        friction_as_measured=friction_error(happening, model, link, sensors.gain, offset),
        friction_shape=friction_shape_error(happening, model, link),
        curves=tuple(curves_held(happening, model)),
        lag=_lag_error(case, corrections),
        load=_load_error(happening, corrections),
        changes=_changes(happening, result.verdicts),
        gains=tuple(_gain_errors(case, corrections)),
        gains_held=tuple(_gains_held(case, corrections)),
        contacts=_contacts(happening, result) if happening.contacts else None,
        bodies=tuple(_bodies(case, model)),
        base=tuple(_base(case, result)),
        said=tuple((kind, kinds.count(kind)) for kind in dict.fromkeys(kinds)),
        verdicts=tuple(
            dict.fromkeys(
                verdict.key
                for verdict in result.verdicts
                if verdict.grade in (Grade.DOUBTFUL, Grade.WRONG)
            )
        ),
        texts=(*(correction.text for correction in corrections), *model.warnings),
    )


def _last_correction(corrections: Sequence[Correction], kind: str, drive: str) -> Correction | None:
    """The last correction of a kind about a drive, or about all."""
    found = [
        correction
        for correction in corrections
        if correction.kind == kind and correction.subject in (drive, "")
    ]
    return found[-1] if found else None


def _lag_error(case: Case, corrections: Sequence[Correction]) -> float | None:
    """Lag error of the worst drive; a drive without a correction has no lag."""
    robot = case.robot
    true = np.broadcast_to(np.asarray(case.sensors[0].lag), len(robot.drives))
    found = [_last_correction(corrections, "lag", drive) for drive in robot.drives]
    if all(correction is None for correction in found):
        return None
    values = [0.0 if lag is None or lag.value is None else lag.value * _SECONDS.get(lag.unit, 1.0)
              for lag in found]  # fmt: skip
    return float(np.max(np.abs(np.array(values) - true)))


def _load_error(happening: Happening, corrections: Sequence[Correction]) -> float | None:
    loads = [correction for correction in corrections if correction.kind == "load"]
    masses = [load.value for load in loads if load.unit == "kg" and load.value is not None]
    if happening.load is None or not masses:
        return None
    return abs(masses[0] / happening.load.mass - 1)


def _gain_errors(case: Case, corrections: Sequence[Correction]) -> list[float]:
    """Relative errors of gains; a reported gain multiplies recorded torques."""
    found = [_last_correction(corrections, "gain", drive) for drive in case.robot.drives]
    if any(correction is None or correction.value is None for correction in found):
        return []
    return [
        float(correction.value * true - 1)
        for correction, true in zip(found, _true_gains(case), strict=True)
        if correction is not None and correction.value is not None
    ]


def _true_gains(case: Case) -> np.ndarray:
    """True gain of each drive; without a known load relative to the geometric mean of the limbs'
    drives, as corrections report it."""
    gain = np.broadcast_to(np.asarray(case.sensors[0].gain), len(case.robot.drives))
    limbs = case.robot.limbs
    if "known" in case.tells or limbs is None:
        return gain
    return gain / np.exp(np.mean(np.log(gain[: limbs.count])))


def _gains_held(case: Case, corrections: Sequence[Correction]) -> list[bool]:
    found = [_last_correction(corrections, "gain", drive) for drive in case.robot.drives]
    truths = zip(found, _true_gains(case), strict=True)
    pairs = [(gain, true) for gain, true in truths if gain is not None]
    return [
        gain.low <= 1 / true <= gain.high
        for gain, true in pairs
        if gain.low is not None and gain.high is not None
    ]


def _changes(happening: Happening, verdicts: Sequence[Verdict]) -> Changes | None:
    """Errors of the times in the verdict's text and of the spans that it proposes."""
    found = [
        verdict
        for verdict in verdicts
        if verdict.key == "load-change" and verdict.grade is not Grade.GOOD
    ]
    if not found or not happening.held:
        return Changes(None, None) if found else None
    times = re.findall(r"(?:at|,) ([0-9.]+)(?=,| s| and)", found[0].seen)
    late = float(times[0]) - happening.held[0][0] if times else None
    lines = dict(line for proposal in found[0].proposals for line in proposal.changes)
    spans = lines.get("load.spans")
    right = None
    if spans is not None:
        reported, true = (within(happening.time, x) for x in (spans, happening.held))
        right = float(np.mean(reported == true))
    return Changes(None if late is None else abs(late), right)


def spans_left_out(result: Identified) -> list[Span]:
    """Spans that repairs exclude from the first recording."""
    return [(span.first, span.last) for span in result.recordings[0].repairs.left_out]


def _contacts(happening: Happening, result: Identified) -> Contacts:
    spans = spans_left_out(result)

    def is_left_out(push: Contact) -> bool:
        end = push.start + push.length
        return any(first < end and last > push.start for first, last in spans)

    strong, weak = [], []
    for contact in happening.contacts:
        (strong if contact.size >= 100 else weak).append(is_left_out(contact))
    near = [
        (contact.start - _NEAR, contact.start + contact.length + _NEAR)
        for contact in happening.contacts
    ]
    elsewhere = sum(outside(span, near) for span in spans)
    return Contacts(tuple(strong), tuple(weak), elsewhere / happening.duration)


def outside(span: Span, others: Sequence[Span]) -> float:
    """Length of the part of a span that is in none of the others, which are in order."""
    at, length = span[0], 0.0
    for first, last in others:
        length += max(0.0, min(first, span[1]) - at)
        at = max(at, last)
    return length + max(0.0, span[1] - at)


def _truth(case: Case) -> dict[str, float]:
    """True parameters by name, those of each limb's own bodies too."""
    truth = dict(zip(case.machine.layout.names, case.machine.plant.p.tolist(), strict=True))
    oracle, shared = case.machine.plant.oracle, case.robot.limb_bodies(0)
    for i, limb in enumerate(oracle.limbs):
        for name, body in zip(shared, (limb.driven, limb.strut_body), strict=True):
            (xx, xy, xz), (_, yy, yz), (_, _, zz) = oracle.bodies[body].inertia.tolist()
            entries = (oracle.bodies[body].m, *oracle.bodies[body].mc, xx, yy, zz, xy, yz, xz)
            named = zip(INERTIA_NAMES, entries, strict=True)
            truth |= {f"{name}{i + 1}.{symbol}": float(value) for symbol, value in named}
    return truth


def _bodies(case: Case, model: IdentifiedModel) -> list[bool]:
    """Whether intervals contain the truth, for bodies' entries that data determine."""
    truth = _truth(case)
    bodies = model.layout.parameters[: 10 * len(model.layout.bodies)]
    names = {parameter.name for parameter in bodies}
    return [
        bool(parameter.low <= truth[parameter.name] <= parameter.high)
        for parameter in model.parameters
        if parameter.name in names and parameter.determined_by.startswith("data")
        and parameter.low is not None and parameter.high is not None
    ]  # fmt: skip


def _base(case: Case, result: Identified) -> list[bool]:
    """Whether intervals contain the truth, for base parameters without friction, which `curves`
    judges."""
    truth = _truth(case)
    p = np.array([truth.get(name, 0.0) for name in result.model.layout.names])
    combination = result.base.combination()
    values = combination[:, : len(p)] @ p
    layout = result.model.layout
    rubs = np.any(combination[:, : len(p)][:, layout.friction] != 0, axis=1)
    return [
        bool(parameter.low <= value <= parameter.high)
        for parameter, value, is_friction in zip(
            result.model.base_parameters, values, rubs, strict=False
        )
        if not is_friction
    ]
