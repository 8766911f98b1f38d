"""What a live ride tells its page, and what the page may ask for."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

from bike_sim.physics import state as st
from bike_sim.sim import look as lk
from bike_sim.sim.events import EventKind
from bike_sim.sim.snapshot import Snapshot

STATE_NAMES: Final = (
    *("time", "distance", "x", "y", "yaw", "roll", "steer", "speed", "error", "command", "throttle", "brake"),
)
"""What is told of each state, in order: s, m, rad and m/s; commands in [-1, 1]."""
WHEELS: Final = {
    **{"rear_slip": "rear_slip", "front_slip": "front_slip", "rear_load": "rear_load_n", "front_load": "front_load_n"}
}
"""What is told after these of a superbike, with the names of its signals: slip, and loads in N."""
PACES: Final = (0.1, 10.0)
"""Slowest and fastest ride, times the clock."""


def state_names(powered: bool) -> tuple[str, ...]:
    """Return the names of what is told of a state, in order; of vehicles with signals it is more."""
    return (*STATE_NAMES, *WHEELS) if powered else STATE_NAMES


def places_of(signals: Sequence[str]) -> list[int]:
    """Return where the signals of `WHEELS` stand among a vehicle's; none where it has no signals."""
    return [list(signals).index(name) for name in WHEELS.values()] if len(signals) else []


def state_values(snapshot: Snapshot, places: Sequence[int]) -> list[float]:
    """Return what is told of a state, in the order of `state_names`, with the signals at some places."""
    state, look = snapshot.state, snapshot.look
    values = (
        snapshot.time,
        look[lk.PROGRESS],
        *(state[place] for place in (st.X, st.Y, st.YAW, st.ROLL, st.STEER)),
        snapshot.speed,
        look[lk.LATERAL_ERROR],
        snapshot.steering,
        max(snapshot.throttle, 0.0),
        max(-snapshot.throttle, 0.0),
        *(snapshot.signals[place] for place in places),
    )
    return [round(float(value), 5) for value in values]


def event_message(kind: EventKind | int, text: str, value: float) -> dict[str, Any]:
    """Return what is told of an event; a lap's has its time, s."""
    return {"event": text, **({"lap": value} if kind == EventKind.LAP else {})}


def checked_request(message: Any) -> dict[str, Any] | None:
    """Return a request of the page with its values in bounds, or None if it is none.

    Args:
        message: what the page sent, decoded from JSON.
    """
    if not isinstance(message, dict):
        return None
    kind = message.get("type")
    if kind == "input":
        values = {name: _within(message.get(name), -1.0, 1.0) for name in ("steering", "throttle")}
    elif kind == "pace":
        values = {"factor": _within(message.get("factor"), *PACES)}
    elif kind == "pause":
        values = {"on": _flag(message.get("on"))}
    elif kind == "rider":
        values = {"hands": _flag(message.get("hands")), "balance": _flag(message.get("balance"))}
    elif kind in ("step", "reset"):
        values = {}
    else:
        return None
    return None if None in values.values() else {"type": kind, **values}


def _within(value: Any, low: float, high: float) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value:
        return None
    return float(min(max(value, low), high))


def _flag(value: Any) -> bool | None:
    return value if isinstance(value, bool) else None
