"""Evaluations and laps as runs of a sweep."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Self

from bike_policy.contract.bundle import DEFAULT_POLICY
from bike_policy.riders.classical import CLASSICAL
from bike_policy.riders.rider import bundle_of, make_rider
from bike_sim.course.files import load_course, load_track
from bike_sim.documents import show
from bike_sim.physics.engines import ENGINE_KINDS, SUPERBIKE_ENGINES
from bike_sim.sim.config import SimulatorConfig
from bike_sim.vehicles.files import load_vehicle
from bike_sim.vehicles.superbike import Superbike
from bike_training.arguments import check_positive, check_whole
from bike_training.envs.clients import CLIENT_KINDS, make_client
from bike_training.rollout.evaluation import SPEEDS, evaluate
from bike_training.rollout.laps import pair_figures, ride_laps
from bike_training.rollout.rollout import ride_through
from bike_training.sweeps.job_parts import JobEnd, Tell, check_kinds

FIGURES_FILE: Final = "figures.json"

_EVALUATE_KINDS: Final[Mapping[str, tuple[type, ...]]] = {
    **dict.fromkeys(("policy", "course", "client", "vehicle", "engine"), (str,)),
    "speeds": (list,),
    "random_rides": (int,),
    "seed": (int,),
    "time_step": (int, float),
}

START_SECONDS: Final = 6.0
"""Processor time until the first ride: packages and kernels are loaded, s."""
RIDE_SECONDS: Final = {"pybullet": 1.5, "whipple": 0.4}
"""Processor time of a ride of an evaluation at a step of 1 ms, by engine, s. Rough estimate."""
LAP_SECONDS: Final = 30.0
"""Processor time of a lap of a superbike, s."""
LINE_SECONDS: Final = 20.0
"""Processor time of the line of one machine on one circuit, where it is not in the cache yet, s."""


class RidingJob(ABC):
    """Rides whose figures stay in the folder of the run; curves are drawn from them."""

    cores: ClassVar[float] = 1.0

    @abstractmethod
    def ride(self, tell: Tell) -> dict[str, Any]:
        """Ride all of it and return plain figures."""

    @staticmethod
    @abstractmethod
    def points(figures: Mapping[str, Any]) -> list[tuple[str, float, float]]:
        """Return the curves that figures hold."""

    def run(self, folder: Path, tell: Tell) -> JobEnd:
        """Ride, and keep the figures."""
        figures = self.ride(tell)
        (folder / FIGURES_FILE).write_text(json.dumps(figures), encoding="utf-8")
        return JobEnd({name: value for name, value in figures.items() if not isinstance(value, list | dict)})

    @classmethod
    def curve(cls, folder: Path) -> list[tuple[str, float, float]]:
        """Return its curves; none where it has not finished."""
        path = folder / FIGURES_FILE
        return cls.points(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else []


@dataclass(frozen=True)
class EvaluateJob(RidingJob):
    """An evaluation of a policy, as `bike evaluate`.

    Attributes:
        policy: name of a rider or bundle, or folder of one. course: the fixed course.
        speeds: m/s. random_rides: rides on random paths at each speed. seed: of the random paths.
        client: ``local`` or ``ros``.
        config: vehicle, engine and step.
    """

    policy: str
    course: str
    speeds: tuple[float, ...]
    random_rides: int
    seed: int
    client: str
    config: SimulatorConfig

    memory_gb: ClassVar[float] = 0.8
    axis: ClassVar[str] = "speed_m_s"

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Check entries: those of `bike evaluate`."""
        check_kinds("evaluate", entries, _EVALUATE_KINDS)
        policy, course = entries.get("policy", DEFAULT_POLICY), entries.get("course", "benchmark")
        client, engine = entries.get("client", "local"), entries.get("engine", "pybullet")
        for name, value, known in (("client", client, CLIENT_KINDS), ("engine", engine, ENGINE_KINDS)):
            if value not in known:
                raise ValueError(f"{name} {show(value)} is not one of {', '.join(known)}")
        speeds = entries.get("speeds", list(SPEEDS))
        if not speeds or not all(isinstance(speed, int | float) and not isinstance(speed, bool) for speed in speeds):
            raise ValueError(f"speeds must be numbers, got {show(speeds)}")
        for speed in speeds:
            check_positive("speeds", speed, "m/s")
        time_step = float(entries.get("time_step", 0.001))
        check_positive("time_step", time_step, "s")
        rides, seed = entries.get("random_rides", 1), entries.get("seed", 0)
        check_whole("random_rides", rides, 0)
        check_whole("seed", seed, 0)
        config = SimulatorConfig(entries.get("vehicle", SimulatorConfig.vehicle), engine, time_step)
        load_vehicle(config.vehicle)
        load_course(course)
        rider = make_rider(policy)
        bundle = bundle_of(rider)
        if bundle is not None:
            bundle.check_fit(config.vehicle, config.control_period)
        return cls(policy, course, tuple(map(float, speeds)), rides, seed, client, config)

    def estimate(self) -> float:
        """Return the processor time that it will take, s."""
        rides = len(self.speeds) * (1 + self.random_rides)
        ride = RIDE_SECONDS.get(self.config.engine, RIDE_SECONDS["pybullet"])
        return START_SECONDS + rides * ride * 0.001 / self.config.time_step

    def ride(self, tell: Tell) -> dict[str, Any]:
        """Ride all of it."""
        rider, ridden = make_rider(self.policy), 0
        total = len(self.speeds) * (1 + self.random_rides)

        def tick() -> None:
            nonlocal ridden
            ridden += 1
            tell(ridden, total, "")

        client = make_client(self.client, self.config)
        try:
            return evaluate(
                lambda request, longest: ride_through(client, rider, request, longest),
                self.course, self.speeds, self.random_rides, self.seed, tick,
            )  # fmt: skip
        finally:
            client.close()

    @staticmethod
    def points(figures: Mapping[str, Any]) -> list[tuple[str, float, float]]:
        """Return mean and largest distance over the speed, on the course and on random paths."""
        return [
            (f"{prefix}{name}", float(ride["speed_m_s"]), float(ride[name]))
            for prefix, key in (("", "rides"), ("random_", "random"))
            for ride in figures.get(key, [])
            for name in ("mean_m", "max_m")
        ]


@dataclass(frozen=True)
class LapJob(RidingJob):
    """Laps of a superbike, as `bike ride` on a circuit.

    Attributes:
        vehicle: name or file of a superbike. course: name or file of a circuit. laps: flying laps.
        rider: name of a rider or of a policy that races, or folder of one. engine: that integrates the machine.
    """

    vehicle: str
    course: str
    laps: int
    rider: str = CLASSICAL
    engine: str = SUPERBIKE_ENGINES[0]

    memory_gb: ClassVar[float] = 1.0
    axis: ClassVar[str] = "lap"

    @classmethod
    def from_entries(cls, entries: Mapping[str, Any]) -> Self:
        """Check entries: those of `bike ride` on a circuit."""
        check_kinds("lap", entries, dict.fromkeys(("vehicle", "course", "rider", "engine"), (str,)) | {"laps": (int,)})
        vehicle, course = entries.get("vehicle", "panigale_v4r"), entries.get("course", "barcelona")
        laps, rider = entries.get("laps", 3), entries.get("rider", CLASSICAL)
        engine = entries.get("engine", SUPERBIKE_ENGINES[0])
        check_whole("laps", laps, 1)
        if engine not in SUPERBIKE_ENGINES:
            raise ValueError(f"engine must be one of {', '.join(SUPERBIKE_ENGINES)}, got {show(engine)}")
        if not isinstance(load_vehicle(vehicle), Superbike):
            raise ValueError(f"vehicle {show(vehicle)} is no superbike; laps are ridden on superbikes")
        load_track(course)
        make_rider(rider)
        return cls(vehicle, course, laps, rider, engine)

    def estimate(self) -> float:
        """Return the processor time that it will take, s."""
        return START_SECONDS + LINE_SECONDS + LAP_SECONDS * (self.laps + 1)

    def ride(self, tell: Tell) -> dict[str, Any]:
        """Ride the out-lap and the flying laps."""
        ridden = ride_laps(
            self.vehicle,
            self.course,
            self.laps,
            rider=make_rider(self.rider),
            engine=self.engine,
            tell=lambda snapshot, length: (
                tell(snapshot.progress, length * (self.laps + 1), "") if snapshot.step % 50 == 0 else None
            ),
        )
        return pair_figures(ridden, self.laps)

    @staticmethod
    def points(figures: Mapping[str, Any]) -> list[tuple[str, float, float]]:
        """Return the times of the flying laps, which begin with lap 2."""
        return [("lap_s", float(lap), float(time)) for lap, time in enumerate(figures["laps_s"], start=2)]
