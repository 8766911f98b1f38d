"""Speed of the physics on one core, beside its accuracy: control steps of 50 ms per second.

A control step is what a simulator asks of an engine: 50 ms of integration with the set point held and the drive
evaluated at every step, then the minimal state. Processor time of the process is counted, so that others on the
machine do not slow one engine more than another; engines take turns, and the best ride of each counts.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final, NamedTuple

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
_ROUND_S: Final = 0.06
"""Wall-clock time of an engine's turn, s."""
_ACCURATE_PERCENT: Final = 1.0
"""Largest error of weave and capsize speed, %, with which a setting of Exudyn counts as a setting to ride with."""
OWN_ENGINES: Final = ("pybullet", "whipple")
TIME_STEPS: Final = (0.005, 0.001)
"""Integration steps, s; Exudyn's is the first."""
EXUDYN_SETTINGS: Final = (("trapezoidal", 1e-8), ("generalized_alpha", 1e-8), ("trapezoidal", 1e-4))
"""Method and Newton tolerance. The last is what haste can buy: twice the speed, but wrong modes."""
ERRORS: Final = ("weave_speed_error_percent", "capsize_speed_error_percent")


class Contender(NamedTuple):
    """An engine with its settings.

    Attributes:
        name: engine and settings.
        make: returns a new engine of a vehicle and an integration step.
        time_step: integration step, s.
        read: how the engine is asked for its result after each control step.
    """

    name: str
    make: Callable[[Vehicle, float], Engine]
    time_step: float
    read: str = "state"


def contenders() -> list[Contender]:
    """Return the project's engines, and Exudyn's bicycles at the settings of `EXUDYN_SETTINGS`.

    Raises:
        ModuleNotFoundError: Exudyn is not installed.
    """
    try:
        from bench.exudyn_bicycle import ExudynBicycle
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(f"{error}; it comes with requirements/dev.txt") from error
    own = [Contender(kind, partial(make_engine, kind), step) for kind in OWN_ENGINES for step in TIME_STEPS]
    # Exudyn's raw coordinates are in its favour: mapping them to the minimal state is left out.
    return own + [
        Contender(
            f"exudyn, {method}, {tolerance:g}",
            partial(ExudynBicycle, method=method, tolerance=tolerance),
            TIME_STEPS[0],
            "raw_coordinates",
        )
        for method, tolerance in EXUDYN_SETTINGS
    ]


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


def turn(contender: Contender, engine: Engine, start: StateVector, commands: list[float]) -> float:
    """Repeat the ride for one turn, and return the shortest processor time of a control step, s, without resets."""
    steps, best = round(CONTROL_PERIOD / contender.time_step), math.inf
    advance, read = engine.hold, getattr(engine, contender.read)
    until = time.perf_counter() + _ROUND_S
    while True:
        engine.reset(start)
        begin = time.process_time()
        for command in commands:
            advance(command, steps)
            read()
        best = min(best, (time.process_time() - begin) / len(commands))
        if time.perf_counter() > until:
            return best


def accuracy(contender: Contender, vehicle: Vehicle) -> dict[str, float]:
    """Return the errors of weave and capsize speed by identified modes, in percent of the published formulas."""
    engine = contender.make(free_of_drive(vehicle), contender.time_step)
    published = linear.weave_speed(vehicle), linear.capsize_speed(vehicle)
    try:
        found = [
            linear.measured_speed(engine, mode, 0.85 * v, 1.1 * v, 1e-4)
            for mode, v in zip(("weave", "capsize"), published, strict=True)
        ]
    except ValueError:  # modes so wrong that there is no such speed in reach
        found = [math.nan, math.nan]
    finally:
        engine.close()
    return {name: 100.0 * (value / v - 1.0) for name, value, v in zip(ERRORS, found, published, strict=True)}


def measure(rounds: int = 15) -> dict[str, Any]:
    """Measure all engines in one run.

    Args:
        rounds: turns of each engine.

    Returns:
        ``engines``, a list with name, time step, control steps per second and errors of each, and the figures drawn
        from it. ``exudyn_control_steps_per_s`` is Exudyn's fastest setting whose two speeds are right within 1 %.
        The ratios are to that; ``whipple_no_less_accurate`` says whether both of the compiled engine's errors are at
        most as large as that setting's, ``pybullet_no_less_accurate`` the same for PyBullet at 5 ms.

    Raises:
        ModuleNotFoundError: Exudyn is not installed.
    """
    vehicle, racing = load_vehicle("whipple"), contenders()
    start, commands = slalom(vehicle)
    engines = [contender.make(vehicle, contender.time_step) for contender in racing]
    best = np.min(
        [[turn(*pair, start, commands.tolist()) for pair in zip(racing, engines, strict=True)] for _ in range(rounds)],
        axis=0,
    )
    for engine in engines:
        engine.close()
    found: list[dict[str, Any]] = [
        {"name": of.name, "time_step_s": of.time_step, "control_steps_per_s": 1.0 / took, **accuracy(of, vehicle)}
        for of, took in zip(racing, best.tolist(), strict=True)
    ]
    own = [entry for entry in found if entry["name"] in OWN_ENGINES]
    accurate = [e for e in found if e not in own and all(abs(e[error]) <= _ACCURATE_PERCENT for error in ERRORS)]
    peer = max(accurate, key=lambda entry: entry["control_steps_per_s"])
    figures: dict[str, Any] = {"engines": found, "exudyn_setting": peer["name"]}
    figures["exudyn_control_steps_per_s"] = peer["control_steps_per_s"]
    for entry in own:
        kind, speed = entry["name"], entry["control_steps_per_s"]
        figures[f"{kind}_{1e3 * entry['time_step_s']:g}_ms_control_steps_per_s"] = speed
        if entry["time_step_s"] == peer["time_step_s"]:
            figures[f"{kind}_to_exudyn_ratio"] = speed / peer["control_steps_per_s"]
            figures[f"{kind}_no_less_accurate"] = all(abs(entry[error]) <= abs(peer[error]) for error in ERRORS)
    return figures
