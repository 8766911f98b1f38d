"""The telemetry of a superbike as a message; a module of its own, so that a bicycle's node loads no tyres."""

from __future__ import annotations

from typing import Final

from bike_msgs.msg import Telemetry

from bike_sim.physics import superbike_forces as sf
from bike_sim.ros.stamps import stamp_message
from bike_sim.ros.wire import BASE_FRAME
from bike_sim.schema import FLAG, SIGNALS, TELEMETRY
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.superbike import Superbike

_COPIED: Final = tuple((q.name, SIGNALS.index(q.signal), q.unit == FLAG) for q in TELEMETRY if q.signal)
"""Fields that carry a signal: name, place of the signal, whether it is a flag."""


def telemetry_to_message(snapshot: Snapshot, vehicle: Superbike, stamp: int) -> Telemetry:
    """Return what tyres, engine, brakes and electronics of a superbike do.

    Args:
        snapshot: to be sent.
        vehicle: the machine; its radii turn torques into forces.
        stamp: simulated time, ns.
    """
    message = Telemetry()
    stamp_message(message, snapshot, stamp, BASE_FRAME)
    measured = snapshot.signals.tolist()
    for name, place, is_flag in _COPIED:
        setattr(message, name, measured[place] != 0.0 if is_flag else measured[place])
    message.engine_force = measured[sf.T_DRIVE] / vehicle.rR
    message.rear_brake_force = measured[sf.T_REAR_BRAKE] / vehicle.rR
    message.front_brake_force = measured[sf.T_FRONT_BRAKE] / vehicle.rF
    message.rear_contact_lost = measured[sf.T_REAR_LOAD] <= 0.0
    message.front_contact_lost = measured[sf.T_FRONT_LOAD] <= 0.0
    return message
