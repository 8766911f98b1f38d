"""Draws what an RViz configuration shows of a recorded ride: `draw_live_view.py ride.rviz ride.mcap view.png`.

For machines without RViz, as those that have ROS from wheels. It reads the displays, topics, colours and the view from
the configuration, and the standard messages from the recording, and draws a `TopDownOrtho` view of them at one time.
Displays that it does not know are an error, so that no picture claims to show what it leaves out.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import matplotlib as mpl
import numpy as np
import yaml
from numpy.typing import NDArray

from bike_analysis.read.columns import MessageSchema
from bike_analysis.read.container import Container

mpl.use("Agg")
from matplotlib import pyplot as plt

FloatArray = NDArray[np.float64]

CYLINDER: Final = 3
LINE_STRIP: Final = 4
SPHERE_LIST: Final = 7
FRAME_TYPES: Final = ("tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped")
DPI: Final = 100


def read(path: Path, topics: set[str], until_s: float) -> Iterator[tuple[str, str, Any]]:
    """Yield topic, type and message of chosen topics, and all frames, up to a simulated time."""
    container = Container(path)
    schemas: dict[int, MessageSchema] = {}
    for raw in container.messages():
        channel = container.channels[raw.channel]
        schema = container.schemas[channel.schema_id]
        if raw.log_time_ns > until_s * 1e9 or (channel.topic not in topics and schema.name not in FRAME_TYPES):
            continue
        if channel.id not in schemas:
            schemas[channel.id] = MessageSchema(schema.name, schema.data.decode())
        yield channel.topic, schema.name, schemas[channel.id].decode(raw.data)


def rotation(q: Any) -> FloatArray:
    """Rotation matrix of a quaternion message."""
    x, y, z, w = q.x, q.y, q.z, q.w
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


class Scene:
    """Latest messages and frames of a recording."""

    def __init__(self, fixed_frame: str) -> None:
        self.fixed_frame = fixed_frame
        self.frames: dict[str, Any] = {}
        self.messages: dict[str, list[Any]] = {}

    def take(self, topic: str, kind: str, message: Any) -> None:
        """Add a message."""
        if kind in FRAME_TYPES:
            for transform in getattr(message, "transforms", [message]):
                self.frames[transform.child_frame_id] = transform
        else:
            self.messages.setdefault(topic, []).append(message)

    def to_fixed(self, frame: str, points: FloatArray) -> FloatArray:
        """Return points of a frame in the fixed one, shape (n, 3).

        Raises:
            ValueError: no transform leads there.
        """
        while frame != self.fixed_frame:
            if frame not in self.frames:
                raise ValueError(f"frame {frame!r} has no transform to {self.fixed_frame!r} in the recording")
            link = self.frames[frame]
            t = link.transform.translation
            points = points @ rotation(link.transform.rotation).T + np.array([t.x, t.y, t.z])
            frame = link.header.frame_id
        return points


def draw_marker(axes: Any, scene: Scene, marker: Any) -> None:
    """Draw one marker from above."""
    colour = (marker.color.r, marker.color.g, marker.color.b, marker.color.a)
    turn, p = rotation(marker.pose.orientation), marker.pose.position
    centre = np.array([p.x, p.y, p.z])
    if marker.type == CYLINDER:
        angle = np.linspace(0.0, 2.0 * np.pi, 60)
        ring = 0.5 * np.stack([marker.scale.x * np.cos(angle), marker.scale.y * np.sin(angle), 0.0 * angle], axis=1)
        ends = [ring + np.array([0.0, 0.0, side * 0.5 * marker.scale.z]) for side in (-1.0, 1.0)]
        outline = scene.to_fixed(marker.header.frame_id, np.concatenate(ends) @ turn.T + centre)
        axes.fill(outline[:, 0], outline[:, 1], color=colour, zorder=4)
        return
    local = np.array([[point.x, point.y, point.z] for point in marker.points])
    points = scene.to_fixed(marker.header.frame_id, local @ turn.T + centre)
    if marker.type == LINE_STRIP:
        axes.plot(points[:, 0], points[:, 1], color=colour, lw=marker.scale.x * axes.points_per_metre, zorder=2)
    elif marker.type == SPHERE_LIST:
        axes.scatter(
            points[:, 0], points[:, 1], color=[colour], s=(marker.scale.x * axes.points_per_metre) ** 2, lw=0, zorder=3
        )
    else:
        raise ValueError(f"markers of type {marker.type} are not drawn by this script")


def draw_odometry(axes: Any, scene: Scene, display: dict[str, Any], messages: list[Any]) -> None:
    """Draw the last arrows of an odometry display, spaced by its position tolerance."""
    kept: list[FloatArray] = []
    for message in messages:
        p = message.pose.pose.position
        ends = np.array([[0.0, 0.0, 0.0], [display["Shape"]["Shaft Length"], 0.0, 0.0]])
        arrow = scene.to_fixed(
            message.header.frame_id, ends @ rotation(message.pose.pose.orientation).T + np.array([p.x, p.y, p.z])
        )
        if not kept or np.linalg.norm(arrow[0] - kept[-1][0]) >= display["Position Tolerance"]:
            kept.append(arrow)
    colour = [int(part) / 255.0 for part in display["Shape"]["Color"].split(";")]
    for tail, head in kept[-display["Keep"] :]:
        axes.plot(
            [tail[0], head[0]],
            [tail[1], head[1]],
            color=colour,
            alpha=display["Shape"]["Alpha"],
            lw=2.0 * display["Shape"]["Shaft Radius"] * axes.points_per_metre,
            zorder=1,
        )


def draw_display(axes: Any, scene: Scene, display: dict[str, Any]) -> None:
    """Draw one display of the configuration."""
    kind = display["Class"].removeprefix("rviz_default_plugins/")
    if kind == "Grid":
        half = display["Cell Size"] * display["Plane Cell Count"] / 2.0
        colour = [int(part) / 255.0 for part in display["Color"].split(";")]
        for place in np.arange(-half, half + 0.5 * display["Cell Size"], display["Cell Size"]):
            axes.plot([-half, half], [place, place], color=colour, alpha=display["Alpha"], lw=0.6, zorder=0)
            axes.plot([place, place], [-half, half], color=colour, alpha=display["Alpha"], lw=0.6, zorder=0)
        return
    messages = scene.messages.get(display["Topic"]["Value"], [])
    if not messages:
        raise ValueError(f"display {display['Name']!r}: the recording has no message of {display['Topic']['Value']}")
    if kind == "Marker":
        draw_marker(axes, scene, messages[-1])
    elif kind == "MarkerArray":
        for marker in messages[-1].markers:
            draw_marker(axes, scene, marker)
    elif kind == "Odometry":
        draw_odometry(axes, scene, display, messages)
    else:
        raise ValueError(f"displays of class {display['Class']} are not drawn by this script")


def draw(config_path: Path, recording: Path, at_s: float, picture: Path) -> None:
    """Draw a configuration's view of a recording at a simulated time, s."""
    config = yaml.safe_load(config_path.read_text(encoding="utf-8"))
    manager, window = config["Visualization Manager"], config["Window Geometry"]
    displays = [display for display in manager["Displays"] if display["Enabled"]]
    scene = Scene(manager["Global Options"]["Fixed Frame"])
    for message in read(recording, {d["Topic"]["Value"] for d in displays if "Topic" in d}, at_s):
        scene.take(*message)
    view = manager["Views"]["Current"]
    target = scene.fixed_frame if view["Target Frame"] == "<Fixed Frame>" else view["Target Frame"]
    x, y, _ = scene.to_fixed(target, np.zeros((1, 3)))[0]
    width, height = window["Width"], window["Height"]
    figure = plt.figure(figsize=(width / DPI, height / DPI), dpi=DPI)
    axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.points_per_metre = view["Scale"] * 72.0 / DPI
    for display in displays:
        draw_display(axes, scene, display)
    axes.set_xlim(x - 0.5 * width / view["Scale"], x + 0.5 * width / view["Scale"])
    axes.set_ylim(y - 0.5 * height / view["Scale"], y + 0.5 * height / view["Scale"])
    axes.set_facecolor([int(part) / 255.0 for part in manager["Global Options"]["Background Color"].split(";")])
    axes.spines[:].set_visible(False)
    axes.set_xticks([])
    axes.set_yticks([])
    figure.savefig(picture)
    plt.close(figure)


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("config", type=Path, help="RViz configuration")
    parser.add_argument("recording", type=Path, help="recording with markers")
    parser.add_argument("picture", type=Path, help="PNG to write")
    parser.add_argument("--at", type=float, default=35.0, help="simulated time, s (default: %(default)s)")
    args = parser.parse_args()
    try:
        draw(args.config, args.recording, args.at, args.picture)
    except (ValueError, OSError, KeyError) as error:
        parser.exit(2, f"draw_live_view.py: {error}\n")


if __name__ == "__main__":
    main()
