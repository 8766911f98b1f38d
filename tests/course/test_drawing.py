"""Pictures show the whole course, its sections by name, and its limits where they are."""

import dataclasses
import itertools

import numpy as np
from matplotlib.figure import Figure

from bike_sim.course.course import Course
from bike_sim.course.drawing import course_figure, main, sections_of
from bike_sim.course.elements import Arc, Line
from bike_sim.course.files import load_course


def line_points(axes):
    return np.vstack([line.get_xydata() for line in axes.lines if line.get_linestyle() == "-"])


def test_map_covers_the_course_and_names_every_bend():
    course = load_course("benchmark")
    above, below = course_figure(course).axes
    points = line_points(above)
    for i in range(0, len(course.s), 7):
        assert np.hypot(*(points - [course.x[i], course.y[i]]).T).min() < 1e-9
    texts = {text.get_text() for text in above.texts}
    assert {"full circle", "slalom", "soft lane change", "hard lane change"} <= texts
    assert not any("straight" in text for text in texts)
    np.testing.assert_array_equal(below.lines[0].get_ydata(), course.curvature)


def test_sections_are_spanned_and_coloured():
    course = load_course("benchmark")
    parts = sections_of(course)
    assert parts[0].begin == 0.0
    assert parts[-1].end == course.length
    assert all(one.end == other.begin for one, other in itertools.pairwise(parts))
    colours = {part.name: part.colour for part in parts}
    assert colours["start straight"] == colours["closing straight"] != colours["slalom"]
    plain = Course.from_elements("plain", [Line(5.0)])
    assert [part[:3] for part in sections_of(plain)] == [("plain", 0.0, 5.0)]


def test_limits_are_drawn_on_their_sides_and_never_backwards():
    bare = Course.from_elements("road", [Line(20.0)])
    ones = np.ones(len(bare.s))
    above, _ = course_figure(dataclasses.replace(bare, width_left=2.0 * ones, width_right=ones)).axes
    assert {float(y) for line in above.lines for y in line.get_ydata()} == {2.0, 0.0, -1.0}
    course = Course.from_elements("corner", [Line(5.0), Arc(1.0, 1.5), Line(5.0)])
    above, _ = course_figure(course).axes
    left = above.lines[0].get_xydata()
    assert np.isnan(left).any()
    assert not np.isnan(above.lines[1].get_xydata()).any()


def test_pictures_are_written(tmp_path, monkeypatch):
    saved = []
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: saved.append(path))
    main([str(tmp_path / "new")])
    assert (tmp_path / "new").is_dir()
    assert {path.name for path in saved} >= {"course_benchmark.png", "course_junction.png", "random_paths.png"}
    saved.clear()
    main([str(tmp_path), "--course", "line"])
    assert [path.name for path in saved] == ["course_line.png"]
