"""Quasi-steady equilibrium of a leaned machine, compiled: how much it can turn, drive and brake at the same time.

Two wheels, each within its friction ellipse under its own load. Beside load transfer three effects count that a point
mass does not have:

* The mass is on the inside of the line of contacts. Braking pushes it on and so turns the machine out of the curve: the
  front tyre's lateral force grows and the rear's falls; driving does the reverse.
* A tyre that carries a lateral force has a slip angle, which costs that force times its tangent along the road.
* The electronics allow what they allow at this lean and roll rate (`bike_sim.physics.superbike.drive`), less what they
  cut at the slips and loads that the force itself brings: a smaller force is cut less, so there is one that stays.

Lateral quantities are positive into the turn, whatever its side.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

from numba import njit

from bike_sim.physics.superbike import tyres
from bike_sim.physics.superbike.drive import aid_cuts, aid_limits
from bike_sim.vehicles.superbike import Record

_HALVINGS: Final = 30
LATERAL_TOLERANCE: Final = 1e-9
"""Accuracy of the lean of a lateral acceleration, m/s^2."""
_FORCE_TOLERANCE: Final = 0.1  # N
_SLIP_TOLERANCE: Final = 1e-6
_LEAST_COSINE: Final = 0.4
"""Of the lean beyond which a turn presses a machine no more on its springs."""
_TRIM_ROUNDS: Final = 3
"""Rounds in which loads and pose of a machine on springs agree to 1 mm."""


class Turn(NamedTuple):
    """A state of a machine in a turn.

    Attributes:
        speed: m/s.
        lean: rad, >= 0.
        lateral: acceleration of the mass, m/s^2.
        gravity: what presses the machine on the road, m/s^2: less over a crest, more in a dip.
        inertia: mass that thrust accelerates, the spinning wheels included, kg.
    """

    speed: float
    lean: float
    lateral: float
    gravity: float
    inertia: float


class Wheels(NamedTuple):
    """Forces on the ground, N.

    Attributes:
        rear: load.
        front: load.
        rear_side: lateral force.
        front_side: lateral force.
    """

    rear: float
    front: float
    rear_side: float
    front_side: float


class Pose(NamedTuple):
    """Where the mass is in the machine's plane, m; see `bike_sim.vehicles.trim`.

    Attributes:
        x: of the mass ahead of the rear contact.
        above: of the mass above the centres of the tyres' cross-sections.
        crown: of these centres above the ground.
        aside: of the mass towards the lean, by the rider's torso.
        wheelbase: distance of the contacts.
    """

    x: float
    above: float
    crown: float
    aside: float
    wheelbase: float


@njit(cache=True)
def _mean_crown(m: Record) -> float:
    """Return the radius of the tyres' cross-sections below the mass, m."""
    share = m.com_x / m.w
    return share * m.front_tyre.crown + (1.0 - share) * m.rear_tyre.crown


@njit(cache=True)
def _travel(force: float, trim: Record) -> float:
    """Return the travel of a suspension under a generalised force beyond the standing machine's, m or rad."""
    travel = trim.soft * force
    if travel > trim.most:
        return trim.most + (force - trim.most / trim.soft) * trim.hard
    if travel < trim.least:
        return trim.least + (force - trim.least / trim.soft) * trim.hard
    return travel


@njit(cache=True)
def travels(rear: float, front: float, thrust: float, m: Record) -> tuple[float, float]:
    """Return the angle of the swing arm (rad) and the travel of the fork (m), pressed together, under steady loads.

    Args:
        rear: load of the wheel in the machine's plane, N.
        front: the same.
        thrust: N, negative braking: both tyres in proportion to their loads.
        m: `Superbike.machine`.
    """
    at_rest = m.mass * m.g * m.com_x / m.w
    more_rear, more_front = rear - (m.mass * m.g - at_rest), front - at_rest
    drive, brake = max(thrust, 0.0), max(-thrust, 0.0)
    front_brake = min(max(front / (rear + front), 0.0), 1.0) * brake
    swing = m.rear_trim.load * more_rear + m.rear_trim.drive * drive + m.rear_trim.brake * (brake - front_brake)
    return _travel(swing, m.rear_trim), _travel(
        m.front_trim.load * more_front + m.front_trim.brake * front_brake, m.front_trim
    )


@njit(cache=True)
def mass_place(lean: float, pose: Pose, m: Record) -> tuple[float, float]:
    """Return how far the mass is inside the line of contacts and how far above the ground, m.

    The toroidal tyres move the contacts towards the lean, and the rider hangs off.
    """
    slide = m.rider.slide * min(1.0, math.degrees(lean) / m.rider.slide_lean_deg)
    offset = m.rider.mass * slide / m.mass + pose.aside
    sin_lean, cos_lean = math.sin(lean), math.cos(lean)
    return pose.above * sin_lean + offset * cos_lean, pose.crown + pose.above * cos_lean - offset * sin_lean


class Load(NamedTuple):
    """What acts on a machine in a turn.

    Attributes:
        pressing: acceleration by which the mass presses on the wheels in the machine's plane, m/s^2.
        falling: the same square to that plane, towards the lean, m/s^2.
        upward: force of the ground, N.
        down: downforce in the machine's plane, N.
        drag: N.
        thrust: of the tyres along the road, N, negative braking.
    """

    pressing: float
    falling: float
    upward: float
    down: float
    drag: float
    thrust: float


@njit(cache=True)
def pose_under(load: Load, m: Record) -> Pose:
    """Return the pose of a machine in a turn: the standing one where it is rigid."""
    crown = _mean_crown(m)
    x, above, wheelbase = m.com_x, m.com_height - crown, m.w
    if m.rear_trim.tyre == 0.0:
        return Pose(x, above, crown, 0.0, wheelbase)
    share, weight = m.com_x / m.w, m.mass * m.g
    standing = share * m.front_trim.tyre * weight * share + (1.0 - share) * m.rear_trim.tyre * weight * (1.0 - share)
    height = m.com_height
    total = max(m.mass * load.pressing + load.down, 1.0)
    for _ in range(_TRIM_ROUNDS):
        moment = m.mass * load.pressing * x + load.down * m.air.x
        moment -= load.drag * m.air.height + (load.thrust - load.drag) * height
        front = min(max(moment / wheelbase, 0.0), total)
        swing, travel = travels(total - front, front, load.thrust, m)
        part = front / total
        pressed = load.upward * (share * m.front_trim.tyre * part + (1.0 - share) * m.rear_trim.tyre * (1.0 - part))
        x = m.com_x + m.rear_trim.forward * swing + m.front_trim.forward * travel
        above = m.com_height - crown - m.rear_trim.sink * swing - m.front_trim.sink * travel
        wheelbase = m.w - m.rear_trim.shorter * swing - m.front_trim.shorter * travel
        height = above + crown + standing - pressed
    swayed = m.torso_trim.moment * load.falling / max(m.torso_trim.stiffness - m.torso_trim.moment * load.pressing, 1.0)
    return Pose(x, above, crown + standing - pressed, m.torso_trim.moment * swayed / m.mass, wheelbase)


@njit(cache=True)
def turning_place(lean: float, m: Record) -> tuple[float, float]:
    """Return `mass_place` of a turn on level ground without air."""
    pressing = m.g / max(math.cos(lean), _LEAST_COSINE)
    return mass_place(lean, pose_under(Load(pressing, 0.0, m.mass * m.g, 0.0, 0.0, 0.0), m), m)


@njit(cache=True)
def steady_lateral(lean: float, speed: float, gravity: float, spread: float, m: Record) -> float:
    """Return the lateral acceleration of a steady turn, m/s^2; see `superbike_statics.steady_lateral`.

    Args:
        lean: rad, >= 0.
        speed: m/s.
        gravity: m/s^2.
        spread: integral of z^2 - y^2 over the mass about its centre, in the machine's axes, kg m2.
        m: `Superbike.machine`.
    """
    sin_lean, cos_lean = math.sin(lean), math.cos(lean)
    momentum = m.motor.crank_momentum
    momentum += m.IRyy * speed / (m.rR - m.rear_tyre.crown * (1.0 - cos_lean))
    momentum += m.IFyy * speed / (m.rF - m.front_tyre.crown * (1.0 - cos_lean))
    pressure = 0.5 * m.air.density * speed**2
    down, drag = 0.5 * m.air.density * m.air.down_area * speed**2, pressure * m.air.drag_area
    quadratic = spread * sin_lean * cos_lean / speed**2
    a = gravity * math.tan(lean)
    for i in range(21):
        upward = m.mass * gravity + down * cos_lean
        pressing, falling = gravity * cos_lean + a * sin_lean, gravity * sin_lean - a * cos_lean
        pose = pose_under(Load(pressing, falling, upward, down, drag, drag), m)
        y, z = mass_place(lean, pose, m)
        pull = m.mass * gravity * y - down * pose.crown * sin_lean
        linear = m.mass * z + momentum / speed * cos_lean
        a = pull / (linear - quadratic * a) if i > 0 else pull / linear
    return a


@njit(cache=True)
def _enclose(
    low: float, below: float, high: float, above: float, at: float, value: float
) -> tuple[float, float, float, float]:
    """Return both ends of an interval around a zero of a growing function, each with its value, after one more value.

    Illinois: false position that halves the value of an end which stays, so that both ends come together.
    """
    if value <= 0.0:
        return at, value, high, 0.5 * above
    return low, 0.5 * below, at, value


@njit(cache=True)
def _false_position(low: float, below: float, high: float, above: float) -> float:
    """Return where the line between two values, one below and one above zero, is zero."""
    return high - above * (high - low) / (above - below)


@njit(cache=True)
def steady_lean(lateral: float, high: float, speed: float, gravity: float, spread: float, m: Record) -> float:
    """Return the lean at which a lateral acceleration is steady, rad; NaN if it takes as much as `high` (rad) or more.

    Args:
        lateral: m/s^2, > 0.
        high: largest lean, rad.
        speed: m/s.
        gravity: m/s^2.
        spread: see `steady_lateral`.
        m: `Superbike.machine`.
    """
    low, below = 0.0, -lateral
    above = steady_lateral(high, speed, gravity, spread, m) - lateral
    if above <= 0.0:
        return math.nan
    for _ in range(40):
        middle = _false_position(low, below, high, above)
        value = steady_lateral(middle, speed, gravity, spread, m) - lateral
        if abs(value) < LATERAL_TOLERANCE:
            return middle
        low, below, high, above = _enclose(low, below, high, above, middle, value)
    return high


@njit(cache=True)
def steady_lean_one(
    lateral: float, high: float, speed: float, gravity: float, spread: float, constants: Record
) -> float:
    """Do as `steady_lean` with an array of one `CONSTANTS`, which costs a caller in Python less than records."""
    return steady_lean(lateral, high, speed, gravity, spread, constants[0].machine)


@njit(cache=True)
def wheels(turn: Turn, thrust: float, m: Record) -> Wheels:
    """Return loads and lateral forces with a thrust (N, negative braking) of the tyres along the road."""
    sin_lean, cos_lean = math.sin(turn.lean), math.cos(turn.lean)
    pressure = 0.5 * m.air.density * turn.speed**2
    pull, down = pressure * m.air.drag_area, pressure * m.air.down_area
    weight = m.mass * turn.gravity
    pressing = turn.gravity * cos_lean + turn.lateral * sin_lean
    falling = turn.gravity * sin_lean - turn.lateral * cos_lean
    pose = pose_under(Load(pressing, falling, weight + down * cos_lean, down, pull, thrust), m)
    y, z = mass_place(turn.lean, pose, m)
    spin = (m.IRyy / m.rR + m.IFyy / m.rF) * cos_lean
    acceleration = (thrust - pull) / turn.inertia
    front_load = (
        weight * pose.x
        + down * cos_lean * m.air.x
        - pull * m.air.height * cos_lean
        - m.mass * acceleration * z
        - acceleration * spin
    ) / pose.wheelbase
    # Moments about the vertical through the rear contact: the air holds and the mass pushes on inside of it.
    side = m.mass * turn.lateral + down * sin_lean
    turned = m.mass * turn.lateral * pose.x + down * sin_lean * m.air.x
    opposed = pull * (m.air.height - m.rear_tyre.crown) * sin_lean + m.mass * acceleration * y
    front_side = (turned - opposed) / pose.wheelbase
    return Wheels(weight + down * cos_lean - front_load, front_load, side - front_side, front_side)


@njit(cache=True)
def left_along(load: float, side: float, lean: float, tyre: Record) -> float:
    """Return the force along the road that a tyre's lateral force leaves it, N; below 0 it cannot hold even that."""
    most = tyres.friction(lean, load, tyre) * load
    if load <= 0.0 or abs(side) > most:
        return -1.0
    return tyre.friction_ratio * most * math.sqrt(1.0 - (side / most) ** 2)


@njit(cache=True)
def _used(load: float, side: float, along: float, lean: float, tyre: Record) -> float:
    """Return the part of its friction that a tyre uses; see `tan_slip_angle_of`."""
    use = math.hypot(side, along / tyre.friction_ratio) / (tyres.friction(lean, load, tyre) * load)
    return min(max(use, 1e-9), 1.0)


@njit(cache=True)
def _slip_at(use: float, tyre: Record) -> float:
    """Return the normalised slip at which a tyre uses a part of its friction, up to its peak."""
    return tyre.shape * math.tan(math.asin(use) / tyre.shape)


@njit(cache=True)
def slip_of(load: float, side: float, along: float, lean: float, tyre: Record) -> float:
    """Return the normalised slip, up to its peak, with which a tyre gives two forces; see `tan_slip_angle_of`."""
    return _slip_at(_used(load, side, along, lean, tyre), tyre) if load > 0.0 else tyres.peak_slip(tyre)


@njit(cache=True)
def tan_slip_angle_of(load: float, side: float, along: float, lean: float, tyre: Record) -> float:
    """Return the tangent of the slip angle with which a tyre gives a lateral force.

    Args:
        load: N, > 0.
        side: lateral force, N.
        along: force along the road, N.
        lean: rad.
        tyre: its parameters.
    """
    mu = tyres.friction(lean, load, tyre)
    use = _used(load, side, along, lean, tyre)
    slip = _slip_at(use, tyre) * side / (mu * load) / use
    return (slip * mu - tyre.camber * lean) / tyres.cornering_coefficient(load, tyre)


@njit(cache=True)
def slip_angle_loss(load: float, side: float, along: float, lean: float, radius: float, tyre: Record) -> float:
    """Return the cost along the road of a tyre's lateral force, N: by its slip angle, and by its moment on a wheel.

    Args:
        load: N.
        side: lateral force, N.
        along: force along the road, N.
        lean: rad.
        radius: of the wheel, m.
        tyre: its parameters.
    """
    if load <= 0.0:
        return 0.0
    tan_slip_angle = tan_slip_angle_of(load, side, along, lean, tyre)
    moment = tyres.forces(0.0, tan_slip_angle, lean, load, 1.0, tyre)[2]
    return side * tan_slip_angle - moment * math.sin(lean) / radius


@njit(cache=True)
def holds(turn: Turn, thrust: float, m: Record) -> bool:
    """Return whether both tyres hold a turn with a thrust (N, >= 0) at the rear."""
    return _hold(wheels(turn, thrust, m), turn.lean, thrust, m)


@njit(cache=True)
def _hold(at: Wheels, lean: float, thrust: float, m: Record) -> bool:
    """Return whether tyres with these loads and lateral forces hold a thrust, N."""
    return (
        left_along(at.front, at.front_side, lean, m.front_tyre) >= 0.0
        and left_along(at.rear, at.rear_side, lean, m.rear_tyre) >= thrust
    )


@njit(cache=True)
def resistance(turn: Turn, at: Wheels, thrust: float, brake: float, m: Record) -> float:
    """Return what slows the machine beside its brakes, N: air, rolling and slip angles.

    Args:
        turn: the state.
        at: forces on the ground.
        thrust: of the rear tyre, N.
        brake: of the front tyre, N.
        m: `Superbike.machine`.
    """
    air = 0.5 * m.air.density * m.air.drag_area * turn.speed**2
    rear, front = m.rear_tyre, m.front_tyre
    rolling = rear.rolling * max(at.rear, 0.0) + front.rolling * max(at.front, 0.0)
    rear_loss = slip_angle_loss(at.rear, at.rear_side, thrust, turn.lean, m.rR, rear)
    return air + rolling + rear_loss + slip_angle_loss(at.front, at.front_side, brake, turn.lean, m.rF, front)


@njit(cache=True)
def _driven(turn: Turn, thrust: float, most: float, m: Record) -> bool:
    """Return whether both tyres hold a thrust (N) and the electronics leave as much of the `most` that is asked for."""
    at = wheels(turn, thrust, m)
    if not _hold(at, turn.lean, thrust, m):
        return False
    slip = slip_of(at.rear, at.rear_side, thrust, turn.lean, m.rear_tyre)
    cuts = aid_cuts(thrust, slip, at.rear, 0.0, at.front, m.electronics)
    return thrust <= cuts.traction * cuts.wheelie * most


@njit(cache=True)
def most_drive(turn: Turn, engine: float, roll_rate: float, m: Record) -> float:
    """Return the largest net forward acceleration, m/s^2; negative where resistance beats what the tyres have left.

    Args:
        turn: the state.
        engine: force at full throttle, N.
        roll_rate: rad/s, which the electronics answer.
        m: `Superbike.machine`.
    """
    aids = aid_limits(turn.lean, roll_rate, turn.speed**2, m)
    most = max(0.0, min(engine, aids.wheelie, aids.traction))
    high = most
    if not _driven(turn, high, most, m):
        low = 0.0
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if _driven(turn, middle, most, m) else (low, middle)
        high = low
    return (high - resistance(turn, wheels(turn, high, m), high, 0.0, m)) / turn.inertia


@njit(cache=True)
def _along_at(slip: float, load: float, side: float, lean: float, tyre: Record) -> float:
    """Return the force along the road of a tyre that slips (normalised) and gives a lateral force, N, at least 0."""
    most = tyres.friction(lean, load, tyre) * load
    combined = most * math.sin(tyre.shape * math.atan(slip / tyre.shape))
    return tyre.friction_ratio * math.sqrt(max(combined * combined - side * side, 0.0))


@njit(cache=True)
def _uncut(asked: float, load: float, side: float, lean: float, aids: Record, tyre: Record) -> float:
    """Return the force of a brake (N) that the tyre holds and brake control leaves of the one asked for.

    Both wheels' brakes are cut alike (`aids.aid_cuts`), by a slip that grows with the force.
    """
    available = left_along(load, side, lean, tyre)
    if available <= 0.0 or aids.brake_control == 0.0:
        return max(min(asked, available), 0.0)
    # below the first of these slips nothing is cut, beyond the second all
    low, high = aids.brake_slip_on, min(aids.brake_slip_off, tyres.peak_slip(tyre))
    below = _along_at(low, load, side, lean, tyre) - asked
    if below >= 0.0:
        return asked
    left = asked * aid_cuts(0.0, 0.0, load, high, load, aids).front
    above = _along_at(high, load, side, lean, tyre) - left
    for _ in range(_HALVINGS):
        if above <= 0.0 or high - low < _SLIP_TOLERANCE:
            break
        slip = _false_position(low, below, high, above)
        left = asked * aid_cuts(0.0, 0.0, load, slip, load, aids).front
        value = _along_at(slip, load, side, lean, tyre) - left
        if abs(value) < _FORCE_TOLERANCE:
            break
        low, below, high, above = _enclose(low, below, high, above, slip, value)
    return left


@njit(cache=True)
def brakes_left(turn: Turn, brake: float, m: Record) -> tuple[float, float]:
    """Return what front and rear brake can do while the machine is braked with a force, N."""
    at = wheels(turn, -brake, m)
    aids = aid_limits(turn.lean, 0.0, turn.speed**2, m)
    share = m.brakes.front_share * m.brakes.force
    stoppie = aid_cuts(0.0, 0.0, at.rear, 0.0, at.front, m.electronics).stoppie
    asked = stoppie * min(share, aids.braking, aids.stoppie)
    front_brake = _uncut(asked, at.front, at.front_side, turn.lean, m.electronics, m.front_tyre)
    asked = aids.rear * (m.brakes.force - share + m.motor.engine_brake)
    return front_brake, _uncut(asked, at.rear, at.rear_side, turn.lean, m.electronics, m.rear_tyre)


@njit(cache=True)
def _over(turn: Turn, brake: float, m: Record) -> float:
    """Return by how much a braking force is more than both brakes can do while it acts, N."""
    front_brake, rear_brake = brakes_left(turn, brake, m)
    return brake - front_brake - rear_brake


@njit(cache=True)
def most_brake(turn: Turn, m: Record) -> float:
    """Return the largest deceleration, resistance included, m/s^2."""
    low, high = 0.0, 1.01 * (m.brakes.force + m.motor.engine_brake)
    below, above = _over(turn, low, m), _over(turn, high, m)
    for _ in range(_HALVINGS):
        if high - low < _FORCE_TOLERANCE or below == 0.0:
            break
        brake = _false_position(low, below, high, above)
        value = _over(turn, brake, m)
        low, below, high, above = _enclose(low, below, high, above, brake, value)
        if abs(value) < _FORCE_TOLERANCE:
            break
    front_brake, rear_brake = brakes_left(turn, low, m)
    at = wheels(turn, -low, m)
    return (low + resistance(turn, at, rear_brake, front_brake, m)) / turn.inertia


@njit(cache=True)
def steepest(speed: float, gravity: float, spread: float, inertia: float, m: Record) -> float:
    """Return the lean at which coasting tyres hold no more, rad; at most the rider's largest."""
    low, high = 0.0, math.radians(m.virtual_rider.max_lean_deg)
    top = Turn(speed, high, steady_lateral(high, speed, gravity, spread, m), gravity, inertia)
    if holds(top, 0.0, m):
        return high
    for _ in range(_HALVINGS):
        lean = 0.5 * (low + high)
        turn = Turn(speed, lean, steady_lateral(lean, speed, gravity, spread, m), gravity, inertia)
        low, high = (lean, high) if holds(turn, 0.0, m) else (low, lean)
    return low
