"""A superbike through simulator node and classical pilot: what travels, and that it is ridden."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bike_analysis.lap_report import Theory, lap_figures, load_laps, render_lap_page
from bike_sim.fast_lines import track_with_line
from bike_sim.lap_limit import lap_limit
from bike_sim.messages import Episode as MessageEpisode
from bike_sim.messages import course_points_to_message, snapshot_from_message, state_to_message
from bike_sim.physics.envelope import envelope
from bike_sim.physics.superbike import Superbike
from bike_sim.physics.vehicle import load_vehicle
from bike_sim.reset import ResetRequest
from bike_sim.track_ride import PREVIEW, TrackRide, superbike_config
from bike_training.laps import seen_from
from bike_training.node_laps import ride_through_nodes

pytestmark = pytest.mark.ros


@pytest.fixture
def circuit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("BIKE_CACHE", str(tmp_path / "lines"))
    angle = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    radius = 110.0 + 25.0 * np.cos(2.0 * angle)
    rows = "\n".join(f"{r * np.cos(a):.4f},{r * np.sin(a):.4f},6.0,6.0" for a, r in zip(angle, radius, strict=True))
    path = tmp_path / "oval.csv"
    path.write_text(f"# x_m,y_m,w_tr_right_m,w_tr_left_m\n{rows}\n")
    return path


def test_messages_carry_what_the_rider_sees(circuit: Path) -> None:
    machine = TrackRide(superbike_config("m1000rr"))
    snapshot = machine.reset(ResetRequest(course=str(circuit), speed_range=(25.0, 25.0)))
    for _ in range(20):
        snapshot = machine.step(0.4, 0.2)
    assert machine.course is not None
    episode = MessageEpisode(machine.vehicle, machine.course, PREVIEW, machine.config.control_period)
    message = state_to_message(snapshot, episode, 10**9)
    assert seen_from(snapshot_from_message(message)) == seen_from(snapshot)
    points = course_points_to_message(snapshot, machine.course, 10**9)
    assert [len(points.line), len(points.left), len(points.right)] == [20, 20, 20]
    assert [(p.x, p.y, p.z) for p in points.right] == [tuple(row) for row in snapshot.points[2]]
    machine.close()


def test_laps_through_the_nodes_are_recorded_and_timed_alike(circuit: Path, tmp_path: Path) -> None:
    machine = load_vehicle("panigale_v4r")
    assert isinstance(machine, Superbike)
    limits = envelope(machine)
    track = track_with_line(circuit, limits)
    limit = lap_limit(limits, track.line(1.0))
    recording = tmp_path / "lap.mcap"
    ride_through_nodes("panigale_v4r", str(circuit), float(limit.s[-1]), 1, recording, limit.lap_time)
    laps = load_laps(recording, track)
    theory = Theory(limit.s, limit.speed, limit.lateral, limit.longitudinal, limit.lap_time, limit.sector_times)
    figures = lap_figures(laps, theory)
    assert figures["falls"] == figures["walls"] == figures["lost_steps"] == 0
    assert len(figures["laps_s"]) == 1
    assert figures["timing_agrees"]
    page = render_lap_page(laps, theory)
    assert page.count("<svg") == 4
    assert 'id="follow-data"' in page
    assert "http" not in page.replace("http://www.w3.org", "")
