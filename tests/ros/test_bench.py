"""What `bike bench ros` measures."""

from __future__ import annotations

import pytest

from bike_training.commands.bench import _load as load_bench

pytestmark = pytest.mark.ros


def test_lockstep_is_held_against_messages_alone_in_the_same_run(compiled: None) -> None:
    figures = load_bench("bench.ros_speed").lockstep_speed(rounds=3, steps=20)
    rates = {name: figures[name] for name in figures if name.endswith("_per_s")}
    assert len(rates) == 3
    assert all(rate > 1.0 for rate in rates.values())
    ratio = "ros_to_empty_rclpy_ratio"
    assert 0.0 < figures[f"{ratio}_lower_quartile"] <= figures[ratio] <= figures[f"{ratio}_upper_quartile"]
    assert figures["ros_to_empty_rclpy_cpu_ratio"] > 0.0


def test_a_peer_that_does_not_come_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    peer = load_bench("bench.ros_peer")
    monkeypatch.setattr(peer.sys, "executable", "/bin/false")
    with pytest.raises(RuntimeError, match="does not answer"):
        peer.Peer()
