"""From a circuit to ground and walls in tables that compiled code reads, for one simulator and batches.

The normal velocity decides what a wall does to a superbike: a glancing touch scrapes and the ride goes on, a hit ends
it. In a scrape a part of the normal velocity is thrown back, the rest is lost, and friction takes speed along the wall
by Coulomb's law; the wall turns the machine into its new direction. So no tyre is torn sideways, and the energy lost is
that of the velocities. A real machine would also be rolled and yawed by the touch; nothing of that is modelled.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_sim.course.road import (
    CLASSES,
    GRASS_STRIP,
    REFERENCE,
    RoadSurface,
    RunOffKind,
    Wind,
    bump_profile,
    run_off_kinds,
)
from bike_sim.course.track import Track, slope_of
from bike_sim.physics.ground import BUMP_SAMPLES, BUMP_SPACING
from bike_sim.schema import Quantity, Schema

FloatArray = NDArray[np.float64]
Record = Any

ROAD: Final = Schema(
    (
        Quantity("heading", "rad", -1, "of the centre line"),
        Quantity("curvature", "1/m", -1, "of the centre line"),
        Quantity("height", "m", 1, "of the centre line"),
        Quantity("grade", "1", 1, "rise per m"),
        Quantity("crest", "1/m", 1, "change of the grade per m"),
        Quantity("bank", "1", -1, "rise per m to the left"),
        Quantity("twist", "1/m", -1, "change of the bank per m"),
        Quantity("grip", "1", 1, "factor on friction"),
        Quantity("left", "m", 1, "distance to the left limit"),
        Quantity("right", "m", 1, "distance to the right limit"),
        Quantity("left_wall", "m", -1, "offset of the left wall"),
        Quantity("right_wall", "m", -1, "offset of the right wall, negative"),
        Quantity("left_kind", "1", 1, "`RunOffKind` of the left run-off"),
        Quantity("right_kind", "1", 1, "`RunOffKind` of the right run-off"),
    )
)
"""Columns of a road's table, all at the centre line."""
HEADING, CURVATURE, HEIGHT, GRADE = map(ROAD.index, ("heading", "curvature", "height", "grade"))
CREST, BANK, TWIST, GRIP = map(ROAD.index, ("crest", "bank", "twist", "grip"))
LEFT, RIGHT, LEFT_WALL, RIGHT_WALL = map(ROAD.index, ("left", "right", "left_wall", "right_wall"))
LEFT_KIND, RIGHT_KIND = map(ROAD.index, ("left_kind", "right_kind"))
COLUMNS: Final = len(ROAD)

FACTS: Final = np.dtype(
    [
        (name, np.float64)
        for name in (
            "spacing", "length", "bumps", "stretch", "wind_x", "wind_y", "gusts", "friction", "restitution", "hit",
            "drift",
        )
    ]
)  # fmt: skip
"""Distance of the samples of the centre line and its length, m; factor on the profile of bumps, and how far that goes
on per m of the centre line; mean wind in the map, m/s, and the gusts' standard deviation over it; what walls do (see
`bike_sim.course.road.Walls`); change of the grip in a lap."""

GRASS_GRIP: Final = 0.22
GRAVEL_GRIP: Final = 0.3
OFF_TRACK: Final = ((0.9, 0.0, "A"), (GRASS_GRIP, 0.08, "C"), (GRAVEL_GRIP, 0.3, "C"))
"""Asphalt, grass and gravel outside the limits: factor on friction, resistance by load, class of bumps.

Grass: the slicks' 1.8 becomes 0.4, dry (estimate; wet grass has 0.2, Noon 1994, Engineering Analysis of Vehicular
Accidents). Gravel: cars in arrester beds are slowed by 0.3 g coasting and up to 0.9 g braking (Decelerations of
Passenger Vehicles on Gravel Arrester Beds, Sustainability 2020, 12(5), 1761). Grass resists with 0.08, dusty asphalt
has 0.9 of the grip, bumps are those of the class (estimates)."""
_GRIPS: Final = tuple(kind[0] for kind in OFF_TRACK)
_DRAGS: Final = tuple(kind[1] for kind in OFF_TRACK)
_ROUGH: Final = tuple(math.sqrt(CLASSES[kind[2]] / REFERENCE) for kind in OFF_TRACK)
_GRASS, _GRAVEL, _MIXED = int(RunOffKind.GRASS), int(RunOffKind.GRAVEL), int(RunOffKind.MIXED)

GUST_SAMPLES: Final = 8192
GUST_SPACING: Final = 0.1
"""Distance in time of the samples of gusts, s."""
_GUST_LENGTH: Final = 100.0
"""Length of gusts, m: of the order of the integral scale 10 m above open country (estimate)."""
_CROSS_GUSTS: Final = 0.75
"""Gusts across the wind over those along it (estimate)."""


EDGE: Final = 1.0
"""Width over which the bumps of the run-off begin, m, so that its edge is no step."""
_LEAST_GRIP: Final = 0.1
"""Factor on friction at which a drift ends."""
_LEAST_SHARE: Final = 0.2
"""Least part of a metre of the centre line, for places near the centre of a curve."""


class Road(NamedTuple):
    """A circuit as compiled code reads it.

    Attributes:
        table: a row a sample of the centre line, shape (samples, COLUMNS).
        facts: a record of `FACTS`, shape (1,).
        bumps: profiles of bumps, see `bike_sim.physics.ground.Ground`.
        gusts: along and across the mean wind over time, of unit variance, shape (2, GUST_SAMPLES), periodic.
    """

    table: FloatArray
    facts: NDArray[np.void]
    bumps: FloatArray
    gusts: FloatArray


def road_of(track: Track, surface: RoadSurface | None = None) -> Road:
    """Return a circuit's road.

    Args:
        track: the circuit.
        surface: that is ridden in place of the circuit's, banked in the same way; None for the circuit's.
    """
    centre, surface = track.centre, surface or track.surface
    columns = [
        centre.heading, centre.curvature, track.elevation, track.grade, track.crest, track.bank,
        slope_of(track.bank, centre.spacing), surface.grip(centre.s), track.width_left, track.width_right,
        *track.walls(), *run_off_kinds(centre.s, (track.run_off_left, track.run_off_right), surface.run_off),
    ]  # fmt: skip
    facts = np.zeros(1, dtype=FACTS)
    # the profile fits into a lap a whole number of times, so that every lap has the same bumps and none has a step
    turn = BUMP_SAMPLES * BUMP_SPACING
    wind = surface.wind
    values = {
        "spacing": centre.spacing,
        "length": track.length,
        "bumps": math.sqrt(surface.bumps / REFERENCE),
        "stretch": max(1, round(track.length / turn)) * turn / track.length,
        "wind_x": wind.speed * math.cos(wind.towards),
        "wind_y": wind.speed * math.sin(wind.towards),
        "gusts": wind.gusts,
        "friction": surface.walls.friction,
        "restitution": surface.walls.restitution,
        "hit": surface.walls.hit,
        "drift": surface.drift,
    }
    for name, value in values.items():
        facts[name] = value
    return Road(np.stack(columns, axis=1), facts, _profiles(surface.seed), gust_series(wind))


_known: dict[int, FloatArray] = {}


def _profiles(seed: int) -> FloatArray:
    """Return the profile of a seed, shape (1, BUMP_SAMPLES); the run-off has it too, however smooth the road is."""
    if seed not in _known:
        profile = bump_profile(seed, BUMP_SAMPLES, BUMP_SPACING)[None]
        profile.setflags(write=False)
        _known[seed] = profile
    return _known[seed]


def gust_series(wind: Wind) -> FloatArray:
    """Return gusts along and across a wind over time, of unit variance along, shape (2, GUST_SAMPLES), periodic.

    Each is a random series with the spectrum of Dryden's longitudinal turbulence, ``1 / (1 + (2 pi f T)^2)``, for the
    time T in which a gust of 100 m passes.
    """
    if wind.gusts == 0.0:
        return np.zeros((2, GUST_SAMPLES))
    passing = _GUST_LENGTH / max(wind.speed, 1.0)
    frequency = np.fft.rfftfreq(GUST_SAMPLES, GUST_SPACING)
    amplitude = 1.0 / np.sqrt(1.0 + (2.0 * math.pi * frequency * passing) ** 2)
    amplitude[0] = 0.0
    rng = np.random.default_rng(wind.seed)
    series = np.fft.irfft(amplitude * np.exp(2j * math.pi * rng.random((2, len(frequency)))), GUST_SAMPLES)
    return np.asarray(series / series.std(axis=1, keepdims=True) * np.array([[1.0], [_CROSS_GUSTS]]))


@njit(cache=True)
def _mix(here: FloatArray, there: FloatArray, part: float, column: int) -> float:
    return here[column] + part * (there[column] - here[column])


@njit(cache=True)
def _lay_patch(x: float, y: float, progress: float, offset: float, road: Road, patch: Record) -> tuple[float, bool]:
    """Write the ground at a place; return the distance beyond the limits, m, and whether a wall is there.

    Args:
        x: in the map, m.
        y: the same, m.
        progress: along the centre line, m, of any lap.
        offset: from it, m to the left.
        road: the circuit.
        patch: a record of `bike_sim.physics.ground.PATCH`, written.
    """
    table, facts = road.table, road.facts[0]
    u = (progress % facts.length) / facts.spacing
    i = min(int(u), len(table) - 2)
    here, there, part = table[i], table[i + 1], u - i
    beyond_left = offset - _mix(here, there, part, LEFT)
    beyond_right = -offset - _mix(here, there, part, RIGHT)
    beyond = max(beyond_left, beyond_right)
    wall = not _mix(here, there, part, RIGHT_WALL) < offset < _mix(here, there, part, LEFT_WALL)

    heading = _mix(here, there, part, HEADING)
    # a metre beside the centre line of a curve is more or less than one along it
    bend = _mix(here, there, part, CURVATURE)
    share = 1.0 / max(_LEAST_SHARE, 1.0 - offset * bend)
    bank = _mix(here, there, part, BANK)
    patch.x, patch.y = x, y
    patch.cos, patch.sin = math.cos(heading), math.sin(heading)
    patch.height = _mix(here, there, part, HEIGHT) + bank * offset
    patch.grade = share * (_mix(here, there, part, GRADE) + offset * _mix(here, there, part, TWIST))
    # a patch is straight: where the road bends, what lies ahead is not on its axis but up or down the bank
    patch.crest = share * share * _mix(here, there, part, CREST) - bank * share * bend
    patch.bank = bank
    patch.stretch = share * facts.stretch
    patch.arc = (progress % facts.length) * facts.stretch
    patch.grip, patch.drag, patch.bumps = _mix(here, there, part, GRIP), 0.0, facts.bumps
    if facts.drift != 0.0:
        patch.grip *= max(_LEAST_GRIP, 1.0 + facts.drift * progress / facts.length)
    if beyond > 0.0:
        kind = int(here[LEFT_KIND] if beyond_left > beyond_right else here[RIGHT_KIND])
        if kind == _MIXED:
            kind = _GRASS if beyond < GRASS_STRIP else _GRAVEL
        patch.grip *= _GRIPS[kind]
        patch.drag = _DRAGS[kind]
        rough = facts.bumps + min(1.0, beyond / EDGE) * (_ROUGH[kind] - facts.bumps)
        patch.bumps = max(facts.bumps, rough)
    return beyond, wall


@njit(cache=True)
def lay_ground(
    rear_x: float, rear_y: float, front_x: float, front_y: float, place: FloatArray, time: float, road: Road,
    grounds: Record,
) -> tuple[float, float, int]:  # fmt: skip
    """Write the ground under both wheels for the next control period, and return where they are.

    Args:
        rear_x: of the rear contact point in the map, m.
        rear_y: the same, m.
        front_x: of the front contact point, m.
        front_y: the same, m.
        place: progress and offset of both contact points relative to the centre line, m, in the order of `sim.look`.
        time: s since the reset.
        road: the circuit, from `road_of`.
        grounds: of `bike_sim.physics.ground.GROUND`, shape (1,), written but for the number of the profile.

    Returns:
        Rear and front distance beyond the limits, m, negative within; index of the progress in `place` of the first
        contact point that has reached a wall, or -1.
    """
    ground, facts = grounds[0], road.facts[0]
    rear, rear_wall = _lay_patch(rear_x, rear_y, place[0], place[1], road, ground.rear)
    front, front_wall = _lay_patch(front_x, front_y, place[2], place[3], road, ground.front)
    ground.wind_x, ground.wind_y = facts.wind_x, facts.wind_y
    if facts.gusts > 0.0:
        u = time / GUST_SPACING
        k, part = int(u) % GUST_SAMPLES, u - math.floor(u)
        following = (k + 1) % GUST_SAMPLES
        along = facts.gusts * (road.gusts[0, k] + part * (road.gusts[0, following] - road.gusts[0, k]))
        across = facts.gusts * (road.gusts[1, k] + part * (road.gusts[1, following] - road.gusts[1, k]))
        ground.wind_x += along * facts.wind_x - across * facts.wind_y
        ground.wind_y += along * facts.wind_y + across * facts.wind_x
    wall = 0 if rear_wall else (2 if front_wall else -1)
    return rear, front, wall


class Touch(NamedTuple):
    """A contact point at a wall.

    Attributes:
        approach: speed towards the wall, m/s; negative leaving it.
        angle: between velocity and wall, rad, 0 along it.
        turn: by which a scrape turns the machine, rad, positive to the left.
        share: of the speed that a scrape leaves.
        dx: in the map, that brings the rear contact point back in front of the wall, m.
        dy: the same, m.
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
