"""The whole cycle of one robot as one graph."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca

from deltaid.model.model import Model
from deltaid.online.estimates import CycleEstimates, estimates, friction_bounds, friction_part
from deltaid.online.graph import CyclePart, StepGraph, assembled
from deltaid.online.knowledge import OnlineKnowledge, knowledge
from deltaid.online.settings import OnlineSettings
from deltaid.online.signals import Signals, signals


@dataclass(frozen=True, eq=False)
class Cycle:
    """What further parts can be made of.

    Attributes:
        model, settings, known: what the cycle is of.
        signals: what is read, filtered.
        estimates: what is known of load, model and friction.
        anew: 1 where filters begin anew behind this cycle, as the gripper told of another load.
    """

    model: Model
    settings: OnlineSettings
    known: OnlineKnowledge
    signals: Signals
    estimates: CycleEstimates
    anew: ca.SX


# Makes a further part, such as one that looks for contact.
MorePart = Callable[[Cycle], CyclePart]


def step_graph(
    model: Model,
    settings: OnlineSettings | None = None,
    more: Sequence[MorePart] = (),
    known: OnlineKnowledge | None = None,
) -> StepGraph:
    """One cycle: state and inputs to next state and outputs.

    Args:
        more: further parts, behind these in the state and in the outputs.
        known: numbers in place of those that the model gives.

    Raises:
        DeltaidError: settings and robot do not fit each other.
    """
    settings = settings or OnlineSettings()
    known = known or knowledge(model, settings)
    anew, touched = ca.SX.sym("anew"), ca.SX.sym("touched")
    read, first = signals(model, known, settings, anew)
    bounds = friction_bounds(model, known, settings.friction_range)
    found = estimates(read, known, settings, touched, bounds)
    cycle = Cycle(model, settings, known, read, found, anew)
    parts = [
        first,
        found.part,
        friction_part(model, known, found.behind.x[read.at_friction], bounds),
        *(make(cycle) for make in more),
    ]
    graph = assembled(read.inputs, read.u, read.good, parts, settings.period)
    following = {kept.field.name: kept.following for part in parts for kept in part.kept}
    contact = ca.if_else(following.get("contact_rests", ca.SX(0)) > 0, 1.0, 0.0)
    x, y = ca.substitute([graph.following, graph.y], [anew], [found.changed])
    x, y = ca.substitute([x, y], [touched], [contact])
    return StepGraph(graph.state, graph.inputs, graph.outputs, graph.x, graph.u, x, y, graph.period)
