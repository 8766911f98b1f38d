"""Every number of state, derived quantities, circuits and telemetry: name, unit, mirror sign and meaning, said once.

A vector's places, the fields of messages, the columns of tables and the terms of observations derive from here. Signs
follow REP-103: x forward, y left, z up; roll and camber positive leaning right; yaw and steer positive to the left.
Needs numpy alone, and everything may import it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

GRAVITY: Final = 9.81
"""m/s^2."""

FLAG: Final = "flag"
"""Unit of what is true or false (1 or 0)."""

_SUFFIXES: Final = {
    "m": "_m", "m/s": "_m_s", "m/s^2": "_m_s2", "1/m": "_1_m", "rad": "_rad", "rad/s": "_rad_s", "s": "_s", "N": "_n",
    "Nm": "_nm", "W": "_w", "J": "_j", "1": "", FLAG: "",
}  # fmt: skip


class Quantity(NamedTuple):
    """One number.

    Attributes:
        name: in messages and in code.
        unit: SI, `1` for numbers without a unit, or `FLAG`.
        mirror: sign in the left/right mirror image of a ride about the map's x axis.
        meaning: description.
        signal: of a field of ``bike_msgs/Telemetry``, the signal that it carries; empty where it is computed from some.
    """

    name: str
    unit: str
    mirror: int
    meaning: str
    signal: str = ""

    @property
    def column(self) -> str:
        """Its name with the unit as suffix, as tables have it."""
        return self.name + _SUFFIXES[self.unit]


class Schema:
    """Quantities in the order in which a vector holds them.

    Attributes:
        quantities: in order.
        names: of the quantities.
        columns: their names with units as suffixes.
        mirror_signs: signs that turn a vector into its left/right mirror image.
    """

    def __init__(self, quantities: Iterable[Quantity]) -> None:
        """Take quantities in order."""
        self.quantities = tuple(quantities)
        self.names = tuple(quantity.name for quantity in self.quantities)
        self.columns = tuple(quantity.column for quantity in self.quantities)
        self.mirror_signs: NDArray[np.float64] = np.array([q.mirror for q in self.quantities], dtype=np.float64)
        self._places = {name: place for place, name in enumerate(self.names)}

    def __len__(self) -> int:
        return len(self.quantities)

    def __iter__(self) -> Iterator[Quantity]:
        return iter(self.quantities)

    def __getitem__(self, name: str) -> Quantity:
        return self.quantities[self._places[name]]

    def index(self, name: str) -> int:
        """Return the place of a quantity in the vector."""
        return self._places[name]

    def take(self, *names: str) -> tuple[Quantity, ...]:
        """Return some quantities."""
        return tuple(self[name] for name in names)


STATE: Final = Schema(
    (
        Quantity("x", "m", 1, "rear contact point in map"),
        Quantity("y", "m", -1, "rear contact point in map"),
        Quantity("yaw", "rad", -1, "heading of the rear wheel in map, not wrapped, positive to the left"),
        Quantity("roll", "rad", -1, "of the rear frame, positive leaning right"),
        Quantity("steer", "rad", -1, "of the fork to the rear frame about the steering axis, positive to the left"),
        Quantity("rear_wheel_angle", "rad", 1, "to the rear frame, positive rolling forward, not wrapped"),
        Quantity("front_wheel_angle", "rad", 1, "to the fork, positive rolling forward, not wrapped"),
        Quantity("roll_rate", "rad/s", -1, "positive while leaning further right"),
        Quantity("steer_rate", "rad/s", -1, "positive while turning further left"),
        Quantity("front_wheel_rate", "rad/s", 1, "relative to the fork, positive rolling forward"),
    )
)
"""The minimal state, Eq. (1) of Weyrer et al. (2026) in this project's signs."""

LOOK: Final = Schema(
    (
        Quantity("pitch", "rad", 1, "of the rear frame, positive nose down"),
        Quantity("yaw_rate", "rad/s", -1, "positive to the left"),
        Quantity("speed", "m/s", 1, "along yaw, positive forward"),
        Quantity("front_x", "m", 1, "front contact point in map"),
        Quantity("front_y", "m", -1, "front contact point in map"),
        Quantity("progress", "m", 1, "arc length of the point of the course nearest to the rear contact"),
        Quantity("lateral_error", "m", -1, "distance of the rear contact to the course, positive left of it"),
        Quantity("heading_error", "rad", -1, "yaw minus heading of the course, within [-pi, pi], positive left"),
        Quantity("curvature", "1/m", -1, "of the course at progress, positive turning left"),
        Quantity("front_progress", "m", 1, "arc length of the point of the course nearest to the front contact"),
        Quantity("front_lateral_error", "m", -1, "distance of the front contact to the course, positive left of it"),
        Quantity("preview_spacing", "m", 1, "distance of the preview points along the line"),
    )
)
"""Derived quantities: motion, and the relation to the followed course."""

PLACE: Final = Schema(
    (
        Quantity("centre_progress", "m", 1, "arc length of the rear contact along the centre line"),
        Quantity("centre_offset", "m", -1, "of the rear contact from the centre line, positive to the left"),
        Quantity("front_centre_progress", "m", 1, "arc length of the front contact along the centre line"),
        Quantity("front_centre_offset", "m", -1, "of the front contact from the centre line, positive to the left"),
    )
)
"""Position of both contact points on a circuit (``BikeState.centre_place``)."""

LIMITS: Final = Schema(
    (
        Quantity("rear_left_margin", "m", 1, "distance of the rear contact to the left limit, positive inside"),
        Quantity("rear_right_margin", "m", 1, "distance of the rear contact to the right limit, positive inside"),
        Quantity("front_left_margin", "m", 1, "distance of the front contact to the left limit, positive inside"),
        Quantity("front_right_margin", "m", 1, "distance of the front contact to the right limit, positive inside"),
        Quantity("outside", "m", 1, "distance beyond the limits of the contact that is less far out; negative inside"),
        Quantity("off_track_time", "s", 1, "time with any contact point outside the limits since the reset"),
        Quantity("wall_energy", "J", 1, "energy of the motion towards walls that were met since the reset"),
        Quantity("wrong_way", FLAG, 1, "the heading is more than 90 deg from that of the centre line"),
    )
)
"""Relation to the limits of a circuit. In the mirror image the left margins take the place of the right ones."""

OPPONENT_SLOTS: Final = ("ahead_1", "ahead_2", "left", "right", "behind")
"""Nearest others that a machine of a race sees: two ahead, one on either side, one behind."""

OPPONENT: Final = Schema(
    (
        Quantity("present", FLAG, 1, "whether there is one"),
        Quantity("x", "m", 1, "its rear contact point, base_footprint"),
        Quantity("y", "m", -1, "its rear contact point, base_footprint"),
        Quantity("vx", "m/s", 1, "its velocity relative to the own one, along the own heading"),
        Quantity("vy", "m/s", -1, "its velocity relative to the own one, to the left of the own heading"),
    )
)
"""What is seen of each; zeros where there is none."""

SUSPENSION: Final = Schema(
    (
        Quantity("fork_travel", "m", 1, "of the fork from the standing machine's, positive pressed together"),
        Quantity("fork_speed", "m/s", 1, "rate of `fork_travel`"),
        Quantity("shock_travel", "m", 1, "of the rear spring unit, as of the fork"),
        Quantity("shock_speed", "m/s", 1, "rate of `shock_travel`"),
        Quantity("head_twist", "rad", -1, "of the steering head against the frame"),
        Quantity("chain_force", "N", 1, "of the chain, positive driving"),
    )
)
"""Signals of what gives way, zeros where it is rigid."""

SIGNALS: Final = Schema(
    (
        Quantity("speed", "m/s", 1, "of the centre of mass of the machine without rider, fork and wheels, along yaw"),
        Quantity("pitch", "rad", 1, "angle of the rear frame's x axis below the horizontal"),
        Quantity("acceleration_long", "m/s^2", 1, "of machine and rider by tyres and air, positive forward"),
        Quantity("acceleration_lat", "m/s^2", -1, "of machine and rider by tyres and air, positive to the left"),
        Quantity("yaw_rate", "rad/s", -1, "angular velocity of the rear frame about the vertical"),
        Quantity("rear_load", "N", 1, "vertical load of the rear tyre"),
        Quantity("front_load", "N", 1, "vertical load of the front tyre"),
        Quantity("rear_slip", "1", 1, "longitudinal slip of the rear tyre with relaxation, positive driving"),
        Quantity("front_slip", "1", 1, "longitudinal slip of the front tyre with relaxation, positive driving"),
        Quantity("rear_slip_angle", "rad", -1, "of the rear tyre with relaxation, positive moving to the left"),
        Quantity("front_slip_angle", "rad", -1, "of the front tyre with relaxation, positive moving to the left"),
        Quantity("rear_camber", "rad", -1, "of the rear tyre, positive leaning right"),
        Quantity("front_camber", "rad", -1, "of the front tyre, positive leaning right"),
        Quantity("rear_force_long", "N", 1, "on the machine along the rear wheel's heading, positive driving"),
        Quantity("rear_force_lat", "N", -1, "on the machine to the left of the rear wheel's heading"),
        Quantity("front_force_long", "N", 1, "on the machine along the front wheel's heading, positive driving"),
        Quantity("front_force_lat", "N", -1, "on the machine to the left of the front wheel's heading"),
        Quantity("rear_use", "1", 1, "normalised slip of the rear tyre; 1 is linear saturation"),
        Quantity("front_use", "1", 1, "normalised slip of the front tyre; the peak lies at `tyres.peak_slip`"),
        Quantity("steer_torque", "Nm", -1, "of the virtual rider, without damper and stop, positive to the left"),
        Quantity("lean_reference", "rad", -1, "roll reference of the virtual rider, positive leaning right"),
        Quantity("rider_slide", "m", -1, "of the rider's centre of mass from the middle plane, positive to the left"),
        Quantity("drive_torque", "Nm", 1, "of the engine at the rear wheel"),
        Quantity("engine_power", "W", 1, "at the crank, not negative; engine braking is not in it"),
        Quantity("front_brake", "Nm", 1, "brake torque at the front wheel after all cuts"),
        Quantity("rear_brake", "Nm", 1, "brake torque at the rear wheel after all cuts"),
        Quantity("traction_cut", "1", 1, "share of the drive that traction control leaves: 1 all, 0 none"),
        Quantity("wheelie_cut", "1", 1, "share of the drive that anti-wheelie leaves"),
        Quantity("front_brake_cut", "1", 1, "share of the front brake that brake control and anti-stoppie leave"),
        Quantity("rear_brake_cut", "1", 1, "share of the rear brake that brake control leaves"),
        Quantity("drag", "N", 1, "aerodynamic drag against the velocity"),
        Quantity("fall", "1", 1, "kind of fall, an index of `forces.FALL_NAMES`"),
        Quantity("traction_active", FLAG, 1, "traction control allows less drive than the command requests"),
        Quantity("wheelie_active", FLAG, 1, "anti-wheelie allows less drive than the command requests"),
        Quantity("brake_active", FLAG, 1, "brake control allows less brake than the command requests"),
        Quantity("stoppie_active", FLAG, 1, "anti-stoppie allows less front brake than the command requests"),
        Quantity("lateral_velocity", "m/s", -1, "of the point of `speed`, to the left of the heading"),
        Quantity("vertical_velocity", "m/s", 1, "of the point of `speed`, upwards"),
        Quantity("pitch_rate", "rad/s", 1, "rate of `pitch`"),
        Quantity("lean_reference_rate", "rad/s", -1, "rate of `lean_reference`"),
        Quantity("rider_integral", "Nm", -1, "integral part of the virtual rider's torque"),
        Quantity("drive_share", "1", 1, "part of the engine's torque after its lag"),
        Quantity("brake_share", "1", 1, "part of the brakes' force after their lag"),
        *SUSPENSION,
    )
)
"""Telemetry of a superbike at every step; ``EpisodeStart.signal_names`` are the columns."""

_WHEELS: Final = ("rear", "front")

TELEMETRY: Final = Schema(
    (
        Quantity("acceleration_longitudinal", "m/s^2", 1, "by tyres and air, positive forward", "acceleration_long"),
        Quantity("acceleration_lateral", "m/s^2", -1, "by tyres and air, positive to the left", "acceleration_lat"),
        *(
            Quantity(f"{wheel}_{name}", unit, mirror, SIGNALS[f"{wheel}_{signal}"].meaning, f"{wheel}_{signal}")
            for wheel in _WHEELS
            for name, unit, mirror, signal in (
                ("slip_angle", "rad", -1, "slip_angle"),
                ("slip", "1", 1, "slip"),
                ("camber", "rad", -1, "camber"),
                ("load", "N", 1, "load"),
                ("force_longitudinal", "N", 1, "force_long"),
                ("force_lateral", "N", -1, "force_lat"),
                ("slip_use", "1", 1, "use"),
            )
        ),
        Quantity("engine_power", "W", 1, "at the crank, not negative", "engine_power"),
        Quantity("engine_force", "N", 1, "wheel torque of the engine by the rear radius"),
        Quantity("drag_force", "N", 1, "aerodynamic drag against the velocity", "drag"),
        Quantity("rear_brake_force", "N", 1, "brake torque by the rear wheel's radius after all cuts"),
        Quantity("front_brake_force", "N", 1, "brake torque by the front wheel's radius after all cuts"),
        Quantity("rider_offset", "m", -1, "of the rider's centre of mass, positive to the left", "rider_slide"),
        Quantity("lean_reference", "rad", -1, "of the virtual rider, positive leaning right", "lean_reference"),
        Quantity("traction_control", FLAG, 1, "less drive, so that the rear tyre holds", "traction_active"),
        Quantity("anti_wheelie", FLAG, 1, "less drive, so that the front wheel stays down", "wheelie_active"),
        Quantity("brake_control", FLAG, 1, "less brake, so that a tyre holds", "brake_active"),
        Quantity("anti_stoppie", FLAG, 1, "less front brake, so that the rear wheel stays down", "stoppie_active"),
        Quantity("rear_contact_lost", FLAG, 1, "the rear tyre carries no load"),
        Quantity("front_contact_lost", FLAG, 1, "the front tyre carries no load"),
    )
)
"""Numbers of ``bike_msgs/Telemetry`` in the message's order."""

BIKE_STATE: Final = Schema(
    (
        Quantity("control_period", "s", 1, "time between two steps"),
        Quantity("steering_limit", "rad", 1, "set point of the steering angle for steering = 1; superbikes: the stop"),
        *STATE,
        *LOOK.take("pitch", "yaw_rate", "speed", "front_x", "front_y"),
        Quantity("steering_command", "1", -1, "command applied during the step, positive to the left"),
        Quantity("throttle_command", "1", 1, "command applied during the step, positive accelerates"),
        Quantity("steer_torque", "Nm", -1, "of the steering drive or the virtual rider, positive to the left"),
        *LOOK.take("progress"),
        Quantity("course_length", "m", 1, "length of the course"),
        Quantity("course_closed", FLAG, 1, "the course ends where it begins"),
        *LOOK.take("lateral_error", "front_progress", "front_lateral_error", "heading_error", "curvature"),
        *LOOK.take("preview_spacing"),
        Quantity("fallen", FLAG, 1, "the ride is over: fallen, stopped by a wall, or diverged"),
        Quantity("off_course", FLAG, 1, "beyond the course's limit; circuits: both contact points outside"),
        Quantity("finished", FLAG, 1, "the end of an open course is reached, or a closed one was ridden once"),
        *LIMITS.take("outside", "off_track_time", "wall_energy", "wrong_way"),
    )
)
"""Single numbers of ``bike_msgs/BikeState`` in the message's order, without those that count and those of the preview's
form."""
