"""Speed of the physics on one core, beside its accuracy: control steps of 50 ms per second.

A control step is what a simulator asks of an engine: 50 ms of integration with the set point held and the drive
evaluated at every step, then the minimal state. Processor time of the process is counted, so that others on the
machine do not slow one engine more than another; engines take turns, and the best ride of each counts.

Without a part, ``bike bench`` prints the project's engines and Exudyn as a table.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import state as st
from bike_sim.physics.bicycle import linear
from bike_sim.physics.engine import Engine
from bike_sim.physics.engines import make_engine
from bike_sim.physics.state import StateVector
from bike_sim.validation.bicycle import free_of_drive
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_vehicle

CONTROL_PERIOD: Final = 0.05
_RIDE_PERIODS: Final = 40
_ACCURATE_PERCENT: Final = 1.0
"""Largest error of weave and capsize speed, %, with which a setting of Exudyn counts as a setting to ride with."""

EXUDYN_SETTINGS: Final = (
    ("trapezoidal", 1e-8),
    ("generalized_alpha", 1e-8),
    ("trapezoidal", 1e-4),
)
"""Method and Newton tolerance. The last is what haste can buy: twice the speed, but wrong modes."""


@dataclass(slots=True)
class Contender:
    """One engine with its settings in the race.

    Attributes:
        name: engine and settings.
        make: returns a new engine for a vehicle.
        time_step: integration step, s.
        read: how the engine is asked for its result after each control step; None is `Engine.state`.
        best: shortest processor time of a control step so far, s.
    """

    name: str
    make: Callable[[Vehicle], Engine]
    time_step: float
    read: str = "state"
    best: float = field(default=math.inf, init=False)


def own_engines(time_steps: dict[str, tuple[float, ...]] | None = None) -> list[Contender]:
    """Return the project's engines at their usual steps, or at those given by kind, s."""
    chosen = time_steps or {"pybullet": (0.005, 0.001), "whipple": (0.005, 0.001)}
    return [
        Contender(kind, lambda vehicle, kind=kind, step=step: make_engine(kind, vehicle, step), step)  # type: ignore[misc]
        for kind, steps in chosen.items()
        for step in steps
    ]


def exudyn_engines(time_step: float = 0.005) -> list[Contender]:
    """Return Exudyn's bicycles at the settings of `EXUDYN_SETTINGS`.

    Raises:
        ModuleNotFoundError: Exudyn is not installed.
    """
    try:
        from bench import exudyn_bicycle
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"{error}; it comes with requirements/dev.txt") from error

    def contender(method: str, tolerance: float) -> Contender:
        return Contender(
            f"exudyn, {method}, {tolerance:g}",
            lambda vehicle: exudyn_bicycle.ExudynBicycle(vehicle, time_step, method, tolerance),
            time_step,
            read="raw_coordinates",  # in Exudyn's favour: mapping them to the minimal state is left out
        )

    return [contender(*setting) for setting in EXUDYN_SETTINGS]


def slalom(vehicle: Vehicle) -> tuple[StateVector, NDArray[np.float64]]:
    """Return a start and set points of 2 s of balanced weaving, rad, one for each control step."""
    engine = make_engine("whipple", vehicle, 0.001)
    start = st.upright_state(4.6, vehicle.rF)
    start[st.ROLL_RATE] = 0.3
    engine.reset(start)
    commands = []
    for k in range(_RIDE_PERIODS):
        state = engine.state()
        commands.append(-3.0 * state[st.ROLL] - state[st.ROLL_RATE] + 0.4 * math.sin(0.15 * k))
        engine.hold(commands[-1], round(CONTROL_PERIOD / engine.time_step))
    return start, np.array(commands)


def race(contenders: list[Contender], vehicle: Vehicle, rounds: int = 15, round_s: float = 0.06) -> None:
    """Let the contenders take turns, and leave the best time of each in it.

    Args:
        contenders: who takes part.
        vehicle: the bicycle.
        rounds: turns of each.
        round_s: length of a turn, s, in which the ride is repeated.
    """
    start, commands = slalom(vehicle)
    engines = [contender.make(vehicle) for contender in contenders]
    for _ in range(rounds):
        for contender, engine in zip(contenders, engines, strict=True):
            _run(contender, engine, start, commands.tolist(), round_s)
    for engine in engines:
        engine.close()


def _run(contender: Contender, engine: Engine, start: StateVector, commands: list[float], round_s: float) -> None:
    """Repeat the ride for one turn; the reset is not timed."""
    steps = round(CONTROL_PERIOD / contender.time_step)
    advance, read = engine.hold, getattr(engine, contender.read)
    until = time.perf_counter() + round_s
    while True:
        engine.reset(start)
        begin = time.process_time()
        for command in commands:
            advance(command, steps)
            read()
        contender.best = min(contender.best, (time.process_time() - begin) / len(commands))
        if time.perf_counter() > until:
            return


def accuracy(contender: Contender, vehicle: Vehicle) -> dict[str, float]:
    """Return the errors of weave and capsize speed by identified modes, in percent of the published formulas."""
    engine = contender.make(free_of_drive(vehicle))
    weave, capsize = linear.weave_speed(vehicle), linear.capsize_speed(vehicle)
    try:
        found = (
            linear.measured_speed(engine, "weave", 0.85 * weave, 1.1 * weave, 1e-4),
            linear.measured_speed(engine, "capsize", 0.85 * capsize, 1.1 * capsize, 1e-4),
        )
    except ValueError:  # modes so wrong that there is no such speed in reach
        found = (math.nan, math.nan)
    finally:
        engine.close()
    return {
        "weave_speed_error_percent": 100.0 * (found[0] / weave - 1.0),
        "capsize_speed_error_percent": 100.0 * (found[1] / capsize - 1.0),
    }


def measure(vehicle_name: str = "whipple", with_exudyn: bool = True, rounds: int = 15) -> dict[str, Any]:
    """Measure all engines in one run.

    Args:
        vehicle_name: shipped vehicle or file.
        with_exudyn: whether Exudyn takes part.
        rounds: turns of each engine.

    Returns:
        ``engines``, a list with name, time step, control steps per second and errors of each, and the figures drawn
        from it. ``exudyn_control_steps_per_s`` is Exudyn's fastest setting whose two speeds are right within 1 %.
        The ratios are to that; ``whipple_no_less_accurate`` says whether both of the compiled engine's errors are at
        most as large as that setting's, ``pybullet_no_less_accurate`` the same for PyBullet at 5 ms.

    Raises:
        ModuleNotFoundError: Exudyn is wanted but not installed.
    """
    vehicle = load_vehicle(vehicle_name)
    contenders = own_engines() + (exudyn_engines() if with_exudyn else [])
    race(contenders, vehicle, rounds)
    engines: list[dict[str, Any]] = [
        {
            "name": contender.name,
            "time_step_s": contender.time_step,
            "control_steps_per_s": 1.0 / contender.best,
            **accuracy(contender, vehicle),
        }
        for contender in contenders
    ]
    figures: dict[str, Any] = {"engines": engines}
    for kind in ("pybullet", "whipple"):
        for entry in engines:
            if entry["name"] == kind:
                figures[f"{kind}_{1e3 * entry['time_step_s']:g}_ms_control_steps_per_s"] = entry["control_steps_per_s"]
    if with_exudyn:
        figures.update(_against_exudyn(engines))
    return figures


def _against_exudyn(engines: list[dict[str, Any]]) -> dict[str, Any]:
    """Compare the project's engines with Exudyn's fastest accurate setting, all at the same step."""
    exudyn = [entry for entry in engines if entry["name"].startswith("exudyn") and _worst(entry) <= _ACCURATE_PERCENT]
    fastest = max(exudyn, key=lambda entry: entry["control_steps_per_s"])
    figures: dict[str, Any] = {
        "exudyn_setting": fastest["name"],
        "exudyn_control_steps_per_s": fastest["control_steps_per_s"],
    }
    for entry in engines:
        if entry["name"] in ("pybullet", "whipple") and entry["time_step_s"] == fastest["time_step_s"]:
            kind = entry["name"]
            figures[f"{kind}_to_exudyn_ratio"] = entry["control_steps_per_s"] / fastest["control_steps_per_s"]
            figures[f"{kind}_no_less_accurate"] = all(
                abs(entry[name]) <= abs(fastest[name])
                for name in ("weave_speed_error_percent", "capsize_speed_error_percent")
            )
    return figures


def _worst(entry: dict[str, Any]) -> float:
    """Return the larger of the two errors of an engine, %; nan counts as infinite."""
    worst = max(abs(entry["weave_speed_error_percent"]), abs(entry["capsize_speed_error_percent"]))
    return worst if math.isfinite(worst) else math.inf
