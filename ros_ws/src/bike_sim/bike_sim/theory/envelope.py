"""What a machine can do: its largest lateral, driving and braking accelerations over speed (the g-g-v diagram).

`envelope` computes them from tyres, geometry, power and air; a lap-time simulation needs nothing else of a machine.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from bike_sim.physics import superbike_statics as statics
from bike_sim.physics.superbike_forces import force_limits
from bike_sim.vehicles.superbike import Superbike

FloatArray = NDArray[np.float64]

SHAPE_SPEED = 40.0
"""Speed at which the electronics' share of the drive over lean is taken, m/s."""
SHAPE_SAMPLES = 41


@dataclass(frozen=True)
class Envelope:
    """Quasi-steady limits of a machine on flat ground, sampled over speed. All accelerations are >= 0, in m/s^2.

    Between samples values are linear, outside they are held. While the machine turns with lateral acceleration
    ``a``, what the tyres can still do along the road shrinks as ``(1 - (a / lateral_max)^exponent)^(1 / exponent)``;
    what the engine and the air do does not. Driving shrinks to `drive_shape` besides, where that is less.

    Attributes:
        name: the machine's name.
        speeds: m/s, increasing, shape (n,).
        lateral_max: largest steady lateral acceleration, shape (n,).
        drive_max: largest net forward acceleration going straight, drag taken off; 0 at and above top speed.
        brake_max: largest deceleration going straight, drag included.
        grip_drive_max: what tyres and wheelie limit would allow the engine to do, drag not taken off.
        drag: deceleration by the air alone.
        exponent: of the combination; 2 is an ellipse.
        drive_shape: part of `grip_drive_max` that electronics leave, over ``a / lateral_max`` in equal steps from 0 to
            1 (a leaned machine needs more load on its front wheel than an upright one); None leaves all.
    """

    name: str
    speeds: FloatArray
    lateral_max: FloatArray
    drive_max: FloatArray
    brake_max: FloatArray
    grip_drive_max: FloatArray
    drag: FloatArray
    exponent: float = 2.0
    drive_shape: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check shapes and values and make the arrays read-only.

        Raises:
            ValueError: naming the array that is wrong.
        """
        shape = np.shape(self.speeds)
        for field in fields(self):
            if field.name in ("name", "exponent", "drive_shape"):
                continue
            values = np.array(getattr(self, field.name), dtype=np.float64)
            if values.ndim != 1 or values.shape != shape or values.size < 2:
                raise ValueError(f"envelope '{self.name}': {field.name} has shape {values.shape}, speeds {shape}")
            if not np.isfinite(values).all() or (values < 0.0).any():
                raise ValueError(f"envelope '{self.name}': {field.name} must be finite and not negative")
            values.setflags(write=False)
            object.__setattr__(self, field.name, values)
        if (np.diff(self.speeds) <= 0.0).any():
            raise ValueError(f"envelope '{self.name}': speeds must increase")
        if (self.lateral_max <= 0.0).any():
            raise ValueError(f"envelope '{self.name}': lateral_max must be positive")
        if not self.exponent > 0.0:
            raise ValueError(f"envelope '{self.name}': exponent = {self.exponent} must be positive")
        if self.drive_shape is not None:
            part = np.array(self.drive_shape, dtype=np.float64)
            if part.ndim != 1 or part.size < 2 or not ((part >= 0.0) & (part <= 1.0)).all():
                raise ValueError(f"envelope '{self.name}': drive_shape must be at least 2 values from 0 to 1")
            part.setflags(write=False)
            object.__setattr__(self, "drive_shape", part)

    def lateral(self, speed: FloatArray | float) -> FloatArray:
        """Return the largest steady lateral acceleration at a speed (m/s), m/s^2."""
        return np.asarray(np.interp(speed, self.speeds, self.lateral_max))

    def left_for_tyres(self, speed: FloatArray | float, lateral: FloatArray | float) -> FloatArray:
        """Return the fraction of the longitudinal tyre limit that is left at a lateral acceleration (m/s^2)."""
        used = np.minimum(np.abs(lateral) / self.lateral(speed), 1.0)
        return np.asarray((1.0 - used**self.exponent) ** (1.0 / self.exponent))

    def left_for_drive(self, used: FloatArray | float) -> FloatArray:
        """Return the part of the driving limit that is left where this part of the lateral limit is used."""
        used = np.minimum(np.abs(used), 1.0)
        left = (1.0 - used**self.exponent) ** (1.0 / self.exponent)
        if self.drive_shape is not None:
            left = np.minimum(left, np.interp(used, np.linspace(0.0, 1.0, self.drive_shape.size), self.drive_shape))
        return np.asarray(left)

    def drive(self, speed: FloatArray | float, lateral: FloatArray | float = 0.0) -> FloatArray:
        """Return the largest net forward acceleration, m/s^2; negative where drag beats what the tyres have left."""
        used = np.abs(lateral) / self.lateral(speed)
        grip = np.interp(speed, self.speeds, self.grip_drive_max) * self.left_for_drive(used)
        air = np.interp(speed, self.speeds, self.drag)
        return np.asarray(np.minimum(np.interp(speed, self.speeds, self.drive_max), grip - air))

    def brake(self, speed: FloatArray | float, lateral: FloatArray | float = 0.0) -> FloatArray:
        """Return the largest deceleration, drag included, m/s^2."""
        air = np.interp(speed, self.speeds, self.drag)
        straight = np.interp(speed, self.speeds, self.brake_max)
        return np.asarray((straight - air) * self.left_for_tyres(speed, lateral) + air)


def envelope(vehicle: Superbike, share: float = statics.RIDEABLE_SHARE) -> Envelope:
    """Return what a machine can do from 5 m/s to beyond its top speed.

    Args:
        vehicle: the machine with its rider and electronics.
        share: part of the tyres' friction that turning may use, see `superbike_statics.RIDEABLE_SHARE`.
    """
    speeds = np.arange(5.0, 1.1 * vehicle.top_gear_speed, 1.0)
    mass = statics.inertial_mass(vehicle)
    lateral, drive, brake, grip, air = [], [], [], [], []
    for speed in speeds:
        resistance = statics.rolling_drag(vehicle, speed)
        thrust, braking = statics.straight_limits(vehicle, speed)
        lateral.append(statics.lateral_limit(vehicle, speed, share)[0])
        drive.append(max(0.0, min(thrust, statics.engine_force(vehicle, speed)) - resistance) / mass)
        brake.append((braking + resistance) / mass)
        grip.append(thrust / mass)
        air.append(resistance / mass)
    return Envelope(
        vehicle.name,
        speeds,
        lateral_max=np.array(lateral),
        drive_max=np.array(drive),
        brake_max=np.array(brake),
        grip_drive_max=np.array(grip),
        drag=np.array(air),
        drive_shape=_drive_shape(vehicle, share),
    )


def _drive_shape(vehicle: Superbike, share: float) -> FloatArray:
    """Return what the electronics leave of the drive over the used part of the lateral limit.

    Taken at one speed: from 20 to 70 m/s the parts differ by 0.03 at most.
    """
    limit, steepest = statics.lateral_limit(vehicle, SHAPE_SPEED, share)
    leans = np.linspace(0.0, steepest, SHAPE_SAMPLES)
    used = np.array([statics.steady_lateral(vehicle, lean, SHAPE_SPEED) for lean in leans]) / limit
    allowed = np.array([force_limits(lean, 0.0, SHAPE_SPEED**2, vehicle.machine, vehicle.tyres)[0] for lean in leans])
    straight = allowed[0]
    if not np.isfinite(straight) or straight <= 0.0:
        return np.ones(SHAPE_SAMPLES)
    part = np.clip(allowed / straight, 0.0, 1.0)
    return np.asarray(np.interp(np.linspace(0.0, 1.0, SHAPE_SAMPLES), used, part))
