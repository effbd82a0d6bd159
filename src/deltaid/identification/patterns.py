"""What a residual may look like: columns that follow from speed, position, time, load or drive.

Each `Pattern` is a group of columns that one cause would add to the torques, to first order in its
size. What parameters can take of them is taken away before they are compared with a residual.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from deltaid.dynamics.dynamics import Parameters
from deltaid.estimation.drive_rows import DriveRows
from deltaid.estimation.span import Rows, Span
from deltaid.identification.information import active_columns
from deltaid.identification.trace_rows import parameters_of
from deltaid.identification.traces import Trace
from deltaid.recording.windows import Samples

# Stribeck speeds, as shares of a joint's largest.
_SLOW = (0.03, 0.08, 0.2)
# Time constants of warming up, as shares of the recording.
_WARM = (0.1, 0.25, 0.6)
# Steps [rad or m] that the slope by a drive's zero is taken with.
_ZERO = 1e-4
# Sweeps of a fit with a factor for each drive; directions that show less are left out.
_SWEEPS, _SHOWN = 3, 0.05
# Decades that torques over the place must be more surprising: so many shapes bend to noise that is
# not quite white.
_BENDS = 6.0

Stack = Float[np.ndarray, "dof samples"]


@dataclass(frozen=True, eq=False)
class Pattern:
    """Columns that one cause would add.

    Attributes:
        kind: of the cause.
        subject: the drive or joint; empty for all together.
        columns: as rows of all drives.
        words: what the torque follows, for messages.
        tries: how many of its like it was chosen from, as a decimal logarithm.
        detail: what was found beside, such as times.
    """

    kind: str
    subject: str
    columns: Float[np.ndarray, "rows columns"]
    words: str = ""
    tries: float = 0.0
    detail: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class _Joint:
    """A joint with friction: where its viscous and Coulomb entries are, and its largest speed."""

    name: str
    rows: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    fastest: float


@dataclass(frozen=True, eq=False)
class Scene:
    """A recording, what parameters explain of it, and the fitted parameters.

    Attributes:
        trace: the recording.
        Y: the active columns of its regressor, filtered.
        rows, span: its samples as rows, and what these columns explain of them.
        tau: its torques as rows.
    """

    trace: Trace
    Y: Float[np.ndarray, "dof samples columns"]
    rows: DriveRows
    span: Span
    tau: Rows

    @cached_property
    def p(self) -> Parameters:
        """Of least squares."""
        return parameters_of(self.trace.dynamics, self.span, self.tau)

    @property
    def drives(self) -> tuple[str, ...]:
        """Names."""
        return self.trace.dynamics.robot.drives

    @cached_property
    def motion(self) -> Samples:
        """At the filtered samples."""
        return self.trace.motion()

    @cached_property
    def model(self) -> Stack:
        """Torques of p."""
        return self.trace.model(self.p)

    @cached_property
    def scaled_model(self) -> Stack:
        """Torques of parameters that are fitted together with a factor for every drive.

        τ_i = (1 + g_i) Y_i p, by Gauss–Newton. What torques hardly show of the factors, such as one
        common to all, stays 1.
        """
        model = self.model
        for _ in range(_SWEEPS):
            own = self.rows.own(model)
            bare = self.span.without(own)
            gain = np.linalg.lstsq(bare, self.span.without(self.tau), rcond=_SHOWN)[0]
            model = self.Y @ self.span.coefficients(self.tau - own @ gain)
        return model

    def column(self, name: str) -> Stack:
        """One parameter's column of Y."""
        dynamics = self.trace.dynamics
        at = np.searchsorted(active_columns(dynamics), dynamics.layout.names.index(name))
        return self.Y[:, :, at]

    def shows(self, name: str) -> bool:
        """Whether a parameter has a column."""
        dynamics = self.trace.dynamics
        return dynamics.layout.names.index(name) in active_columns(dynamics)

    def patterns(self) -> Iterator[Pattern]:
        """All but ripples and changes of load, which are searched for."""
        yield from self._lags()
        yield from self._gains()
        yield from self._friction()
        yield from self._drifts()
        yield from self._zeros()
        yield from self._positions()

    def _lags(self) -> Iterator[Pattern]:
        slope = self.trace.slopes(self.p)
        yield Pattern("torque-lag", "", self.rows.stack(slope)[:, None])
        yield Pattern("torque-lag", "", self.rows.own(slope))

    def _gains(self) -> Iterator[Pattern]:
        own = self.rows.own(self.scaled_model)
        for i, drive in enumerate(self.drives):
            yield Pattern("drive-gain", drive, own[:, [i]])
        yield Pattern("drive-gain", "", own)

    def _friction(self) -> Iterator[Pattern]:
        """Of each joint and of all: other friction near rest, at speed, by direction, by load."""
        joints = self._joints
        laws = [f"near {share:g}" for share in _SLOW] + ["square", "root"]
        values = dict(zip([joint.name for joint in joints], self._laws(), strict=True))
        for k, law in enumerate(laws):
            each = np.stack([self.rows.stack(values[j.name][k]) for j in joints], axis=1)
            coulomb = np.array([self._size(f"coulomb.{j.name}") for j in joints])
            words = _WORDS[law.split()[0]]
            yield Pattern("friction-law", "", (each @ coulomb)[:, None], words)
            yield Pattern("friction-law", "", each, words)
            for i, joint in enumerate(joints):
                yield Pattern("friction-law", joint.name, each[:, [i]], words)
        ways, loads = [], []
        for joint in joints:
            if joint.name in self.drives:
                one = [self.rows.stack(x) for x in values[joint.name][len(laws) :]]
                ways.append(np.stack(one[:2], axis=1))
                loads.append(one[2])
                yield Pattern("friction-law", joint.name, ways[-1], _WORDS["way"])
                yield Pattern("friction-law", joint.name, loads[-1][:, None], _WORDS["load"])
        if ways:
            offsets = np.stack([way[:, 0] for way in ways], axis=1)
            yield Pattern("friction-law", "", offsets, _WORDS["way"])
            yield Pattern("friction-law", "", np.hstack(ways), _WORDS["way"])
            yield Pattern("friction-law", "", np.stack(loads, axis=1), _WORDS["load"])

    def _laws(self) -> list[list[Stack]]:
        """For each joint torques of further terms of its friction, at a coefficient of 1."""
        dof, dynamics, joints = len(self.drives), self.trace.dynamics, self._joints
        drives = [self.drives.index(j.name) if j.name in self.drives else None for j in joints]

        def values(w: Samples) -> np.ndarray:
            load = dynamics.carried(w.z, w.qd, w.qdd, self.p)
            entries, laws = dynamics.sparse_regressor(w.z, w.qd, w.qdd, load).values, []
            for joint, drive in zip(joints, drives, strict=True):
                C, V = entries[joint.coulomb], entries[joint.viscous]
                speed = np.abs(V).max(axis=0) / np.maximum(np.abs(C).max(axis=0), 1e-300)
                x = speed / joint.fastest
                laws += [C * np.exp(-x / share) for share in _SLOW] + [C * x**2, C * np.sqrt(x)]
                if drive is not None:
                    laws += [np.ones_like(C), C * V, C * np.abs(load[:, drive])]
            return np.concatenate(laws)

        counts = [len(_SLOW) + 2 + (0 if drive is None else 3) for drive in drives]
        rows = [np.tile(j.rows, n) for j, n in zip(joints, counts, strict=True)]
        if not rows:
            return []
        filtered = self.trace.filtered(values, np.concatenate(rows))
        ends = np.cumsum([len(one) for one in rows])[:-1]
        result: list[list[Stack]] = []
        for joint, part in zip(joints, np.split(filtered, ends), strict=True):
            laws = part.reshape(-1, len(joint.rows), part.shape[1])
            full = np.zeros((len(laws), dof, part.shape[1]))
            full[:, joint.rows] = laws
            result.append(list(full))
        return result

    def _drifts(self) -> Iterator[Pattern]:
        """Friction that changes with time, of one joint or all alike; an offset that does."""
        time = self.motion.time
        share = (time - time[0]) / (time[-1] - time[0])
        courses = [("steadily", share - 0.5)]
        courses += [("as in warming up", np.exp(-share / constant)) for constant in _WARM]
        parts = [
            self.column(f"viscous.{j.name}") * self._size(f"viscous.{j.name}")
            + self.column(f"coulomb.{j.name}") * self._size(f"coulomb.{j.name}")
            for j in self._joints
        ]
        for words, course in courses:
            if parts:
                each = np.stack([self.rows.stack(part * course) for part in parts], axis=1)
                yield Pattern("drift", "", each.sum(axis=1)[:, None], words)
                yield Pattern("drift", "", each, words)
                for i, joint in enumerate(self._joints):
                    yield Pattern("drift", joint.name, each[:, [i]], words)
            offset = self.rows.own(self.motion.weights.T * course)
            for i, drive in enumerate(self.drives):
                yield Pattern("drift", drive, offset[:, [i]], words)

    def _zeros(self) -> Iterator[Pattern]:
        """Slopes of the torques by the zero of each drive; a tilted base looks much the same."""
        w, dynamics = self.motion, self.trace.dynamics
        q, at = dynamics.kinematics.inverse(w.z), dynamics.torque(w.z, w.qd, w.qdd, self.p)
        columns = []
        for i in range(len(self.drives)):
            moved = q.copy()
            moved[:, i] += _ZERO
            z, good = dynamics.kinematics.forward_unchecked(moved)
            slope = (dynamics.torque(z, w.qd, w.qdd, self.p) - at) / _ZERO
            slope[~good] = 0.0
            columns.append(self.rows.stack((slope * w.weights).T))
            yield Pattern("homing-or-tilt", self.drives[i], columns[-1][:, None])
        yield Pattern("homing-or-tilt", "", np.stack(columns, axis=1))

    def _positions(self) -> Iterator[Pattern]:
        """Torques that bend with the platform's place, alone and times what the drive gives."""
        w = self.motion
        middle, reach = w.z.mean(axis=0), np.maximum(np.ptp(w.z, axis=0), 1e-12)
        x = (w.z - middle) / reach
        dof = x.shape[1]
        shapes = [x[:, i] for i in range(dof)]
        shapes += [x[:, i] * x[:, j] for i in range(dof) for j in range(i, dof)]
        alone = [self.rows.own(w.weights.T * shape) for shape in shapes]
        times = [self.rows.own(self.model * shape) for shape in shapes[:dof]]
        for i, drive in enumerate(self.drives):
            columns = np.stack([one[:, i] for one in (*alone, *times)], axis=1)
            yield Pattern("geometry-or-cogging", drive, columns, _WORDS["place"], _BENDS / dof)
        everything = np.hstack(alone + times)
        yield Pattern("geometry-or-cogging", "", everything, _WORDS["place"], _BENDS)

    def _size(self, name: str) -> float:
        return float(self.p[self.trace.dynamics.layout.names.index(name)])

    @cached_property
    def _joints(self) -> list[_Joint]:
        """Joints with friction that move."""
        dynamics, w = self.trace.dynamics, self.motion
        rows, columns = dynamics.regressor_pattern
        names = np.array(dynamics.layout.names)[columns]
        entries = dynamics.sparse_regressor(w.z, w.qd, w.qdd, np.zeros_like(w.tau)).values
        found = []
        for joint in dynamics.robot.friction_joints:
            viscous = np.flatnonzero(names == f"viscous.{joint}")
            coulomb = np.flatnonzero(names == f"coulomb.{joint}")
            C, V = np.abs(entries[coulomb]).max(axis=0), np.abs(entries[viscous]).max(axis=0)
            fastest = float(np.max(V / np.maximum(C, 1e-300), where=C > 0, initial=0.0))
            if fastest > 0:
                found.append(_Joint(joint, rows[coulomb], viscous, coulomb, fastest))
        return found


_WORDS = {
    "near": "more friction at low speed",
    "square": "friction that grows with the square of speed",
    "root": "friction that flattens with speed",
    "way": "friction that differs by direction",
    "load": "friction that grows with the load",
    "place": "the place of the platform",
}
