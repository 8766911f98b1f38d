"""The theoretical lap against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from bike_sim.course.course import Course
from bike_sim.course.elements import Line
from bike_sim.course.files import load_track
from bike_sim.planning.envelope import Envelope, ellipse_envelope, point_mass_envelope
from bike_sim.planning.lap_limit import lap_limit
from bike_sim.schema import GRAVITY

MACHINE = point_mass_envelope(1.4)


def constant(lateral: float = 12.0, drive: float = 6.0, brake: float = 9.0, exponent: float = 2.0) -> Envelope:
    """Return a machine without air whose limits do not change with speed."""
    speeds = np.array([0.0, 100.0])
    flat = np.ones(2)
    forces = lateral * flat, drive * flat, brake * flat, drive * flat, 0.0 * flat
    return ellipse_envelope("constant", speeds, *forces, exponent)


@pytest.mark.parametrize("radius", [30.0, 100.0, 400.0])
def test_lap_of_a_circle(shapes, radius):
    lap = lap_limit(constant(lateral=12.0), shapes.circle(radius).centre)
    assert lap.lap_time == pytest.approx(2.0 * math.pi * radius / math.sqrt(12.0 * radius), rel=1e-4)
    assert lap.speed == pytest.approx(math.sqrt(12.0 * radius), rel=1e-4)
    assert np.abs(lap.lateral) == pytest.approx(12.0, rel=1e-4)


def test_lap_of_an_oval_whose_curves_do_not_accelerate(shapes):
    # On the straight: v^2 grows by 2 a s until braking must begin. In the curves: constant speed.
    radius, straight, lateral, drive, brake = 50.0, 300.0, 12.0, 6.0, 9.0
    lap = lap_limit(constant(lateral, drive, brake), shapes.oval(radius, straight).centre, step=0.2)
    corner = math.sqrt(lateral * radius)
    gather = straight * brake / (drive + brake)
    top = math.sqrt(corner**2 + 2.0 * drive * gather)
    expected = 2.0 * (math.pi * radius / corner + (top - corner) / drive + (top - corner) / brake)
    assert lap.lap_time == pytest.approx(expected, rel=1e-3)
    assert lap.speed.max() == pytest.approx(top, rel=2e-3)
    assert lap.s[lap.speed.argmax()] % (straight + math.pi * radius) == pytest.approx(gather, abs=1.5)
    assert lap.longitudinal.min() == pytest.approx(-brake, rel=0.02)


def test_top_speed_is_where_power_meets_drag(shapes):
    lap = lap_limit(MACHINE, shapes.circle(5000.0).centre)
    top = (151_800.0 / (0.5 * 1.2 * 0.33)) ** (1.0 / 3.0)
    assert lap.speed == pytest.approx(top, rel=0.01)


def test_profile_does_not_depend_on_where_the_line_is_drawn():
    line = load_track("cremona").centre
    rows = np.roll(np.arange(len(line.s) - 1), -12345)
    rows = np.append(rows, rows[0])
    heading = np.unwrap(line.heading[rows])
    shifted = dataclasses.replace(
        line, x=line.x[rows], y=line.y[rows], heading=heading, curvature=line.curvature[rows], sections=()
    )
    assert lap_limit(MACHINE, shifted).lap_time == pytest.approx(lap_limit(MACHINE, line).lap_time, abs=2e-3)


def test_no_point_exceeds_the_machine_and_time_distance_and_sectors_agree():
    lap = lap_limit(MACHINE, load_track("barcelona").centre)
    assert sum(lap.sector_times) == pytest.approx(lap.lap_time, abs=1e-9)
    assert len(lap.sector_times) == 3
    assert lap.speed_at(lap.s[-1] + lap.s[7]) == pytest.approx(lap.speed[7])
    lateral, longitudinal = lap.lateral[:-1], lap.longitudinal[:-1]
    speed = 0.5 * (lap.speed[1:] + lap.speed[:-1])
    assert np.sum(np.diff(lap.time) * speed) == pytest.approx(lap.s[-1])
    assert np.all(np.abs(lateral) <= MACHINE.lateral(speed) * 1.001)
    # At the limit of cornering what is left has an infinite slope: a hundredth of the lateral acceleration is allowed.
    side = 0.99 * 0.5 * (lap.lateral[1:] + lap.lateral[:-1])
    assert np.all(longitudinal <= MACHINE.drive(speed, side) + 0.05)
    assert np.all(-longitudinal <= MACHINE.brake(speed, side) + 0.05)


def test_every_limit_matters():
    line = load_track("barcelona").centre
    base = lap_limit(constant(), line).lap_time
    assert lap_limit(constant(lateral=13.0), line).lap_time < base - 0.5
    assert lap_limit(constant(drive=7.0), line).lap_time < base - 0.5
    assert lap_limit(constant(brake=11.0), line).lap_time < base - 0.3
    assert lap_limit(constant(exponent=4.0), line).lap_time < base - 0.3


def test_hills_slow_up_and_help_down(shapes):
    track = shapes.oval(50.0, 400.0)
    centre = track.centre
    up = dataclasses.replace(
        centre, height=np.interp(centre.s, [0.0, 400.0, 450.0, centre.length], [0.0, 20.0, 20.0, 0.0])
    )
    flat, climbing = (lap_limit(MACHINE, line, crest=np.zeros(len(centre.s))) for line in (centre, up))
    rows = (flat.s > 20.0) & (flat.s < 200.0)
    lost = (flat.longitudinal - climbing.longitudinal)[rows]
    assert np.mean(lost) == pytest.approx(0.05 * GRAVITY, rel=0.35)
    assert climbing.lap_time > flat.lap_time


def test_bad_requests_are_refused(shapes):
    line = shapes.circle().centre
    with pytest.raises(ValueError, match="is open"):
        lap_limit(MACHINE, Course.from_elements("line", [Line(100.0)]))
    with pytest.raises(ValueError, match="step of the profile"):
        lap_limit(MACHINE, line, step=0.0)
    with pytest.raises(ValueError, match="no drive"):
        lap_limit(constant(drive=0.0), line)
    with pytest.raises(ValueError, match="lateral_g of a point mass"):
        point_mass_envelope(-1.0)


def test_a_cap_is_kept(shapes):
    line = shapes.oval(50.0, 300.0).centre
    free = lap_limit(constant(drive=6.0), line)
    cap = np.where(free.s[:-1] < 100.0, 20.0, np.inf)
    held = lap_limit(constant(drive=6.0), line, cap=cap)
    assert held.speed[:-1][free.s[:-1] < 100.0].max() <= 20.0 + 1e-9
    assert held.lap_time > free.lap_time + 0.5
    with pytest.raises(ValueError, match="cap has shape"):
        lap_limit(constant(), line, cap=np.ones(3))


def test_crests_cost_and_dips_help(shapes):
    line = shapes.circle(60.0).centre
    level = lap_limit(constant(), line)
    for crest in (-0.004, 0.004):
        lap = lap_limit(constant(), line, crest=np.full(len(line.s), crest))
        # v^2 / R = a (1 + v^2 c / g): the load of the road's curvature scales what the tyres give.
        square = 12.0 / (1.0 / 60.0 - 12.0 * crest / GRAVITY)
        assert lap.speed == pytest.approx(math.sqrt(square), rel=1e-3)
        assert (lap.lap_time > level.lap_time) == (crest < 0.0)
    with pytest.raises(ValueError, match="crest has 3 samples"):
        lap_limit(MACHINE, line, crest=np.zeros(3))


@pytest.mark.parametrize("degrees", [-10.0, -4.0, 4.0, 10.0])
def test_banking_helps_or_hinders_by_its_side(shapes, degrees):
    """Along the road the tyres carry v^2 cos(b) / R + g sin(b), across it g cos(b) - v^2 sin(b) / R."""
    line, radius = shapes.circle(60.0).centre, 60.0
    bank = math.radians(degrees)  # the circle turns to the left; positive: the left side is higher, off-camber
    banked = dataclasses.replace(line, bank=np.full(len(line.s), math.tan(bank)))
    lap = lap_limit(constant(), banked)
    held = 12.0 / GRAVITY
    turn = GRAVITY * (held * math.cos(bank) - math.sin(bank)) / (math.cos(bank) + held * math.sin(bank))
    assert lap.speed == pytest.approx(math.sqrt(turn * radius), rel=1e-3)
    assert (lap.lap_time > lap_limit(constant(), line).lap_time) == (degrees > 0.0)
    other = dataclasses.replace(banked, y=-line.y, heading=-line.heading, curvature=-line.curvature, bank=-banked.bank)
    assert lap_limit(constant(), other).lap_time == pytest.approx(lap.lap_time, rel=1e-9)


def test_a_banked_straight_takes_from_drive_and_brakes(shapes):
    line = shapes.oval().centre
    straight = np.abs(line.curvature) < 1e-9
    banked = dataclasses.replace(line, bank=np.where(straight, 0.1, 0.0))
    assert lap_limit(constant(), banked).lap_time > lap_limit(constant(), line).lap_time + 0.01
