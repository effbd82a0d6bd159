"""Factor files of simulated recordings, drawn without simulating a sample: a year in seconds.

A few recordings of a type are simulated and gathered once, with courses of noise N as further
columns beside the gathered ones G. Triangles of [G, N] then tell what any other robot of the type
with any friction, load and noise would have given on these motions: with truth θ over the columns
G, and weights a of the courses, the factor of [G, Gθ + Na] is that of R_G, R_Gθ + R_N a. Filters,
stretches, places and their sums are those of a true recording, and so is the noise's correlation.

    kind = drawn_type(load_robot("clavel-delta3"))         # seconds: simulates some recordings
    file = kind.drawn("robot 7", day=31, p=truth, temperature=24.0, seed=3)    # a millisecond

`p` is over `kind.dynamics.layout`. Friction of that day and temperature is the caller's:
`at_temperature` and `made_alike` below help. A robot's files go to `identify_gathered` as
those of `gathered` do. Columns of lags and of what gears carry are those of the described robot.
`python benchmarks/drawn_against_simulated.py` compares drawn recordings with truly simulated ones.
"""

import hashlib
import sys
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import polars as pl
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from courses import Courses
from deltaid.check.identified import identify
from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.dynamics.parameters import ParameterLayout, prior_parameters
from deltaid.factors.condensed import Condensed, Group, Groups
from deltaid.factors.file import FactorFile
from deltaid.factors.gather import condensed, gathered_columns, with_geometry
from deltaid.factors.problem import merging_of
from deltaid.factors.record import FactorRecord, Temperature
from deltaid.factors.record_of import record_of
from deltaid.factors.target import map_to
from deltaid.identification.load_columns import LoadColumns
from deltaid.model.record import Settings
from deltaid.motion.random_motion import random_motion
from deltaid.motion.surrogate import SensorNoise, simulate_recording
from deltaid.recording.carried import Load
from deltaid.recording.mapping import ColumnMapping
from deltaid.robot.description import RobotDescription
from deltaid.robot.inertia import PSEUDO_INERTIA_ENTRIES, inertia_parameters, pseudo_inertia

RATE = 500.0
# Courses of white noise, and of friction that wanders, and how long the latter remembers [s].
WHITE, WANDERING, MEMORY = 72, 16, 0.15
SETTINGS = Settings(cutoff=15.0, friction="described", events=False, lag="none")


@dataclass(frozen=True)
class Sensing:
    """What torques are recorded with.

    Attributes:
        torque: white noise at the sampling rate, a share of each drive's largest torque.
        wander: by how much a drive's Coulomb friction wanders within a recording, as a share.
    """

    torque: float = 0.02
    wander: float = 0.01


@dataclass(frozen=True, eq=False)
class Template:
    """A recording with courses of noise.

    Attributes:
        record: of what was gathered.
        condensed: over gathered columns and courses.
        names: of the gathered columns.
        truth: parameters that it was simulated with.
        load: truth of what was held (ten parameters), if anything.
    """

    record: FactorRecord
    condensed: Condensed
    names: tuple[str, ...]
    truth: np.ndarray
    load: np.ndarray | None = None

    @cached_property
    def layout(self) -> ParameterLayout:
        """Of the robot's parameters."""
        return compiled(self.record.robot).layout

    @cached_property
    def to_columns(self) -> np.ndarray:
        """From parameters, those of loads behind them, to gathered columns."""
        found = FactorFile(self.record, replace(self.condensed, names=self.names))
        merging = merging_of([found], self.record.robot, SETTINGS)
        loads = [one for one in merging.additions if isinstance(one, LoadColumns)]
        T = map_to(merging.columns, merging.dynamics, loads)
        wide = np.zeros((len(self.names), T.shape[1]))  # lags are no parameters
        for k, name in enumerate(merging.columns.kept_names):
            wide[self.names.index(name)] = T[k]
        return wide

    @cached_property
    def groups(self) -> list[tuple[Group, list[tuple[np.ndarray, np.ndarray]]]]:
        """The whole and every group, with R_G and R_N of each drive."""
        n, found = len(self.names), []
        for group in (self.condensed.whole, *self.condensed.groups):
            split = []
            for R, at in zip(group.factors, self.condensed.felt, strict=True):
                own = int(np.sum(at < n))
                rows = int(np.flatnonzero(np.any(R != 0, axis=1))[-1]) + 1
                split.append((R[:own, :own], R[:rows, own:-1]))
            found.append((replace(group, factors=()), split))
        return found

    def with_load(self, p: np.ndarray) -> np.ndarray:
        """Parameters with those of the load as columns have them."""
        if self.load is None:
            return p
        taken = [np.array(one.taken) for one in self.record.loads]
        return np.concatenate([p, *(self.load - one for one in taken)])


@dataclass(frozen=True, eq=False)
class DrawnType:
    """A type of robots, of which recordings can be drawn.

    Attributes:
        robot: as described.
        templates: without load.
        loaded: with a load that is held in cycles.
    """

    robot: RobotDescription
    templates: tuple[Template, ...]
    loaded: tuple[Template, ...]

    @property
    def dynamics(self) -> Dynamics:
        """Of the robot."""
        return compiled(self.robot)

    def drawn(
        self,
        name: str,
        day: int,
        p: np.ndarray,
        *,
        temperature: float | None = None,
        loaded: bool = False,
        sensing: Sensing | None = None,
        gain: np.ndarray | float = 1.0,
        seed: int = 0,
    ) -> FactorFile:
        """A recording of a robot.

        Args:
            name, day: of the recording; with `seed` they decide motion and noise.
            p: true parameters on that day.
            temperature: to be written down.
            loaded: whether a load is held in cycles.
            sensing: noise.
            gain: what torques are recorded at, in shares of the truth (one, or one a drive).
        """
        key = hashlib.sha256(f"{name} {day} {seed}".encode()).hexdigest()
        rng = np.random.default_rng(int(key[:16], 16))
        among = self.loaded if loaded else self.templates
        one = among[int(rng.integers(len(among)))]
        gains = np.broadcast_to(gain, len(self.robot.drives))
        found = _drawn(one, p, rng, sensing or Sensing(), gains)
        return FactorFile(_record(one, key, f"{name}-{day:04d}", temperature, day), found, key[:12])


def drawn_type(
    robot: RobotDescription,
    *,
    motions: int = 3,
    loaded: int = 0,
    duration: float = 12.0,
    seed: int = 0,
    load: float = 0.5,
    settings: Settings = SETTINGS,
) -> DrawnType:
    """Simulate and gather the recordings that others are drawn from.

    Args:
        motions, loaded: how many, without and with a load.
        duration: of each [s].
        load: mass of the load [kg].
    """
    each = [_template(robot, seed + k, duration, None, settings) for k in range(motions)]
    with_load = [_template(robot, seed + k, duration, load, settings) for k in range(loaded)]
    return DrawnType(robot, tuple(each), tuple(with_load))


def at_temperature(
    robot: RobotDescription, p: np.ndarray, temperature: float, share: float = -0.01
) -> np.ndarray:
    """Parameters p of 25 °C with viscous friction at another temperature.

    Args:
        share: change a degree.
    """
    found, layout = p.copy(), compiled(robot).layout
    found[layout.viscous] *= np.exp(share * (temperature - 25.0))
    return found


def made_alike(
    robot: RobotDescription,
    p: np.ndarray,
    rng: np.random.Generator,
    *,
    body: float = 0.03,
    friction: float = 0.15,
) -> np.ndarray:
    """One robot of a type with parameters p in the mean.

    Free entries of each body's pseudo-inertia matrix are off by a share of √(M_ii M_jj),
    coefficients of joints by a share of themselves, all independently.
    """
    found, layout = p.copy(), compiled(robot).layout
    for name in layout.bodies:
        part = layout.body(name)
        M = pseudo_inertia(p[part])
        size, off = np.sqrt(np.outer(np.diag(M), np.diag(M))), np.zeros((4, 4))
        for entry in robot.bodies[name].free:
            i, j = PSEUDO_INERTIA_ENTRIES[entry]
            off[i, j] = off[j, i] = rng.standard_normal()
        found[part] = inertia_parameters(M + body * size * off)
    at = layout.coefficients
    found[at] *= 1.0 + friction * rng.standard_normal(at.stop - at.start)
    return found


def simulated(
    dynamics: Dynamics,
    p: np.ndarray,
    seed: int,
    duration: float,
    load: float | None,
    noise: float,
    noise_seed: int = 0,
) -> tuple[pl.DataFrame, np.ndarray | None]:
    """A recording on the motion of a seed, and what is held in it."""
    rng = np.random.default_rng([seed, 7])
    motion = random_motion(dynamics.kinematics, rng, period=0.8 * duration)
    sensing = SensorNoise(torque=noise)
    args = {"duration": duration, "rate": RATE, "noise": sensing}
    bare = simulate_recording(dynamics, p, motion, np.random.default_rng(noise_seed), **args)
    if load is None:
        return bare, None
    carrier = "EE" if "EE" in dynamics.layout.bodies else "P"
    c, own = np.array([0.01, -0.005, -0.05]), 4e-4 * load * np.eye(3)
    M = np.zeros((4, 4))
    M[:3, :3], M[:3, 3], M[3, :3], M[3, 3] = own + load * np.outer(c, c), load * c, load * c, load
    held, more = inertia_parameters(M), p.copy()
    more[dynamics.layout.body(carrier)] += held
    full = simulate_recording(dynamics, more, motion, np.random.default_rng(noise_seed), **args)
    state = np.sin(2 * np.pi * bare["t"].to_numpy() / 1.37) > 0.2
    tau = [f"tau{i + 1}" for i in range(dynamics.dof)]
    mixed = {one: np.where(state, full[one].to_numpy(), bare[one].to_numpy()) for one in tau}
    return bare.with_columns(
        *(pl.Series(one, x) for one, x in mixed.items()), pl.Series("gripper", state.astype(float))
    ), held


def _template(
    robot: RobotDescription, seed: int, duration: float, load: float | None, settings: Settings
) -> Template:
    """A recording of the described robot, gathered with courses of noise."""
    dynamics, p = compiled(robot), prior_parameters(robot)
    table, held = simulated(dynamics, p, seed, duration, load, 1e-3)
    mapping = None if load is None else ColumnMapping(load=Load(column="gripper"))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "log.parquet"
        table.write_parquet(path)
        result = identify(robot, [path], columns=mapping, settings=settings)
        problem, recording = result.problem, result.recordings[0]
        columns = gathered_columns(problem, recording)
        courses = Courses(_courses(table, dynamics, np.random.default_rng([seed, 8])), RATE)
        wide = replace(columns, additions=(*columns.additions, courses))
        found, quantities = with_geometry(condensed(wide, recording), wide, problem, recording)
    names = tuple(columns.names[k] for k in columns.kept)
    own = _own(found, len(names))
    record = record_of(robot, result, own, quantities)
    return Template(record, found, names, p, held)


def _own(found: Condensed, count: int) -> Condensed:
    """The gathered columns of what has been condensed with courses."""
    return replace(
        found, names=found.names[:count], felt=tuple(at[at < count] for at in found.felt)
    )


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


def _drawn(
    one: Template, p: np.ndarray, rng: np.random.Generator, sensing: Sensing, gain: np.ndarray
) -> Condensed:
    """Factors of a recording."""
    dof, n, layout, values = len(gain), len(one.names), one.layout, one.with_load(p)
    theta = one.to_columns @ values
    off = theta - one.to_columns @ one.with_load(one.truth)
    coulomb, a, felt = p[layout.coulomb][:dof], [], []
    for i, at in enumerate(one.condensed.felt):
        largest = one.condensed.whole.torque_max[i]
        white = sensing.torque * largest * rng.standard_normal(WHITE) / np.sqrt(WHITE)
        slow = sensing.wander * coulomb[i] * rng.standard_normal(WANDERING) / np.sqrt(WANDERING)
        a.append(np.concatenate([white, slow]))
        felt.append(at[at < n])

    def drawn(group: Group, split: list[tuple[np.ndarray, np.ndarray]]) -> Group:
        factors = []
        for i, (R, N) in enumerate(split):
            own, e = len(R), N @ a[i]
            square = np.zeros((own + 1, own + 1))
            square[:own, :own], square[:own, own] = R, R @ theta[felt[i]]
            square[: min(own, len(e)), own] += e[:own]
            square[own, own] = np.linalg.norm(e[own:])
            square[:, own] *= gain[i]
            factors.append(square)
        return replace(group, factors=tuple(factors))

    geometry = one.condensed.geometry
    if geometry is not None:
        factors = []
        for i, R in enumerate(geometry.factors):
            at = one.condensed.felt[i]
            own = len(felt[i])
            Y, D = R[:, :own], R[:, len(at) : -1]
            tau = R[:, -1] + Y @ off[felt[i]]
            factors.append(np.column_stack([Y, D, gain[i] * tau]))
        geometry = replace(geometry, factors=tuple(factors))
    whole, *groups = (drawn(*each) for each in one.groups)
    packed = Groups.of(groups)
    return replace(_own(one.condensed, n), whole=whole, groups=packed, geometry=geometry)


def _record(one: Template, key: str, log: str, temperature: float | None, day: int) -> FactorRecord:
    """The template's, with the recording's own name, checksum and temperature; not validated."""
    source = one.record.model.sources[0]
    fields = dict(source) | {"log": log, "sha256": key}
    model = dict(one.record.model) | {"sources": (type(source).model_construct(**fields),)}
    start = day * 86400.0
    own = dict(one.record) | {
        "model": type(one.record.model).model_construct(**model),
        "first": start + one.record.first,
        "last": start + one.record.last,
    }
    if temperature is not None:
        own["temperature"] = Temperature(mean=temperature, low=temperature, high=temperature)
    return FactorRecord.model_construct(**own)
