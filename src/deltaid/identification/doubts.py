"""Doubts about a fit: contradictions between data, priors and measured values, and pairs of causes
that a recording does not separate, with the errors of parameters that follow.

A constant torque of a drive's friction, an offset or different Coulomb friction by direction, is
not distinguishable from an offset of the measured torque. A telescope's drive is not coupled to the
others by limbs, so its torque constant scales all inertia and friction that it turns.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from deltaid.effects.joint import ONE_WAY
from deltaid.effects.unexplained import FreeTorque
from deltaid.estimation.scatter import NORMAL, inverse, quantile
from deltaid.identification.fit import CURE, FittedProblem, against_motion, contradiction
from deltaid.identification.study import ADEQUATE, FAR
from deltaid.levels import FAINT, WIDER
from deltaid.model.corrections import Inseparable
from deltaid.sensors.weighings import weighings

# Standard deviations from which a measured value contradicts the other rows; and the part 1 − h of
# its row above which other rows determine it too.
_NO_CHANCE, _REDUNDANT = 4.0, 1e-4


def doubts(problem: FittedProblem) -> tuple[str, ...]:
    """Sentences on contradictions: what was detected, the likeliest cause, the fix.

    One cause has many symptoms: torques of another scale leave a misfit, contradict the prior and
    make masses grow. So only the first symptom is reported, the most telling first; and every
    measured value that recordings, other values or consistency contradict.
    """
    measured = tuple(_of_measured(problem))
    negatives = against_motion(problem.dynamics, problem.information)
    if negatives:
        of_data = [f"{contradiction(negatives, problem.dynamics.robot)}; {CURE}"]
    else:
        of_data = [*_misfit(problem, measured), *_contradictions(problem), *_grown(problem)]
        of_data = of_data or list(_of_priors(problem))
        # Ratio of measured torques to the prior's, by least squares.
        rows = problem.information.of_drives.problem
        prior = rows.A @ problem.reduction.p_reg[problem.information.columns]
        square = float(prior @ prior)
        scale = float(prior @ rows.b) / square if square > 0 else np.nan
        if of_data and np.isfinite(scale) and not 1 / FAR < scale < FAR:
            of_data = [
                f"torques are {scale:.3g} times what the described robot would need. Likeliest "
                "their unit, torque constant or gear is not declared, else masses and lengths of "
                "the description are those of another robot; deltaid check compares units and gears"
            ]
    return (*of_data[:1], *measured)


def _misfit(problem: FittedProblem, measured: Sequence[str]) -> Iterator[str]:
    """Torques that no consistent parameters explain."""
    noise = max(problem.noise, FAINT)
    rows = problem.information.rows / problem.information.mean_samples
    rms = np.sqrt(problem.objective.data.evaluate(problem.solution.x)[0] / rows)
    if rms <= max(FAR * noise, ADEQUATE):
        return
    leaves = f"the consistent fit leaves {rms / noise:.3g} times the torque error that is possible "
    if problem.settings.gamma is None:
        yield (
            f"{leaves}without physical consistency: only negative masses or friction would explain "
            f"these torques. Likeliest {'a measured value is wrong, ' if measured else ''}a torque "
            "or position is not that of its drive, or something drives the robot beside its "
            "motors; deltaid check tries signs, orders and gears"
        )
    else:
        yield (
            f"{leaves}without physical consistency and prior. Likeliest the given γ of "
            f"{problem.settings.gamma:.3g} weighs the prior too much; leave it out, so that the "
            "noise decides, and see what remains"
        )


def _is_unexplained(problem: FittedProblem) -> bool:
    return any(isinstance(addition, FreeTorque) for addition in problem.additions)


def _grown(problem: FittedProblem) -> Iterator[str]:
    """Entries that no torque determines and consistency made much larger than the prior."""
    reduction, p = problem.reduction, problem.values
    held = ~np.any(reduction.A, axis=1)
    grown = np.flatnonzero(held & (reduction.p_reg > 0) & (p > FAR * reduction.p_reg))
    names = ", ".join(
        f"{reduction.layout.names[i]} had to grow from {reduction.p_reg[i]:.3g} to {p[i]:.3g} "
        f"{reduction.layout.units[i]}"
        for i in grown
    )
    cause = "the prior is too light or too small; weigh the body, or describe its size"
    if _is_unexplained(problem):
        cause = "unexplained torque is mistaken for these moments; find its cause first"
    if names:
        yield (
            f"{names} to keep its body consistent, whose moments in the torques are too large for "
            f"the described mass. Likeliest {cause}"
        )


def _of_priors(problem: FittedProblem) -> Iterator[str]:
    """Priors that had to be widened more than a description is ever off."""
    owners: dict[str, float] = {}
    for parameter in problem.layout.parameters:
        factor = problem.reduction.widened.get(parameter.name, 1.0)
        if factor > WIDER and parameter.kind != "sensor":
            owners[parameter.owner] = max(factor, owners.get(parameter.owner, 0.0))
    for owner, factor in owners.items():
        yield (
            f"the recording requires the prior of {owner} to be {factor:.2g} times as wide as "
            "stated, so it describes something else. Likeliest the description has a wrong mass, "
            "size or unit there, or lacks a tool or cable; weigh it"
        )


def _contradictions(problem: FittedProblem) -> Iterator[str]:
    """The base parameter whose fitted value is farthest from that of the recording alone.

    With the truth within the prior, both agree up to the noise of the estimate. Otherwise the fit
    also moves parameters that are correlated with this one, maybe out of their intervals, which
    trust the description. Parameters that the fit holds are not compared.
    """
    base, estimate = problem.base, problem.estimate
    by_noise, freedom = estimate.by_noise  # geometry shifts both sides alike
    # The noise level that γ assumes (`default_gamma`).
    assumed = np.sqrt(problem.objective.gamma * problem.information.mean_samples)
    assumed *= problem.settings.prior_spread
    excess = max(1.0, float(assumed / max(problem.noise, np.finfo(float).tiny)))
    fitted, half = base.values(problem.values), excess * quantile(freedom) * by_noise
    apart = np.abs(fitted - estimate.values) / np.maximum(half, np.finfo(float).tiny)
    held = [
        parameter.name
        for addition in problem.additions if addition.is_held for parameter in addition.parameters
    ]  # fmt: skip
    apart[np.isin(np.array(problem.layout.names)[base.representatives], held)] = 0.0
    k, count = int(np.argmax(apart)), int(np.sum(apart > FAR))
    if not count:
        return
    unit = base.layout.units[base.representatives[k]]
    others = f"; {count - 1} more are as far apart" if count > 1 else ""
    yield (
        f"the recording alone gives {base.formulas[k]} = {estimate.values[k]:.3g} ± "
        f"{half[k]:.2g} {unit}, the fit {fitted[k]:.3g} {unit}{others}: {_why(problem)}"
    )


def _why(problem: FittedProblem) -> str:
    """The likeliest cause of a contradiction, and its cure."""
    if _is_unexplained(problem):
        return "a part of what is unexplained passes for it. Find that first"
    causes, cure = "entries that 'free' excludes or consistency", "Free more of their entries"
    if problem.settings.gamma is not None:  # then no prior is widened
        causes = f"prior, {causes}"
        cure = "Likeliest the prior of this body is too far off: correct it, or free more entries"
    return (
        f"{causes} contradict the recording, and other parameters of these bodies may lie outside "
        f"of their intervals. {cure}"
    )


def _of_measured(problem: FittedProblem) -> Iterator[str]:
    """Measured values that the recording contradicts.

    A value has the row a, u = R⁻ᵀa and the leverage h = ‖u‖². Least squares without it would leave
    the residual r / (1 − h) in place of r, whose prediction has the error (uᵀs − h e) / (1 − h).
    Where no other row determines the value (h = 1), physical consistency still may contradict it:
    then the fitted value differs.
    """
    information, estimate = problem.information, problem.estimate
    if information.facts is None:
        return
    noise, over = estimate.noise, inverse(estimate.noise.root)
    columns = np.searchsorted(information.columns, problem.base.representatives)
    others_too = ", with what else was measured," if len(information.facts) > 1 else ""
    for fact, row in zip(weighings(problem.dynamics.robot), information.facts, strict=True):
        u = over.T @ row[columns]
        residual, free = float(row[-1] - row[columns] @ estimate.values), float(1.0 - u @ u)
        std, _ = noise.deviations(u[:, None])
        others = max(float(std[0]) ** 2 - (noise.sigma * (1.0 - free)) ** 2, 0.0)
        others += float(np.sum((row[columns] @ problem.geometry.shifts) ** 2))
        who, apart, value = f"the recording{others_too}", 0.0, 0.0
        if free > _REDUNDANT:
            apart = abs(residual / free / np.hypot(noise.sigma, np.sqrt(others) / free))
            value = fact.value * (1.0 - residual / free / row[-1]) if row[-1] else 0.0
        if apart <= _NO_CHANCE:
            who, value = "the fit, whose bodies must be possible,", fact.coefficients @ problem.p
            apart = abs(fact.value - value) / fact.std
        if apart > _NO_CHANCE:
            yield (
                f"{fact.where}: {fact.name} was measured as {fact.shown(fact.value)} ± "
                f"{fact.std:.2g} {fact.unit}, but {who} says {fact.shown(float(value))} "
                f"{fact.unit}, {apart:.2g} standard deviations apart. Likeliest its unit, or what "
                "was measured with it (screws, cables, half a joint); correct it, state a larger "
                "std, "
                "or leave it out"
            )


def inseparable(problem: FittedProblem, *, absolute: bool) -> Iterator[Inseparable]:
    """Pairs of causes of a fit; `absolute` is whether the scale of its torques is known."""
    if drives := tuple(constants(problem)):
        yield Inseparable(
            causes=("a constant of friction", "an offset of the measured torque"), subjects=drives
        )
    robot = problem.dynamics.robot
    unknown = tuple(
        drive for drive in undetected_constants(problem)
        if NORMAL * abs(problem.undetected.get(f"offset.{drive}", 0.0))
        > ONE_WAY * robot.friction[drive].coulomb  # so nothing is known of it
    )  # fmt: skip
    if unknown:
        yield Inseparable(causes=("weight", "a constant of friction"), subjects=unknown)
    if robot.telescope is not None and not absolute:
        causes = f"inertia and friction that {robot.drives[-1]} turns", "its torque constant"
        yield Inseparable(causes=causes, is_counted=False)


def constants(problem: FittedProblem) -> dict[str, float]:
    """The constant torque in each drive's friction, where its law has one [N m or N]."""
    laws = problem.dynamics.robot.friction
    values = problem.layout.named(problem.values)
    out = dict[str, float]()
    for drive in problem.dynamics.robot.drives:
        law = laws.get(drive)
        if law is not None and law.offset is not None:
            out[drive] = values[f"offset.{drive}"]
        elif law is not None and not law.both_ways:
            out[drive] = 0.5 * (values[f"coulomb.{drive}"] - values[f"coulomb_back.{drive}"])
    return out


def undetected_constants(problem: FittedProblem) -> dict[str, float]:
    """One standard deviation of a constant torque that a drive's law lacks [N m or N]."""
    known, moves = problem.layout.names, [*problem.moves, problem.undetected]
    sizes = {
        drive: float(np.linalg.norm([move.get(f"offset.{drive}", 0.0) for move in moves]))
        for drive in problem.dynamics.robot.drives if f"offset.{drive}" not in known
    }  # fmt: skip
    return {drive: size for drive, size in sizes.items() if size > 0}


def ambiguous(problem: FittedProblem) -> dict[str, float]:
    """Changes of parameters if these constants are offsets of measured torques instead."""
    moved = {"offset": -1.0, "coulomb": -1.0, "coulomb_back": 1.0}
    return {
        f"{kind}.{drive}": sign * constant
        for drive, constant in constants(problem).items()
        for kind, sign in moved.items()
    }
