"""Platforms of two equal parts for whatever sees how these parts are turned.

Both half platforms are the same part, of which one is mounted turned by 180° about z. Parts only
translate, so torques show their masses alone, and both may be described in world axes. What carries
first and second moments, such as a base or a single strut, sees the second half turned.
"""

from dataclasses import replace

import casadi as ca
import numpy as np

from deltaid.mechanism.mechanism import Mechanism, MovingBody
from deltaid.mechanism.rotation import Rotation
from deltaid.mechanism.vectors import fixed

_HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def with_turned_half(mechanism: Mechanism) -> Mechanism:
    """The same mechanism with its second half platform turned; itself where there is none."""
    parts = mechanism.platform
    if len(parts) < 2 or parts[0].name != parts[1].name:
        return mechanism
    second = _turned(parts[1])
    bodies = tuple(second if body is parts[1] else body for body in mechanism.bodies)
    return replace(mechanism, bodies=bodies, platform=(parts[0], second, *parts[2:]))


def _turned(body: MovingBody) -> MovingBody:
    turn: ca.SX = fixed(_HALF_TURN)
    was = body.rotation
    return replace(body, rotation=Rotation(was.R @ turn, turn.T @ was.w, turn.T @ was.alpha))
