"""Moving pictures of rides: the page's own view, painted without a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from bike_analysis import open_ride
from bike_analysis.page.video import RATES, SIZE, write_video
from bike_analysis.report import Video, analyze


@pytest.fixture(scope="module")
def recording(writer: Any, circle: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A circle of 10 m to the left, 20 s at 4 m/s, upright but for one second from 10 s on."""
    ride = circle(steps=400)
    ride.states["roll"] = np.where((np.arange(400) >= 200) & (np.arange(400) < 220), 0.9, 0.0)
    return writer.write(tmp_path_factory.mktemp("video") / "ride.mcap", [ride])


def frames(path: Path) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]


def test_a_video_lasts_as_long_as_the_ride_and_shows_it(recording: Path, tmp_path: Path) -> None:
    path = write_video(open_ride(recording).rides[0], tmp_path / "ride.mp4", 9.8, 0.4)
    shown = frames(path)
    assert len(shown) == round(0.4 * RATES[".mp4"])
    assert shown[0].shape == (SIZE[1], SIZE[0], 3)
    sky, ground = shown[0][20, 500].astype(int), shown[0][520, 40].astype(int)
    assert sky[2] > sky[0] + 40  # blue
    assert ground[1] > ground[2] + 20  # green
    horizon = [np.argmax(frame[:, 5].astype(int) @ [0, 1, -1] > 20) for frame in (shown[0], shown[-1])]
    assert abs(horizon[1] - horizon[0]) > 20, "the picture tilts with the bicycle's lean"
    moved = np.abs(shown[0].astype(int) - shown[3].astype(int)).mean()
    assert moved > 0.2


def test_a_gif_plays_at_the_pace_of_the_ride(recording: Path, tmp_path: Path) -> None:
    figures = analyze(recording, video=Video(tmp_path / "ride.gif", 2.0, 0.25))
    assert figures["video"] == str(tmp_path / "ride.gif")
    with Image.open(tmp_path / "ride.gif") as picture:
        assert picture.n_frames == round(0.25 * RATES[".gif"])
        assert picture.info["duration"] == pytest.approx(1000 / RATES[".gif"], abs=10)


def test_a_video_shows_others_where_they_are_at_its_time(
    recording: Path, writer: Any, circle: Any, tmp_path: Path
) -> None:
    """Another bicycle a second ahead stands in the picture; one that rides later does not."""
    ahead, later = circle(steps=400), circle(steps=400, start_s=1000.0)
    for name in ("x", "y"):
        ahead.states[name] = np.roll(ahead.states[name], -20)
    ride = open_ride(recording).rides[0]
    shown = []
    for number, others in enumerate(([], [ahead], [later])):
        rides = [open_ride(writer.write(tmp_path / f"other_{number}.mcap", [other])).rides[0] for other in others]
        shown.append(frames(write_video(ride, tmp_path / f"{number}.mp4", 5.0, 0.05, rides))[0].astype(int))
    assert np.abs(shown[1] - shown[0]).max() > 60
    np.testing.assert_array_equal(shown[2], shown[0])


@pytest.mark.parametrize(
    ("name", "begin", "words"), [("ride.avi", 0.0, "an .mp4 or a .gif"), ("ride.mp4", 99.0, "cannot begin at 99 s")]
)
def test_what_cannot_be_shown_is_refused(recording: Path, tmp_path: Path, name: str, begin: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        write_video(open_ride(recording).rides[0], tmp_path / name, begin)
    assert not (tmp_path / name).exists()


def test_a_video_never_overwrites_its_recording(recording: Path, tmp_path: Path) -> None:
    link = tmp_path / "link.mp4"
    link.symlink_to(recording)
    with pytest.raises(ValueError, match="would be overwritten"):
        analyze(recording, video=Video(link))


def test_a_ride_without_a_course_makes_no_video(writer: Any, circle: Any, tmp_path: Path) -> None:
    ride = circle(steps=50)
    ride.course = None
    path = writer.write(tmp_path / "bare.mcap", [ride])
    with pytest.raises(ValueError, match="a recorded course"):
        write_video(open_ride(path).rides[0], tmp_path / "bare.mp4")
