"""Videos of rides: the vehicle on its course from behind, and others, drawn by Pillow, written by PyAV or Pillow."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from bike_analysis.figures.numbers import lap_text
from bike_analysis.figures.rides import Ride
from bike_analysis.page.ride_view import edge, is_fast
from bike_analysis.read.container import shown
from bike_analysis.read.messages import Floats

SIZE: Final = (960, 540)
"""Pixels of a frame."""
RATES: Final = {".mp4": 25, ".gif": 12}
"""Frames a second, by the file's suffix."""
LONGEST: Final = {".mp4": 600.0, ".gif": 15.0}
"""Longest video where no duration is given, s."""
_OVERSIZE: Final = 2
"""Frames are drawn so many times as large as shown, which makes edges smooth."""
_BEHIND, _HEIGHT, _FOCAL, _NEAR, _HORIZON = 5.6, 2.2, 740.0, 1.0, 216.0
"""Camera: m behind the vehicle, m above the ground, pixels, m to the nearest seen point, row of pixels."""
_AHEAD: Final = {False: np.arange(-6.0, 120.0), True: np.r_[-6.0:60.0:2.0, 60.0:420.0:4.0]}
"""Arc lengths at which the road is drawn, m from the vehicle, without and with an engine."""
_GRASS, _ROAD, _WHITE, _KERB = ("#5f7f45", "#66884b"), ("#4a4e55", "#4d5158"), ("#e8e8e8",) * 2, ("#d8412f", "#f3f3f3")
_SKY: Final = ((77, 134, 198), (207, 227, 242), -300.0, _HORIZON)
_MEADOW: Final = ((155, 178, 127), (111, 138, 78), _HORIZON, 840.0)
"""Colours at the upper and the lower end, and the rows of pixels between which they change."""
_VEHICLES: Final = {
    False: "15171a -.03 0 .03 0 .03 .6 -.03 .6, 22252a -.28 .97 .28 .97 .28 1 -.28 1, 0b66ad -.02 .3 .02 .3 .02 .85 "
    "-.02 .85, 39424d -.15 .9 .15 .9 .18 .3 .08 .3 0 .8 -.08 .3 -.18 .3, 1f8f6b -.14 .88 .14 .88 .29 1 .21 1.38 "
    "-.21 1.38 -.29 1, e9ebee -.08 1.42 .08 1.42 .12 1.54 .08 1.68 -.08 1.68 -.12 1.54",
    True: "15171a -.1 0 .1 0 .1 .64 -.1 .64, 8f1a12 -.15 .42 .15 .42 .25 .75 .21 .98 -.21 .98 -.25 .75, c8261a -.11 "
    ".55 .11 .55 .14 .92 -.14 .92, 22252a -.33 .91 .33 .91 .33 .95 -.33 .95, 173a69 -.12 .86 .12 .86 .26 .62 .17 .42 "
    ".1 .66 -.1 .66 -.17 .42 -.26 .62, 1f4f8f -.17 .8 .17 .8 .37 1 .25 1.24 .12 1.36 -.12 1.36 -.25 1.24 -.37 1, "
    "e9ebee -.09 1.31 .09 1.31 .14 1.45 .09 1.6 -.09 1.6 -.14 1.45, c8261a -.04 1.4 .04 1.4 .04 1.58 -.04 1.58",
}
"""Parts from behind, without and with an engine: colour and corners, m to the right and above the contact point."""
_OTHER: Final = {"8f1a12": "5b4a12", "c8261a": "d9a514", "0b66ad": "d9a514"}
"""Colours of other vehicles in place of the followed one's."""


def write_video(
    ride: Ride,
    path: str | os.PathLike[str],
    begin_s: float = 0.0,
    duration_s: float | None = None,
    others: Sequence[Ride] = (),
) -> Path:
    """Write a video of a ride at its own pace.

    Args:
        ride: A recorded ride.
        path: File to write, ``.mp4`` (H.264) or ``.gif``.
        begin_s: Where it begins, s since the ride's first state.
        duration_s: How long it lasts, s; to the ride's end, but not beyond `LONGEST`, if None.
        others: Rides of other vehicles with the same clock, shown where they are at that time.

    Returns:
        The path.

    Raises:
        ValueError: If the file is of another kind, nothing is left to show, or the ride has no course or position.
        OSError: If the file cannot be written.
    """
    target, time, states, course = Path(path), ride.time, ride.states, ride.course
    kind = target.suffix.lower()
    if kind not in RATES:
        raise ValueError(f"a video is an .mp4 or a .gif, not {target.name!r}")
    end = min(float(time[-1]), begin_s + (LONGEST[kind] if duration_s is None else duration_s))
    if not 0.0 <= begin_s < end:
        raise ValueError(f"the ride lasts {time[-1]:.1f} s: a video cannot begin at {begin_s:g} s")
    motion = np.stack([states.x, states.y, np.unwrap(states.yaw), states.roll, states.speed, states.progress])
    if course is None or len(course.x) < 3 or not np.isfinite(motion).any(axis=1).all():
        raise ValueError("a video needs a recorded course, positions and lean")
    draw = partial(
        _frame, ride, ride.recording.vehicle, np.nan_to_num(motion), [_paths(ride, other) for other in others]
    )
    frames = map(draw, begin_s + np.arange(max(1, round((end - begin_s) * RATES[kind]))) / RATES[kind])
    if kind == ".gif":  # half as large, because it is not compressed well
        first, *rest = (frame.reduce(2).quantize(96, dither=Image.Dither.NONE) for frame in frames)
        first.save(target, save_all=True, append_images=rest, duration=round(1000 / RATES[kind]), loop=0)
        return target
    import av  # late: it loads FFmpeg

    with av.open(str(target), "w") as container:
        stream = container.add_stream("libx264", rate=RATES[kind], options={"crf": "23", "preset": "fast"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_image(frame)))
        container.mux(stream.encode())
    return target


def _paths(ride: Ride, other: Ride) -> Floats:
    """Return time since the first state of a ride, s, and x, y, roll of another one, shape (4, states)."""
    states = other.states
    return np.stack([states.time_s - ride.states.time_s[0], states.x, states.y, states.roll])


def _frame(ride: Ride, vehicle: str, motion: Floats, others: Sequence[Floats], time_s: float) -> Image.Image:
    """Draw the ride, and the paths of others, at a time since its first state, s."""
    x, y, yaw, roll, speed, progress = (float(np.interp(time_s, ride.time, column)) for column in motion)
    lagging = float(np.interp(time_s - 0.16, ride.time, motion[2]))  # the camera turns a little later
    pose = Pose(x, y, yaw, lagging, roll, speed, progress)
    riding = [path for path in others if path[0, 0] <= time_s <= path[0, -1]]
    beside = [[float(np.interp(time_s, path[0], column)) for column in path[1:]] for path in riding]
    return draw_frame(ride.course, vehicle, pose, time_s, is_fast(ride), beside)


class Pose(NamedTuple):
    """A vehicle as a frame shows it.

    Attributes:
        x: Rear contact point, m.
        y: Rear contact point, m.
        yaw: rad.
        lagging: Yaw angle that the camera follows with, rad.
        roll: rad, positive leaning right.
        speed: m/s.
        progress: Arc length along the course, m.
    """

    x: float
    y: float
    yaw: float
    lagging: float
    roll: float
    speed: float
    progress: float


def draw_frame(
    course: Any, vehicle: str, pose: Pose, time_s: float, powered: bool, others: Sequence[Sequence[float]] = ()
) -> Image.Image:
    """Draw a vehicle on its course from behind.

    Args:
        course: A course with samples and limits; as recorded, or as the simulator has it.
        vehicle: Its name.
        pose: Where it is and how it leans.
        time_s: Time that the frame tells, s.
        powered: Whether it has an engine.
        others: x and y (m) and roll (rad) of other vehicles of its kind.

    Returns:
        The picture, `SIZE` pixels large.
    """
    image = Image.new("RGB", (_OVERSIZE * SIZE[0], _OVERSIZE * SIZE[1]))
    heading = 0.5 * (pose.yaw + pose.lagging)
    camera = _Camera(ImageDraw.Draw(image, "RGBA"), np.array([pose.x, pose.y]), heading, 0.22 * pose.roll)
    camera.draw_background()
    camera.draw_road(course, pose.progress, powered)
    camera.draw_vehicles([(pose.x, pose.y, pose.roll), *others], powered)
    pace = f"{3.6 * pose.speed:.0f} km/h" if powered else f"{pose.speed:.1f} m/s"
    title = shown(f"{vehicle}, {course.name}" if vehicle else course.name, 60)
    text = f"{title}\n{lap_text(time_s)}    {pace}    lean {abs(np.degrees(pose.roll)):.0f}°"
    x0, y0, x1, y1 = camera.pen.textbbox((40, 36), text, _font())
    camera.pen.rounded_rectangle((x0 - 20, y0 - 16, x1 + 20, y1 + 16), 16, (12, 15, 20, 158))
    camera.pen.text((40, 36), text, "#ffffff", _font())
    return image.reduce(_OVERSIZE)


class _Camera:
    """Draws as seen from behind and above a place, with a picture that leans by `lean`, rad."""

    def __init__(self, pen: ImageDraw.ImageDraw, place: Floats, heading: float, lean: float) -> None:
        self.pen, self._heading = pen, heading
        self._forward = np.array([np.cos(heading), np.sin(heading)])
        self._eye = place - _BEHIND * self._forward
        self._turn = np.array([[np.cos(lean), -np.sin(lean)], [np.sin(lean), np.cos(lean)]])

    def _polygon(self, corners: Floats, colour: Any) -> None:
        self.pen.polygon(list(map(tuple, corners)), colour)

    def _pixels(self, points: Floats) -> Floats:
        """Pixels of points of the upright picture; it leans about a point below its middle."""
        middle = np.array([480.0, 335.0])
        return np.asarray(_OVERSIZE * ((points - middle) @ self._turn + middle))

    def _seen(self, points: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Pixels of points of the ground, and whether they are ahead."""
        ahead, left = (points - self._eye) @ self._forward, (points - self._eye) @ [-self._forward[1], self._forward[0]]
        depth = np.maximum(ahead, _NEAR)
        upright = np.stack([480.0 - _FOCAL * left / depth, _HORIZON + _FOCAL * _HEIGHT / depth], 1)
        return self._pixels(upright), ahead > _NEAR

    def draw_background(self) -> None:
        """Sky and meadow, and hills that turn with the heading."""
        for upper, lower, begin, end in (_SKY, _MEADOW):
            height = (end - begin) / 40.0
            for share in np.linspace(0.0, 1.0, 40):
                top = begin + share * (end - begin - height)
                corners = np.array([(-900, top), (1860, top), (1860, top + height + 1), (-900, top + height + 1)])
                mixed = (1.0 - share) * np.array(upper) + share * np.array(lower)
                self._polygon(self._pixels(corners), tuple(mixed.astype(int).tolist()))
        across = np.arange(-900.0, 1860.0, 12.0)
        angle = self._heading - np.arctan((across - 480.0) / _FOCAL)
        hills = _HORIZON - 12 - 9 * np.sin(3 * angle) - 6 * np.sin(7 * angle + 1) - 3 * np.sin(17 * angle)
        outline = np.concatenate([np.stack([across, hills], 1), [(1860, _HORIZON + 1), (-900, _HORIZON + 1)]])
        self._polygon(self._pixels(outline), "#8ea3a0")

    def draw_road(self, course: Any, progress: float, powered: bool) -> None:
        """The road between the limits, with kerbs in the bends of circuits, and the followed line."""
        places = progress + _AHEAD[powered]
        places = places if course.closed else places[(places >= 0.0) & (places <= course.s[-1])]
        period = course.length if course.closed else None
        columns = (*edge(course, 1.0), *edge(course, -1.0), course.x, course.y)
        lines = np.stack([np.interp(places, course.s, c, period=period) for c in columns], 1)
        left, right, middle = lines[:, :2], lines[:, 2:4], lines[:, 4:]
        side = (right - left) / np.hypot(*(right - left).T)[:, None]
        heading = np.unwrap(np.arctan2(*np.gradient(middle, axis=0).T))
        bends = powered & (np.abs(np.gradient(heading, places)) > 0.005)
        for inner, outer, colours in (
            (left - 14.0 * side, left, _GRASS),
            (right, right + 14.0 * side, _GRASS),
            (left, right, _ROAD),
            (left - 0.9 * side, left, _KERB),
            (right, right + 0.9 * side, _KERB),
            (left, left + 0.16 * side, _WHITE),
            (right - 0.16 * side, right, _WHITE),
        ):
            (a, a_ahead), (b, b_ahead) = self._seen(inner), self._seen(outer)
            ahead = a_ahead | b_ahead
            for k in np.flatnonzero(ahead[:-1] & ahead[1:] & (bends[:-1] | (colours is not _KERB)))[::-1]:
                self._polygon(np.stack([a[k], a[k + 1], b[k + 1], b[k]]), colours[int(places[k] // 6.0) % 2])
        line, _ = self._seen(middle[places > progress + 1.0])
        self.pen.line(list(map(tuple, line)), (120, 200, 255, 140), 2 * _OVERSIZE, joint="curve")

    def draw_vehicles(self, vehicles: Sequence[Sequence[float]], powered: bool) -> None:
        """Vehicles with their riders and shadows, each leaning about its contact point, the farthest first.

        Args:
            vehicles: x, y and roll of each; the first is the followed one.
            powered: whether they have engines.
        """
        away = np.array(vehicles)[:, :2] - self._eye
        depths = away @ self._forward
        for k in np.argsort(-depths):
            if _NEAR < depths[k] < _AHEAD[powered][-1]:
                left, roll = float(away[k] @ [-self._forward[1], self._forward[0]]), vehicles[k][2]
                foot = np.array([480.0 - _FOCAL * left / depths[k], _HORIZON + _FOCAL * _HEIGHT / depths[k]])
                self._draw_vehicle(foot, _FOCAL / depths[k], roll, powered, {} if k == 0 else _OTHER)

    def _draw_vehicle(self, foot: Floats, metre: float, roll: float, powered: bool, colours: dict[str, str]) -> None:
        around, width = np.linspace(0.0, 2.0 * np.pi, 32), 0.3 + 0.5 * abs(np.sin(roll))
        shadow = np.stack([0.3 * np.sin(roll) + width * np.cos(around), 0.07 * np.sin(around)], 1)
        self._polygon(self._pixels(foot + metre * shadow), (0, 0, 0, 90))
        turn = np.array([[np.cos(roll), np.sin(roll)], [np.sin(roll), -np.cos(roll)]])
        for part in _VEHICLES[powered].split(", "):
            colour, *numbers = part.split(" ")
            corners = np.array(numbers, float).reshape(-1, 2)
            self._polygon(self._pixels(foot + metre * corners @ turn), f"#{colours.get(colour, colour)}")


@cache
def _font() -> ImageFont.FreeTypeFont:
    bold = font_manager.FontProperties(family="DejaVu Sans", weight="bold")
    return ImageFont.truetype(font_manager.findfont(bold), 20 * _OVERSIZE)
