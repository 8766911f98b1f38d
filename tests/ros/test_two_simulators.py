"""Simulators beside each other: in namespaces of a domain, in domains, and by mistake in one namespace."""

from __future__ import annotations

import pytest
from geometry_msgs.msg import TransformStamped
from rosgraph_msgs.msg import Clock
from visualization_msgs.msg import MarkerArray

pytestmark = pytest.mark.ros

STEPS = 25


@pytest.mark.slow
def test_rides_in_two_namespaces_and_two_domains_do_not_touch(ros, other_ros, policy: str) -> None:
    """The same seed is the same ride wherever it is ridden; frames and clock belong to one simulator each."""
    places = [(ros, "left", 1, True), (ros, "right", 2, False), (other_ros, "bike", 1, True)]
    programs, probes, clocks, frames, markers = [], [], [], [], []
    for place, namespace, seed, clock in places:
        settings = {"namespace": namespace, "seed": seed, "perturb": True, "publish_clock": clock}
        programs.append(place.simulator(**settings))
        probe = place.probe(namespace)
        probes.append(probe)
        clocks.append(probe.listen(Clock, "/clock"))
        frames.append(probe.attend(TransformStamped, "transform"))
        markers.append(probe.attend(MarkerArray, "markers"))
    for place, namespace, *_ in places:
        place.start("bike_policy.drive", namespace=namespace, policy=policy)
    rides = []
    for probe in probes:
        probe.until(lambda probe=probe: probe.states[-1].step >= STEPS)
        ridden = {s.step: (s.x, s.y, s.roll, s.steer, s.steering_command) for s in probe.states}
        rides.append([ridden[step] for step in range(STEPS)])
        assert {s.episode for s in probe.states} == {1}
    assert rides[0] == rides[2] != rides[1]
    for heard in clocks:
        times = [(m.clock.sec, m.clock.nanosec) for m in heard]
        assert times == sorted(times)
        assert times
    prefixes = ("left/", "right/", "")
    for heard, prefix in zip(frames, prefixes, strict=True):
        links = {(m.header.frame_id, m.child_frame_id) for m in heard}
        odom, footprint, base = (f"{prefix}{name}" for name in ("odom", "base_footprint", "base_link"))
        assert links == {("map", odom), (odom, footprint), (footprint, base)}
    for heard, prefix in zip(markers, prefixes, strict=True):
        assert {m.ns for message in heard for m in message.markers} == {f"{prefix}bike"}
    assert not any("another" in program.words for program in programs)


def test_a_second_simulator_in_a_namespace_or_on_the_clock_is_named(ros) -> None:
    first = ros.simulator()
    probe = ros.probe()
    beside = ros.simulator(namespace="beside")
    sentence = "another node publishes /clock: set publish_clock to false in all simulators but one"
    probe.until(lambda: all(sentence in program.words for program in (first, beside)))
    assert beside.end()[0] == 0
    second = ros.simulator(publish_clock=False)
    sentence = "another simulator, or one that was killed just now, publishes /bike/state: give each its own namespace"
    probe.until(lambda: all(sentence in program.words for program in (first, second)))
    probe.until(lambda: any(status.message == sentence for status in probe.statuses["sim_node"]))
