"""What was found over time, as a table."""

import polars as pl

from deltaid.online.found import Watched


def over_time(found: Watched) -> pl.DataFrame:
    """One row a cycle, or every so many cycles of a long recording (`Series`)."""
    s, names = found.series, found.robot.task.names
    force = {f"force_{name}": x for name, x in zip(names, s.force.T, strict=False)}
    effort = {f"effort{i + 1}": x for i, x in enumerate(s.effort.T)}
    columns = {
        "t": s.time,
        "held": s.held,
        "mass": s.mass,
        "mass_low": s.low,
        "mass_high": s.high,
        "contact_size": s.size,
        "contact_limb": s.limb,
        **force,
        **effort,
        "least_force_best": s.best,
        "least_force_worst": s.worst,
    }
    return pl.DataFrame(columns)
