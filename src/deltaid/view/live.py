"""The live view: a browser window with a draggable platform, by viser, an optional library."""

import contextlib
import io
import threading
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.limits import AtRest
from deltaid.libraries import require
from deltaid.mechanism.skeleton import Skeleton
from deltaid.view import style
from deltaid.view.animation import outward_faces
from deltaid.view.at_pose import View, moved, panel, standing
from deltaid.view.drawing import Placement, along, members, outline_segments
from deltaid.view.own_page import HOST, answering_own_page_only
from deltaid.view.reach import limit_kinds, patches, reach

# Usual port of a local server.
DEFAULT_PORT = 8080
# Position of the camera, in multiples of the robot's size.
_FROM = np.array([1.3, 1.0, 0.35])
# Number of sides of a cylinder, enough to look round.
_SIDES = 16
# Factor on the brightness of colours, which the lamps would bleach.
_SHADE = 0.7


def require_viser() -> ModuleType:
    """The library of the live view.

    Raises:
        DeltaidError: it is not installed.
    """
    require("viser", by="--live", name="viser", install="pip install viser; --report needs nothing")
    return import_module("viser")


class LiveView:
    """A robot in a browser window, and the server behind it.

    The window shows `view` and only requests poses.

    Args:
        robot: to be shown.
        port: that the server listens on, on this machine only; 0 for any free one.

    Raises:
        DeltaidError: viser is not installed.
    """

    def __init__(self, robot: AtRest, port: int = 0) -> None:
        viser = require_viser()
        self.robot = robot
        self.view: View = standing(robot, robot.home)
        self._lock = threading.RLock()
        with _silence(), answering_own_page_only():
            self.server = viser.ViserServer(HOST, port, robot.robot.name, verbose=False)
        self.server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._skeleton = Skeleton(robot.robot, robot.dynamics.kinematics.mechanism)
        points = self._skeleton.evaluate(robot.home[None]).reshape(-1, 3)
        self._size = float(np.ptp(points, axis=0).max())  # of the robot at home [m]
        self._bars = self._add_robot()
        self._add_surroundings()
        self._target = self.server.scene.add_transform_controls(
            "/target",
            scale=0.2 * self._size,
            disable_rotations=True,
            depth_test=False,
            position=self.view.z[:3],
        )
        self._target.on_update(self._dragged)
        self._inputs = self._add_inputs()
        self._panel = self.server.gui.add_html(panel(self.view))

    @property
    def url(self) -> str:
        """Address of the live view."""
        return f"http://{HOST}:{self.server.get_port()}"

    def move(self, wanted: Float[np.ndarray, " dof"], *, dragging: bool = False) -> View:
        """Request a pose and show the result; the handle is not moved while the user drags it."""
        with self._lock:
            self.view = moved(self.robot, self.view, wanted)
            self._draw(dragging)
            return self.view

    def close(self) -> None:
        """Stop the server behind the view."""
        with _silence():
            self.server.stop()

    def _draw(self, dragging: bool) -> None:
        with self.server.atomic():
            for body, placed in self._placements().items():
                bars = self._bars[body]
                bars.batched_positions = placed.positions.astype(np.float32)
                bars.batched_wxyzs = placed.wxyz.astype(np.float32)
                bars.batched_scales = placed.scales.astype(np.float32)
            self._inputs["point"].value = tuple(np.round(self.view.z[:3], 4))
            if not dragging:
                self._target.position = self.view.z[:3]
                if "turn" in self._inputs:
                    self._inputs["turn"].value = round(float(np.rad2deg(self.view.z[3])), 2)
            self._panel.content = panel(self.view)

    def _placements(self) -> dict[str, Placement]:
        shapes, bodies = self._skeleton.evaluate(self.view.z[None])[0], self._skeleton.bodies
        owners = np.array([segment.body for segment in self._skeleton.segments])
        radii = {body: member.radius(self._size) for body, member in members(bodies).items()}
        return {body: along(shapes[owners == body], radius) for body, radius in radii.items()}

    def _add_robot(self) -> dict[str, Any]:
        corners, drawn = cylinder(), members(self._skeleton.bodies)
        return {
            body: self.server.scene.add_batched_meshes_simple(
                f"/robot/{body}",
                corners.astype(np.float32),
                outward_faces(corners).astype(np.uint32),
                placed.wxyz.astype(np.float32),
                placed.positions.astype(np.float32),
                batched_scales=placed.scales.astype(np.float32),
                batched_colors=_paint(drawn[body].color),
                lod="off",
            )
            for body, placed in self._placements().items()
        }

    def _add_surroundings(self) -> None:
        scene, reached = self.server.scene, reach(self.robot)
        scene.add_line_segments(
            "/workspace",
            outline_segments(self.robot.robot.workspace).astype(np.float32),
            _rgb(style.MEASURED),
            thickness=2.0,
            thickness_units="screen",
        )
        colors = limit_kinds(self.robot)
        region = scene.add_frame("/reach", show_axes=False, visible=False)
        for name, (points, faces) in patches(self.robot, reached).items():
            scene.add_mesh_simple(
                f"/reach/{name}",
                points.astype(np.float32),
                faces.astype(np.uint32),
                color=_paint(colors[name]),
                opacity=0.25,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
            )
        self.server.gui.add_checkbox(
            "reachable region", False, hint="where straight ways from home end, and at which limit"
        ).on_update(lambda event: setattr(region, "visible", event.target.value))
        scene.world_axes.visible = True
        scene.world_axes.axes_length, scene.world_axes.axes_radius = 0.15 * self._size, 0.003
        middle = self.robot.home[:3] * [1.0, 1.0, 0.6]
        self.server.initial_camera.look_at = middle
        self.server.initial_camera.position = middle + self._size * _FROM

    def _dragged(self, event: Any) -> None:
        """Move the robot with the handle, which snaps back to it when released; the message
        stays."""
        if event.phase == "end":
            with self._lock:
                self._draw(dragging=False)
        else:
            self.move(np.array([*event.target.position, *self.view.z[3:]]), dragging=True)

    def _add_inputs(self) -> dict[str, Any]:
        gui, turn = self.server.gui, self.robot.robot.turn
        inputs: dict[str, Any] = {
            "point": gui.add_vector3("platform [m]", tuple(self.view.z[:3]), step=0.001)
        }
        if self.robot.dynamics.dof > 3:
            low, high = (round(float(np.rad2deg(a)), 1) for a in (turn.low, turn.high))
            inputs["turn"] = gui.add_slider(
                "tool ψ [deg]",
                low,
                high,
                step=(high - low) / 720,
                initial_value=float(np.rad2deg(self.robot.home[3])),
            )
        for handle in inputs.values():
            handle.on_update(self._on_input)
        gui.add_button("home").on_click(lambda _: self.move(self.robot.home))
        return inputs

    def _on_input(self, event: Any) -> None:
        if event.client is not None:  # without a client, this program changed the number
            turn = [np.deg2rad(self._inputs["turn"].value)] if "turn" in self._inputs else []
            self.move(np.array([*self._inputs["point"].value, *turn]))


def cylinder() -> Float[np.ndarray, "corners 3"]:
    """Corners of a cylinder of radius 1 and length 1 along z, centred at the origin."""
    angle = 2 * np.pi * np.arange(_SIDES) / _SIDES
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.full(_SIDES, 0.5)])
    return np.concatenate([ring, ring * [1.0, 1.0, -1.0]])


def _silence() -> contextlib.redirect_stdout[io.StringIO]:
    return contextlib.redirect_stdout(io.StringIO())


def _paint(color: str) -> tuple[int, ...]:
    return tuple(round(_SHADE * part) for part in _rgb(color))


def _rgb(color: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(color[1:]))
