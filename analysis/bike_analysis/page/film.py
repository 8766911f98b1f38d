"""A ride as a moving picture, without a browser: the report page's own view from behind, with map and instruments.

``follow_view.js`` runs in QuickJS on a context that writes down what it paints; Pillow paints that, twice as large as
shown so that edges come out smooth, and PyAV (FFmpeg) or Pillow writes the file.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib import font_manager
from PIL import Image, ImageColor, ImageDraw, ImageFont

from bike_analysis.figures.recorded import RecordedRide
from bike_analysis.figures.track_limits import has_limits
from bike_analysis.page.follow import edge, follow_spec
from bike_analysis.page.ride_view import is_fast, ride_columns
from bike_analysis.read.rides import Ride

SIZE: Final = (960, 540)
"""Pixels of the view."""
GIF_WIDTH: Final = 480
"""Pixels across of a GIF, which is not compressed well."""
RATES: Final = {".mp4": 25, ".gif": 12}
"""Pictures a second, by the file's suffix."""
LONGEST: Final = {".mp4": 600.0, ".gif": 15.0}
"""Longest moving picture where no duration is asked for, s."""
_OVERSIZE: Final = 2
_SCRIPTS: Final = ("page_view.js", "follow_view.js", "film.js")
_COLUMNS: Final = ("time", "distance", "x", "y", "yaw", "roll", "steer", "speed", "throttle", "brake")


def write_film(
    ride: RecordedRide, path: str | os.PathLike[str], begin_s: float = 0.0, duration_s: float | None = None
) -> Path:
    """Write a moving picture of a ride at its own pace.

    Args:
        ride: A recorded ride.
        path: File to write, ``.mp4`` (H.264) or ``.gif``.
        begin_s: Where it begins, s since the ride's first state.
        duration_s: How long it lasts, s; to the ride's end, but not beyond `LONGEST`, if None.

    Returns:
        The path.

    Raises:
        ValueError: If the file is of another kind, nothing is left to show, or the ride has no course or position.
        OSError: If the file cannot be written.
    """
    target = Path(path)
    kind = target.suffix.lower()
    if kind not in RATES:
        raise ValueError(f"a video is an .mp4 or a .gif, not {target.name!r}")
    time = ride.data.time
    end = min(float(time[-1]), begin_s + (LONGEST[kind] if duration_s is None else duration_s))
    if not 0.0 <= begin_s < end:
        raise ValueError(f"the ride lasts {time[-1]:.1f} s: a video cannot begin at {begin_s:g} s")
    moments = begin_s + np.arange(max(1, round((end - begin_s) * RATES[kind]))) / RATES[kind]
    pictures = _pictures(ride.data, ride.recording.vehicle, np.interp(moments, time, np.arange(len(time))))
    if kind == ".gif":
        _write_gif(pictures, target)
    else:
        _write_mp4(pictures, target)
    return target


def _pictures(ride: Ride, vehicle: str, places: np.ndarray) -> Iterator[Image.Image]:
    """The view at rows of the ride, or between two of them."""
    from quickjs import Context  # late: only videos need it

    columns = {name: c for name, c in ride_columns(ride, slice(0, len(ride.states))).items() if name in _COLUMNS}
    if not {"x", "y", "yaw", "roll", "speed"} <= columns.keys() or ride.course is None or len(ride.course.x) < 3:
        raise ValueError("a video needs a recorded course, positions and lean")
    script = Context()
    script.eval("\n".join((files("bike_analysis.page") / name).read_text(encoding="utf-8") for name in _SCRIPTS))
    plain = {name: np.nan_to_num(np.round(column, 4)).tolist() for name, column in columns.items()}
    data = json.dumps([plain, _spec(ride, vehicle), *SIZE])
    script.eval(f"var film = filmOf(...JSON.parse({json.dumps(data)}));")
    for place in places:
        yield _painted(json.loads(script.eval(f"film({float(place)!r})")))


def _spec(ride: Ride, vehicle: str) -> dict[str, Any]:
    course, fast = ride.course, is_fast(ride)
    assert course is not None
    heading = np.unwrap(np.arctan2(np.gradient(course.y), np.gradient(course.x)))
    limits = (course.width_left, course.width_right) if has_limits(course) else (None, None)
    edges = [edge(course.x, course.y, heading, side, limit) for side, limit in zip((1.0, -1.0), limits, strict=True)]
    title = f"{vehicle}, {course.name}" if vehicle else course.name
    return follow_spec(title, (course.s, course.x, course.y), (*edges[0], *edges[1]), course.closed, fast)


# ---- painting ------------------------------------------------------------------------------------------------------


def _painted(shapes: list[list[Any]]) -> Image.Image:
    image = Image.new("RGB", (_OVERSIZE * SIZE[0], _OVERSIZE * SIZE[1]))
    draw = ImageDraw.Draw(image, "RGBA")
    for kind, style, places, *more in shapes:
        if kind == "text":
            words, size, align = more
            anchor = {"left": "ls", "center": "ms", "right": "rs"}[align]
            x, y = (_OVERSIZE * value for value in places)
            draw.text((x, y), words, _ink(style), _font(round(_OVERSIZE * size)), anchor)
            continue
        corners = [(_OVERSIZE * x, _OVERSIZE * y) for x, y in places]
        if kind == "fill":
            draw.polygon(corners, _ink(style))
        else:
            draw.line(corners, _ink(style), max(1, round(_OVERSIZE * more[0])), joint="curve")
    return image.reduce(_OVERSIZE)


@cache
def _ink(style: str) -> tuple[int, ...]:
    """Red, green, blue and opacity of a CSS colour."""
    if not style.startswith("rgba("):
        return ImageColor.getrgb(style)
    *parts, opacity = style[5:-1].split(",")
    return (*map(int, parts), round(255 * float(opacity)))


@cache
def _font(size: int) -> ImageFont.FreeTypeFont:
    bold = font_manager.FontProperties(family="DejaVu Sans", weight="bold")
    return ImageFont.truetype(font_manager.findfont(bold), size)


# ---- files ---------------------------------------------------------------------------------------------------------


def _write_mp4(pictures: Iterator[Image.Image], path: Path) -> None:
    import av  # late: it loads FFmpeg

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=RATES[".mp4"], options={"crf": "23", "preset": "fast"})
        stream.width, stream.height = SIZE
        stream.pix_fmt = "yuv420p"
        for picture in pictures:
            container.mux(stream.encode(av.VideoFrame.from_image(picture)))
        container.mux(stream.encode())


def _write_gif(pictures: Iterator[Image.Image], path: Path) -> None:
    size = (GIF_WIDTH, round(GIF_WIDTH * SIZE[1] / SIZE[0]))
    small = (picture.resize(size, Image.Resampling.LANCZOS) for picture in pictures)
    first = next(small).quantize(96, dither=Image.Dither.NONE)
    rest = (picture.quantize(palette=first, dither=Image.Dither.NONE) for picture in small)
    first.save(path, save_all=True, append_images=rest, duration=round(1000 / RATES[".gif"]), loop=0, optimize=False)
