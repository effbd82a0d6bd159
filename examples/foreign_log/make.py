"""Two logs as somebody else's controller may write them, made from recordings of `deltaid demo`.

    deltaid demo --keep demo
    python make.py

writes log.csv and other-log.csv: time in milliseconds, angles in degrees, and, which nobody was
told, the torque of drive 2 counted the other way.
"""

import polars as pl

for source, target in (("identify", "log"), ("verify", "other-log")):
    rows = pl.read_csv(f"demo/{source}.csv")
    rows.select(
        (1000 * pl.col("t")).alias("time_ms"),
        *(pl.col(f"q{i}").degrees().alias(f"angle{i}") for i in (1, 2, 3, 4)),
        "tau1",
        -pl.col("tau2"),
        "tau3",
        "tau4",
    ).write_csv(f"{target}.csv")
