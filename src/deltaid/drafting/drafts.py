"""From answers to a description that has been checked, group by group."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

from deltaid.check.priors import checked_priors
from deltaid.check.run import of_robot
from deltaid.check.verdict import Grade, Verdict
from deltaid.check.workspace import checked_workspace
from deltaid.drafting.draft import Draft
from deltaid.drafting.questions import Group, asked
from deltaid.drafting.text import written
from deltaid.drafting.workspace import find_space, height
from deltaid.errors import DeltaidError
from deltaid.robot.description import RobotDescription
from deltaid.robot.load import described_in

_SPACE = ("radius", "low", "high")
# Where the workspace is looked for stands a small one first: its size as a share of the struts'.
_FIRST = 0.02


def description(draft: Draft) -> RobotDescription:
    """The robot that a complete draft describes.

    Raises:
        DeltaidError: its numbers contradict each other.
    """
    return described_in(written(draft), f"{draft.name}.yaml")


def require_group(draft: Draft, group: Group) -> Draft:
    """A draft whose answers so far go together, with what they make known.

    Raises:
        DeltaidError: they do not, with what was seen and how to mend it.
    """
    _require_ordered(draft.values)
    if group in ("lengths", "tool"):
        return _with_space(draft)
    if group == "masses":
        _refuse(checked_priors(description(draft.completed())))
    if group == "motors":
        found = checked_workspace(description(draft.completed()))
        _refuse(verdict for verdict in found if verdict.key == "torque-limit")
    if group == "workspace":
        complete = draft.completed()
        _require_ordered(complete.values)
        _refuse(of_robot(description(complete)))
        return complete
    return draft


def _with_space(draft: Draft) -> Draft:
    """A draft that knows what its robot reaches, as what is assumed of its workspace.

    Raises:
        DeltaidError: the lengths do not go together, or nothing is within reach.
    """
    draft = _own_space(draft)
    bare = replace(
        draft,
        values={k: v for k, v in draft.values.items() if k not in _SPACE},
        offered={k: v for k, v in draft.offered.items() if k not in _SPACE},
    )
    a = _found(bare, 1.0, -2.0, -1.0).completed().values
    _require_ordered(a)
    middle, half = height(draft.kind, a), _FIRST * a["strut"]
    if middle <= 2 * half:
        raise DeltaidError(
            "the platform would stand beside or above its base, where no workspace is looked for",
            where="--strut",
            cure="a longer strut, or rails that reach farther down",
        )
    trial = _found(bare, half, -middle - half, -middle + half).completed()
    space = find_space(_with_any_stroke(description(trial)), middle, a["strut"])
    return _found(draft, space.radius, space.low, space.high)


def _own_space(draft: Draft) -> Draft:
    """Without the workspace of the robot it starts from, if other lengths were given."""
    keys = [question.key for question in asked(draft.kind) if question.group == "lengths"]
    same = all(draft.values.get(k, draft.offered.get(k)) == draft.offered.get(k) for k in keys)
    if same:
        return draft
    return replace(draft, offered={k: v for k, v in draft.offered.items() if k not in _SPACE})


def _with_any_stroke(robot: RobotDescription) -> RobotDescription:
    """The stroke that is assumed of a telescope follows from the workspace, and not the reverse."""
    if robot.telescope is None:
        return robot
    return robot.changed(telescope=robot.telescope.changed(stroke=None))


def _found(draft: Draft, radius: float, low: float, high: float) -> Draft:
    return replace(draft, found={"found_radius": radius, "found_low": low, "found_high": high})


def _require_ordered(a: Mapping[str, float]) -> None:
    """Ranges have a lower and an upper end."""
    for low, high in (("angle_low", "angle_high"), ("rail_low", "rail_high"), ("low", "high")):
        if low in a and high in a and a[low] >= a[high]:
            raise DeltaidError(
                f"must be more than --{low.replace('_', '-')}, {a[low]:g}, and is {a[high]:g}",
                where=f"--{high.replace('_', '-')}",
            )


def _refuse(found: Iterable[Verdict]) -> None:
    """Raise the first verdict that is not good."""
    for verdict in found:
        if verdict.grade is not Grade.GOOD:
            raise DeltaidError(verdict.seen, where=verdict.subject, cure=verdict.cure)
