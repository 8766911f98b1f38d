"""Compliant parts of a superbike: suspension, frame and rider, as sections of its file. Each may be left out.

A joint rests at 0 in the design pose, in which the machine stands on its wheels: spring forces there follow from the
masses. A part belongs to the body of the rigid machine that carries it in the file (the swing arm to the frame, the
fork's slider to the fork, the torso to the rider) and is taken out of it. Points are x forward from the rear contact
and z up, m, in the design pose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from bike_sim.vehicles.parameters import number, point, positive, signed

FloatArray = NDArray[np.float64]
Point = tuple[float, float]

UNIT_SAMPLES: Final = 65
"""Samples of the table of the rear spring unit's length over the swing arm's angle."""
UNIT_RANGE: Final = 0.24
"""Angles of the swing arm that the table covers, from its negative to this, rad."""


@dataclass(frozen=True)
class Part:
    """A body; inertias about its own centre of mass, z up."""

    mass: float = field(metadata=positive("kg", "of the part"))
    x: float = field(metadata=signed("m", "centre of mass"))
    height: float = field(metadata=signed("m", "centre of mass"))
    Ixx: float = field(metadata=positive("kg m2", "roll"))
    Iyy: float = field(metadata=positive("kg m2", "pitch"))
    Izz: float = field(metadata=positive("kg m2", "yaw"))
    Ixz: float = field(metadata=signed("kg m2", "element xz of the tensor"))


@dataclass(frozen=True)
class Strut:
    """A spring unit."""

    stiffness: float = field(metadata=positive("N/m", "of the spring"))
    bump: float = field(metadata=number("N s/m", "damping while it is pressed together"))
    rebound: float = field(metadata=number("N s/m", "damping while it comes out again"))
    compression: float = field(metadata=positive("m", "from the design pose to the stop"))
    extension: float = field(metadata=positive("m", "from the design pose to the stop, coming out"))
    stop: float = field(metadata=number("N/m", "stiffness of both stops"))


@dataclass(frozen=True)
class Rocker:
    """A rocker on the frame between swing arm and spring unit, drawn by a pull rod."""

    pivot: Point = field(metadata=point("its axis on the frame"))
    rod_rocker: Point = field(metadata=point("end of the pull rod on the rocker"))
    rod_arm: Point = field(metadata=point("end of the pull rod on the swing arm"))


@dataclass(frozen=True)
class Chain:
    """The chain, whose pull turns the swing arm; without one the engine acts like a motor in the hub."""

    countershaft: Point = field(metadata=point("axis of the front sprocket"))
    front_sprocket: float = field(metadata=positive("m", "radius"))
    rear_sprocket: float = field(metadata=positive("m", "radius"))


@dataclass(frozen=True)
class SwingArm:
    """Swing arm with its spring unit, directly on it or over a rocker, and the chain.

    Attributes:
        part: the arm.
        strut: the spring unit.
        rocker: None where the unit stands on the arm.
        chain: None where the engine acts on the wheel against the arm.
    """

    part: Part
    strut: Strut
    pivot: Point = field(metadata=point("its axis on the frame"))
    unit_top: Point = field(metadata=point("end of the spring unit on the frame"))
    unit_bottom: Point = field(metadata=point("end of the spring unit on rocker or arm"))
    rocker: Rocker | None = None
    chain: Chain | None = None

    def unit_lengths(self) -> FloatArray:
        """Return the spring unit's length, m, over angles of the arm from -`UNIT_RANGE` to it, shape (UNIT_SAMPLES,).

        Raises:
            ValueError: the pull rod does not reach at an angle.
        """
        angles = np.linspace(-UNIT_RANGE, UNIT_RANGE, UNIT_SAMPLES)
        pivot, top, bottom = (np.array(p) for p in (self.pivot, self.unit_top, self.unit_bottom))
        if self.rocker is None:
            return np.array([math.hypot(*(turned(bottom - pivot, angle) + pivot - top)) for angle in angles])
        axis, near, far = (np.array(p) for p in (self.rocker.pivot, self.rocker.rod_rocker, self.rocker.rod_arm))
        rod, crank = math.hypot(*(far - near)), math.hypot(*(near - axis))
        start = math.atan2(*(near - axis)[::-1])
        line = math.atan2(*(far - axis)[::-1])
        side = math.copysign(1.0, math.remainder(start - line, math.tau))  # of two triangles, that of the design pose
        lengths = np.empty(UNIT_SAMPLES)
        for i, angle in enumerate(angles):
            reach = turned(far - pivot, angle) + pivot - axis
            distance = math.hypot(*reach)
            cosine = (distance**2 + crank**2 - rod**2) / (2.0 * distance * crank)
            if not -1.0 < cosine < 1.0:
                raise ValueError(f"the pull rod does not reach at {math.degrees(angle):.1f} deg of swing arm")
            turn = math.atan2(reach[1], reach[0]) + side * math.acos(cosine) - start
            # a turn from x towards z is about -y
            lengths[i] = math.hypot(*(turned(bottom - axis, -turn) + axis - top))
        return lengths


def turned(arm: FloatArray, angle: float) -> FloatArray:
    """Return an arm (x, z) turned about the axis to the left by an angle, rad: what points back rises."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * arm[0] + s * arm[1], c * arm[1] - s * arm[0]])


@dataclass(frozen=True)
class Telescope:
    """Telescopic fork.

    Attributes:
        part: what slides along the steering axis, without the wheel.
        strut: both legs together.
    """

    part: Part
    strut: Strut


@dataclass(frozen=True)
class Flexure:
    """A joint in which the front gives way sideways, about the axis square to the steering axis, forward and up."""

    height: float = field(metadata=positive("m", "of the joint on the steering axis"))
    stiffness: float = field(metadata=positive("N m/rad", "of the joint"))
    damping: float = field(metadata=number("N m s/rad", "of the joint"))


@dataclass(frozen=True)
class Torso:
    """The rider's upper body, which rolls on the lower about an axis along the machine.

    Attributes:
        part: upper body.
    """

    part: Part
    x: float = field(metadata=signed("m", "of the joint"))
    height: float = field(metadata=positive("m", "of the joint"))
    stiffness: float = field(metadata=positive("N m/rad", "of the joint"))
    damping: float = field(metadata=number("N m s/rad", "of the joint"))


@dataclass(frozen=True)
class Joints:
    """All that gives way; None is rigid.

    Attributes:
        swing_arm: rear suspension.
        fork: front suspension.
        head: twist of the frame at the steering head.
        fork_bending: of the fork, sideways.
        torso: the rider's.
    """

    swing_arm: SwingArm | None = None
    fork: Telescope | None = None
    head: Flexure | None = None
    fork_bending: Flexure | None = None
    torso: Torso | None = None
