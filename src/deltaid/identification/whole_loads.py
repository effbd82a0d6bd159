"""Stage for undeclared loads that recordings hold from beginning to end.

In one recording such a load is a part of its carrier. Two recordings of one machine show it, but
also torque constants, friction, offsets or zeros may differ between them. So all known effects
compete for the torques of both, as if each acted in one of them only.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from deltaid.effects.account import account
from deltaid.effects.all import EFFECTS
from deltaid.effects.at_platform import platform_forces
from deltaid.effects.load_search import holders
from deltaid.effects.point import EffectCandidate, RigidFit
from deltaid.estimation.problem import Span
from deltaid.identification.lags_and_gears import estimated_anew
from deltaid.identification.loads import declared_loads, holding, undeclared_name
from deltaid.identification.setup import Progress, Setup
from deltaid.identification.study import LOAD_CHANGE, Study
from deltaid.levels import FAINT
from deltaid.recording.carried import Load

# Kind of all candidates but loads: what else differs is corrected or judged elsewhere.
_OTHER = ""


def loads_of_whole_recordings(setup: Setup, progress: Progress) -> Setup:
    """Identify what the heavier recordings hold as loads; the lightest one is without load."""
    if setup.settings.effects == "none":
        return setup
    pairs = zip(setup.recordings, setup.studies, strict=False)  # no studies where none is needed
    studies = {
        k: study
        for k, (recording, study) in enumerate(pairs)
        if not recording.log.columns.loads
        and undeclared_name(recording) not in setup.barred_effects
    }
    detected = dict(setup.detected)
    for k, excess in heavier(studies).items():
        recording = setup.recordings[k]
        load = Load(always=True, name=undeclared_name(recording), body=excess.body)
        detected[load.name] = None
        setup = setup.with_recording(k, holding(recording, load))
    if len(detected) == len(setup.detected):
        return setup
    setup = declared_loads(setup.changed(detected=detected), progress)
    return estimated_anew(setup.studied(), progress)


class ExcessMass(NamedTuple):
    """A body that is heavier in one recording than in the lightest of several [kg]."""

    body: str
    mass: float


def heavier(studies: Mapping[int, Study | None]) -> dict[int, ExcessMass]:
    """The excess mass of recordings that hold a load from beginning to end, by their numbers.

    Args:
        studies: of recordings of one machine without declared loads, by their numbers.
    """
    fits = {k: study.fit for k, study in studies.items() if study and not study.is_disturbed}
    if len(fits) < 2:
        return {}
    first, *others = fits
    masses = {first: ExcessMass("", 0.0)} | {k: _difference(fits[first], fits[k]) for k in others}
    lightest = min(excess.mass for excess in masses.values())
    largest = max(excess.mass for excess in masses.values()) - lightest
    body = next((excess.body for excess in masses.values() if excess.body), "")
    return {
        k: ExcessMass(body, excess.mass - lightest)
        for k, excess in masses.items()
        if excess.mass - lightest > 0.5 * largest
    }


def _difference(first: RigidFit, second: RigidFit) -> ExcessMass:
    """By how much a body is heavier in the second recording; 0 where something else explains what
    differs."""
    span = Span.of_columns(np.vstack([fit.rows.stack(fit.Y) for fit in (first, second)]))
    tau = np.concatenate([first.tau, second.tau])
    groups = np.concatenate([first.rows.groups, second.rows.groups + first.rows.groups.max() + 1])
    candidates = [
        replace(candidate, columns=np.pad(candidate.columns, ((len(first.tau), 0), (0, 0))))
        for candidate in _candidates(second)
    ]
    found = account(candidates, lambda _: (), groups, span, span.without(tau))
    if not found.detected or found.detected[0].candidate.kind != LOAD_CHANGE:
        return ExcessMass("", 0.0)
    columns = found.detected[0].candidate.columns
    change = np.linalg.lstsq(span.without(columns), tau, rcond=FAINT)[0]
    return ExcessMass(found.detected[0].candidate.words, float(change[0]))


def _candidates(fit: RigidFit) -> Iterator[EffectCandidate]:
    """All that may act in one of two recordings only: loads, known effects, pulls at the platform,
    and other gains, offsets and friction."""
    for body, columns in holders(fit).items():
        yield EffectCandidate(LOAD_CHANGE, "", columns[:, :1], body)
        yield EffectCandidate(LOAD_CHANGE, "", columns, body)
    for effect in EFFECTS:
        yield from (c for c in effect.candidates(fit) if c.kind != LOAD_CHANGE)
    pulls = platform_forces(fit.dynamics, fit.fastest_platform)
    names = [p.name for p in fit.dynamics.layout.parameters if p.kind == "friction"]
    gains, offsets = (fit.rows.per_drive(x) for x in (fit.model, np.ones_like(fit.model)))
    together = [
        *(fit.rows.stack(fit.added(pull)) for pull in pulls),
        *(fit.rows.stack(fit.column(name))[:, None] for name in names if fit.shows(name)),
        *np.moveaxis(gains, 1, 0)[:, :, None],
        *np.moveaxis(offsets, 1, 0)[:, :, None],
        gains,
        offsets,
    ]
    yield from (EffectCandidate(_OTHER, "", columns) for columns in together)
