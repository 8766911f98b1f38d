"""Simulators beside each other: in namespaces of a domain, in domains, and by mistake in one namespace."""

from __future__ import annotations

import pytest
from geometry_msgs.msg import TransformStamped
from rosgraph_msgs.msg import Clock
from visualization_msgs.msg import MarkerArray

pytestmark = pytest.mark.ros

STEPS = 25


@pytest.mark.slow
def test_simulators_beside_each_other_do_not_touch_and_rivals_are_named(ros, other_ros, policy: str) -> None:
    """Seeds, frames and clock belong to one simulator each; another domain hears nothing."""
    places = [("left", 1, True), ("right", 2, False)]
    programs = [
        ros.simulator(namespace=name, seed=seed, perturb=True, publish_clock=clock) for name, seed, clock in places
    ]
    outside = other_ros.sender()
    probes = [ros.probe(name) for name, *_ in places]
    clocks = [probe.listen(Clock, "/clock") for probe in probes]
    frames = [probe.attend(TransformStamped, "transform") for probe in probes]
    markers = [probe.attend(MarkerArray, "markers") for probe in probes]
    for name, *_ in places:
        ros.start("bike_policy.drive", namespace=name, policy=policy)
    rides = []
    for probe, (name, *_) in zip(probes, places, strict=True):
        probe.until(lambda probe=probe: probe.states[-1].step >= STEPS)
        ridden = {s.step: (s.x, s.y, s.roll, s.steer, s.steering_command) for s in probe.states}
        rides.append([ridden[step] for step in range(STEPS)])
        assert {s.episode for s in probe.states} == {1}
        assert not outside.count_publishers(f"/{name}/state")
    assert rides[0] != rides[1]
    for heard in clocks:
        times = [(m.clock.sec, m.clock.nanosec) for m in heard]
        assert times == sorted(times)
        assert times
    for heard, shown, (name, *_) in zip(frames, markers, places, strict=True):
        links = {(m.header.frame_id, m.child_frame_id) for m in heard}
        odom, footprint, base = (f"{name}/{frame}" for frame in ("odom", "base_footprint", "base_link"))
        assert links == {("map", odom), (odom, footprint), (footprint, base)}
        assert {m.ns for message in shown for m in message.markers} == {f"{name}/bike"}
    assert not any("another" in program.words for program in programs)
    beside = ros.simulator(namespace="beside")
    sentence = "another node publishes /clock: set publish_clock to false in all simulators but one"
    probes[0].until(lambda: all(sentence in program.words for program in (programs[0], beside)))
    second = ros.simulator(namespace="right", publish_clock=False)
    sentence = "another simulator, or one that was killed just now, publishes /right/state: give each its own namespace"
    probes[0].until(lambda: all(sentence in program.words for program in (programs[1], second)))
    probes[0].until(lambda: any(status.message == sentence for status in probes[0].statuses.get("right/sim_node", [])))
