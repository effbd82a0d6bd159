"""Files that accompany an export in a folder: a README, test vectors, and for code a program that
runs these."""

from collections.abc import Sequence

import numpy as np
import polars as pl
from jaxtyping import Float

from deltaid.exports.digits import on_home_branch, random_poses
from deltaid.exports.options import TargetName
from deltaid.exports.structured_text import quantities, st_test
from deltaid.exports.text import SINGLE, Precision, plain_letters, rendered
from deltaid.kernel.batch import BLOCK
from deltaid.mechanism.one_or_many import numbered
from deltaid.model.model import Model

# Number of vectors; largest distance from the middle of the workspace as a share of its half size;
# largest condition of the Jacobian.
_COUNT, _SHARE, _CONDITION = 100, 0.7, 30.0
States = Float[np.ndarray, "states dof"]
# Largest speeds and accelerations of the vectors [rad/s, rad/s² or m/s, m/s²].
_SPEED, _ACCELERATION = 2.0, 10.0


def reference_states(subject: Model, precision: Precision) -> dict[str, States]:
    """z, q, qd, qdd and the package's own tau at reproducible states all over the workspace, in the
    precision of the code, one state per row."""
    kinematics, rng = subject.dynamics.kinematics, np.random.default_rng(0)
    z = _rounded(random_poses(subject, rng, _SHARE, BLOCK), precision)
    z = on_home_branch(kinematics, z)
    z = z[kinematics.condition(z) < _CONDITION][:_COUNT]
    sizes = np.array([_SPEED, _ACCELERATION])[:, None, None]
    qd, qdd = _rounded(sizes * rng.uniform(-1, 1, (2, *z.shape)), precision)
    tau = subject.dynamics.torque(z, qd, qdd, _rounded(subject.p, precision))
    return {"z": z, "q": kinematics.inverse(z), "qd": qd, "qdd": qdd, "tau": tau}


def _rounded(x: np.ndarray, precision: Precision) -> np.ndarray:
    return x.astype(np.float32).astype(float) if precision is SINGLE else x


def handover(
    subject: Model, to: TargetName, stem: str, files: Sequence[str], precision: Precision
) -> dict[str, str]:
    """Texts by file name.

    Args:
        stem: beginning of the names of the export's files, and of functions in code.
        files: names of the export's files.
        precision: of code.
    """
    states = reference_states(subject, precision)
    made = {f"{stem}_vectors.csv": pl.DataFrame(numbered(**states)).write_csv()}
    if to == "c":
        rows = np.hstack([*states.values()]).tolist()
        program = rendered(
            "test.c.jinja",
            prefix=stem,
            guard=stem.upper(),
            real=precision.c_type,
            share="1e-5" if precision is SINGLE else "1e-12",
            rows=[", ".join(precision.c_number(x) for x in row) for row in rows],
        )
        made[f"{stem}_test.c"] = plain_letters(program)
    if to == "st":
        made[f"{stem}_test.st"] = st_test(subject, stem, precision, states)
    readme = rendered(
        "readme.md.jinja",
        title=subject.robot.title or subject.name,
        provenance=subject.provenance,
        files=(*files, *made),
        quantities=quantities(subject),
        to=to,
        stem=stem,
        count=len(states["z"]),
    )
    return {f"README_{stem}_{to}.md": readme, **made}
