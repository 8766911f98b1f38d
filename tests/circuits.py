"""Circuits that tests of several folders ride, and how they ride races."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, RiderSettings, plan_line
from bike_policy.planning.line_law import LineLaw
from bike_policy.riders.wheel_to_wheel import MachinePlanner, RaceField
from bike_sim.course.course import Course
from bike_sim.sim.race import Race
from bike_sim.vehicles.superbike import Superbike

OVAL = """
format: bike.track/1
length_m: 1200
width_m: 12
elements:
  - {straight_m: 300}
  - {arc: {length_m: 300, angle_deg: 180}}
  - {straight_m: 300}
  - {arc: {length_m: 300, angle_deg: 180}}
elevation_m: [[0, 10], [300, 14], [600, 12], [900, 8]]
"""
"""Two straights and two half circles, with hills."""


def write_kidney(path: Path) -> Path:
    """Write a circuit of about 1.3 km with left and right bends as a CSV file."""
    angle = np.linspace(0.0, 2.0 * math.pi, 160, endpoint=False)
    radius = 190.0 + 45.0 * np.cos(2.0 * angle) + 22.0 * np.sin(3.0 * angle)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    rows = "\n".join(f"{x:.4f},{y:.4f},6.0,6.0" for x, y in points)
    path.write_text(f"# x_m,y_m,w_tr_right_m,w_tr_left_m\n{rows}\n", encoding="utf-8")
    return path


def write_oval(folder: Path, size: float = 1.0) -> Path:
    """Write a small circuit for superbikes, 700 m long at a size of 1."""
    angle = np.linspace(0.0, 2.0 * math.pi, 120, endpoint=False)
    radius = size * (110.0 + 25.0 * np.cos(2.0 * angle))
    rows = "\n".join(f"{r * np.cos(a):.4f},{r * np.sin(a):.4f},6.0,6.0" for a, r in zip(angle, radius, strict=True))
    path = folder / "oval.csv"
    path.write_text(f"# x_m,y_m,w_tr_right_m,w_tr_left_m\n{rows}\n", encoding="utf-8")
    return path


def circle(radius: float, spacing: float = 0.1) -> Course:
    """A closed circle to the left."""
    count = round(2.0 * math.pi * radius / spacing)
    s = np.linspace(0.0, 2.0 * math.pi * radius, count + 1)
    angle = s / radius
    return Course(
        "circle",
        s,
        radius * np.sin(angle),
        radius - radius * np.cos(angle),
        angle,
        np.full(count + 1, 1 / radius),
        True,
        10.0,
    )


def over_a_crest(height: float, turn: float = 1.0) -> Course:
    """A circle that turns to the left (1) or to the right (-1), with a crest (m) after a quarter of the lap."""
    level = circle(60.0, 1.0)
    hill = height * np.exp(-(((level.s - 0.25 * level.length) / 20.0) ** 2))
    return replace(level, y=turn * level.y, heading=turn * level.heading, curvature=turn * level.curvature, height=hill)


def wavy() -> Course:
    """A closed line of 1.9 km with bends both ways."""
    angle = np.linspace(0.0, 2.0 * math.pi, 8001)
    radius = 260.0 + 60.0 * np.cos(3.0 * angle) + 20.0 * np.sin(5.0 * angle)
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    s = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    even = np.linspace(0.0, s[-1], 3801)
    x, y = np.interp(even, s, x), np.interp(even, s, y)
    at = np.interp(even, s, angle)
    r = 260.0 + 60.0 * np.cos(3.0 * at) + 20.0 * np.sin(5.0 * at)
    d = -180.0 * np.sin(3.0 * at) + 100.0 * np.cos(5.0 * at)
    dd = -540.0 * np.cos(3.0 * at) - 500.0 * np.sin(5.0 * at)
    curvature = (r**2 + 2.0 * d**2 - r * dd) / (r**2 + d**2) ** 1.5
    heading = at + np.arctan2(r, d)
    return Course("wavy", even, x, y, heading, curvature, True, 6.0)


class LineController:
    """The classical law on one line, state by state."""

    def __init__(self, vehicle: Superbike, line: Course, period: float, settings: RiderSettings = CLASSICAL_SETTINGS):
        self.plan = plan_line(vehicle, line, settings)
        self.law = LineLaw(vehicle, period, settings)
        self.reset()

    def reset(self) -> None:
        self.law.begin(0, self.plan)

    def command(self, *seen: float) -> tuple[float, float]:
        """Return steering and throttle for the law's inputs; the roll rate may be left out."""
        steering, throttle = self.law.commands(np.array([[*seen, 0.0][:6]]))[0].tolist()
        return steering, throttle


def ridden(race: Race, planner: MachinePlanner, shares: Sequence[float] = ()) -> list[np.ndarray]:
    """Ride a race by the riders of its entries, who may ride a part of their speed; return its commands."""
    field = RaceField.of(race, planner)
    for row, share in enumerate(shares):
        field.set_share(row, share)
    return [commands for commands, _ in field.ride(race)]
