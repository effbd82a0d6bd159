"""Terms of friction that were chosen, and effects, that the final fit puts at zero.

Laws are chosen by rows in which lags are free, and a fit may hold them: what explained a lag there
is then at its bound. A law that does without such a term is chosen instead.
"""

import numpy as np

from deltaid.effects.along_motion import AlongMotion
from deltaid.identification.fit import FittedProblem
from deltaid.identification.friction_curves import freed
from deltaid.identification.setup import Setup
from deltaid.identification.uncertainty import uncertainty
from deltaid.model.friction_record import JointTerm

# Half a 95 % interval in standard deviations: a coefficient within it may be zero.
_MAY_BE_ZERO = 1.96


def idle_terms(setup: Setup, problem: FittedProblem) -> frozenset[JointTerm]:
    """Chosen terms of one coefficient whose removal would cost the fit no more than chance."""
    if setup.friction_choice is None:
        return frozenset()
    chosen = {(step.joint, step.addition) for step in setup.friction_choice.steps if step.useful}
    names = problem.layout.names
    of_terms = {
        (term.joint, term.kind): names.index(term.name)
        for term in problem.dynamics.robot.friction_terms
        if (term.joint, term.kind) in chosen
    }
    if not of_terms:
        return frozenset()
    std = uncertainty(freed(problem)).std
    return frozenset(
        term for term, k in of_terms.items() if abs(problem.values[k]) < _MAY_BE_ZERO * std[k]
    )


def idle_effects(problem: FittedProblem) -> frozenset[str]:
    """Names of effects along the motion of which every coefficient may be zero."""
    spread = uncertainty(freed(problem)).std[len(problem.p) :]
    values, first, idle = problem.values[len(problem.p) :], 0, set[str]()
    for addition in problem.additions:
        own = slice(first, first := first + len(addition.parameters))
        if isinstance(addition, AlongMotion) and np.all(
            np.abs(values[own]) < _MAY_BE_ZERO * spread[own]
        ):
            idle.add(addition.name)
    return frozenset(idle)
