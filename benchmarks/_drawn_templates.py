"""Simulated recordings with courses of noise beside the gathered columns, to draw others from.

Why they tell what any other robot of the type would have given is said in `drawn_fleet.py`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import _alone  # noqa: F401
import numpy as np
import polars as pl
from scipy.signal import lfilter

from courses import Courses
from deltaid.checks.identify import identify
from deltaid.control.plant import loaded
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import ParameterLayout, prior_parameters
from deltaid.effects.load_columns import LoadColumns
from deltaid.fleets.factor_columns import map_to
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.factor_record import FactorGroups, FactorRecord
from deltaid.fleets.gather import condensed, gathered_columns, geometry_of, record_of
from deltaid.fleets.merged import merging_of
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import RigidBody

DURATION, RATE = 12.0, 500.0
# Mass that is held in cycles [kg], and noise of what others are drawn from.
LOAD, _NOISE = 0.5, 1e-3
# Courses of white noise, and of friction that wanders, and how long the latter remembers [s].
WHITE, WANDERING, MEMORY = 72, 16, 0.15
SETTINGS = Settings(cutoff=15.0, friction="described", events=False, lag="none")


@dataclass(frozen=True, eq=False)
class Template:
    """A recording with courses of noise.

    Attributes:
        file: with the record of what was gathered; groups are over gathered columns and courses.
        felt: indices of each drive's columns among these.
        truth: parameters that it was simulated with.
        load: truth of what was held (ten parameters), if anything.
    """

    file: FactorFile
    felt: tuple[np.ndarray, ...]
    truth: np.ndarray
    load: np.ndarray | None = None

    @property
    def record(self) -> FactorRecord:
        return self.file.record

    @property
    def names(self) -> tuple[str, ...]:
        """Those of the gathered columns."""
        return self.record.names

    @cached_property
    def layout(self) -> ParameterLayout:
        return compiled(self.record.robot).layout

    @cached_property
    def to_columns(self) -> np.ndarray:
        """From parameters, those of loads behind them, to gathered columns."""
        merging = merging_of([self.file.brief], self.record.robot, SETTINGS)
        loads = [addition for addition in merging.additions if isinstance(addition, LoadColumns)]
        T = map_to(merging.columns, merging.dynamics, loads)
        wide = np.zeros((len(self.names), T.shape[1]))  # lags are no parameters
        for k, name in enumerate(merging.columns.place):
            wide[self.names.index(name)] = T[k]
        return wide

    @cached_property
    def groups(self) -> tuple[FactorGroups, list[list[tuple[np.ndarray, np.ndarray]]]]:
        """The whole and every group behind it, with R_G and R_N of each drive and group."""
        n, found = len(self.names), []
        every = self.file.whole.joined(self.file.groups)
        for factors, places in zip(every.factors, self.felt, strict=True):
            own, split = int(np.sum(places < n)), []
            for R in factors:
                rows = int(np.flatnonzero(np.any(R != 0, axis=1))[-1]) + 1
                split.append((R[:own, :own], R[:rows, own:-1]))
            found.append(split)
        return every, found

    def with_load(self, p: np.ndarray) -> np.ndarray:
        """Parameters with those of the load as columns have them."""
        if self.load is None:
            return p
        taken = [np.array(load.taken) for load in self.record.loads]
        return np.concatenate([p, *(self.load - load for load in taken)])


def simulated(
    dynamics: Dynamics, p: np.ndarray, seed: int, noise: float, noise_seed: int = 0
) -> pl.DataFrame:
    """A recording on the motion of a seed."""
    rng = np.random.default_rng([seed, 7])
    motion = random_motion(dynamics.kinematics, rng, period=0.8 * DURATION)
    rng, sensing = np.random.default_rng(noise_seed), SensorNoise(torque=noise)
    return simulate_recording(dynamics, p, motion, rng, duration=DURATION, rate=RATE, noise=sensing)


def _loaded(dynamics: Dynamics, p: np.ndarray, seed: int) -> tuple[pl.DataFrame, np.ndarray]:
    """A recording with a load that is held in cycles, and the load's ten parameters."""
    held = RigidBody.centred(LOAD, (0.01, -0.005, -0.05), 4e-4 * LOAD * np.eye(3)).p
    more = loaded(dynamics.robot, p, held)
    bare, full = (simulated(dynamics, each, seed, _NOISE) for each in (p, more))
    state = np.sin(2 * np.pi * bare["t"].to_numpy() / 1.37) > 0.2
    tau = [f"tau{i + 1}" for i in range(dynamics.dof)]
    mixed = [pl.Series(x, np.where(state, full[x].to_numpy(), bare[x].to_numpy())) for x in tau]
    return bare.with_columns(*mixed, pl.Series("gripper", state.astype(float))), held


def template(robot: RobotDescription, seed: int, *, is_loaded: bool) -> Template:
    """A recording of the described robot, gathered with courses of noise."""
    dynamics, p = compiled(robot), prior_parameters(robot)
    if is_loaded:
        table, held = _loaded(dynamics, p, seed)
        mapping = ColumnMapping(load=Load(column="gripper"))
    else:
        table, held, mapping = simulated(dynamics, p, seed, _NOISE), None, None
    result = identify(robot, table, columns=mapping, settings=SETTINGS)
    problem, recording = result.problem, result.recordings[0]
    columns = gathered_columns(problem, recording)
    courses = _courses(table, dynamics, np.random.default_rng([seed, 8]))
    beside = Courses(columns.dynamics, courses, RATE)
    wide = replace(columns, additions=(*columns.additions, beside))
    geometry, quantities = geometry_of(wide, problem, recording)
    record = record_of(robot, result, columns, quantities)
    file = FactorFile(record, *condensed(wide, recording), geometry)
    return Template(file, wide.of_drives, p, held)


def _courses(table: pl.DataFrame, dynamics: Dynamics, rng: np.random.Generator) -> np.ndarray:
    """White noise of one, and wandering steps of friction of one, for every drive."""
    rows, dof = len(table), dynamics.dof
    white = rng.standard_normal((WHITE, dof, rows))
    memory = np.exp(-1.0 / (MEMORY * RATE))
    noise = rng.standard_normal((WANDERING, dof, rows + 4000))
    slow = lfilter([np.sqrt(1 - memory**2)], [1, -memory], noise)
    t = table["t"].to_numpy()
    q = np.stack([table[f"q{i + 1}"].to_numpy() for i in range(dof)])
    sign = np.sign(np.gradient(q, t, axis=1))
    return np.concatenate([white, slow[:, :, 4000:] * sign])
