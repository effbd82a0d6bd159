"""What runs while the robot runs (`deltaid.online`) as an entry of an export: `--with online`."""

import casadi as ca
import numpy as np

from deltaid.errors import Doubt
from deltaid.exports.functions import ExportedCycle
from deltaid.model.model import Model
from deltaid.online.contact_part import standard_parts
from deltaid.online.cycle import step_graph
from deltaid.online.settings import OnlineSettings

NO_CONTACT = Doubt(
    "the online cycle finds loads, and no contacts",
    cause="the model is a robot's prior: without an identification nothing says how far its "
    "torques may be off",
    cure="identify a model from a recording first, `deltaid identify`",
)


def online_cycle(subject: Model, settings: OnlineSettings) -> ExportedCycle:
    """One cycle: payload, friction and, for an identified model, contact.

    What becomes of the state where an input is no finite number follows from the graph itself: NaN
    in place of inputs folds to constants whatever depends on them.

    Raises:
        DeltaidError: settings and robot do not fit each other.
    """
    more = standard_parts(subject)
    graph = step_graph(subject, settings, more)
    none = ca.SX(ca.DM(np.full(graph.inputs.size, np.nan)))
    spoilt, spoilt_y = ca.substitute([graph.following, graph.y], [graph.u], [none])
    return ExportedCycle(
        "online",
        f"Payload, friction{' and contact' if more else ''} while the robot runs: one cycle of "
        f"{settings.period:.9g} s. The parameters of the model are inside, not in the table.",
        graph.state,
        graph.inputs,
        graph.outputs,
        graph.x,
        graph.u,
        graph.following,
        graph.y,
        spoilt,
        spoilt_y,
    )
