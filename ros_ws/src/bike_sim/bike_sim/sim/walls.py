"""What a wall does to a superbike that meets it: a glancing touch scrapes and the ride goes on, a hit ends it.

The normal velocity decides. In a scrape a part of it is thrown back, the rest is lost, and friction takes speed along
the wall by Coulomb's law; the wall turns the machine into its new direction. So no tyre is torn sideways, and the
energy lost is that of the velocities. A real machine would also be rolled and yawed by the touch; nothing of that is
modelled.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import njit
from numpy.typing import NDArray

from bike_sim.sim.ground import CURVATURE, HEADING, LEFT_WALL, RIGHT_WALL, Road


class Touch(NamedTuple):
    """A contact point at a wall.

    Attributes:
        approach: speed towards the wall, m/s; negative leaving it. angle: between velocity and wall, rad, 0 along it.
        turn: by which a scrape turns the machine, rad, positive to the left. share: what it leaves of the speed.
        dx: in the map, that brings the rear contact point back in front of the wall, m. dy: the same, m.
    """

    approach: float
    angle: float
    turn: float
    share: float
    dx: float
    dy: float


@njit(cache=True)
def touch_of(yaw: float, speed: float, place: NDArray, contact: int, road: Road) -> Touch:
    """Return what happens where a contact point has reached a wall.

    Args:
        yaw: direction of motion, rad.
        speed: m/s.
        place: progress and offset of both contact points relative to the centre line, m.
        contact: index of the progress in it of the point that has reached the wall.
        road: the circuit.
    """
    facts = road.facts[0]
    side = 1.0 if place[contact + 1] > 0.0 else -1.0
    offset, slope, heading, bend = _wall_at(place[contact], side, road)
    # of the wall against the centre line, which bends away from it or towards it
    along = heading + math.atan2(slope, max(0.05, 1.0 - offset * bend))
    towards = yaw - along
    forward, approach = speed * math.cos(towards), side * speed * math.sin(towards)
    angle = math.atan2(abs(approach), abs(forward))
    if approach <= 0.0 or speed <= 0.0:
        return Touch(approach, angle, 0.0, 1.0, 0.0, 0.0)
    lost = facts.friction * (1.0 + facts.restitution) * approach
    left, back = math.copysign(max(0.0, abs(forward) - lost), forward), facts.restitution * approach
    turn = math.atan2(-side * back, left) - towards
    turn -= 2.0 * math.pi * round(turn / (2.0 * math.pi))
    rear, _, heading, _ = _wall_at(place[0], side, road)
    inside = max(0.0, side * (place[1] - rear))
    dx, dy = side * inside * math.sin(heading), -side * inside * math.cos(heading)
    return Touch(approach, angle, turn, math.hypot(left, back) / speed, dx, dy)


@njit(cache=True)
def _wall_at(progress: float, side: float, road: Road) -> tuple[float, float, float, float]:
    """Return offset of a wall (m), its slope against the centre line, heading (rad) and curvature (1/m) of that."""
    table, facts = road.table, road.facts[0]
    column = LEFT_WALL if side > 0.0 else RIGHT_WALL
    u = (progress % facts.length) / facts.spacing
    i = min(int(u), len(table) - 2)
    here, there, part = table[i], table[i + 1], u - i
    return (
        here[column] + part * (there[column] - here[column]),
        (there[column] - here[column]) / facts.spacing,
        here[HEADING] + part * (there[HEADING] - here[HEADING]),
        here[CURVATURE] + part * (there[CURVATURE] - here[CURVATURE]),
    )
