"""The robot in three dimensions: it goes where sliders or the dragged ball ask it to go."""

import asyncio
from typing import Any

import numpy as np
from nicegui import events, ui

from deltaid.studio.look import Problem
from deltaid.studio.pages import parts
from deltaid.studio.session import Session
from deltaid.studio.stand import Axis, Stage, Stand, stage, stand
from deltaid.view.at_pose import panel

# Of the ground and of the workspace's edges, on a light page and on a dark one.
_LIGHT, _DARK = ("#dfe5ea", "#66727d"), ("#2a3138", "#9aa6b0")
# three.js draws cylinders along y; parts are placed along z.
_Y_TO_Z = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


async def live(session: Session, name: str) -> None:
    """The robot, sliders for its platform, and readings of drives and limits."""
    robot, changed = session.place(name), session.stamped(name)
    with parts.waiting():
        found = await session.look(stage, robot, changed)
    if isinstance(found, Problem):
        parts.problem(found)
        return
    await _Live(session, (robot, changed), found).go()


class _Live:
    """A scene, and the pose that it was asked for last."""

    def __init__(self, session: Session, robot: tuple[str, str], found: Stage) -> None:
        self.session, self.robot, self.found = session, robot, found
        self.place = session.poses.get(robot, found.home)
        self.wanted, self.going = self.place, False
        with ui.element("div").classes("live"):
            with ui.element("div").classes("seen"):
                self._scene()
                with ui.row().classes("dim legend"):
                    for label, color in found.legend.items():
                        with ui.row().classes("items-center no-wrap"):
                            ui.element("span").classes("swatch").style(f"background: {color}")
                            ui.label(label)
                    ui.label("Drag the ball, or turn and zoom with the mouse.")
            with ui.element("div").classes("asked"):
                ui.label("Where the platform is to be").classes("text-weight-bold")
                self.sliders = [self._slider(k, axis) for k, axis in enumerate(found.axes)]
                ui.button("Home", on_click=lambda: self._put(found.home)).props(
                    "outline dense no-caps"
                )
                self.readings = ui.html(sanitize=False).props("role=status")

    def _scene(self) -> None:
        size = self.found.size
        ground, edges = _DARK if self.session.dark else _LIGHT
        self.scene = ui.scene(
            height=440, grid=False, background_color=ground, click_events=[],
            on_drag_end=lambda event: self._put((event.x, event.y, event.z, *self.wanted[3:])),
        ).classes("w-full")  # fmt: skip
        self.scene.props('role=img aria-label="The robot, in three dimensions"')
        with self.scene:
            for start, end in self.found.edges:
                self.scene.line(start.tolist(), end.tolist()).material(edges)
            self.bars = [
                self.scene.cylinder(1, 1, 1, 12).material(color) for color in self.found.colors
            ]
            self.ball = self.scene.sphere(0.022 * size).material("#e8a200").draggable()
        middle = np.array(self.found.home[:3]) * [1, 1, 0.55]
        eye = middle + size * np.array([1.0, 0.78, 0.25])
        self.scene.move_camera(*eye.tolist(), *middle.tolist(), duration=0)

    def _slider(self, k: int, axis: Axis) -> Any:
        def ask(event: events.ValueChangeEventArguments[float | None]) -> None:
            asked = self.found.home[k] if event.value is None else event.value
            value.set_text(_text(asked, axis))
            if abs(asked - self.wanted[k]) > 1e-9:
                self.ask(tuple(asked if i == k else w for i, w in enumerate(self.wanted)))

        with ui.row().classes("items-center w-full no-wrap"):
            ui.label(axis.name).classes("w-4")
            slider = ui.slider(
                min=axis.low, max=axis.high, step=(axis.high - axis.low) / 200, value=self.place[k]
            )
            slider.props(f'aria-label="platform {axis.name} [{axis.unit}]"').classes("grow")
            value = ui.label(_text(self.place[k], axis)).classes("number")
            slider.on_value_change(ask)
        return slider

    def _put(self, wanted: tuple[float, ...]) -> None:
        """Go somewhere that no slider has asked for: they follow."""
        self.ask(wanted)
        for slider, value in zip(self.sliders, wanted, strict=True):
            slider.set_value(value)

    def ask(self, wanted: tuple[float, ...]) -> None:
        """Go somewhere; of what is asked for on the way the last counts."""
        self.wanted = wanted
        if not self.going:
            asyncio.get_running_loop().create_task(self.go())

    async def go(self) -> None:
        """Move the robot until it is where it was asked to be last."""
        self.going = True
        try:
            asked = None
            while asked != self.wanted:
                asked = self.wanted
                found = await self.session.glance(stand, *self.robot, asked, self.place)
                if isinstance(found, Problem):
                    parts.warn(found)
                    return
                self._draw(found)
        finally:
            self.going = False

    def _draw(self, found: Stand) -> None:
        units = np.array([1.0 if axis.unit == "m" else np.rad2deg(1.0) for axis in self.found.axes])
        self.place = tuple((found.view.z * units).tolist())
        self.session.poses = {self.robot: self.place}
        for k, (bar, radius) in enumerate(zip(self.bars, self.found.radii, strict=True)):
            bar.move(*found.middles[k].tolist())
            bar.rotate_R((found.turns[k] @ _Y_TO_Z).tolist())
            bar.scale(radius, float(found.lengths[k]), radius)
        self.ball.move(*self.place[:3])
        self.readings.set_content(panel(found.view))


def _text(value: float, axis: Axis) -> str:
    return f"{value:.3f} m" if axis.unit == "m" else f"{value:.1f}°"
