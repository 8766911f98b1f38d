"""Tables 6 and 8 of Weyrer et al. (2026), and one of the settings with intervals."""

from __future__ import annotations

from typing import Final

import numpy as np

from bike_training.reproduce.bicycle.data import Data
from bike_training.reproduce.bicycle.statements import controller_1, finished_at, worst_of
from bike_training.reproduce.statement import with_interval

_PUBLISHED_6 = {"prop": ("0.69 m at 7 m/s", "0.09 m at 7 m/s"), "alt3": ("0.58 m at 7 m/s", "0.13 m at 2.25 m/s")}


def _settings(data: Data) -> str:
    lines = [
        "| setting | curricula ended | steps to the end | T, benchmark path / m | rides ended, benchmark | random |",
        "|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(run.setting for run in data.runs):
        runs = [run for run in data.runs if run.setting == name]
        done = finished_at(data, name)
        means = np.array(_means(data, name))
        rides = {
            course: [ride.completed for ride in data.rides if (ride.setting, ride.course) == (name, course)]
            for course in ("benchmark", "random")
        }
        ridden = " | ".join(f"{sum(each)} of {len(each)}" for each in rides.values())
        lines.append(
            f"| {name} | {len(done)} of {len(runs)} | {with_interval(done, ',.0f')} | {with_interval(means, '.3f')} "
            f"| {ridden} |"
        )
    return "\n".join(lines) + "\n"


def _means(data: Data, setting: str) -> list[float]:
    """Return the mean distance of each controller on the benchmark path, over the rides that came to the end, m."""
    rides = [ride for ride in data.rides if (ride.setting, ride.course, ride.completed) == (setting, "benchmark", True)]
    return [
        float(np.mean([ride.mean for ride in rides if ride.seed == seed]))
        for seed in sorted({ride.seed for ride in rides})
    ]


def _table_6(data: Data) -> str:
    lines = ["| controller 1 of | | published | found |", "|---|---|---|---|"]
    for name, (published_max, published_mean) in _PUBLISHED_6.items():
        worst = worst_of(data, name)
        if worst is None:
            continue
        largest, at, mean, mean_at = worst
        seed = controller_1(data, name)
        lines.append(f"| {name} (seed {seed}) | largest maximum | {published_max} | {largest:.2f} m at {at:g} m/s |")
        lines.append(f"| | largest mean | {published_mean} | {mean:.3f} m at {mean_at:g} m/s |")
    return "\n".join(lines) + "\n"


def _table_8(data: Data) -> str:
    lines = [
        "| roll | steer | published | Eq. (A.10) | compiled, rolled | PyBullet, rolled |",
        "|---|---|---|---|---|---|",
    ]
    for row in data.directions:
        found = " | ".join(f"{value:.3f}" for value in (row.formula, row.whipple, row.pybullet))
        lines.append(f"| {row.roll:g} | {row.steer:g} | {row.published:g} | {found} |")
    return "\n".join(lines) + "\n"


TABLES: Final = {
    "Settings, means with 95 % bootstrap intervals": _settings,
    "Table 6: controller 1 on the benchmark path": _table_6,
    "Table 8: direction of the front contact, degrees": _table_8,
}
"""All tables as Markdown, by their headings."""
