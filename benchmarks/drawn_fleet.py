"""Factor files of simulated recordings, drawn without simulating a sample: a year in seconds.

A few recordings of a type are simulated and gathered once, with courses of noise N as further
columns beside the gathered ones G. Triangles of [G, N] then tell what any other robot of the type
with any friction, load and noise would have given on these motions: with truth θ over the columns
G, and weights a of the courses, the factor of [G, Gθ + Na] is that of R_G, R_Gθ + R_N a. Filters,
stretches, places and their sums are those of a true recording, and so is the noise's correlation.

    kind = drawn_type(load_robot("clavel-delta3"), 3)      # seconds: simulates some recordings
    file = kind.drawn("robot 7", day=31, p=truth, temperature=24.0, seed=3)    # a millisecond

`p` is over `kind.dynamics.layout`. Friction of that day and temperature is the caller's, and
`plants.made_alike` draws robots. A robot's files go to `identify_gathered` as those of `gathered`
do. Columns of lags and of what gears carry are those of the described robot.
`python benchmarks/drawn_against_simulated.py` compares drawn recordings with truly simulated ones.
"""

import hashlib
from dataclasses import dataclass, replace

import numpy as np
from _drawn_templates import WANDERING, WHITE, Template, template

from deltaid.dynamics.dynamics import Dynamics, compiled
from deltaid.fleets.factor_file import FactorFile
from deltaid.fleets.factor_record import FactorGroups, FactorRecord, Temperature
from deltaid.robot.description import RobotDescription

# White noise of torques at the sampling rate, a share of each drive's largest torque.
NOISE = 0.02


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
        return compiled(self.robot)

    def drawn(
        self,
        name: str,
        day: int,
        p: np.ndarray,
        *,
        temperature: float | None = None,
        loaded: bool = False,
        wander: float = 0.01,
        gain: np.ndarray | float = 1.0,
        seed: int = 0,
    ) -> FactorFile:
        """A recording of a robot.

        Args:
            name, day: of the recording; with `seed` they decide motion and noise.
            p: true parameters on that day.
            temperature: to be written down.
            loaded: whether a load is held in cycles.
            wander: by how much a drive's Coulomb friction wanders meanwhile, as a share.
            gain: what torques are recorded at, in shares of the truth (one, or one a drive).
        """
        key = hashlib.sha256(f"{name} {day} {seed}".encode()).hexdigest()
        rng = np.random.default_rng(int(key[:16], 16))
        among = self.loaded if loaded else self.templates
        base_template = among[int(rng.integers(len(among)))]
        gains = np.broadcast_to(gain, len(self.robot.drives))
        found = _drawn(base_template, p, rng, wander, gains)
        record = _record(base_template, key, f"{name}-{day:04d}", temperature, day)
        return FactorFile(record, *found, path=key[:12])


def drawn_type(robot: RobotDescription, motions: int, loaded: int = 0) -> DrawnType:
    """Simulate and gather so many recordings without and with a load, to draw others from."""
    each = [template(robot, seed, is_loaded=False) for seed in range(motions)]
    with_load = [template(robot, seed, is_loaded=True) for seed in range(loaded)]
    return DrawnType(robot, tuple(each), tuple(with_load))


def _drawn(
    base_template: Template,
    p: np.ndarray,
    rng: np.random.Generator,
    wander: float,
    gain: np.ndarray,
) -> tuple[FactorGroups, FactorGroups, FactorGroups | None]:
    dof, n, layout, values = (
        len(gain),
        len(base_template.names),
        base_template.layout,
        base_template.with_load(p),
    )
    theta = base_template.to_columns @ values
    off = theta - base_template.to_columns @ base_template.with_load(base_template.truth)
    coulomb, a, felt = p[layout.coulomb][:dof], [], []
    for i, places in enumerate(base_template.felt):
        largest = base_template.file.whole.torque_max[0, i]
        white = NOISE * largest * rng.standard_normal(WHITE) / np.sqrt(WHITE)
        slow = wander * coulomb[i] * rng.standard_normal(WANDERING) / np.sqrt(WANDERING)
        a.append(np.concatenate([white, slow]))
        felt.append(places[places < n])

    def drawn(i: int, R: np.ndarray, N: np.ndarray) -> np.ndarray:
        own, e = len(R), N @ a[i]
        square = np.zeros((own + 1, own + 1))
        square[:own, :own], square[:own, own] = R, R @ theta[felt[i]]
        square[: min(own, len(e)), own] += e[:own]
        square[own, own] = np.linalg.norm(e[own:])
        square[:, own] *= gain[i]
        return square

    geometry = base_template.file.geometry
    if geometry is not None:
        factors = []
        for i, (R,) in enumerate(geometry.factors):
            places = base_template.felt[i]
            own = len(felt[i])
            Y, D = R[:, :own], R[:, len(places) : -1]
            tau = R[:, -1] + Y @ off[felt[i]]
            factors.append(np.column_stack([Y, D, gain[i] * tau])[None])
        geometry = replace(geometry, factors=tuple(factors))
    every, split = base_template.groups
    factors = [
        np.stack([drawn(i, *each) for each in of_groups]) for i, of_groups in enumerate(split)
    ]
    every = replace(every, factors=tuple(factors))
    whole, groups = every.named("whole"), every.named("time").joined(every.named("place"))
    return whole, groups, geometry


def _record(
    base_template: Template, key: str, log: str, temperature: float | None, day: int
) -> FactorRecord:
    """The template's, with the recording's own name, checksum and temperature; not validated."""
    source = base_template.record.model.sources[0]
    fields = dict(source) | {"log": log, "sha256": key}
    model = dict(base_template.record.model) | {
        "sources": (type(source).model_construct(**fields),)
    }
    start = day * 86400.0
    own = dict(base_template.record) | {
        "model": type(base_template.record.model).model_construct(**model),
        "first": start + base_template.record.first,
        "last": start + base_template.record.last,
    }
    if temperature is not None:
        own["temperature"] = Temperature(mean=temperature, low=temperature, high=temperature)
    return FactorRecord.model_construct(**own)
