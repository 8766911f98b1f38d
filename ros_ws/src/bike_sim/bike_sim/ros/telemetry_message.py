"""The telemetry of a superbike as a message; a module of its own, so that a bicycle's node loads no tyres."""

from __future__ import annotations

from typing import Final

from bike_msgs.msg import Telemetry

from bike_sim.physics import superbike_forces as sf
from bike_sim.ros.stamps import stamp_message
from bike_sim.ros.wire import BASE_FRAME
from bike_sim.sim.snapshot import Snapshot
from bike_sim.vehicles.superbike import Superbike

_TELEMETRY_FIELDS: Final = (
    ("acceleration_longitudinal", sf.T_ALONG),
    ("acceleration_lateral", sf.T_LATERAL),
    ("rear_slip_angle", sf.T_REAR_DRIFT),
    ("rear_slip", sf.T_REAR_SLIP),
    ("rear_camber", sf.T_REAR_CAMBER),
    ("rear_load", sf.T_REAR_LOAD),
    ("rear_force_longitudinal", sf.T_REAR_FX),
    ("rear_force_lateral", sf.T_REAR_FY),
    ("rear_slip_use", sf.T_REAR_USE),
    ("front_slip_angle", sf.T_FRONT_DRIFT),
    ("front_slip", sf.T_FRONT_SLIP),
    ("front_camber", sf.T_FRONT_CAMBER),
    ("front_load", sf.T_FRONT_LOAD),
    ("front_force_longitudinal", sf.T_FRONT_FX),
    ("front_force_lateral", sf.T_FRONT_FY),
    ("front_slip_use", sf.T_FRONT_USE),
    ("engine_power", sf.T_POWER),
    ("drag_force", sf.T_DRAG),
    ("rider_offset", sf.T_SLIDE),
    ("lean_reference", sf.T_LEAN_REFERENCE),
)
"""Fields of Telemetry with their indices in the telemetry of the forces."""

_AID_FIELDS: Final = (
    ("traction_control", sf.T_TRACTION_ACTIVE),
    ("anti_wheelie", sf.T_WHEELIE_ACTIVE),
    ("brake_control", sf.T_BRAKE_ACTIVE),
    ("anti_stoppie", sf.T_STOPPIE_ACTIVE),
)


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
    for name, place in _TELEMETRY_FIELDS:
        setattr(message, name, measured[place])
    for name, place in _AID_FIELDS:
        setattr(message, name, measured[place] != 0.0)
    message.engine_force = measured[sf.T_DRIVE] / vehicle.rR
    message.rear_brake_force = measured[sf.T_REAR_BRAKE] / vehicle.rR
    message.front_brake_force = measured[sf.T_FRONT_BRAKE] / vehicle.rF
    message.rear_contact_lost = measured[sf.T_REAR_LOAD] <= 0.0
    message.front_contact_lost = measured[sf.T_FRONT_LOAD] <= 0.0
    return message
