"""Disturbances of rides, from one YAML file: wind, pushes, sensors, delays, a weak drive, wrong parameters.

A file says what disturbs; a ride draws how. The draws depend on the file's seed and on the first state of the ride, so
the same ride is disturbed in the same way wherever it is ridden. Forces, drive and parameters act on the vehicle
(`bike_sim.sim.plant`), sensors and delays lie between it and its rider (`bike_policy.riders.disturbed`, and for
superbikes `bike_policy.riders.instruments`). A superbike has no wind and no pushes of its own, but the road under it
may differ from the circuit that its rider knows.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from bike_sim.course.road import RoadSurface, WetPatch
from bike_sim.course.road import Wind as CircuitWind
from bike_sim.documents import DocumentError, check_text, parse_yaml, show
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.parameters import number, positive, signed
from bike_sim.vehicles.superbike import Superbike

VehicleT = TypeVar("VehicleT", bound=Vehicle)

FORMAT: Final = "bike.disturbances/1"

CHANNELS: Final = ("roll", "steer", "roll_rate", "steer_rate", "lateral", "heading", "speed")
"""Measured quantities: rad, rad/s, m, rad, m/s; signs of the state."""

MACHINE_CHANNELS: Final = (
    *CHANNELS, "progress", "yaw_rate", "acceleration_long", "acceleration_lat", "wheel_speed",
)  # fmt: skip
"""Measured quantities of a superbike: those, then m, rad/s, m/s^2 (both) and the front wheel's m/s."""

TYRE_SIGNALS: Final = (
    *(f"{wheel}_{name}" for wheel in ("rear", "front") for name in ("load", "slip", "slip_angle", "camber", "use")),
    *(f"{wheel}_force_{axis}" for wheel in ("rear", "front") for axis in ("long", "lat")),
    *("lateral_velocity", "vertical_velocity"),
)
"""Signals of a superbike that nothing on a machine measures."""


@dataclass(frozen=True)
class Wind:
    """A force on the rear frame with the rider."""

    direction_deg: float = field(default=90.0, metadata=signed("deg", "to where, in the map, 0 along x, left positive"))
    force_n: float = field(default=0.0, metadata=number("N", "its mean"))
    gust_n: float = field(default=0.0, metadata=number("N", "standard deviation of its gusts"))
    gust_s: float = field(default=1.0, metadata=positive("s", "time over which gusts change"))
    height_m: float = field(default=0.9, metadata=number("m", "of the point that it acts on, above the ground"))
    ahead_m: float = field(default=0.3, metadata=signed("m", "of that point ahead of the rear contact"))


@dataclass(frozen=True)
class Impulses:
    """Sideways pushes on the rear frame with the rider, each to a side that is drawn."""

    impulse_ns: float = field(default=0.0, metadata=number("N s", "of each"))
    every_s: float = field(default=5.0, metadata=positive("s", "time between two; the first comes after as long"))
    lasting_s: float = field(default=0.1, metadata=positive("s", "how long each lasts"))
    height_m: float = field(default=0.9, metadata=number("m", "of the point that is pushed, above the ground"))
    ahead_m: float = field(default=0.3, metadata=signed("m", "of that point ahead of the rear contact"))


@dataclass(frozen=True)
class RawSensors:
    """Sensors of a real bicycle: inertial unit and antenna on the rear frame, encoders of steering and front wheel.

    A bias is the same on all axes. The position comes `position_hz` times in a second, `position_delay_s` late; the
    others come in each control period at once.
    """

    gyro: float = field(default=0.0, metadata=number("rad/s", "standard deviation of the angular velocity"))
    gyro_bias: float = field(default=0.0, metadata=signed("rad/s", "its constant error"))
    accelerometer: float = field(default=0.0, metadata=number("m/s^2", "standard deviation of the specific force"))
    accelerometer_bias: float = field(default=0.0, metadata=signed("m/s^2", "its constant error"))
    steer: float = field(default=0.0, metadata=number("rad", "standard deviation of the steering encoder"))
    steer_bias: float = field(default=0.0, metadata=signed("rad", "its constant error"))
    steer_rate: float = field(default=0.0, metadata=number("rad/s", "standard deviation of its rate"))
    wheel_speed: float = field(default=0.0, metadata=number("m/s", "standard deviation of the front wheel's speed"))
    wheel_scale: float = field(default=1.0, metadata=positive("1", "measured over true speed"))
    position: float = field(default=0.0, metadata=number("m", "standard deviation of each coordinate"))
    position_hz: float = field(default=10.0, metadata=positive("1/s", "whole control periods apart"))
    position_delay_s: float = field(default=0.0, metadata=number("s", "whole control periods"))
    unit_ahead_m: float = field(default=0.3, metadata=signed("m", "of the inertial unit ahead of the rear contact"))
    unit_height_m: float = field(default=0.6, metadata=number("m", "of it above the ground"))
    antenna_ahead_m: float = field(default=0.3, metadata=signed("m", "of the antenna ahead of the rear contact"))
    antenna_height_m: float = field(default=1.0, metadata=number("m", "of it above the ground"))


@dataclass(frozen=True)
class RoadChanges:
    """Differences of a circuit's road from the one that riders and their plans know.

    Attributes:
        grip: factor on friction, everywhere.
        patches: further factors, each as beginning and end of a part of the lap along the centre line, m, and factor;
            the end is less than the beginning where it lies over the start line.
        bumps_m3: density of the heights at 0.1 cycles per m where that is rougher than known, m3; 16e-6 is class A.
        wind_m_s: mean speed of the wind in place of the known one, m/s; 0 leaves that.
        wind_towards_deg: where it blows to, from the map's x axis to the left, deg.
        wind_gusts: standard deviation over the mean.
        seed: of the gusts.
        drift_per_lap: change of the factor in each lap, evenly along it; 0 at the start line of the first lap.
    """

    grip: float = 1.0
    patches: tuple[tuple[float, float, float], ...] = ()
    bumps_m3: float = 0.0
    wind_m_s: float = 0.0
    wind_towards_deg: float = 0.0
    wind_gusts: float = 0.0
    seed: int = 0
    drift_per_lap: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no road has.

        Raises:
            ValueError: naming the value.
        """
        for value in (self.grip, *(patch[2] for patch in self.patches)):
            if not 0.0 < value <= 2.0:
                raise ValueError(f"disturbances: road: grip must be above 0 and at most 2, got {value!r}")
        for patch in self.patches:
            if not (0.0 <= patch[0] < math.inf and 0.0 <= patch[1] < math.inf):
                raise ValueError(f"disturbances: road: a patch must lie on the lap, got {patch!r}")
        if not abs(self.drift_per_lap) <= 0.5:
            raise ValueError(f"disturbances: road: drift_per_lap must lie in [-0.5, 0.5], got {self.drift_per_lap!r}")
        self.surface(RoadSurface())

    def surface(self, known: RoadSurface) -> RoadSurface:
        """Return the surface that is ridden in place of a known one.

        Args:
            known: of the circuit.
        """
        wet = tuple(WetPatch(*patch) for patch in ((0.0, math.inf, self.grip), *self.patches))
        wind = CircuitWind(self.wind_m_s, math.radians(self.wind_towards_deg), self.wind_gusts, self.seed)
        return replace(
            known,
            wet=(*known.wet, *wet),
            bumps=max(known.bumps, self.bumps_m3),
            drift=self.drift_per_lap,
            wind=wind if self.wind_m_s > 0.0 else known.wind,
        )


NO_CHANGES: Final = RoadChanges()
"""The known road."""


@dataclass(frozen=True)
class Disturbances:
    """Everything that disturbs a ride; the defaults disturb nothing.

    Attributes:
        name: for people.
        seed: of all draws, with the first state of the ride.
        wind: force of the air.
        impulses: pushes.
        noise: standard deviation of each measurement, by channel, in the channel's unit.
        bias: constant error of each measurement, by channel.
        observation_delay_s: age of what the rider sees, s; whole control periods.
        command_delay_s: time until its command acts, s; whole control periods.
        command_rate: largest change of steering and throttle, 1/s.
        position_hz: fixes of a superbike's position in a second; between them lateral and heading error, progress and
            all that is shown of the course are those of the last one.
        raw_sensors: of a bicycle, in place of `noise` and `bias` of the state that is made of them; None for none.
        tyres_hidden: whether slips, loads, cambers and forces of a superbike's tyres and the velocity
            of its body (`TYRE_SIGNALS`) are hidden from its rider, who estimates them from what is measured.
        drive_torque_nm: largest torque of the steering drive, Nm.
        vehicle: factors of the vehicle's parameters by name, those of a superbike's sections as ``section.name``; the
            rider knows the parameters without them.
        road: what differs of a circuit's road from the known one.
    """

    name: str = "none"
    seed: int = field(default=0, metadata=number("", "of all draws"))
    wind: Wind = field(default_factory=Wind)
    impulses: Impulses = field(default_factory=Impulses)
    noise: Mapping[str, float] = field(default_factory=dict)
    bias: Mapping[str, float] = field(default_factory=dict)
    observation_delay_s: float = field(default=0.0, metadata=number("s", "whole control periods"))
    command_delay_s: float = field(default=0.0, metadata=number("s", "whole control periods"))
    command_rate: float = field(default=math.inf, metadata=positive("1/s", "largest"))
    position_hz: float = field(default=math.inf, metadata=positive("1/s", "whole control periods apart"))
    raw_sensors: RawSensors | None = None
    tyres_hidden: bool = False
    drive_torque_nm: float = field(default=math.inf, metadata=positive("Nm", "largest"))
    vehicle: Mapping[str, float] = field(default_factory=dict)
    road: RoadChanges = NO_CHANGES

    def __post_init__(self) -> None:
        """Check every value.

        Raises:
            ValueError: naming the value and what it should be.
        """
        checked: list[tuple[str, float, Any]] = []
        for record, of in (
            (self, ""),
            (self.wind, "wind "),
            (self.impulses, "impulses "),
            (self.raw_sensors, "raw_sensors "),
        ):
            if record is None:
                continue
            known = [(spec.name, spec.metadata) for spec in fields(record) if spec.metadata]
            checked += [(f"{of}{name}", getattr(record, name), bounds) for name, bounds in known]
        for what, values, bounds in (("noise", self.noise, number("", "")), ("bias", self.bias, signed("", ""))):
            if unknown := sorted(set(values) - set(MACHINE_CHANNELS)):
                known_ones = ", ".join(MACHINE_CHANNELS)
                raise ValueError(f"disturbances: {what} of unknown channels {unknown}; there are {known_ones}")
            checked += [(f"{what} of {name}", value, bounds) for name, value in values.items()]
        checked += [(f"vehicle {name}", value, positive("", "")) for name, value in self.vehicle.items()]
        for name, value, bounds in checked:
            if bounds["strict"] and not value > 0.0:
                raise ValueError(f"disturbances: {name} must be positive, got {value!r}")
            if not bounds["strict"] and not (math.isfinite(value) and value >= bounds["low"]):
                words = "finite" if bounds["low"] < 0.0 else "finite and not negative"
                raise ValueError(f"disturbances: {name} must be {words}, got {value!r}")
        if self.raw_sensors is not None and (self.noise or self.bias):
            raise ValueError("disturbances: noise and bias are of a state, and with raw_sensors the state is estimated")
        if self.impulses.lasting_s > self.impulses.every_s:
            raise ValueError("disturbances: impulses that last longer than the time between them cannot be told apart")

    @property
    def pushes(self) -> bool:
        """Whether a force acts."""
        return bool(self.wind.force_n or self.wind.gust_n or self.impulses.impulse_ns)

    @property
    def acts_on_vehicle(self) -> bool:
        """Whether anything acts on the vehicle itself."""
        return self.pushes or math.isfinite(self.drive_torque_nm) or bool(self.vehicle) or self.road != NO_CHANGES

    @property
    def acts_on_sensors(self) -> bool:
        """Whether what the rider sees has errors."""
        errs = self.noise or self.bias or self.tyres_hidden or self.raw_sensors is not None
        return bool(errs) or math.isfinite(self.position_hz)

    @property
    def acts_between(self) -> bool:
        """Whether anything lies between vehicle and rider."""
        late = self.observation_delay_s or self.command_delay_s
        return self.acts_on_sensors or bool(late) or math.isfinite(self.command_rate)

    def errors(self, table: Mapping[str, float]) -> list[float]:
        """Return the values of `noise` or `bias` in the order of MACHINE_CHANNELS."""
        return [table.get(name, 0.0) for name in MACHINE_CHANNELS]

    def check_sensors(self, vehicle: Vehicle) -> None:
        """Refuse sensors that a bicycle does not have.

        Raises:
            ValueError: naming the disturbances and the sensor.
        """
        own = sorted({*self.noise, *self.bias} - set(CHANNELS))
        own += ["position_hz"] if math.isfinite(self.position_hz) else []
        own += ["tyres_hidden"] if self.tyres_hidden else []
        if own and not isinstance(vehicle, Superbike):
            raise ValueError(f"disturbances {self.name!r} have {own[0]}, which are a superbike's, not {vehicle.name!r}")
        if self.raw_sensors is not None and isinstance(vehicle, Superbike):
            raise ValueError(
                f"disturbances {self.name!r} have raw_sensors, which are a bicycle's, not {vehicle.name!r}"
            )

    def fix_periods(self, period: float) -> int:
        """Return the control periods from one fix of the position to the next.

        Raises:
            ValueError: not a whole number of them.
        """
        rate = self.position_hz if self.raw_sensors is None else self.raw_sensors.position_hz
        between = 1.0 / (rate * period) if math.isfinite(rate) else 1.0
        if round(between) < 1 or abs(between - round(between)) > 1e-6:
            raise ValueError(
                f"disturbances {self.name!r}: position_hz of {rate!r} is not once in a whole number of "
                f"control periods of {period!r} s"
            )
        return round(between)

    def periods(self, delay: float, period: float) -> int:
        """Return a delay in control periods.

        Raises:
            ValueError: it is not a whole number of them.
        """
        count = round(delay / period)
        if abs(count * period - delay) > 1e-9:
            raise ValueError(f"disturbances: a delay of {delay!r} s is not a whole number of periods of {period!r} s")
        return count

    def wrong(self, vehicle: VehicleT) -> VehicleT:
        """Return the vehicle that is ridden in place of the one that the rider knows.

        Raises:
            ValueError: a factor of a parameter that the vehicle does not have, or that cannot be wrong.
        """
        unknown = sorted(set(self.vehicle) - set(vehicle.scalable))
        if unknown:
            raise ValueError(
                f"disturbances {self.name!r}: vehicle {vehicle.name!r} has no parameter {unknown[0]!r} that may be "
                f"wrong; one of its {len(vehicle.scalable)} is called {vehicle.scalable[0]!r}"
            )
        return vehicle.scaled(self.vehicle)

    def to_text(self) -> str:
        """Return a document of it for recordings; it is read again as exactly the same."""
        values = {name: value for name, value in asdict(self).items() if value not in (math.inf, None)}
        if self.raw_sensors is not None:
            values["raw_sensors"] = {name: value for name, value in values["raw_sensors"].items() if value != math.inf}
        return json.dumps({"format": FORMAT, **values})

    def generator(self, state: NDArray[np.float64], branch: int) -> np.random.Generator:
        """Return the draws of a ride.

        Args:
            state: first minimal state of the ride.
            branch: so that forces and sensors draw their own numbers.
        """
        return np.random.default_rng([self.seed, zlib.crc32(np.ascontiguousarray(state).tobytes()), branch])


def read_disturbances(text: str, name: str) -> Disturbances:
    """Read the text of a YAML file, or what :meth:`Disturbances.to_text` wrote.

    Args:
        text: of the file.
        name: name if the text gives none.

    Raises:
        ValueError: it is not YAML, has a key too many, or a value that means nothing.
    """
    document = parse_yaml(text)
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise DocumentError(f"{show(name)} holds no disturbances: its format must be {FORMAT}")
    values = {key: value for key, value in document.items() if key not in ("format", "description")}
    if "description" in document:
        check_text(document["description"], "description of the disturbances")
    values.setdefault("name", name)
    for key, kind in (("wind", Wind), ("impulses", Impulses), ("raw_sensors", RawSensors)):
        if values.get(key) is not None:
            values[key] = kind(**_numbers(values[key], f"disturbances: {key}", [spec.name for spec in fields(kind)]))
    if "road" in values:
        values["road"] = _road(values["road"])
    for key in ("noise", "bias", "vehicle"):
        if key in values:
            values[key] = _numbers(values[key], f"disturbances: {key}")
    plain = ("observation_delay_s", "command_delay_s", "command_rate", "position_hz", "drive_torque_nm")
    values.update(_numbers({key: values[key] for key in plain if key in values}, "disturbances"))
    unknown = sorted(map(str, set(values) - {spec.name for spec in fields(Disturbances)}))
    if unknown:
        raise DocumentError(f"disturbances: unknown entries {', '.join(map(show, unknown))}")
    if not isinstance(values.get("tyres_hidden", False), bool):
        raise DocumentError(f"disturbances: tyres_hidden must be true or false, got {show(values['tyres_hidden'])}")
    if not isinstance(values.get("seed", 0), int) or not isinstance(values["name"], str):
        raise DocumentError("disturbances: seed must be a whole number and name a text")
    return Disturbances(**values)


def _road(table: Any) -> RoadChanges:
    """Return changes of a road.

    Raises:
        ValueError: an entry that is not known, or a value that is none.
    """
    patches = table.get("patches", []) if isinstance(table, dict) else []
    if not isinstance(patches, list) or not all(isinstance(patch, list) and len(patch) == 3 for patch in patches):
        raise DocumentError(f"disturbances: road: patches must be lists of from_m, to_m and grip, got {show(patches)}")
    keys = ("from_m", "to_m", "grip")
    named = [_numbers(dict(zip(keys, patch, strict=True)), "disturbances: road: patch") for patch in patches]
    known = [spec.name for spec in fields(RoadChanges)]
    plain = {key: value for key, value in table.items() if key != "patches"} if isinstance(table, dict) else table
    numbers: dict[str, Any] = _numbers(plain, "disturbances: road", known)
    numbers["seed"] = int(numbers.get("seed", 0))
    return RoadChanges(**numbers, patches=tuple((each["from_m"], each["to_m"], each["grip"]) for each in named))


def _numbers(table: Any, what: str, known: list[str] | None = None) -> dict[str, float]:
    """Return a table of numbers.

    Raises:
        DocumentError: it is none, or has an entry that is not known.
    """
    if not isinstance(table, dict):
        raise DocumentError(f"{what} must be a table of numbers, got {show(table)}")
    numbers = {}
    for key, value in table.items():
        if known is not None and key not in known:
            raise DocumentError(f"{what} has no entry {show(key)}; it has {', '.join(known)}")
        try:  # YAML 1.1 reads 1e-6 as a text
            numbers[str(key)] = float("" if isinstance(value, bool) else value)
        except (TypeError, ValueError):
            raise DocumentError(f"{what}: entry {show(key)} must be a number, got {show(value)}") from None
    return numbers
