"""The report of a recording: its page says the figures and stands on its own."""

from __future__ import annotations

import json
import re
import shutil
from collections import Counter
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from bike_analysis import compare, find_rides, open_ride, read_recording
from bike_analysis.figures.circuit import course_corners
from bike_analysis.page import ride_page
from bike_analysis.page.ride_view import comparison_view, ride_view
from bike_analysis.report import analyze
from bike_sim.course.files import load_track
from bike_training import cli
from bike_training.commands import analyze as command


@pytest.fixture(scope="module")
def recorded(writer, circle, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ride around the circle, and one that falls."""
    path = tmp_path_factory.mktemp("report") / "ride.mcap"
    offset = 0.2 + 0.15 * np.sin(0.05 * np.arange(400))
    falling = circle(steps=100, episode=2, start_s=30.0)
    falling.states["fallen"] = np.arange(100) >= 99
    falling.events = [
        {"step": 99, "kind": 1, "time": 4.95, "progress": 19.8, "value": 1.0, "text": "Fell <to> the left."}
    ]
    return writer.write(path, [circle(steps=400, offset=offset, latency_ms=(0.06, 0.31)), falling])


@pytest.fixture(scope="module")
def report(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    return analyze(recorded, tmp_path_factory.mktemp("out"))


class Links(HTMLParser):
    """Collects what the page refers to, its ids and its tags."""

    def __init__(self) -> None:
        super().__init__()
        self.references: list[str] = []
        self.ids: list[str] = []
        self.tags: Counter[str] = Counter()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        for name, value in attributes:
            if name in ("href", "xlink:href", "src", "srcset", "data", "action"):
                self.references.append(value or "")
            elif name == "id":
                self.ids.append(value or "")


def links(path: str) -> Links:
    parser = Links()
    parser.feed(Path(path).read_text(encoding="utf-8"))
    return parser


def own_text(path: str) -> str:
    """The page without uPlot's script, which is not ours."""
    text = Path(path).read_text(encoding="utf-8")
    begin = text.index("<script>")
    return text[:begin] + text[text.index("</script>", begin) :]


def test_page_needs_no_network_and_its_references_meet_one_target(report: dict) -> None:
    found = links(report["page"])
    assert all(reference.startswith(("#", "data:")) for reference in found.references)
    assert found.tags["link"] == 1
    assert found.tags["script"] == 3  # the data, uPlot, and the page's own
    text = own_text(report["page"])
    assert "@import" not in text
    assert "url(" not in text.replace("url(#", "")  # saved pictures refer to their own parts
    assert "http" not in text.replace("http-equiv", "").replace("http://www.w3.org/2000/svg", "")
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]+)"', text)
    assert policy is not None
    assert policy[1].startswith("default-src 'none';")
    assert "http" not in policy[1]
    assert [i for i, count in Counter(found.ids).items() if count > 1] == []
    assert {r[1:] for r in found.references if r.startswith("#")} <= set(found.ids)


def test_every_colour_follows_the_scheme(report: dict) -> None:
    """Every colour that the page uses has a value in the light and in the dark scheme."""
    text = own_text(report["page"])
    style = text[text.index("<style>") : text.index("</style>")]
    used = set(re.findall(r"var\(--([a-z0-9]+)\)", text)) - {"font", "own", "at"}  # no colours
    light, dark = style[: style.index("@media")], style[style.index("@media") :]
    assert used <= set(re.findall(r"--([a-z0-9]+):", light))
    assert used <= set(re.findall(r"--([a-z0-9]+):", dark))
    body = text[text.index("<body>") : text.index("</main>")]
    assert not re.search(r"#[0-9a-f]{6}\b", body)


def test_page_tells_the_figures(report: dict) -> None:
    text = Path(report["page"]).read_text(encoding="utf-8")
    for ride in report["rides"]:
        assert f"{ride['mean_error_m']:.3f}" in text
        assert f"{ride['max_error_m']:.3f}" in text
    assert "Fell &lt;to&gt; the left." in text
    assert "<to>" not in text
    assert 'name="viewport"' in text
    assert links(report["page"]).tags["figure"] == 7 + 2 * 7  # side by side, and those of two rides


def test_lean_is_compared_with_the_one_that_balances_the_turn(recorded: Path) -> None:
    """On a circle to the left both are below zero, and meet where tan(roll) = -v^2 curvature / g."""
    columns = ride_view(find_rides(read_recording(recorded))[0], "r", "ride").series[0].columns
    np.testing.assert_allclose(columns["balance"], -np.degrees(np.arctan(16 / 98.1)))
    np.testing.assert_allclose(columns["roll"], columns["balance"])
    assert np.all(columns["steer"] > 0)


def test_a_fall_is_marked_in_the_traces_and_told_in_degrees(writer, circle, tmp_path: Path) -> None:
    """Also in a comparison, where it belongs to one of the rides."""
    falling = circle(steps=100, events=[{"step": 90, "kind": 1, "text": "fell with a roll of 0.81 rad"}])
    paths = [
        writer.write(tmp_path / f"{n}.mcap", [r], metadata_file=False)
        for n, r in (("a", falling), ("b", circle(steps=110)))
    ]
    recordings = [open_ride(path) for path in paths]
    moments = ride_view(recordings[0].rides[0].evaluated, "a", "a").data()["moments"]
    assert moments == [{"series": 0, "row": 90, "label": "fall"}]
    view = comparison_view(compare(recordings), "both")
    (moment,) = view.data()["moments"]
    assert (view.series[moment["series"]].name, moment["row"]) == ("a", 90)
    assert "fell with a roll of 46°" in ride_page.write_page(recordings, tmp_path / "page.html").read_text()


def test_circuits_have_their_turns_and_laps_their_kind(writer, circle, tmp_path: Path) -> None:
    """A line named after a shipped circuit: its turns by number; what begins at the reset is no flying lap."""
    line = load_track("barcelona").centre
    ride = circle(steps=500, speed=20.0)
    ride.course |= {
        "name": "barcelona (median)",
        "length": line.length,
        "section_names": [],
        "section_starts": np.empty(0),
    }
    ride.course |= {name: getattr(line, name) for name in ("s", "x", "y", "curvature", "width_left", "width_right")}
    path = writer.write(tmp_path / "lap.mcap", [ride], metadata_file=False)
    both = compare([open_ride(path)])
    view = comparison_view(both, "both")
    corners = load_track("barcelona").corners
    assert [label["text"] for label in view.labels] == [corner.name for corner in corners]
    found = course_corners(both.runs[0].ride.course)
    np.testing.assert_allclose([c.apex for c in found], [c.apex for c in corners], atol=1.0)
    assert [run.kind for run in both.runs[:2]] == ["rolling start", "flying"]
    assert {series.kind for series in view.series} == {"flying"}
    assert [panel["key"] for panel in view.panels[:3]] == ["speed", "delta", "speed_delta"]


def test_very_short_rides_and_those_without_optional_fields_are_drawn(writer, circle, tmp_path: Path) -> None:
    rides = [circle(steps=steps, episode=steps, start_s=10.0 * steps) for steps in (1, 2, 3)]
    path = writer.write(tmp_path / "ride.mcap", rides)
    assert [ride["steps"] for ride in analyze(path, tmp_path / "out")["rides"]] == [1, 2, 3]
    ride = circle(steps=50)
    for name in ("speed", "roll", "curvature", "steering_command"):
        ride.states[name] = np.full(50, np.nan)
    result = analyze(writer.write(tmp_path / "poor.mcap", [ride], topics=["/bike/state"]), tmp_path / "out")
    figures = result["rides"][0]
    assert figures["speed_mean_m_s"] is None
    assert figures["mean_error_m"] == pytest.approx(0.3)
    json.dumps(result, allow_nan=False)
    assert "was not recorded" in Path(result["page"]).read_text()


def test_many_rides_are_listed_and_the_worst_drawn(writer, circle, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(ride_page, "DRAWN_RIDES", 2)
    rides = [circle(steps=20, episode=n, start_s=5.0 * n, offset=0.01 * n) for n in range(1, 10)]
    rides[0].states["fallen"] = np.arange(20) >= 19
    result = analyze(writer.write(tmp_path / "ride.mcap", rides), tmp_path / "out")
    drawn = re.findall(r'<section id="ride-(\d+)"', Path(result["page"]).read_text())
    assert drawn == ["1", "9"]  # the one that fell, and the one farthest from its path
    assert len(result["rides"]) == 9


def run_command(*words: str) -> dict:
    return command.run(cli.parse("analyze", words))


def test_command_prints_a_table_and_writes_beside_the_recording(recorded: Path, tmp_path: Path, capsys) -> None:
    copy = Path(shutil.copy(recorded, tmp_path / "mine.mcap"))
    result = run_command(str(copy))
    printed = capsys.readouterr().out
    assert result["schema"] == "bike.analyze/4"
    assert result["ok"] is True
    assert f"{result['figures']['rides'][0]['mean_error_m']:.3f}" in printed
    assert (tmp_path / "ride.html").exists()
    copy.write_bytes(recorded.read_bytes()[:-3000])
    assert run_command(str(copy))["figures"]["truncated"]
    assert "The recording is torn" in (tmp_path / "ride.html").read_text()


@pytest.mark.parametrize("option", ["--csv", "--parquet", "--out"])
def test_no_recording_is_overwritten(option: str, recorded: Path, tmp_path: Path) -> None:
    """Under whatever name, and before anything else is written."""
    folder = tmp_path / "bag"
    folder.mkdir()
    content = recorded.read_bytes()
    name = "ride.html" if option == "--out" else "bag_0.mcap"
    target = folder / name
    target.write_bytes(content)
    (tmp_path / "link").symlink_to(folder)
    written = tmp_path / "link" if option == "--out" else tmp_path / "link" / name
    inputs = [[str(target)], [str(recorded), str(target)]]
    if option != "--out":
        inputs.append([str(folder)])
    for words in inputs:
        other = ("--csv", str(tmp_path / "other.csv")) if option != "--csv" else ("--out", str(tmp_path / "other"))
        with pytest.raises(ValueError, match="would be overwritten"):
            run_command(*words, *other, option, str(written), "--json")
        assert target.read_bytes() == content
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bag", "link"]


def test_command_json_is_silent_and_writes_only_where_asked(recorded: Path, tmp_path: Path, capsys) -> None:
    copy = shutil.copy(recorded, tmp_path / "mine.mcap")
    result = run_command(str(copy), "--json")
    assert capsys.readouterr().out == ""
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.mcap"]
    assert json.loads(json.dumps(result, allow_nan=False))["figures"]["truncated"] is False
