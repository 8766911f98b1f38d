"""A live ride for Foxglove's app: the channels that a WebSocket client of its protocol sees, and their messages."""

from __future__ import annotations

import json
import re
import socket
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from bike_analysis.read.columns import MessageSchema
from bike_policy.riders.rider import make_rider
from bike_sim.sim.config import SimulatorConfig
from bike_sim.sim.request import ResetRequest
from bike_training.nodes.foxglove_bridge import FoxgloveBridge
from bike_training.nodes.live_ride import LiveRide, LiveSettings

LAYOUTS: Final = Path(__file__).parents[2] / "ros_ws" / "src" / "bike_bringup" / "foxglove"
PROTOCOL: Final = Subprotocol("foxglove.sdk.v1")
OF_SUPERBIKES: Final = {"/bike/telemetry"}
"""Topics of the layouts that the ride of a bicycle does not have."""


@pytest.fixture(scope="module")
def ride() -> Iterator[LiveRide]:
    """The ride of a bicycle."""
    request = ResetRequest(course="circle", speed_range=(4.0, 4.0))
    ride = LiveRide(LiveSettings(SimulatorConfig(), request, make_rider("lqr")), lambda _: None)
    try:
        ride.start()
        yield ride
    finally:
        ride.end()
    ride.check()


@pytest.fixture(scope="module")
def bridge(ride: LiveRide) -> Iterator[FoxgloveBridge]:
    with closing(FoxgloveBridge(ride.domain_id, 0)) as bridge:
        yield bridge


def channels(client: ClientConnection, wanted: set[str]) -> dict[str, dict[str, Any]]:
    """Descriptions of channels by topic, once all that are wanted are there."""
    found: dict[str, dict[str, Any]] = {}
    while not wanted <= found.keys():
        message = client.recv(timeout=10)
        if isinstance(message, str) and (told := json.loads(message))["op"] == "advertise":
            found |= {channel["topic"]: channel for channel in told["channels"]}
    return found


def subscribe(client: ClientConnection, channel: dict[str, Any]) -> None:
    subscription = {"id": channel["id"], "channelId": channel["id"]}
    client.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))


def next_message(client: ClientConnection, channel: dict[str, Any]) -> Any:
    """The next message of a subscribed channel, decoded by the definition that the channel carries."""
    while True:
        message = client.recv(timeout=10)
        if isinstance(message, bytes) and message[0] == 1:
            identifier, _ = struct.unpack_from("<IQ", message, 1)
            if identifier == channel["id"]:
                return MessageSchema(channel["schemaName"], channel["schema"]).decode(message[13:])


@contextmanager
def connected(bridge: FoxgloveBridge, wanted: set[str]) -> Iterator[tuple[ClientConnection, dict[str, dict[str, Any]]]]:
    """A client and the channels that it wants."""
    with connect(bridge.address, subprotocols=[PROTOCOL], max_size=None) as client:
        yield client, channels(client, wanted)


def heard(bridge: FoxgloveBridge, topic: str) -> Any:
    """A message of a topic."""
    with connected(bridge, {topic}) as (client, found):
        subscribe(client, found[topic])
        return next_message(client, found[topic])


@pytest.mark.ros
def test_a_client_sees_the_layouts_topics_and_receives_states(bridge: FoxgloveBridge) -> None:
    shown = {topic for file in LAYOUTS.glob("*.json") for topic in re.findall(r"/bike/\w+", file.read_text())}
    assert {"/bike/state", "/bike/markers", "/bike/course_marker"} <= shown
    with connected(bridge, shown) as (client, found):
        state = found["/bike/state"]
        assert (state["encoding"], state["schemaEncoding"]) == ("cdr", "ros2msg")
        assert state["schemaName"] == "bike_msgs/msg/BikeState"
        subscribe(client, state)
        first = second = next_message(client, state)
        while second.step == first.step:  # the latest is sent again to who comes in between two
            second = next_message(client, state)
        assert second.step == first.step + 1
        assert second.speed == pytest.approx(4.0, abs=0.5)


@pytest.mark.ros
def test_who_comes_late_gets_what_was_sent_once(bridge: FoxgloveBridge) -> None:
    for _ in range(2):
        assert heard(bridge, "/bike/course").name == "circle"


@pytest.mark.ros
def test_only_this_machine_is_served_and_clients_only_listen(bridge: FoxgloveBridge) -> None:
    others = [info[4][0] for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)]
    for other in {name for name in others if not name.startswith("127.")}:
        with pytest.raises(OSError, match="refused"):
            socket.create_connection((other, bridge.port), timeout=2)
    with connect(bridge.address, subprotocols=[PROTOCOL], max_size=None) as client:
        told = json.loads(client.recv(timeout=10))
        assert told["op"] == "serverInfo"
        assert not {"clientPublish", "parameters", "services"} & set(told["capabilities"])


@pytest.mark.ros
def test_a_taken_port_is_one_sentence(bridge: FoxgloveBridge) -> None:
    with pytest.raises(OSError, match=f"port {bridge.port} cannot be opened for Foxglove: .*in use"):
        FoxgloveBridge(0, bridge.port)
