"""A superbike on ground that is not level: hills, crests, banking, bumps, loose ground and wind, in both engines."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bike_sim.course.road import CLASSES, REFERENCE, bump_profile
from bike_sim.physics import state as st
from bike_sim.physics.engines import make_engine
from bike_sim.physics.ground import BUMP_SAMPLES, BUMP_SPACING, NO_BUMPS, Ground, flat_ground
from bike_sim.physics.superbike import forces as sf
from bike_sim.physics.superbike.contact import bump_at, surface_at
from bike_sim.physics.superbike.engine import SuperbikeEngine
from bike_sim.physics.superbike.statics import inertial_mass
from bike_sim.schema import SIGNALS
from bike_sim.vehicles.files import load_superbike
from bike_sim.vehicles.superbike import Superbike

signal = SIGNALS.index

STEP, PERIOD, G = 0.002, 0.02, 9.81

LOADED = load_superbike("panigale_v4r")
DUCATI: Superbike = LOADED


@pytest.fixture(scope="module")
def engine() -> SuperbikeEngine:
    made = make_engine("compiled", DUCATI, STEP)
    assert isinstance(made, SuperbikeEngine)
    return made


def ground(bumps: np.ndarray = NO_BUMPS, wind: tuple[float, float] = (0.0, 0.0), **patch: float) -> Ground:
    """Return ground that is the same under both wheels."""
    made = Ground(flat_ground().record, bumps)
    for wheel in ("rear", "front"):
        for name, value in patch.items():
            made.record[wheel][name] = value
    made.record["wind_x"], made.record["wind_y"] = wind
    return made


Lay = Callable[[np.ndarray, Ground], None]


def ride(
    machine: SuperbikeEngine,
    under: Ground,
    speed: float,
    seconds: float,
    steering: float = 0.0,
    throttle: float = 0.0,
    lay: Lay | None = None,
    **start: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Return states and telemetry after each control period of a ride with held commands, from upright.

    The ground is laid anew at the beginning of each period by ``lay(state, ground)``, and stays without it.
    """
    state = st.upright_state(speed, DUCATI.rF)
    for name, value in start.items():
        state[st.FIELDS.index(name)] = value
    if lay is not None:
        lay(state, under)
    machine.reset(state, under)
    states, telemetry = [], []
    for _ in range(round(seconds / PERIOD)):
        machine.advance(steering, throttle, round(PERIOD / machine.time_step), under)
        states.append(machine.state())
        telemetry.append(machine.telemetry())
        if lay is not None:
            lay(states[-1], under)
    return np.array(states), np.array(telemetry)


def loads(telemetry: np.ndarray) -> np.ndarray:
    return np.asarray(telemetry[:, signal("rear_load")] + telemetry[:, signal("front_load")])


def hills(height: float, length: float, bank: float = 0.0, bumps: float = 0.0) -> Lay:
    """Return what lays waves along x, with the slope across growing along y."""
    k = 2.0 * math.pi / length

    def lay(state: np.ndarray, under: Ground) -> None:
        x, y, yaw = state[st.X], state[st.Y], state[st.YAW]
        for wheel, ahead in (("rear", 0.0), ("front", DUCATI.w)):
            px, py = x + ahead * math.cos(yaw), y + ahead * math.sin(yaw)
            values = {
                "x": px,
                "y": py,
                "height": height * math.sin(k * px) + bank * py,
                "grade": height * k * math.cos(k * px),
                "crest": -height * k * k * math.sin(k * px),
                "bank": bank,
                "bumps": bumps,
                "arc": px,
            }
            for name, value in values.items():
                under.record[wheel][name] = value

    return lay


# --- level ground ---


def test_level_ground_has_no_direction_and_no_place(engine: SuperbikeEngine) -> None:
    """Not a bit depends on how level ground is described."""
    told = ground(x=30.0, y=-7.0, cos=0.6, sin=0.8, arc=12.0)
    one, other = (ride(engine, under, 40.0, 3.0, 0.5, 0.3) for under in (flat_ground(), told))
    assert (one[0] == other[0]).all()
    assert (one[1] == other[1]).all()


# --- hills ---


@pytest.mark.parametrize("grade", [0.08, -0.05])
def test_a_slope_accelerates_by_its_share_of_gravity(engine: SuperbikeEngine, grade: float) -> None:
    slope = math.atan(grade)
    level, there = (ride(engine, under, 30.0, 3.0) for under in (flat_ground(), ground(grade=grade)))
    along = there[1][:, signal("speed")] / math.cos(slope)
    gained = np.diff((along - level[1][:, signal("speed")])[[49, 149]])[0] / 2.0
    drag = sf.TELEMETRY_NAMES.index("drag_n")
    air = (level[1][50:150, drag] - there[1][50:150, drag]).mean()  # another speed meets another drag
    # the wheels' spin is inertia too
    assert gained == pytest.approx((air - DUCATI.mass * G * math.sin(slope)) / inertial_mass(DUCATI), rel=0.01)
    assert loads(there[1])[-1] == pytest.approx(loads(level[1])[-1] * math.cos(slope), rel=0.005)
    assert there[1][-1, signal("pitch")] == pytest.approx(level[1][-1, signal("pitch")] - slope, abs=0.002)


def test_the_height_of_a_closed_hill_gives_back_what_it_took() -> None:
    """Without air, rolling resistance and engine braking a machine coasts over hills like a point mass."""
    free = replace(
        DUCATI,
        air=replace(DUCATI.air, drag_area=0.0, down_area=0.0),
        motor=replace(DUCATI.motor, engine_brake=0.0),
        rear_tyre=replace(DUCATI.rear_tyre, rolling=0.0),
        front_tyre=replace(DUCATI.front_tyre, rolling=0.0),
    )
    height, length = 2.0, 300.0
    machine = make_engine("compiled", free, STEP)
    assert isinstance(machine, SuperbikeEngine)
    states, told = ride(machine, ground(), 50.0, 6.2, lay=hills(height, length))
    share = free.mass / inertial_mass(free)

    def speed_at(x: float) -> float:
        slope = height * 2.0 * math.pi / length * math.cos(2.0 * math.pi / length * x)
        return float(np.interp(x, states[:, st.X], told[:, signal("speed")])) * math.hypot(1.0, slope)

    for x, climbed in ((75.0, height), (225.0, -height), (300.0, 0.0)):
        assert speed_at(x) == pytest.approx(math.sqrt(50.0**2 - 2.0 * G * share * climbed), abs=0.02)


@pytest.mark.parametrize("crest", [-1e-3, 1e-3])
def test_a_crest_unloads_by_speed_squared_times_curvature(engine: SuperbikeEngine, crest: float) -> None:
    """On a vertical arc, laid anew at its top each period, the load settles at m (g + v^2 crest)."""
    speed = 50.0

    def lay(state: np.ndarray, under: Ground) -> None:
        for wheel, ahead in (("rear", 0.0), ("front", DUCATI.w)):
            x = state[st.X] + ahead
            under.record[wheel]["x"], under.record[wheel]["height"] = x, 0.5 * crest * x * x
            under.record[wheel]["grade"], under.record[wheel]["crest"] = crest * x, crest

    level = ride(engine, flat_ground(), speed, 1.6)
    _, there = ride(engine, ground(), speed, 1.6, lay=lay, x=-40.0)
    middle = slice(35, 45)  # around the top, where the road is level
    rode = there[middle, signal("speed")].mean()
    gained = loads(there)[middle].mean() - loads(level[1])[middle].mean()
    assert gained == pytest.approx(DUCATI.mass * crest * rode**2, rel=0.06)


# --- banking ---


@pytest.mark.parametrize("bank", [0.1, -0.1])
def test_banking_takes_a_share_of_the_side_force(engine: SuperbikeEngine, bank: float) -> None:
    """In a steady right turn on a banked ring: lean to the vertical stays, camber and side force change."""

    def lay(state: np.ndarray, under: Ground) -> None:
        for wheel in ("rear", "front"):
            under.record[wheel]["x"], under.record[wheel]["y"] = state[st.X], state[st.Y]
            under.record[wheel]["cos"], under.record[wheel]["sin"] = math.cos(state[st.YAW]), math.sin(state[st.YAW])

    level = ride(engine, flat_ground(), 30.0, 4.0, -0.6, 0.12)
    states, there = ride(engine, ground(bank=bank), 30.0, 4.0, -0.6, 0.12, lay=lay)
    roll, angle = states[-1, st.ROLL], math.atan(bank)
    assert roll == pytest.approx(level[0][-1, st.ROLL], abs=math.radians(0.2))
    assert there[-1, signal("rear_camber")] == pytest.approx(roll - angle, abs=math.radians(0.1))
    inward = -there[-1, signal("yaw_rate")] * there[-1, signal("speed")]
    side = -(there[-1, signal("rear_force_lat")] + there[-1, signal("front_force_lat")]) / DUCATI.mass
    load = loads(there)[-1] / DUCATI.mass
    assert side == pytest.approx(inward * math.cos(angle) - G * math.sin(angle), rel=0.03)
    # air presses a little, which the weight does not tell
    assert load == pytest.approx(G * math.cos(angle) + inward * math.sin(angle), rel=0.03)


def test_roll_is_to_the_vertical_and_a_fall_is_to_the_road(engine: SuperbikeEngine) -> None:
    under = ground(bank=math.tan(math.radians(20.0)))
    state = st.upright_state(30.0, DUCATI.rF)
    for roll, camber in ((0.0, -20.0), (20.0, 0.0), (40.0, 20.0)):
        state[st.ROLL] = math.radians(roll)
        engine.reset(state, under)
        assert engine.state()[st.ROLL] == pytest.approx(math.radians(roll), abs=1e-12)
        assert math.degrees(engine.telemetry()[signal("rear_camber")]) == pytest.approx(camber, abs=1e-6)
    state[st.ROLL] = -math.radians(0.5 * (DUCATI.fall_roll * 180.0 / math.pi + 58.0))  # inside the limit if level
    engine.reset(state, under)
    engine.advance(0.0, 0.0, 1, under)
    assert engine.fall == "tip_over"


# --- starts ---


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.5])
def test_a_start_on_a_slope_is_the_state_that_was_asked_for(engine: SuperbikeEngine, yaw: float) -> None:
    under = ground(grade=0.09, bank=0.05, crest=-5e-4, x=10.0, y=2.0, height=130.0, cos=0.8, sin=0.6)
    state = st.upright_state(40.0, DUCATI.rF)
    state[[st.X, st.Y, st.YAW, st.ROLL, st.STEER, st.ROLL_RATE]] = 11.0, 3.0, yaw, 0.7, -0.02, 0.4
    engine.reset(state, under)
    # the road bends: its normal where the machine stands is known to the millimetre
    assert engine.state() == pytest.approx(state, abs=1e-6)


@pytest.mark.parametrize("crest", [-4e-3, 4e-3])
def test_a_start_on_a_crest_and_in_a_dip_does_not_bounce(engine: SuperbikeEngine, crest: float) -> None:
    """Both wheels stand on the road that bends away below or up to the machine, and the machine turns with it."""
    bumps = bump_profile(4, BUMP_SAMPLES, BUMP_SPACING)[None]
    for size in (0.0, 4.0):  # smooth, and as rough as grass

        def bent(state: np.ndarray, under: Ground, size: float = size) -> None:
            for wheel, ahead in (("rear", 0.0), ("front", DUCATI.w)):
                x = state[st.X] + ahead
                values = {"x": x, "height": 0.5 * crest * x * x, "grade": crest * x, "crest": crest, "arc": x}
                for name, value in {**values, "bumps": size}.items():
                    under.record[wheel][name] = value

        _, told = ride(engine, ground(bumps), 20.0, 0.1, lay=bent)
        carried = DUCATI.mass * (DUCATI.g + crest * 20.0**2)
        assert loads(told)[0] == pytest.approx(carried, rel=0.25 if size else 0.15)
        assert told[:, [signal("rear_load"), signal("front_load")]].min() > 0.3 * 0.5 * carried


# --- bumps ---


def test_a_profile_has_the_spectrum_of_its_class_and_seed() -> None:
    profile = bump_profile(3, BUMP_SAMPLES, BUMP_SPACING)
    assert (profile == bump_profile(3, BUMP_SAMPLES, BUMP_SPACING)).all()
    assert np.abs(profile - bump_profile(4, BUMP_SAMPLES, BUMP_SPACING)).max() > 1e-3
    density = 2.0 * np.abs(np.fft.rfft(profile)) ** 2 * BUMP_SPACING / BUMP_SAMPLES
    frequency = np.fft.rfftfreq(BUMP_SAMPLES, BUMP_SPACING)
    for n in (0.05, 0.1, 1.0, 2.5):
        assert density[int(np.argmin(np.abs(frequency - n)))] == pytest.approx(REFERENCE * (n / 0.1) ** -2.0, rel=0.05)
    assert abs(profile.mean()) < 1e-12
    assert CLASSES["C"] == pytest.approx(256e-6)


def test_between_samples_bumps_are_smooth() -> None:
    profile = bump_profile(1, BUMP_SAMPLES, BUMP_SPACING)
    places = np.random.default_rng(0).uniform(-2000.0, 2000.0, 200)
    for s in places:
        height, slope = bump_at(s, profile)
        numeric = (bump_at(s + 1e-6, profile)[0] - bump_at(s - 1e-6, profile)[0]) / 2e-6
        assert slope == pytest.approx(numeric, abs=1e-6)
        assert bump_at(s + BUMP_SAMPLES * BUMP_SPACING, profile)[0] == pytest.approx(height, abs=1e-9)
    assert bump_at(17 * BUMP_SPACING, profile)[0] == pytest.approx(profile[17], abs=1e-12)


def test_the_normal_is_that_of_the_height() -> None:
    profile = bump_profile(1, BUMP_SAMPLES, BUMP_SPACING)
    patch = ground(grade=0.05, bank=-0.03, crest=1e-3, x=1.0, y=2.0, cos=0.8, sin=0.6, bumps=2.0).record["rear"][0]
    rng = np.random.default_rng(1)
    for x, y in rng.uniform(-3.0, 3.0, (50, 2)):
        normal = surface_at(x, y, patch, profile)[1]
        d = 1e-6
        east = (surface_at(x + d, y, patch, profile)[0] - surface_at(x - d, y, patch, profile)[0]) / (2.0 * d)
        north = (surface_at(x, y + d, patch, profile)[0] - surface_at(x, y - d, patch, profile)[0]) / (2.0 * d)
        assert np.array(normal) == pytest.approx(
            np.array([-east, -north, 1.0]) / math.sqrt(1.0 + east**2 + north**2), abs=1e-6
        )


def test_rougher_roads_shake_the_load_more(engine: SuperbikeEngine) -> None:
    bumps = bump_profile(1, BUMP_SAMPLES, BUMP_SPACING)[None]
    spread = []
    for size in (0.0, 0.5, 1.0):
        states, told = ride(engine, ground(bumps), 50.0, 4.0, 0.0, 0.2, lay=hills(0.0, 100.0, bumps=size))
        spread.append(float(np.std(loads(told)[50:])))
    assert spread[0] < 20.0
    assert spread[2] == pytest.approx(2.0 * spread[1], rel=0.05)
    assert spread[2] == pytest.approx(float(np.std(heaving_load(states[:, st.X], bumps[0])[50:])), rel=0.1)


def heaving_load(places: np.ndarray, profile: np.ndarray) -> np.ndarray:
    """Change of the load of a stiff beam on two springs that a rough road lifts, and two dampers that know none, N."""
    x, height = DUCATI.centre_of_mass
    bodies = ((DUCATI.mB, DUCATI.xB, -DUCATI.zB), (DUCATI.mH, DUCATI.xH, -DUCATI.zH))
    wheels = ((DUCATI.mR, 0.0, DUCATI.rR), (DUCATI.mF, DUCATI.w, DUCATI.rF))
    inertia = DUCATI.IByy + DUCATI.IHyy
    inertia += sum(m * ((along - x) ** 2 + (up - height) ** 2) for m, along, up in (*bodies, *wheels))
    step, place = 0.001, np.array([0.0, 0.0])
    rate, told = np.array([0.0, 0.0]), []
    arms, rows = np.array([-x, DUCATI.w - x]), round(PERIOD / step)
    stiffness, damping = (
        np.array([getattr(tyre, name) for tyre in (DUCATI.rear_tyre, DUCATI.front_tyre)])
        for name in ("stiffness", "damping")
    )
    for k in range(rows * len(places)):
        at = np.interp(k / rows, np.arange(len(places)), places)
        road = np.array([bump_at(at, profile)[0], bump_at(at + DUCATI.w, profile)[0]])
        force = stiffness * (road - place[0] - arms * place[1]) - damping * (rate[0] + arms * rate[1])
        rate = rate + step * np.array([force.sum() / DUCATI.mass, (arms * force).sum() / inertia])
        place = place + step * rate
        if (k + 1) % rows == 0:
            told.append(force.sum())
    return np.array(told)


# --- loose ground and wind ---


def test_loose_ground_slows_by_its_share_of_the_load(engine: SuperbikeEngine) -> None:
    level, there = (ride(engine, under, 20.0, 1.6) for under in (flat_ground(), ground(drag=0.1)))
    lost = (level[1][:, signal("speed")] - there[1][:, signal("speed")])[[29, 79]]
    assert lost[1] - lost[0] == pytest.approx(0.1 * G * DUCATI.mass / inertial_mass(DUCATI), rel=0.05)
    assert engine.fall == "none"


def test_loose_ground_holds_a_standing_machine_and_does_not_push_it(engine: SuperbikeEngine) -> None:
    states, _ = ride(engine, ground(drag=0.3), 0.5, 1.0)
    assert states[-1, st.X] < 0.1
    assert abs(states[-1, st.FRONT_WHEEL_RATE]) < 0.1


def test_wind_counts_as_speed_in_the_air(engine: SuperbikeEngine) -> None:
    calm = ride(engine, flat_ground(), 60.0, 0.02)[1][0, sf.TELEMETRY_NAMES.index("drag_n")]
    for wind in (-10.0, 10.0):
        blown = ride(engine, ground(wind=(wind, 0.0)), 60.0, 0.02)[1][0, sf.TELEMETRY_NAMES.index("drag_n")]
        assert blown / calm == pytest.approx(((60.0 - wind) / 60.0) ** 2, rel=1e-3)
    aside, _ = ride(engine, ground(wind=(0.0, 10.0)), 60.0, 3.0, 0.0, 0.3)
    assert aside[:, st.ROLL].min() < -math.radians(0.5) or aside[-1, st.Y] > 0.5
    assert engine.fall == "none"


# --- both engines, both sides, all steps ---


def hilly(machine: SuperbikeEngine, side: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Ride a bend over banked, bumpy hills in a cross-wind; `side` -1 for the mirror image."""
    bumps = bump_profile(2, BUMP_SAMPLES, BUMP_SPACING)[None]
    lay = hills(3.0, 180.0, side * 0.04, 0.3)
    return ride(machine, ground(bumps, wind=(-4.0, side * 5.0)), 40.0, seconds, side * 0.35, 0.15, lay=lay)


def test_a_mirrored_road_is_ridden_mirrored(engine: SuperbikeEngine) -> None:
    left, right = (hilly(engine, side, 5.0) for side in (1.0, -1.0))
    assert left[0] == pytest.approx(right[0] * st.MIRROR_SIGNS, abs=1e-8)


def test_rides_on_hills_converge_with_the_step() -> None:
    ends = []
    for step in (0.004, 0.002, 0.001, 0.0005):
        made: Any = make_engine("compiled", DUCATI, step)
        ends.append(hilly(made, 1.0, 3.0)[0][-1])
    apart = [np.abs(ends[k] - ends[k + 1])[[st.X, st.Y, st.ROLL]].max() for k in range(3)]
    assert apart[0] > 1.5 * apart[1] > 2.2 * apart[2]
    assert apart[2] < 0.1
