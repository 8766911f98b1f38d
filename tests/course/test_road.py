"""The road's surface in circuit files: keys, refusals, mirror image, heights of lines."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bike_sim.course.files import load_track
from bike_sim.course.road import CLASSES, GRASS_STRIP, RoadSurface, RunOffKind, WetPatch, run_off_kinds
from bike_sim.course.track import Track
from tests.circuits import OVAL

FULL = (
    OVAL
    + """
banking_deg: [[0, 0], [250, 0], [330, -4], [570, -4], [650, 0]]
bumps: {class: A, seed: 7}
wet:
  - {from_m: 100, to_m: 150, grip: 0.6}
  - {from_m: 1150, to_m: 20, grip: 0.7}
wind: {speed_m_s: 8, towards_deg: 90, gusts: 0.2, seed: 3}
run_off_kinds:
  - {from_m: 300, to_m: 600, side: right, kind: gravel}
  - {from_m: 1100, to_m: 100, side: both, kind: asphalt}
walls: {friction: 0.3, hit_m_s: 2.5}
"""
)


def read(tmp_path: Path, text: str) -> Track:
    path = tmp_path / "oval.yaml"
    path.write_text(text, encoding="utf-8")
    return load_track(str(path))


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Track:
    return read(tmp_path_factory.mktemp("road"), FULL)


def test_a_file_says_all_about_the_road(full: Track) -> None:
    surface = full.surface
    assert surface.bumps == CLASSES["A"]
    assert surface.seed == 7
    assert surface.wet == (WetPatch(100.0, 150.0, 0.6), WetPatch(1150.0, 20.0, 0.7))
    assert (surface.wind.speed, surface.wind.towards, surface.wind.gusts) == (8.0, math.radians(90.0), 0.2)
    assert [(part.side, part.kind.name) for part in surface.run_off] == [("right", "GRAVEL"), ("both", "ASPHALT")]
    assert (surface.walls.friction, surface.walls.restitution, surface.walls.hit) == (0.3, 0.2, 2.5)
    assert float(full.at(full.bank, 450.0)) == pytest.approx(math.tan(math.radians(-4.0)))
    assert float(full.at(full.bank, 0.0)) == float(full.at(full.bank, 900.0)) == 0.0
    assert (full.bank <= 0.0).all()  # without overshoot
    assert (full.bank >= math.tan(math.radians(-4.0)) - 1e-12).all()


def test_by_default_there_is_nothing(tmp_path: Path) -> None:
    surface = read(tmp_path, OVAL).surface
    assert surface.bank is None
    assert (surface.bumps, surface.wet, surface.run_off, surface.wind.speed) == (0.0, (), (), 0.0)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("banking_deg: [[0, 1]]", "banking_deg must be a list of at least 2 pairs"),
        ("banking_deg: [[0, 1], [300, 50]]", "entry 2: the angle is 50 deg; at most 45"),
        ("banking_deg: [[300, 1], [200, 2]]", "distances must grow from 0 and stay below the length of 1200 m"),
        ("bumps: {class: Z, seed: 1}", "bumps: class must be one of A, B"),
        ("bumps: {class: A, density_m3: 1e-6, seed: 1}", "either class or density_m3"),
        ("bumps: {density_m3: 16, seed: 1}", "density_m3 is 16; m3, as 16e-6 of class A"),
        ("bumps: {class: A, seed: -1}", "bumps: seed must be a whole number from 0"),
        ("bumps: {class: A}", "bumps: seed is missing"),
        ("wet: {from_m: 0, to_m: 1, grip: 1}", "wet must be a list"),
        ("wet: [{from_m: 0, to_m: 1300, grip: 1}]", "wet: part 1: to_m is 1300, and must be 0 to the length of 1200 m"),
        ("wet: [{from_m: 0, to_m: 10, grip: 0}]", "wet: part 1: grip must be above 0"),
        ("wind: {speed_m_s: 200, towards_deg: 0, gusts: 0, seed: 0}", "wind: wind must have a speed of 0 to 60 m/s"),
        ("wind: {speed_m_s: 5, towards_deg: 0, gusts: 0}", "wind: seed is missing"),
        ("run_off_kinds: [{from_m: 0, to_m: 9, side: up, kind: grass}]", "part 1: side must be one of left, right"),
        ("run_off_kinds: [{from_m: 0, to_m: 9, side: left, kind: lava}]", "kind must be one of asphalt, grass, gravel"),
        ("walls: {friction: -1}", "walls: walls must have a friction of 0 to 2"),
        ("walls: {rubber: 1}", "walls: unknown key 'rubber'"),
    ],
)
def test_what_no_road_has_is_refused_with_its_key(tmp_path: Path, keys: str, message: str) -> None:
    with pytest.raises(ValueError, match=message.replace("(", r"\(")):
        read(tmp_path, OVAL + keys)


def test_a_track_refuses_a_surface_that_does_not_fit(full: Track) -> None:
    with pytest.raises(ValueError, match="bank has 3 samples"):
        replace(full, surface=replace(full.surface, bank=np.zeros(3)))
    with pytest.raises(ValueError, match="banked by 60 deg"):
        replace(full, surface=replace(full.surface, bank=np.full(len(full.centre.s), math.sqrt(3.0))))


def test_run_off_is_grass_with_gravel_where_it_is_wide() -> None:
    s, widths = np.array([0.0, 10.0, 20.0]), (np.array([5.0, 19.0, 30.0]), np.array([40.0, 5.0, 5.0]))
    left, right = run_off_kinds(s, widths, ())
    assert left.tolist() == [RunOffKind.GRASS, RunOffKind.GRASS, RunOffKind.MIXED]
    assert right.tolist() == [RunOffKind.MIXED, RunOffKind.GRASS, RunOffKind.GRASS]
    assert GRASS_STRIP < 20.0


def test_lines_have_the_height_of_the_road_below_them(full: Track) -> None:
    track = full.with_ideal(np.full(len(full.centre.s), 3.0))
    line = track.line(1.0)
    assert line.height is not None
    progress = np.interp(line.s, [0.0, line.length], [0.0, track.length])
    near = track.points(np.array([450.0]), 3.0)[0, 2]
    assert float(np.interp(450.0, progress, line.height)) == pytest.approx(near, abs=0.05)
    middle = track.line(0.0)
    assert middle.height is not None
    assert (middle.height == track.elevation).all()
    assert middle.grade == pytest.approx(track.grade, abs=2e-4)
    assert middle.crest == pytest.approx(track.crest, abs=2e-5)


def test_heights_of_a_closed_lap_sum_to_nothing(full: Track) -> None:
    line = full.line(0.0)
    assert abs(np.sum(line.grade[:-1]) * line.spacing) < 1e-9
    assert abs(np.sum(line.crest[:-1]) * line.spacing) < 1e-9
    flat = replace(full, elevation=np.zeros(len(full.elevation)), surface=replace(full.surface, bank=None)).line(0.0)
    assert flat.height is None
    assert not flat.grade.any()
    assert not flat.crest.any()


def test_lines_know_the_banking_below_them(shapes: Any) -> None:
    level = shapes.oval()
    bank = 0.05 * np.sin(2.0 * np.pi * level.centre.s / level.length)
    track = replace(level, surface=RoadSurface(bank=bank))
    assert level.line(0.0).bank is None
    assert not level.line(0.0).slope_across.any()
    np.testing.assert_array_equal(track.line(0.0).bank, bank)
    beside = track.with_ideal(np.full(len(bank), 2.0)).line(1.0)
    share = beside.s / beside.length
    np.testing.assert_allclose(beside.bank, 0.05 * np.sin(2.0 * np.pi * share), atol=2e-3)
    # Beside the centre line by interpolated samples, the line turns a little against it.
    np.testing.assert_allclose(beside.height, 2.0 * beside.bank, atol=1e-5)


def test_lines_know_where_they_are_wet(shapes: Any) -> None:
    level = shapes.oval()
    assert level.line(0.0).grip is None
    wet = RoadSurface(wet=(WetPatch(50.0, 80.0, 0.6), WetPatch(level.length - 20.0, 10.0, 0.8)))
    line = replace(level, surface=wet).with_ideal(np.full(len(level.centre.s), 1.0)).line(1.0)
    places = line.s / line.length * level.length  # to a metre: offset lines are shorter
    for begin, end, grip in ((52.0, 78.0, 0.6), (0.0, 8.0, 0.8), (12.0, 48.0, 1.0)):
        assert (line.grip[(places > begin) & (places < end)] == grip).all()
    assert line.height is None


def test_a_line_across_a_hill_rides_off_camber_or_banked(full: Track) -> None:
    share = full.centre.s / full.length
    hills = 4.0 * np.sin(4.0 * np.pi * share)
    bank = 0.06 * np.sin(6.0 * np.pi * share)
    offset = 3.5 * np.sin(10.0 * np.pi * share)
    track = replace(full, elevation=hills, surface=RoadSurface(bank=bank)).with_ideal(offset)
    line = track.line(1.0)
    away, rows = 1e-3, range(5, len(line.s) - 5, 83)
    found = []
    for row in rows:
        left = np.array([-math.sin(line.heading[row]), math.cos(line.heading[row])])
        heights = [_height(track, np.array([line.x[row], line.y[row]]) + side * away * left) for side in (-1.0, 1.0)]
        found.append((heights[1] - heights[0]) / (2.0 * away))
    told = line.slope_across[list(rows)]
    np.testing.assert_allclose(told, found, atol=4e-4)
    level_across = np.interp(line.s[list(rows)] / line.s[-1], share, bank)
    assert np.abs(told - level_across).max() > 3e-3  # the hill's part, not banking alone


def _height(track: Track, point: np.ndarray) -> float:
    """Return the height of the road at a point of the plane, m."""
    centre = track.centre
    progress = float(centre.s[np.argmin(np.hypot(centre.x - point[0], centre.y - point[1]))])
    for _ in range(20):  # to where the centre line's normal goes through the point
        heading, away = float(track.at(centre.heading, progress)), point - track.points(np.array([progress]))[0, :2]
        progress += math.cos(heading) * away[0] + math.sin(heading) * away[1]
    offset = math.cos(heading) * away[1] - math.sin(heading) * away[0]
    return float(track.points(np.array([progress]), offset)[0, 2])
