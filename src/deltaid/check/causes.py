"""The causes of a residual that count, each with all that it explains."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from deltaid.estimation.problem import scatter
from deltaid.identification.explained import Explained
from deltaid.identification.study import Study

# A cause counts if it explains this share of all that is explained, and this share of the largest
# torque; what is smaller may be what the first-order columns of another one leave.
_SHARE, _LEAST = 0.15, 3e-4
# A drive's factor is odd where it is so many standard deviations, this much, and this share of the
# oddest one's away from the middle of all.
_CLEAR, _ODD, _BESIDE = 3.0, 0.01, 0.25


@dataclass(frozen=True, eq=False)
class Cause:
    """A kind of cause with all that it explains.

    Attributes:
        kind: the key of its verdict.
        found: its patterns, the first found first.
        rms: of what it explains in each drive's torque [N m or N].
        coefficients: of each of its patterns' columns.
    """

    kind: str
    found: tuple[Explained, ...]
    rms: Float[np.ndarray, " dof"]
    coefficients: tuple[Float[np.ndarray, " _"], ...]


def causes_of(study: Study) -> list[Cause]:
    """The causes that count."""
    found, scene = study.account.found, study.scene
    if not found:
        return []
    columns = np.hstack([one.pattern.columns for one in found])
    norms = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    bare = scene.span.without(columns / norms)
    theta = np.linalg.lstsq(bare, scene.span.without(scene.tau), rcond=1e-4)[0] / norms
    ends = np.cumsum([one.pattern.columns.shape[1] for one in found])[:-1]
    parts = np.split(theta, ends)
    total = sum(one.gain for one in found)
    dof, largest = len(study.scene.drives), np.abs(study.scene.model).max(axis=1)
    causes = []
    for kind in dict.fromkeys(one.pattern.kind for one in found):
        own = [k for k, one in enumerate(found) if one.pattern.kind == kind]
        added = sum(found[k].directions @ (found[k].directions.T @ study.scene.tau) for k in own)
        rms = np.sqrt(np.mean(np.reshape(added, (dof, -1)) ** 2, axis=1)) * scene.rows.scale
        gain = sum(found[k].gain for k in own)
        if gain > _SHARE * total and np.any(rms > _LEAST * largest):
            mine = tuple(found[k] for k in own)
            causes.append(Cause(kind, mine, rms, tuple(parts[k] for k in own)))
    return causes


def odd_gains(study: Study, cause: Cause) -> dict[str, float]:
    """By which share torques are too large, of the drives whose factor is not that of the others.

    Of a single drive against the others; of several against the mean of the limbs' drives, since
    a factor common to all does not show.
    """
    scene, drives = study.scene, study.scene.drives
    named = {one.pattern.subject for one in cause.found}
    factor, deviation = _factors(study)
    middle = np.median(factor)
    apart = np.abs(factor / middle - 1.0)
    least = np.maximum(_CLEAR * deviation, max(_ODD, _BESIDE * float(apart.max())))
    odd = [drives.index(one) for one in named] if named != {""} and len(named) == 1 else []
    odd = odd or np.flatnonzero(apart > least).tolist() or [int(np.argmax(apart))]
    if len(odd) == 1:
        others = np.delete(factor, odd[0])
        return {drives[odd[0]]: float(factor[odd[0]] / np.median(others) - 1.0)}
    limbs = scene.trace.dynamics.robot.limbs
    mean = float(np.mean(factor[: limbs.count if limbs else None]))
    gains = factor / mean - 1.0
    shown = np.flatnonzero(np.abs(gains) > np.maximum(_CLEAR * deviation, _ODD))
    return {drives[i]: float(gains[i]) for i in shown}


def _factors(
    study: Study,
) -> tuple[Float[np.ndarray, " dof"], Float[np.ndarray, " dof"]]:
    """What each drive's torque is of the model's, up to a common factor, and its deviation."""
    scene = study.scene
    others = [one.directions for one in study.account.found if one.pattern.kind != "drive-gain"]
    model, span = scene.scaled_model, scene.span
    for U in others:
        extra, R = np.linalg.qr(span.without(U))
        span = span.with_directions(extra[:, np.abs(np.diag(R)) > 1e-6])
    own = scene.rows.own(model)
    bare = span.without(own)
    influence = np.linalg.pinv(bare, rcond=1e-4).T
    theta = influence.T @ scene.tau
    p = span.coefficients(scene.tau - own @ theta)
    common = float(np.sum((scene.Y @ p) * model) / np.sum(model**2))
    left = span.without(scene.tau) - bare @ theta
    freedom = max(len(left) - span.rank - len(theta), 1)
    errors = scatter(influence, left, scene.rows.groups, freedom)
    return (common + theta) / common, np.sqrt(np.diag(errors)) / common
