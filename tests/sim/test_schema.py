"""The schema and the message definitions say the same."""

from __future__ import annotations

import re

import pytest

from bike_sim import schema
from tests.conftest import ROOT

MESSAGES = ROOT / "ros_ws/src/bike_msgs/msg"
COUNTED = {"episode", "step", "preview_by_time", "preview_interval"}
FIELD = re.compile(r"(float64|bool|uint32)\s+(\w+)\s+#\s*(.*)")


def fields_of(message: str) -> list[tuple[str, str]]:
    """Name and unit of each single number of a message, in order."""
    found = []
    for line in (MESSAGES / f"{message}.msg").read_text(encoding="utf-8").splitlines():
        match = FIELD.fullmatch(line.strip())
        if match is None or match[2] in COUNTED:
            continue
        unit = schema.FLAG if match[1] == "bool" else re.match(r"\[-1, 1\]|[^,. ]+", match[3])[0]
        found.append((match[2], "1" if unit == "[-1, 1]" else unit))
    return found


@pytest.mark.parametrize(("message", "described"), [("BikeState", schema.BIKE_STATE), ("Telemetry", schema.TELEMETRY)])
def test_a_message_has_the_fields_and_units_of_the_schema_in_its_order(message: str, described: schema.Schema) -> None:
    assert fields_of(message) == [(quantity.name, quantity.unit) for quantity in described]


@pytest.mark.parametrize(
    "vector", [schema.STATE, schema.LOOK, schema.PLACE, schema.LIMITS, schema.SIGNALS, schema.TELEMETRY]
)
def test_each_quantity_has_a_name_of_its_own_a_sign_and_a_meaning(vector: schema.Schema) -> None:
    assert len(set(vector.columns)) == len(set(vector.names)) == len(vector)
    for place, quantity in enumerate(vector):
        assert vector.index(quantity.name) == place
        assert abs(quantity.mirror) == 1
        assert quantity.meaning


def test_a_telemetry_field_has_unit_and_sign_of_its_signal() -> None:
    for quantity in schema.TELEMETRY:
        if quantity.signal:
            signal = schema.SIGNALS[quantity.signal]
            assert (quantity.unit, quantity.mirror) == (signal.unit, signal.mirror)
