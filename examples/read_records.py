"""Reading a run's episodes with pandas and with polars: success by seed in the last tenth of the episodes.

Usage: python examples/read_records.py runs/planar2-icac-001
"""

import sys
from pathlib import Path

import pandas as pd
import polars as pl


def with_pandas(file: Path) -> pd.DataFrame:
    """Success, steps and size of the map by seed, worst seed first."""
    episodes = pd.read_parquet(file)
    last = episodes[episodes.episode >= 0.9 * episodes.episode.max()]
    by_seed = last.groupby("seed").agg(
        success=("reached", "mean"), steps=("steps", "mean"), live_nodes=("live_nodes", "max")
    )
    return by_seed.sort_values("success", kind="stable")


def with_polars(file: Path) -> pl.DataFrame:
    """The same; only the columns that are needed are read."""
    episodes = pl.scan_parquet(file)
    last = episodes.filter(pl.col("episode") >= 0.9 * pl.col("episode").max())
    by_seed = last.group_by("seed").agg(
        success=pl.col("reached").mean(), steps=pl.col("steps").mean(), live_nodes=pl.col("live_nodes").max()
    )
    return by_seed.sort("success", "seed").collect()


def main(run: str) -> tuple[pd.DataFrame, pl.DataFrame]:
    """Prints and returns both tables."""
    file = Path(run) / "episodes.parquet"
    tables = with_pandas(file), with_polars(file)
    for table in tables:
        print(table, "\n")
    return tables


if __name__ == "__main__":
    main(*sys.argv[1:])
