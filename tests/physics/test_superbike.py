"""Superbike files and dataclass, and the closed-form steady states."""

import math
import re
from dataclasses import FrozenInstanceError, asdict, fields, replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
import yaml

from bike_sim.physics import bodies as bd
from bike_sim.physics.bicycle import linear
from bike_sim.physics.engines import make_engine
from bike_sim.physics.superbike import statics
from bike_sim.physics.superbike.bullet import BulletSuperbikeEngine
from bike_sim.physics.superbike.pose import without_rider
from bike_sim.planning.envelope import Envelope, envelope
from bike_sim.vehicles.bicycle import Vehicle
from bike_sim.vehicles.files import load_superbike, load_vehicle, shipped_vehicles
from bike_sim.vehicles.parameters import VehicleError
from bike_sim.vehicles.superbike import Superbike

NAMES = tuple(name for name in shipped_vehicles() if isinstance(load_vehicle(name), Superbike))
FOLDER = resources.files("bike_sim") / "config" / "vehicles"


MACHINES = {name: load_superbike(name) for name in NAMES}
DUCATI = MACHINES["panigale_v4r"]


def document(name: str = "panigale_v4r") -> dict:
    return yaml.safe_load((FOLDER / f"{name}.yaml").read_text(encoding="utf-8"))


def write(content: dict, folder: Path) -> Path:
    path = folder / "own.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def test_the_five_are_shipped_and_the_bicycle_is_still_one() -> None:
    assert {"panigale_v4r", "zx10rr", "cbr1000rr_r", "r1", "m1000rr"} <= set(NAMES)
    bicycle = load_vehicle("whipple")
    assert type(bicycle) is Vehicle


@pytest.mark.parametrize("name", NAMES)
def test_every_value_has_a_source_or_is_an_estimate(name: str) -> None:
    lines = (FOLDER / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
    values = [line for line in lines if re.match(r"\s*\w+: -?[\d.]+(e[+-]?\d+)?\s", line + " ")]
    assert len(values) > 100
    for line in values:
        if re.match(r"\s+\w+_control: 1.0 ", line):  # a switch
            continue
        comment = line.partition("#")[2]
        assert re.search(r"\[(S\d|maker|reference rider|estimate)|\[.*estimate", comment), line
    cited = set(re.findall(r"\bS\d\b", "\n".join(values)))
    assert cited <= set(document(name)["sources"])


def test_wet_mass_and_load_share_come_back() -> None:
    for name, vehicle in MACHINES.items():
        bodies = document(name)["bodies"]
        bare = without_rider(vehicle)
        assert bare.mass == pytest.approx(bodies["wet_mass"])
        x, height = bare.centre_of_mass
        assert x / vehicle.w == pytest.approx(bodies["front_load_share"])
        assert height == pytest.approx(bodies["centre_height"])
        assert vehicle.mass == pytest.approx(bodies["wet_mass"] + vehicle.rider.mass)


def test_rear_body_is_frame_and_rider_by_parallel_axes() -> None:
    v, f, r = DUCATI, DUCATI.frame, DUCATI.rider
    assert v.xB == pytest.approx((f.mass * f.x + r.mass * r.x) / v.mB)
    pitch = f.Iyy + r.Iyy
    for body in (f, r):
        pitch += body.mass * ((body.x - v.xB) ** 2 + (body.height + v.zB) ** 2)
    assert v.IByy == pytest.approx(pitch)
    # the product of inertia that a z-down benchmark file would hold, from first principles
    product = f.Ixz - sum(body.mass * (body.x - v.xB) * (body.height + v.zB) for body in (f, r))
    tensor = bd.inertia_tensors(v)[bd.REAR_FRAME]
    assert tensor[0, 2] == pytest.approx(product)


def test_wheel_power_never_exceeds_the_engines() -> None:
    for vehicle in MACHINES.values():
        spin = vehicle.wheel_torque_spacing * np.arange(vehicle.wheel_torque.size)
        power = vehicle.wheel_torque * spin
        assert power.max() <= 1.0001 * vehicle.motor.efficiency * vehicle.motor.peak_power
        assert power.max() >= 0.97 * vehicle.motor.efficiency * vehicle.motor.peak_power
        assert vehicle.wheel_torque[-1] == 0.0


def test_records_for_compiled_code_carry_every_number_by_its_name() -> None:
    machine = DUCATI.machine
    assert machine["mass"] == DUCATI.mass
    for name in ("rider", "air", "motor", "brakes", "steering", "virtual_rider", "electronics"):
        section = getattr(DUCATI, name)
        assert {field.name: machine[name][field.name] for field in fields(section)} == asdict(section)
    for record, tyre in ((machine["rear_tyre"], DUCATI.rear_tyre), (machine["front_tyre"], DUCATI.front_tyre)):
        numbers = {name: value for name, value in asdict(tyre).items() if name != "magic_formula"}
        assert {name: record[name] for name in record.dtype.names if name != "magic_formula"} == {
            **numbers,
            "peak": tyre.peak,
            "sag": 0.0,
        }
        assert not any(record["magic_formula"].tolist())
    with pytest.raises(ValueError, match="read-only"):
        DUCATI.wheel_torque[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        machine["mass"] = 1.0
    with pytest.raises(FrozenInstanceError):
        DUCATI.air.drag_area = 0.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("air", "drag_area", -0.3, "air.drag_area = -0.3 must not be negative"),
        ("front_tyre", "crown", 0.4, "must stay below the wheel's radius"),
        ("rear_tyre", "shape", 2.5, "has no peak"),
        ("rear_tyre", "friction", 0.0, "rear_tyre.friction = 0.0 must be positive"),
        ("rear_tyre", "friction", float("nan"), "rear_tyre.friction = nan is not a finite number"),
        ("motor", "peak_power_rpm", 9000.0, "peak_torque_rpm"),
        ("motor", "final_ratio", 0.1, "m/s at the limiter in top gear; at most 200 m/s"),
        ("motor", "gear_3", 2.9, "gear_1 >= gear_2"),
        ("motor", "gear_6", 0.0, "motor.gear_6 = 0.0 must be positive"),
        ("motor", "peak_torque", 90.0, "needs 101.442 N m, more than motor.peak_torque = 90"),
        ("brakes", "front_share", 1.2, "between 0 and 1"),
        ("virtual_rider", "max_lean_deg", 80.0, "below the fall"),
        ("bodies", "wet_mass", 20.0, "leaves no mass for the frame"),
        ("electronics", "traction_slip_off", 1.0, "traction_slip_on"),
        ("geometry", "wheelbase", "long", "'long' is not a finite number"),
    ],
)  # fmt: skip
def test_impossible_machines_are_refused(section: str, key: str, value: object, message: str, tmp_path: Path) -> None:
    content = document()
    content[section][key] = value
    with pytest.raises(VehicleError, match=re.escape(message)):
        load_vehicle(write(content, tmp_path))


def test_missing_unknown_and_foreign(tmp_path: Path) -> None:
    content = document()
    del content["air"]["height"]
    content["air"]["colour"] = 1.0
    with pytest.raises(VehicleError, match="lacks height and has unknown colour"):
        load_vehicle(write(content, tmp_path))
    with pytest.raises(VehicleError, match="unknown type 'tricycle'"):
        load_vehicle(write({**document(), "type": "tricycle"}, tmp_path))


def test_it_is_a_vehicle_to_the_rest_of_the_physics() -> None:
    matrices = linear.canonical_matrices(DUCATI)
    assert np.linalg.eigvalsh(matrices.M).min() > 0.0
    with pytest.raises(ValueError, match="no tyres"):
        make_engine("whipple", DUCATI, 0.002)
    with pytest.raises(ValueError, match="is no superbike"):
        BulletSuperbikeEngine(load_vehicle("whipple"), 0.002)  # type: ignore[arg-type]


def blade() -> Superbike:
    """A machine on knife edges without spin, air and hang-off: it leans like a point on a blade."""
    thin = {"crown": 1e-9}
    return replace(
        DUCATI,
        front_tyre=replace(DUCATI.front_tyre, **thin),
        rear_tyre=replace(DUCATI.rear_tyre, **thin),
        rider=replace(DUCATI.rider, slide=0.0),
        motor=replace(DUCATI.motor, crank_momentum=0.0),
        air=replace(DUCATI.air, down_area=0.0),
        IRyy=1e-6, IRxx=1e-6, IFyy=1e-6, IFxx=1e-6,
    )  # fmt: skip


@pytest.mark.parametrize("lean_deg", [5.0, 30.0, 55.0])
def test_a_point_on_a_blade_leans_by_the_tangent(lean_deg: float) -> None:
    lean = math.radians(lean_deg)
    assert statics.steady_lateral(blade(), lean, 1e4) == pytest.approx(9.81 * math.tan(lean), rel=1e-6)


def test_steady_lateral_by_hand() -> None:
    """Toroidal tyres and hang-off at 45 deg, fast enough for nothing else but spin to matter."""
    c, h = 0.08, 0.6
    v = replace(
        blade(),
        front_tyre=replace(DUCATI.front_tyre, crown=c),
        rear_tyre=replace(DUCATI.rear_tyre, crown=c),
        rider=replace(DUCATI.rider, slide=0.18, slide_lean_deg=45.0),
    )
    _, h = v.centre_of_mass
    offset = 80.0 * 0.18 / v.mass
    root = math.sqrt(0.5)
    y, z = (h - c) * root + offset * root, c + (h - c) * root - offset * root
    assert statics.steady_lateral(v, math.radians(45.0), 1e4) == pytest.approx(9.81 * y / z, rel=1e-6)


@pytest.mark.parametrize("name", [name for name in NAMES if MACHINES[name].joints is None])  # on racing tyres
def test_envelope(name: str) -> None:
    limits = envelope(MACHINES[name])
    assert 1.5 < limits.lateral(30.0) / 9.81 < 1.7
    assert 0.7 < limits.drive(20.0) / 9.81 < 1.0
    assert 1.0 < limits.brake(20.0) / 9.81 < 1.25
    drive = limits.drive(limits.speeds)
    assert drive[-1] < 0.0  # beyond top speed
    assert (np.diff(limits.brake(limits.speeds)) > 0.0).all()  # air helps
    top = limits.speeds[np.argmax(drive <= 0.0)]
    assert 80.0 < top < 95.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"brake_table": np.full((2, 3, 4), np.nan)}, "brake_table must be finite"),
        ({"lateral_table": np.zeros((2, 3))}, "lateral_table must be finite, and a limit positive"),
    ],
)  # fmt: skip
def test_wrong_envelopes_are_refused(change: dict, message: str) -> None:
    one = np.ones
    right = {
        "speeds": np.arange(3.0), "loads": np.array([0.5, 1.0]), "lateral_table": one((2, 3)),
        "drive_table": one((2, 3, 4, 2)), "brake_table": one((2, 3, 4)), "lean_table": one((2, 3, 4)), "drag": one(3),
        "inside": one(5), "height": one(5), "sway": 0.7, "lean_rate": one(3),
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        Envelope(name="x", **{**right, **change})
