"""Terms of friction that were chosen, and effects, that the final fit puts at zero.

Laws are chosen by rows in which lags are free, and a fit may hold them: what explained a lag there
is then at its bound. A law that does without such a term is chosen instead. So is a fit without an
effect that others have made needless.
"""

from typing import NamedTuple

import numpy as np

from deltaid.effects.along_motion import AlongMotion, RippleColumns
from deltaid.estimation.additions import of_each
from deltaid.identification.fit import FittedProblem
from deltaid.identification.friction_curves import freed
from deltaid.identification.setup import Setup
from deltaid.identification.uncertainty import uncertainty
from deltaid.model.friction_record import JointTerm

# Half a 95 % interval in standard deviations: a coefficient within it may be zero.
_MAY_BE_ZERO = 1.96


class Idle(NamedTuple):
    """What a fit has no use for."""

    terms: frozenset[JointTerm] = frozenset()
    effects: frozenset[str] = frozenset()


def idle(setup: Setup, problem: FittedProblem) -> Idle:
    """Chosen terms of one coefficient, and effects along the motion of any number, whose
    coefficients may all be zero.

    No ripples: each has an order of its own, which was searched because it is beyond chance.
    """
    terms, names = _chosen(setup, problem), _effects(problem)
    if not (terms or any(names)):
        return Idle()
    may_be_zero = np.abs(problem.values) < _MAY_BE_ZERO * uncertainty(freed(problem)).std
    added = may_be_zero[len(problem.p) :].tolist()
    zeros = [all(own) for _, own in of_each(problem.additions, added)]
    return Idle(
        frozenset(term for term, k in terms.items() if may_be_zero[k]),
        frozenset(name for name, is_zero in zip(names, zeros, strict=True) if name and is_zero),
    )


def _chosen(setup: Setup, problem: FittedProblem) -> dict[JointTerm, int]:
    """Places of the chosen terms among the parameters."""
    choice, names = setup.friction_choice, problem.layout.names
    if choice is None:
        return {}
    chosen = {(step.joint, step.addition) for step in choice.steps if step.useful}
    return {
        (term.joint, term.kind): names.index(term.name)
        for term in problem.dynamics.robot.friction_terms
        if (term.joint, term.kind) in chosen
    }


def _effects(problem: FittedProblem) -> list[str]:
    """The name of each addition that may be idle, else none."""
    return [
        addition.name
        if isinstance(addition, AlongMotion) and not isinstance(addition, RippleColumns)
        else ""
        for addition in problem.additions
    ]
