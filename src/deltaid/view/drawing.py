"""A still drawing of a robot with its bodies named, made of lines, for the head of a page."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from markupsafe import Markup

from deltaid.errors import visible
from deltaid.mechanism.kinematics import Kinematics
from deltaid.mechanism.skeleton import Skeleton
from deltaid.robot.body import body_in_words
from deltaid.robot.description import RobotDescription
from deltaid.view.page import Drawing
from deltaid.view.robot_shape import members

# The robot's largest width and height, the room for names at either side, their least distance,
# and what is free above the robot [px].
_WIDE, _HIGH, _NAMES, _LINE, _TOP = 320.0, 330.0, 132.0, 30.0, 16.0
# Towards the onlooker; slightly from above.
_EYE = np.array([1.6, 1.15, 0.75]) / np.linalg.norm([1.6, 1.15, 0.75])


@dataclass(frozen=True)
class _Label:
    """A body's name: what it points at, and on which side it stands."""

    body: str
    at: Float[np.ndarray, " 2"]
    left: bool


def drawing(robot: RobotDescription, kinematics: Kinematics) -> Drawing:
    """A robot in the middle of its workspace, seen from the side and slightly from above."""
    skeleton = Skeleton(robot, kinematics.mechanism)
    points = skeleton.evaluate(robot.within(0.0)[0][None])[0]
    bodies = tuple(segment.body for segment in skeleton.segments)
    flat, depth = _seen(points)
    width = float(flat[..., 0].max()) + _NAMES
    labels = _labels(bodies, flat)
    per_side = max(sum(label.left for label in labels), sum(not label.left for label in labels), 1)
    height = max(float(flat[..., 1].max()) + _TOP, _TOP + per_side * _LINE)
    drawn = members(skeleton.bodies)
    lines = [
        Markup('<line x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}" stroke="{}" '
               'stroke-width="{}"/>').format(*flat[i].ravel(), drawn[bodies[i]].color,
                                             0.7 * drawn[bodies[i]].width)
        for i in np.argsort(-depth)
    ]  # fmt: skip
    shown = [body for body in skeleton.bodies if body != "base"]
    others = [body for body in robot.body_names if body not in shown]
    told = ", ".join(f"{body} {body_in_words(body)}" for body in shown)
    svg = Markup(
        '<svg class="robot" viewBox="0 0 {:.0f} {:.0f}" role="img" aria-label="{}">'
        '<g stroke-linecap="round">{}</g>{}</svg>'
    ).format(width, height, f"Drawing of the robot: {visible(told)}", Markup("\n").join(lines),
             Markup("\n").join(_written(labels, width, height)))  # fmt: skip
    return Drawing(svg, tuple((name, body_in_words(name)) for name in (*shown, *others)))


def _seen(
    points: Float[np.ndarray, "segments 2 3"],
) -> tuple[Float[np.ndarray, "segments 2 2"], Float[np.ndarray, " segments"]]:
    """Ends of all segments in the picture [px], and how far away each is."""
    right = np.cross([0.0, 0.0, 1.0], _EYE)
    right /= np.linalg.norm(right)
    flat = np.stack([points @ right, -points @ np.cross(_EYE, right)], axis=-1)
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    scale = np.min(np.array([_WIDE, _HIGH]) / np.maximum(high - low, 1e-9))
    return scale * (flat - low) + np.array([_NAMES, _TOP]), -np.mean(points @ _EYE, axis=1)


def _labels(bodies: tuple[str, ...], flat: Float[np.ndarray, "segments 2 2"]) -> list[_Label]:
    """One name a body, at its longest parts, outside of the robot; as many left as right."""
    labels: list[_Label] = []
    for body in dict.fromkeys(bodies):
        own = flat[[i for i, name in enumerate(bodies) if name == body]]
        lengths = np.linalg.norm(own[:, 1] - own[:, 0], axis=1)
        middles = own.mean(axis=1)[lengths >= 0.5 * lengths.max()]
        left = 2 * sum(label.left for label in labels) <= len(labels)
        at = middles[np.argmin(middles[:, 0]) if left else np.argmax(middles[:, 0])]
        labels.append(_Label(body, at, left))
    return labels


def _written(labels: list[_Label], width: float, height: float) -> list[Markup]:
    """Names beside the robot in the order of what they point at, each with a thin line there."""
    parts = []
    for left in (True, False):
        own = sorted(
            (label for label in labels if label.left is left), key=lambda label: label.at[1]
        )
        edge, anchor = (_NAMES - 16, "end") if left else (width - _NAMES + 16, "start")
        for label, y in zip(own, _apart([label.at[1] for label in own], height), strict=True):
            start = edge + (5 if left else -5)
            parts.append(
                Markup('<line class="lead" x1="{:.1f}" y1="{:.1f}" x2="{:.1f}" y2="{:.1f}"/>'
                       '<circle class="lead" cx="{:.1f}" cy="{:.1f}" r="2.5"/>')
                .format(start, y, *label.at, *label.at)
            )  # fmt: skip
            parts.append(_name(edge, y, anchor, label.body, body_in_words(label.body)))
    return parts


def _name(x: float, y: float, anchor: str, short: str, words: str) -> Markup:
    """A short name, with what it stands for below it."""
    second = Markup('<tspan class="words" x="{:.1f}" dy="12">{}</tspan>').format(x, visible(words))
    if words == short:
        second = Markup("")
    return Markup('<text x="{:.1f}" y="{:.1f}" text-anchor="{}">{}{}</text>').format(
        x, y + 4 - (4 if second else 0), anchor, visible(short), second
    )


def _apart(wanted: list[float], height: float) -> list[float]:
    """Heights as near to those that are wanted as keeps them apart and in the picture, in order."""
    placed: list[float] = []
    for y in wanted:
        placed.append(max(y, placed[-1] + _LINE if placed else _TOP))
    low = height - _LINE + _TOP
    for i in range(len(placed) - 1, -1, -1):
        placed[i] = min(placed[i], low)
        low = placed[i] - _LINE
    return placed
