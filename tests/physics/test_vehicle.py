"""Vehicle files: what ships loads, what is broken says so in one clear error."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from bike_sim.vehicles.bicycle import PARAMETER_NAMES, Vehicle
from bike_sim.vehicles.files import load_vehicle, shipped_vehicles, vehicle_template
from bike_sim.vehicles.parameters import VehicleError


@pytest.fixture
def document() -> dict[str, Any]:
    text = (resources.files("bike_sim") / "config" / "vehicles" / "whipple.yaml").read_text(encoding="utf-8")
    return yaml.safe_load(text)


def load(document: Any, folder: Path) -> Vehicle:
    path = folder / "mine.yaml"
    path.write_text(yaml.safe_dump(document), encoding="utf-8")
    return load_vehicle(path)


@pytest.mark.parametrize("name", shipped_vehicles())
def test_every_shipped_vehicle_loads(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    assert vehicle.parameters.shape == (len(PARAMETER_NAMES),)


def test_shipped_bicycle_is_the_published_one() -> None:
    vehicle = load_vehicle("whipple")
    assert vehicle.lam == math.pi / 10
    assert (vehicle.w, vehicle.c, vehicle.g) == (1.02, 0.08, 9.81)
    assert vehicle.mR + vehicle.mB + vehicle.mH + vehicle.mF == 94.0
    assert (vehicle.P, vehicle.D) == (9.0, 1.6)
    assert math.degrees(vehicle.max_steer) == pytest.approx(70.0)
    assert math.degrees(vehicle.fall_roll) == pytest.approx(45.0)


def test_parameters_follow_their_names_and_cannot_be_changed() -> None:
    vehicle = load_vehicle("whipple")
    for value, name in zip(vehicle.parameters, PARAMETER_NAMES, strict=True):
        assert value == getattr(vehicle, name)
    with pytest.raises(ValueError, match="read-only"):
        vehicle.parameters[0] = 1.0


def test_a_variant_has_its_own_parameters() -> None:
    vehicle = load_vehicle("whipple")
    vehicle.parameters  # noqa: B018  a variant must not inherit the cached vector
    free = replace(vehicle, P=0.0, D=0.0, g=0.0)
    np.testing.assert_array_equal(free.parameters[[PARAMETER_NAMES.index(n) for n in ("P", "D", "g")]], 0.0)


def test_a_vehicle_survives_pickling() -> None:
    vehicle = load_vehicle("whipple")
    assert pickle.loads(pickle.dumps(vehicle)) == vehicle


def test_own_file_equals_the_shipped_one(document: dict[str, Any], tmp_path: Path) -> None:
    assert load(document, tmp_path) == load_vehicle("whipple")


def test_every_key_is_needed_and_no_other_is_taken(document: dict[str, Any], tmp_path: Path) -> None:
    for section in ("bicycle", "steering_drive", "limits"):
        for key in document[section]:
            broken = copy.deepcopy(document)
            del broken[section][key]
            with pytest.raises(VehicleError, match=rf"{section}.*lacks {key}$"):
                load(broken, tmp_path)
        broken = copy.deepcopy(document)
        broken[section]["wheel_base"] = 1.0
        with pytest.raises(VehicleError, match=rf"{section}.*unknown wheel_base"):
            load(broken, tmp_path)
    for key in document:
        broken = {other: value for other, value in document.items() if other != key}
        with pytest.raises(VehicleError, match=f"lacks {key}"):
            load(broken, tmp_path)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), "1e3", None, True, [1.0], 10**400])
def test_what_is_not_a_finite_number_is_refused(document: dict[str, Any], tmp_path: Path, bad: Any) -> None:
    document["bicycle"]["mB"] = bad
    with pytest.raises(VehicleError, match=r"mB = .* is not a finite number|mB is a whole number beyond"):
        load(document, tmp_path)


@pytest.mark.parametrize(
    ("section", "key", "value", "message"),
    [
        ("bicycle", "mF", 0.0, "mF = 0.0 must be positive"),
        ("bicycle", "rR", -0.3, "rR = -0.3 must be positive"),
        ("bicycle", "g", -9.81, "g = -9.81 must not be negative"),
        ("bicycle", "zB", 0.9, "zB = 0.9 .*below the ground"),
        ("bicycle", "lambda", 1.6, "lam = .* below 90 deg"),
        ("bicycle", "IBxz", 6.0, "IB is not positive definite"),  # 9.2 * 2.8 < 6^2
        ("bicycle", "IHzz", -0.1, "IH is not positive definite"),
        ("bicycle", "IByy", 12.5, "IB breaks the triangle inequality"),  # 9.2 + 2.8 = 12
        ("bicycle", "IRyy", 0.121, "IR breaks the triangle inequality"),  # 2 * 0.0603 = 0.1206
        ("steering_drive", "D", -1.0, "D = -1.0 must not be negative"),
        ("steering_drive", "max_steer_deg", 95.0, "max_steer = 95 deg must stay below 90 deg"),
        ("limits", "fall_roll_deg", 0.0, "limits.fall_roll_deg = 0.0 must be positive"),
    ],
)
def test_impossible_vehicles_are_refused(
    document: dict[str, Any], tmp_path: Path, section: str, key: str, value: float, message: str
) -> None:
    document[section][key] = value
    with pytest.raises(VehicleError, match=message):
        load(document, tmp_path)


@pytest.mark.parametrize("name", shipped_vehicles())
def test_a_template_explains_every_number_and_loads_as_its_vehicle(name: str, tmp_path: Path) -> None:
    text = vehicle_template(name)
    numbers = [line for line in text.splitlines() if " # " in line or line.partition(": ")[2][:1].isdigit()]
    assert len(numbers) >= 29
    assert all(len(line.partition(" # ")[2]) > 3 for line in numbers)
    (tmp_path / "mine.yaml").write_text(text)
    shipped = load_vehicle(name)
    mine = replace(load_vehicle(tmp_path / "mine.yaml"), name=shipped.name, description=shipped.description)
    assert mine == shipped


def test_files_that_are_not_there_or_not_vehicles(document: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no vehicle 'tandem'; there are .*whipple"):
        load_vehicle("tandem")
    with pytest.raises(FileNotFoundError, match="does not exist"):
        load_vehicle(tmp_path / "nothing.yaml")
    broken = tmp_path / "broken.yaml"
    broken.write_text("bicycle: {w: [", encoding="utf-8")
    with pytest.raises(VehicleError, match="not valid YAML"):
        load_vehicle(broken)
    with pytest.raises(VehicleError, match="expected a mapping"):
        load([1, 2], tmp_path)
    with pytest.raises(VehicleError, match=r"format is 'bike.vehicle/9'"):
        load({**document, "format": "bike.vehicle/9"}, tmp_path)
