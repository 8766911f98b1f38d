"""Superbikes in one compiled loop: each with its own machine, course and line; see `batch.CircuitBatch`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numba import typeof
from numba.typed import List
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.course import Course
from bike_sim.course.lap_timing import LapLog
from bike_sim.course.track import Track
from bike_sim.physics import state as st
from bike_sim.physics.ground import NO_BUMPS
from bike_sim.physics.multibody import articulated
from bike_sim.physics.superbike.engine import CompiledSuperbikeEngine
from bike_sim.physics.superbike.records import CONSTANTS
from bike_sim.sim import circuit_look as cl
from bike_sim.sim import look as lk
from bike_sim.sim.beginning import Courses, begin, own_speed
from bike_sim.sim.circuit_events import circuit_events
from bike_sim.sim.circuit_scene import CircuitScene
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.events import Event, reset_event
from bike_sim.sim.ground import COLUMNS, GUST_SAMPLES
from bike_sim.sim.ground import FACTS as ROAD_FACTS
from bike_sim.sim.places import Places
from bike_sim.sim.plant import make_plant
from bike_sim.sim.request import COURSE_POINTS, ResetRequest
from bike_sim.sim.scene import PathScene, View
from bike_sim.sim.superbike_plant import SuperbikePlant
from bike_sim.sim.superbike_rows import TrackTables, VehicleTables, make_rows, make_scratch, step_rows
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class _Machine:
    """A machine that rows may ride: its plant draws starts, and its courses are its own, for its lines are."""

    plant: SuperbikePlant
    engine: CompiledSuperbikeEngine
    courses: Courses
    number: int


class CompiledSuperbikeBatch:
    """Superbikes on the compiled engine, with all that they see, in one compiled loop; see `batch.CircuitBatch`.

    A row rides bit for bit as `Simulator` does with engine ``compiled``, alone or among others.

    Attributes:
        count: number of rows.
        preview: which points of the followed line are seen; the same for all superbikes.
    """

    def __init__(
        self,
        count: int,
        config: SimulatorConfig,
        vehicles: Sequence[str] | None = None,
        machine: Superbike | None = None,
    ) -> None:
        """Make room for a number of superbikes.

        Args:
            count: number of superbikes.
            config: vehicle and steps; the engine must be ``compiled``.
            vehicles: name or file of each row's machine; None for the config's.
            machine: the config's where it is loaded already; None to load it.

        Raises:
            ValueError: a vehicle or an engine that this loop does not carry, or a wrong number of vehicles.
            FileNotFoundError: an unknown vehicle.
        """
        names = [config.vehicle] * count if vehicles is None else list(vehicles)
        if len(names) != count:
            raise ValueError(f"a batch of {count} superbikes needs as many vehicles, got {len(names)}")
        self.count, self.config, self.preview = count, config, COURSE_POINTS
        self._machines: dict[str, _Machine] = {}
        self._known = {} if machine is None else {config.vehicle: machine}
        self._stacked = VehicleTables(np.zeros(0, dtype=CONSTANTS), np.zeros(0), np.zeros((0, 0)))
        self._mounted = [self._machine(name) for name in names]
        self._rows, self._scratch = make_rows(count), make_scratch()
        self._tracks, self._lines = Places(count, np.zeros((9, 2))), Places(count, np.zeros((4, 2)))
        self._grounds = TrackTables(
            self._tracks.arrays,
            List([np.zeros(0)] * count),
            self._lines.arrays,
            List([np.zeros((2, lk.STATION_SIZE))] * count),
            List([np.zeros((2, COLUMNS))] * count),
            np.zeros(count, dtype=ROAD_FACTS),
            List([NO_BUMPS] * count),
            List([np.zeros((2, GUST_SAMPLES))] * count),
        )
        self._requests: list[ResetRequest | None] = [None] * count
        self._logs = [LapLog() for _ in range(count)]
        self._paths: dict[int, PathScene] = {}
        self._told: dict[int, tuple[Event, ...]] = {}
        self._episodes = [0] * count
        self._ridden: list[Course | None] = [None] * count
        self._step_rows: Any = None
        self._show()

    def _show(self) -> None:
        """Name the parts of the rows that are seen from outside."""
        rows, n = self._rows, self.count
        self.state, self.end = rows.state, rows.end
        self.signals: FloatArray = rows.measured
        self.look, self.place = rows.views[:, : cl.PLACE], rows.views[:, cl.PLACE : cl.CIRCUIT]
        self.circuit = rows.views[:, cl.CIRCUIT : cl.POINTS]
        self.points = rows.views[:, cl.POINTS :].reshape(n, 3, lk.STATIONS, 3)
        self.preview_y = rows.preview[:, 1]

    def _machine(self, name: str) -> _Machine:
        """Return a machine by name or file, loaded once.

        Raises:
            ValueError: no superbike, or another engine. FileNotFoundError: an unknown vehicle.
        """
        if name not in self._machines:
            plant = make_plant(replace(self.config, vehicle=name), self._known.get(name))
            engine = getattr(plant, "engine", None)
            if not isinstance(plant, SuperbikePlant) or not isinstance(engine, CompiledSuperbikeEngine):
                raise ValueError(
                    f"a compiled batch of superbikes needs a superbike and engine 'compiled', got vehicle "
                    f"{name!r} and engine {self.config.engine!r}"
                )
            self._machines[name] = _Machine(plant, engine, Courses(), len(self._machines))
            vehicles = [machine.plant.vehicle for machine in self._machines.values()]
            engines = [machine.engine for machine in self._machines.values()]
            self._stacked = VehicleTables(
                np.concatenate([engine.constants for engine in engines]),
                np.concatenate([articulated.tree_record(engine.tree, engine.vehicle.g) for engine in engines]),
                np.stack([vehicle.parameters for vehicle in vehicles]),
            )
        return self._machines[name]

    @property
    def vehicle(self) -> Superbike:
        """The machine of the first row."""
        return self._mounted[0].plant.vehicle

    @property
    def vehicles(self) -> tuple[Superbike, ...]:
        """The machine of each row."""
        return tuple(machine.plant.vehicle for machine in self._mounted)

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Names of the columns of `signals`."""
        return self._mounted[0].plant.signal_names

    @property
    def fallen(self) -> NDArray[np.bool_]:
        """Which rides are over: fallen, stopped by a wall, or diverged, shape (n,)."""
        return self._rows.end != 0

    @property
    def off_course(self) -> NDArray[np.bool_]:
        """Which have both contact points beyond the limits, shape (n,)."""
        return self._rows.ride["off_course"] != 0

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Which have ridden the followed line once from where the ride began, shape (n,)."""
        return self._rows.ride["finished"] != 0

    @property
    def laps(self) -> tuple[tuple[float, ...], ...]:
        """Times of the valid laps finished since the reset, s, for each row."""
        return tuple(log.valid_laps() for log in self._logs)

    def fall(self, index: int) -> str:
        """Return how a ride ended, as `Snapshot.fall` does."""
        return cl.ENDS[int(self._rows.end[index])]

    def events(self, index: int) -> tuple[Event, ...]:
        """Return what happened to a row in the last step, or with its reset after it, in the order of time."""
        return self._told.get(index, ())

    def log(self, index: int) -> LapLog:
        """Return the laps that a row has finished since its reset, with sectors and time off the track."""
        return self._logs[index]

    def course(self, index: int) -> Course:
        """Return the followed line of a row; see `batch.Batch`."""
        course = self._ridden[index]
        assert course is not None, "an episode has begun"
        return course

    def add_circuit(self, name: str, track: Track) -> None:
        """Know a circuit that is in no file by a name; its median can be followed, and the ideal line that it has."""
        for machine in self._machines.values():
            machine.courses.add(name, track)

    def at_own_speed(self, index: int, request: ResetRequest) -> ResetRequest:
        """Return a request with the default start speed of a row's machine; see `Simulator.at_own_speed`."""
        machine = self._mounted[index]
        speed = own_speed(request, machine.plant, machine.courses)
        return replace(request, speed_range=(speed, speed))

    def reset(self, index: int, request: ResetRequest, vehicle: str | None = None) -> None:
        """Begin an episode of one superbike; see `batch.Batch`.

        Args:
            index: the row.
            request: of the episode.
            vehicle: name or file of its machine from now on; None for the one it rides.

        Raises:
            ValueError: a request that cannot be met; the row rides on. FileNotFoundError: an unknown vehicle or course.
        """
        machine = self._mounted[index] if vehicle is None else self._machine(vehicle)
        plant, engine = machine.plant, machine.engine
        scene, state = begin(request, plant, machine.courses)
        plant.reset(state, scene.ground)
        state = plant.state()
        view = scene.look(state, plant.signals(), 0.0, plant.fall(state))
        self._mounted[index], self._requests[index] = machine, request
        self._ridden[index] = scene.course
        rows = self._rows
        rows.views[index, : cl.PLACE] = view.look
        if isinstance(scene, CircuitScene):
            self._lay_circuit(index, scene)
        else:
            self._lay_path(index, scene, view, state)
        rows = self._rows
        rows.state[index], rows.motion[index], rows.memory[index] = state, engine.motion[0], engine.memory[0]
        self.signals[index] = plant.signals()
        rows.preview[index] = view.preview_x, view.preview_y
        rows.machine[index], rows.steps[index], rows.end[index] = machine.number, 0, cl.ENDS.index(view.fall)
        rows.told[index] = 0
        self._episodes[index] += 1
        progress = self.look[index, lk.PROGRESS] if scene.track is None else self.place[index, lk.CENTRE_PROGRESS]
        opening = reset_event(self._episodes[index], scene.course, scene.track, float(progress))
        self._told[index] = (opening, *view.events)

    def _lay_path(self, index: int, scene: PathScene, view: View, state: FloatArray) -> None:
        """Put a row on a path."""
        rows, course = self._rows, scene.course
        self._paths[index], self._logs[index] = scene, LapLog()
        rows.line[index] = self._lines.put(index, course.table)
        rows.facts[index] = 0.0
        facts, ride = rows.facts[index], np.zeros((), dtype=cl.RIDE)
        facts["line_spacing"], facts["line_length"] = course.spacing, course.length
        facts["path"], facts["closed"] = True, course.closed
        ride["near"], ride["rear"] = view.look[[lk.PROGRESS, lk.FRONT_PROGRESS]], state[[st.X, st.Y]]
        ride["off_course"], ride["finished"] = view.off_course, view.finished
        rows.ride[index], rows.ground[index] = ride, scene.ground.record[0]
        rows.views[index, cl.PLACE :] = np.nan

    def _lay_circuit(self, index: int, scene: CircuitScene) -> None:
        """Put a row on a circuit and a line of it."""
        self._paths.pop(index, None)
        self._logs[index] = scene.log
        self._rows.ride[index], self._rows.views[index] = scene.ride[0], scene.view
        rows, grounds, followed = self._rows, self._grounds, scene.followed
        track = self._tracks.put(index, followed.track.table)
        line = self._lines.put(index, followed.line.table)
        grounds.marks[track], grounds.stations[line] = followed.track.marks, followed.stations
        road = followed.road
        grounds.roads[track], grounds.road_facts[track] = road.table, road.facts[0]
        grounds.bumps[track], grounds.gusts[track] = road.bumps, road.gusts
        rows.track[index], rows.line[index], rows.facts[index] = track, line, scene.facts[0]
        rows.ground[index] = scene.ground.record[0]
        most = len(followed.rows)
        if most > rows.events.shape[1]:
            self._rows = rows._replace(events=np.zeros((self.count, most, acc.ROW_SIZE)))

    def step(self, commands: FloatArray) -> None:
        """Hold steering and throttle for a control period; see `batch.Batch`.

        Raises:
            ValueError: a command that is not finite or out of range.
        """
        commands = np.ascontiguousarray(commands, dtype=np.float64)
        if commands.shape != (self.count, 2) or not (np.abs(commands) <= 1.0).all():
            raise ValueError(f"commands must be {self.count} pairs in [-1, 1], got {commands!r}")
        config, rows = self.config, self._rows
        args = (
            commands, float(config.time_step), config.substeps, float(config.control_period), self._stacked,
            self._grounds, rows, self._scratch,
        )  # fmt: skip
        if self._step_rows is None:
            # Numba's own call looks at the type of each argument first, which for records costs a good part of a step
            types = tuple(typeof(value) for value in args)
            step_rows.compile(types)
            self._step_rows = step_rows.get_overload(types)
        self._step_rows(*args)
        self._told = {
            index: circuit_events(rows.events[index, : rows.told[index]], self._logs[index])
            for index in np.flatnonzero(rows.told).tolist()
        }
        for index, scene in self._paths.items():
            self._judge_path(index, scene)

    def _judge_path(self, index: int, scene: PathScene) -> None:
        """Count lines, and see whether a row is off its path or at the end; one that diverged is not asked."""
        rows = self._rows
        if rows.end[index] == cl.LOST:
            return
        time = float(rows.steps[index]) * self.config.control_period
        off_course, finished, events = scene.judge(self.state[index], self.look[index], time, self.fall(index))
        rows.ride["off_course"][index], rows.ride["finished"][index] = off_course, finished
        if events:
            self._told[index] = events

    def state_dict(self) -> dict[str, Any]:
        """Return the state of all rows; courses are left out, for they follow from the requests. See `batch.Batch`."""
        rows = self._rows
        names = {machine.number: name for name, machine in self._machines.items()}
        return {
            "vehicles": [names[machine.number] for machine in self._mounted],
            "requests": [None if request is None else request.to_card() for request in self._requests],
            "episodes": list(self._episodes),
            "rows": {name: _plain(getattr(rows, name)).copy() for name in _KEPT},
            "paths": {index: scene.to_card() for index, scene in self._paths.items()},
            "logs": [log.to_card() for log in self._logs],
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Lay the courses again and take the superbikes where they were; see `batch.Batch`."""
        if len(stored["requests"]) != self.count:
            raise ValueError(f"a batch of {self.count} superbikes cannot go on with {len(stored['requests'])}")
        for index, (card, vehicle) in enumerate(zip(stored["requests"], stored["vehicles"], strict=True)):
            if card is not None:
                self.reset(index, ResetRequest.from_card(card), vehicle)
        for name in _KEPT:
            _plain(getattr(self._rows, name))[...] = stored["rows"][name]
        for index, card in stored["paths"].items():
            self._paths[int(index)].restore(card)
        self._logs = [LapLog.from_card(card) for card in stored["logs"]]
        self._episodes = list(stored["episodes"])
        self._told = {}

    def close(self) -> None:
        """Release the engines that starts are drawn with."""
        for machine in self._machines.values():
            machine.plant.close()


def _plain(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array of numbers, or the bytes of an array of records, as files without pickle take them; a view."""
    return array if array.dtype.names is None else array.view(np.uint8).reshape(len(array), -1)


_KEPT: Final = ("state", "motion", "memory", "signals", "ground", "ride", "views", "preview", "steps", "end")
"""What a checkpoint holds of the rows; the rest follows from the requests."""
