"""The superbike paper for `bike reproduce`."""

from __future__ import annotations

from typing import Final

from bike_training.reproduce.paper import Paper
from bike_training.reproduce.superbike.data import Data
from bike_training.reproduce.superbike.experiment import QUICK, SuperbikeExperiment
from bike_training.reproduce.superbike.figures import FIGURES
from bike_training.reproduce.superbike.rides import choose, look_closely, ride, rides_of
from bike_training.reproduce.superbike.statements import STATEMENTS
from bike_training.reproduce.superbike.tables import TABLES

SUPERBIKE: Final[Paper[SuperbikeExperiment, Data]] = Paper(
    name="superbike",
    source="Self-Paced Curriculum Reinforcement Learning for Autonomous Superbike Racing in Simulation, Sect. VI",
    experiment=SuperbikeExperiment(),
    quick=QUICK,
    tables=Data,
    error="mean_excess",
    unit=1.0,
    ridden=("laps", "transfers", "contexts", "episodes"),
    rides=rides_of,
    ride=ride,
    look_closely=look_closely,
    choose=choose,
    statements=STATEMENTS,
    figures=FIGURES,
    written=TABLES,
    counts=lambda data: {
        "rides": sum(row.rides for row in data.laps),
        "rides_completed": sum(row.whole for row in data.laps),
    },
)
