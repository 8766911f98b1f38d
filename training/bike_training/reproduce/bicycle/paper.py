"""The bicycle paper for `bike reproduce`: what of its runs rides, and all that is drawn and said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

from bike_policy.contract.bundle import load_bundle
from bike_policy.riders.rider import LearnedRider
from bike_training.reproduce.bicycle.data import Data, Impact, Instant
from bike_training.reproduce.bicycle.detail import (
    front_directions,
    full_circles,
    impacts,
    instants,
    ride_benchmark,
    steering_step,
)
from bike_training.reproduce.bicycle.experiment import (
    QUICK,
    BicycleExperiment,
    classical_riders,
    controller,
    ride_all,
    ride_junction,
)
from bike_training.reproduce.bicycle.figures import FIGURES
from bike_training.reproduce.bicycle.statements import STATEMENTS, controller_1
from bike_training.reproduce.bicycle.tables import TABLES
from bike_training.reproduce.paper import Advance, Paper, Rows
from bike_training.tasks.path import DISTANCE_THRESHOLD

SHIPPED: Final = "whipple"
"""Actor that is explained beside controller 1 of prop."""
CLOSELY: Final = ("prop", "alt3")
"""Settings whose controllers 1 ride the junction; that of prop is looked at further."""


def ride(folder: Path, setting: str, seed: int, experiment: BicycleExperiment, advance: Advance) -> Rows | None:
    """Ride the controller of a run at all speeds; None where it has none."""
    bundle = controller(folder, setting, experiment.which)
    return None if bundle is None else {"rides": ride_all(bundle, setting, seed, experiment, advance)}


def look_closely(data: Data, folders: Mapping[tuple[str, int], Path], experiment: BicycleExperiment) -> Data:
    """Return the tables with those of Figs. 11 to 14 and 16, Table 8 and Sect. 6.

    Args:
        data: of runs and rides.
        folders: of the runs whose controllers rode, by setting and seed.
        experiment: what is done.
    """
    chosen = [(name, controller_1(data, name)) for name in CLOSELY]
    found = {name: controller(folders[name, seed], name, experiment.which) for name, seed in chosen if seed is not None}
    best = {name: bundle for name, bundle in found.items() if bundle is not None}
    riders = [(name, LearnedRider(bundle)) for name, bundle in best.items()]
    ridden_by_prop: tuple[Instant, ...] = ()
    shares: list[Impact] = []
    for name, bundle in {**({"prop": best["prop"]} if "prop" in best else {}), SHIPPED: load_bundle(SHIPPED)}.items():
        ridden = ride_benchmark(bundle, experiment.longest)
        if name == "prop":
            ridden_by_prop = tuple(instants(ridden))
        shares += impacts(name, bundle, ridden, experiment.explained, experiment.permutations)
    return replace(
        data,
        tracks=tuple(ride_junction([*riders, *classical_riders()])),
        ride=ridden_by_prop,
        impacts=tuple(shares),
        directions=tuple(front_directions()),
        steering=tuple(steering_step()),
        chances=(full_circles(experiment.paths),),
    )


def choose(data: Data, places: Sequence[Data]) -> Data:
    """Return the tables with what was looked at closely where the controllers 1 of all runs are.

    What no run takes part in (classical riders, the shipped actor, Table 8, the step response, the random paths) is the
    same everywhere, and is taken from the first place.

    Args:
        data: of all runs and rides.
        places: tables of each place.
    """
    best = {name: controller_1(data, name) for name in CLOSELY}
    own = {
        name: place
        for place in places
        for name, seed in best.items()
        if any((ride.setting, ride.seed) == (name, seed) for ride in place.rides)
    }
    tracks = [row for name in CLOSELY if name in own for row in own[name].tracks if row.rider == name]
    shares = [row for row in own["prop"].impacts if row.policy == "prop"] if "prop" in own else []
    return replace(
        data,
        tracks=(*tracks, *(row for row in places[0].tracks if row.rider not in CLOSELY)),
        ride=own["prop"].ride if "prop" in own else (),
        impacts=(*shares, *(row for row in places[0].impacts if row.policy == SHIPPED)),
    )


BICYCLE: Final[Paper[BicycleExperiment, Data]] = Paper(
    name="bicycle",
    source="Weyrer et al. (2026), Sects. 5.1 to 5.5",
    experiment=BicycleExperiment(),
    quick=QUICK,
    tables=Data,
    error="mean_error_m",
    unit=DISTANCE_THRESHOLD,
    ridden=("rides",),
    rides=lambda experiment: 2 * len(experiment.speeds),
    ride=ride,
    look_closely=look_closely,
    choose=choose,
    statements=STATEMENTS,
    figures=FIGURES,
    written=TABLES,
    counts=lambda data: {"rides": len(data.rides), "rides_completed": sum(ride.completed for ride in data.rides)},
)
