"""Vehicles that are stepped together, of any kind and engine, on paths and circuits: the one control step.

A step has three parts, the same for one row and many: the engines move the rows for a control period
(:mod:`bike_sim.sim.slots`), the compiled observation looks at all of them (:mod:`bike_sim.sim.observation`), and its
rows become events. A row rides bit for bit the same alone and among others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.course import timing_account as acc
from bike_sim.course.course import Course
from bike_sim.course.lap_timing import LapLog, Timing
from bike_sim.course.track import Track
from bike_sim.physics.ground import Ground, flat_ground
from bike_sim.schema import OPPONENT, OPPONENT_SLOTS
from bike_sim.sim import look as lk
from bike_sim.sim.beginning import Beginning, Courses, begin, own_speed
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.disturbances import Disturbances
from bike_sim.sim.events import ENDS, Event, WallHit, events_of, reset_event
from bike_sim.sim.kinds import make_plant, make_slot
from bike_sim.sim.observation import WALL_HOLD, begin_row, call, make_rows, observe_row, observe_rows
from bike_sim.sim.plant import Plant
from bike_sim.sim.request import Preview, ResetRequest
from bike_sim.sim.slots import bytes_of
from bike_sim.sim.traffic import INCIDENT, forget, make_traffic, meet
from bike_sim.vehicles.bicycle import Vehicle

FloatArray = NDArray[np.float64]

COMPILED_ENGINE: Final = "whipple"
"""The engine that steps all bicycles of a batch in one compiled loop."""
SUPERBIKE_ENGINE: Final = "compiled"
"""The engine that steps all superbikes of a batch in one compiled loop."""

_KEPT: Final = ("state", "signals", "fall", "ground", "ride", "views", "preview", "steps", "end")
"""Fields of the rows in a checkpoint; the rest follows from the requests."""
_PREPARED: Final = ("around", "road_facts", "ride", "ground")
"""Records of a row that a reset makes anew."""
_MET: Final = ("bodies", "racing", "opponents", "ahead", "overlap")
"""Fields of the traffic in a checkpoint."""
_LEVEL: Final = flat_ground()
_LEVEL_BYTES: Final = _LEVEL.record.view(np.uint8)


class Batch:
    """Vehicles that are stepped together. The arrays have one row per vehicle; a step changes them in place.

    Attributes:
        count: number of vehicles.
        config: engine and steps.
        state: minimal states, shape (n, 10).
        look: derived quantities in the order of `schema.LOOK`, shape (n, lk.LOOK_SIZE).
        signals: telemetry, shape (n, signals); no columns where the vehicles have none.
        place: position of both contact points relative to the centre line, in the order of `schema.PLACE`, shape
            (n, 4); zeros in rows that ride a path, as below.
        circuit: position relative to the limits, in the order of `schema.LIMITS`, shape (n, k).
        points: course points, shape (n, 3, lk.STATIONS, 3).
        rows: all that the compiled step knows of the rows.
        traffic: what the rows know of each other; None where each rides as if alone.
        incidents: what happened between rows in the last step, columns of `traffic.INCIDENT`.
        opponents: nearest others of each row, shape (n, slots, numbers), see `schema.OPPONENT_SLOTS` and
            `schema.OPPONENT`;
            zeros where each rides as if alone.
        episodes: number of each row's episode; 0 before the first.
        disturbances: of each row.
    """

    def __init__(
        self,
        count: int,
        config: SimulatorConfig,
        preview: Preview | None = None,
        disturbances: Disturbances | Sequence[Disturbances] | None = None,
        vehicles: Sequence[str | Vehicle] | None = None,
        together: bool | Sequence[int] = False,
    ) -> None:
        """Make room for a number of vehicles.

        Args:
            count: number of vehicles.
            config: vehicle, engine and steps.
            preview: points of the path ahead, the same for all rows; None for those of each request, which must be as
                many for all rows. Superbikes have their own.
            disturbances: of what is ridden, drawn for each row anew, or those of each row; those of what a rider sees
                are not the batch's.
            vehicles: name, file or parameters of each row's vehicle, where they are not the config's.
            together: whether rows meet on the circuit that all of them ride, see `bike_sim.sim.traffic`; or the number
                of each row's race, from 0 on: rows of one race meet, on the circuit of that race.

        Raises:
            ValueError: an invalid parameter, or a wrong number of vehicles or disturbances.
            FileNotFoundError: an unknown vehicle.
        """
        names = [config.vehicle] * count if vehicles is None else list(vehicles)
        if len(names) != count:
            raise ValueError(f"a batch of {count} vehicles needs as many vehicles, got {len(names)}")
        self.count, self.config = count, config
        if disturbances is None or isinstance(disturbances, Disturbances):
            disturbances = [disturbances or Disturbances()] * count
        if len(disturbances) != count:
            raise ValueError(f"a batch of {count} vehicles needs as many disturbances, got {len(disturbances)}")
        self.disturbances = disturbances
        self._known: dict[tuple[str, int], Plant] = {}
        self._courses: dict[str, Courses] = {}
        disturbed = any(known.acts_on_vehicle for known in disturbances)
        # The engine of a superbike differs in its parameters alone.
        self._shared = config.engine == SUPERBIKE_ENGINE or (config.engine == COMPILED_ENGINE and not disturbed)
        self._names: list[str] = [_name_of(name) for name in names]
        self._plants = [self._plant(name, index) for index, name in enumerate(names)]
        if len({plant.rolling for plant in self._plants}) > 1:
            raise ValueError(f"bicycles and superbikes see different points ahead: {', '.join(self._names)}")
        self._slot = make_slot(self._plants, config, disturbed)
        self._fixed, self._preview = preview is not None, preview or Preview()
        signals = len(self._plants[0].signal_names)
        self.rows = make_rows(count, signals, self.preview.count)
        self._scratch = make_rows(1, 0, 0)
        # Rows of bytes: numpy copies records field by field, which takes ten times as long.
        self._prepared = {name: bytes_of(getattr(self._scratch, name))[0] for name in _PREPARED}
        self._started = [(bytes_of(getattr(self.rows, name)), self._prepared[name]) for name in _PREPARED]
        self._by_time, self._interval = (self._scratch.around[name] for name in ("by_time", "interval"))
        self._kept = np.zeros(lk.VIEW_SIZE + 2 * self.preview.count)
        self._period = float(config.control_period)
        for index, plant in enumerate(self._plants):
            self._describe(index, plant)
        rows = self.rows
        self.state, self.signals = rows.state, rows.signals
        self.look, self.place = rows.views[:, : lk.PLACE], rows.views[:, lk.PLACE : lk.CIRCUIT]
        self.circuit = rows.views[:, lk.CIRCUIT : lk.POINTS]
        self.points = rows.views[:, lk.POINTS :].reshape(count, 3, lk.STATIONS, 3)
        # Fields of records, which are slow to look up.
        self._off_course, self._finished, self._stopped, self._touched, self._hit = (
            rows.ride[name] for name in ("off_course", "finished", "stopped", "touched", "hit")
        )
        self._requests: list[ResetRequest | None] = [None] * count
        self._begun: list[Beginning | None] = [None] * count
        self._logs = [LapLog() for _ in range(count)]
        self.episodes = [0] * count
        self._events: dict[int, tuple[Event, ...]] = {}
        groups = [0] * count if isinstance(together, bool) else list(together)
        if len(groups) != count:
            raise ValueError(f"a batch of {count} vehicles needs the race of each, got {len(groups)}")
        self.traffic = None if together is False else make_traffic(groups)
        self.opponents = np.zeros((count, len(OPPONENT_SLOTS), len(OPPONENT)))
        if self.traffic is not None:
            self.opponents = self.traffic.opponents
        self.incidents = np.zeros((0, len(INCIDENT)))

    def _describe(self, index: int, plant: Plant) -> None:
        """Write what a row's vehicle is."""
        vehicle, record = plant.vehicle, self.rows.vehicle[index]
        record["rolling"], record["mass"] = plant.rolling, vehicle.mass
        record["max_steer"], record["fall_roll"] = vehicle.max_steer, vehicle.fall_roll
        self.rows.parameters[index] = vehicle.parameters

    def _plant(self, vehicle: str | Vehicle, index: int) -> Plant:
        """Return a row's vehicle with an engine: its own, or one of all rows where a compiled loop steps them.

        Raises:
            ValueError: an engine that cannot simulate it. FileNotFoundError: an unknown vehicle.
        """
        name, disturbances = _name_of(vehicle), self.disturbances[index]
        key = name, id(disturbances)
        if self._shared and key in self._known:
            return self._known[key]
        config = replace(self.config, vehicle=name)
        known = vehicle if isinstance(vehicle, Vehicle) else None
        plant = self._known[key] = make_plant(config, disturbances, known)
        return plant

    def courses(self, index: int) -> Courses:
        """Return the courses of a row's vehicle: its lines of circuits are its own."""
        return self._courses.setdefault(self._names[index], Courses())

    @property
    def preview(self) -> Preview:
        """The points of the followed line that all rows see."""
        return self._plants[0].preview or self._preview

    def _set_preview(self, preview: Preview) -> None:
        """See the points that a request asks for, where the choice is its own."""
        if self._fixed or self._plants[0].preview is not None:
            return
        if preview.count != self._preview.count:
            self.rows = self.rows._replace(preview=np.zeros((1, 2, preview.count)))
            self._kept = np.zeros(lk.VIEW_SIZE + 2 * preview.count)
        self._preview = preview

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle of the first row."""
        return self._plants[0].vehicle

    @property
    def vehicles(self) -> tuple[Vehicle, ...]:
        """The vehicle of each row."""
        return tuple(plant.vehicle for plant in self._plants)

    @property
    def preview_xy(self) -> FloatArray:
        """Preview points in base_footprint, m, shape (n, 2, points)."""
        return self.rows.preview

    @property
    def on_circuit(self) -> NDArray[np.bool_]:
        """Which rows ride a circuit, shape (n,)."""
        on: NDArray[np.bool_] = (self.rows.around["kind"] == acc.CIRCUIT) & (self.rows.steps >= 0)
        return on

    @property
    def fallen(self) -> NDArray[np.bool_]:
        """Which rides are over: fallen, stopped by a wall, or diverged, shape (n,)."""
        return self.rows.end != 0

    @property
    def off_course(self) -> NDArray[np.bool_]:
        """Which are beyond the limits of their course, as `Snapshot.off_course`, shape (n,)."""
        return self._off_course != 0

    @property
    def finished(self) -> NDArray[np.bool_]:
        """Which have ridden their course to its end, as `Snapshot.finished`, shape (n,)."""
        return self._finished != 0

    def flags(self, index: int) -> tuple[bool, bool]:
        """Return whether a row is off its course, and whether it has finished it."""
        return bool(self._off_course[index]), bool(self._finished[index])

    @property
    def laps(self) -> tuple[tuple[float, ...], ...]:
        """Times of the valid laps finished since the reset, s, for each row."""
        return tuple(log.valid_laps() for log in self._logs)

    def fall(self, index: int) -> str:
        """Return how a ride ended, as `Snapshot.fall`."""
        return ENDS[int(self.rows.end[index])]

    def wall(self, index: int) -> WallHit | None:
        """Return the touch of a wall in the last step, or the one that ended the ride, or None."""
        at_wall = self._stopped[index] == WALL_HOLD or self._touched[index] == 1
        return WallHit(*self._hit[index].tolist()) if at_wall else None

    def events(self, index: int) -> tuple[Event, ...]:
        """Return what happened to a row in the last step, or with its reset after it, in the order of time."""
        return self._events.get(index, ())

    def log(self, index: int) -> LapLog:
        """Return the laps that a row has finished since its reset, with sectors and time off the track."""
        return self._logs[index]

    def timing(self, index: int) -> Timing:
        """Return laps, sectors and distances of a row on a circuit so far."""
        return self._logs[index].timing(self.rows.ride[index]["account"], bool(self.rows.around[index]["measured"]))

    def plant(self, index: int) -> Plant:
        """Return a row's vehicle with the engine that begins its rides."""
        return self._plants[index]

    def request(self, index: int) -> ResetRequest | None:
        """Return the request of a row's episode; None before the first."""
        return self._requests[index]

    def begun(self, index: int) -> Beginning | None:
        """Return how a row's episode began; None before the first."""
        return self._begun[index]

    def course(self, index: int) -> Course:
        """Return the followed line of a row's episode."""
        begun = self._begun[index]
        assert begun is not None, "an episode has begun"
        return begun.course

    def add_circuit(self, name: str, track: Track) -> None:
        """Know a circuit that is in no file by a name; its median can be followed, and the ideal line that it has."""
        for index in range(self.count):
            self.courses(index).add(name, track)

    def at_own_speed(self, index: int, request: ResetRequest) -> ResetRequest:
        """Return a request with the default start speed of a row's vehicle.

        Raises:
            ValueError: an invalid course or position. FileNotFoundError: an unknown course.
        """
        speed = own_speed(request, self._plants[index], self.courses(index))
        return replace(request, speed_range=(speed, speed))

    def check(self, index: int, request: ResetRequest) -> None:
        """Check that an episode of a row can begin; the present one continues.

        Raises:
            ValueError: why it cannot. FileNotFoundError: an unknown course.
        """
        begin(request, self._plants[index], self.courses(index))

    def reset(self, index: int, request: ResetRequest, vehicle: str | None = None) -> None:
        """Begin an episode of one vehicle.

        Args:
            index: the row.
            request: of the episode.
            vehicle: name or file of what it rides from now on; None for what it rides.

        Raises:
            ValueError: a request that cannot be met; the row rides on. FileNotFoundError: an unknown vehicle or course.
        """
        name = self._names[index] if vehicle is None else vehicle
        plant = self._plants[index] if vehicle is None else self._plant(vehicle, index)
        begun = begin(request, plant, self._courses.setdefault(name, Courses()))
        count = self.preview.count if self._fixed or plant.preview else request.preview.count
        if self.count > 1 and count != self.preview.count:
            raise ValueError(f"all rows see {self.preview.count} points ahead, not {count}")
        ground = self._lay_ground(index, plant, begun)
        plant.reset(begun.state, ground)
        if plant is not self._plants[index] and not self._shared:
            self._plants[index].engine.close()
        if plant is not self._plants[index]:
            self._describe(index, plant)
        self._plants[index], self._names[index] = plant, name
        self._set_preview(request.preview)
        self._slot.begin(index, plant)
        self._requests[index], self._begun[index], self._logs[index] = request, begun, LapLog()
        self._start_row(index, plant, begun)
        self.episodes[index] += 1
        if self.traffic is not None:
            forget(self.traffic, index)
        progress = self.place[index, lk.CENTRE_PROGRESS] if begun.followed else self.look[index, lk.PROGRESS]
        opening = reset_event(self.episodes[index], begun.course, begun.track, float(progress))
        self._events[index] = (opening, *self._events_of(index))

    def _lay_ground(self, index: int, plant: Plant, begun: Beginning) -> Ground:
        """Return the ground under the first state, and prepare the row's beginning in the scratch row."""
        scratch, prepared = self._scratch, self._prepared
        prepared["around"][:], prepared["ride"][:] = begun.surroundings.view(np.uint8), 0
        prepared["ground"][:] = _LEVEL_BYTES
        scratch.moved[0], scratch.parameters[0] = begun.state, plant.vehicle.parameters
        if begun.followed is not None:
            prepared["road_facts"][:] = begun.followed.road.facts.view(np.uint8)
        call(begin_row, 0, float(begun.asked), float(begun.near), float(begun.s), scratch)
        return _LEVEL if begun.followed is None else Ground(scratch.ground.copy(), begun.followed.road.bumps)

    def _start_row(self, index: int, plant: Plant, begun: Beginning) -> None:
        """Put a row where its plant has been reset, and observe it."""
        rows, preview = self.rows, self.preview
        self._by_time[0], self._interval[0] = preview.by_time, preview.interval
        for started, prepared in self._started:
            started[index] = prepared
        most = 8 if begun.followed is None else acc.rows_for(len(begun.followed.track.marks), 1.0) + 1
        if most > rows.events.shape[1]:
            self.rows = rows = rows._replace(events=np.zeros((self.count, most, acc.ROW_SIZE)))
        rows.moved[index], rows.moved_signals[index] = plant.engine.state(), plant.engine.telemetry()
        rows.fall[index], rows.steps[index], rows.end[index] = plant.fall(), 0, 0
        rows.views[index], rows.event_count[index] = 0.0, 0
        call(observe_row, index, 0.0, rows, self._kept)

    def _events_of(self, index: int) -> tuple[Event, ...]:
        rows, begun = self.rows, self._begun[index]
        assert begun is not None, "an episode has begun"
        sections = begun.sections if begun.followed is None else None
        return events_of(rows.events[index, : rows.event_count[index]], self._logs[index], sections)

    def step(self, commands: FloatArray) -> None:
        """Hold steering and throttle for a control period.

        Args:
            commands: in [-1, 1], shape (n, 2). Steering: positive to the left; 1 is a bicycle's largest set point, and
                requests the largest lean of a superbike's virtual rider. Throttle: above 0 part of the engine's torque,
                below 0 part of the brakes' force; a bicycle has no drive and ignores it.

        Raises:
            ValueError: a command that is not finite or out of range.
        """
        commands = np.ascontiguousarray(commands, dtype=np.float64)
        if commands.shape != (self.count, 2) or not (np.abs(commands) <= 1.0).all():
            raise ValueError(f"commands must be {self.count} pairs in [-1, 1], got {commands!r}")
        self.advance(commands)

    def advance(self, commands: FloatArray) -> None:
        """Do as :meth:`step` with commands that are known to be in order, contiguous floats."""
        rows = self.rows
        rows.moved[...], rows.moved_signals[...] = rows.state, rows.signals
        self._slot.advance(commands, rows)
        self._events = {}
        if call(observe_rows, self._period, rows, self._kept):
            self._events = {index: self._events_of(index) for index in np.flatnonzero(rows.event_count).tolist()}
        if self.traffic is not None:
            self.incidents = self.traffic.incidents[: call(meet, self._period, rows, self.traffic, -1)]

    def halt(self, rows: NDArray[np.bool_]) -> None:
        """Let rows be as they are until their next reset: a ride that is over costs nothing, shape (n,)."""
        self.rows.steps[rows] = -1

    def meet(self, race: int = 0) -> None:
        """Let the rows of a race see each other after their resets, before the first step.

        Raises:
            ValueError: rows that do not all ride the same circuit.
        """
        groups = () if self.traffic is None else self.traffic.group.tolist()
        begun = [each for each, group in zip(self._begun, groups, strict=False) if group == race]
        circuits = {None if each is None or each.track is None else each.track.name for each in begun}
        if self.traffic is None or None in circuits or len(circuits) != 1:
            raise ValueError("rows that meet ride one circuit, all of them, in a batch that is made for it")
        call(meet, 0.0, self.rows, self.traffic, race)

    def state_dict(self) -> dict[str, Any] | None:
        """Return all that :meth:`restore` needs, as plain values and arrays; None where rides cannot be continued.

        Courses are left out, for they follow from the requests.
        """
        slot = self._slot.state_dict()
        if slot is None:
            return None
        return {
            "vehicles": list(self._names),
            "requests": [None if request is None else request.to_card() for request in self._requests],
            "episodes": list(self.episodes),
            "rows": {name: bytes_of(getattr(self.rows, name)).copy() for name in _KEPT},
            "slot": slot,
            "logs": [log.to_card() for log in self._logs],
            **({} if self.traffic is None else {"traffic": {name: _bytes(self.traffic, name).copy() for name in _MET}}),
        }

    def restore(self, stored: dict[str, Any]) -> None:
        """Continue with the rides that :meth:`state_dict` was taken of, bit for bit.

        Raises:
            ValueError: rides of another number of vehicles, or of an engine whose rides cannot be continued.
        """
        if len(stored["requests"]) != self.count:
            raise ValueError(f"a batch of {self.count} vehicles cannot go on with {len(stored['requests'])}")
        for index, (card, vehicle) in enumerate(zip(stored["requests"], stored["vehicles"], strict=True)):
            if card is not None:
                self.reset(index, ResetRequest.from_card(card), vehicle)
        for name in _KEPT:
            bytes_of(getattr(self.rows, name))[...] = stored["rows"][name]
        if self.traffic is not None:
            for name in _MET:
                _bytes(self.traffic, name)[...] = stored["traffic"][name]
        self._slot.restore(stored["slot"])
        self._logs = [LapLog.from_card(card) for card in stored["logs"]]
        self.episodes = list(stored["episodes"])
        self._events = {}

    def close(self) -> None:
        """Release the engines; a second call does nothing."""
        for plant in {id(plant): plant for plant in (*self._plants, *self._known.values())}.values():
            plant.engine.close()


def _name_of(vehicle: str | Vehicle) -> str:
    return vehicle if isinstance(vehicle, str) else vehicle.name


def _bytes(traffic: Any, name: str) -> NDArray[Any]:
    return bytes_of(getattr(traffic, name))
