"""Draw the rooms of the project and the imports between them, from the code itself: docs/images/house.png.

A room is a package inside one of the four Python packages, or a module that stands in one by itself. A room lies above
all rooms that it imports, so an arrow that pointed upward would be a circle. Run as ``python tools/draw_house.py``.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from typing import Final

import grimp
import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT: Final = Path(__file__).resolve().parents[1]
TARGET: Final = ROOT / "docs" / "images" / "house.png"
PACKAGES: Final = ("bike_sim", "bike_policy", "bike_analysis", "bike_training")
COLOURS: Final = {
    "bike_sim": "#cfe3f5",
    "bike_policy": "#d9efd2",
    "bike_analysis": "#f7e7c4",
    "bike_training": "#f3d3d3",
}
WIDTH, HEIGHT = 2.3, 0.62


def rooms_of(graph: grimp.ImportGraph) -> dict[str, str]:
    """Return the room of each module."""
    return {module: ".".join(module.split(".")[:2]) for module in graph.modules if "." in module}


def arrows_between(graph: grimp.ImportGraph, rooms: dict[str, str]) -> dict[tuple[str, str], int]:
    """Return the number of imports between each two rooms."""
    arrows: dict[tuple[str, str], int] = defaultdict(int)
    for module, room in rooms.items():
        for imported in graph.find_modules_directly_imported_by(module):
            other = rooms.get(imported)
            if other is not None and other != room:
                arrows[room, other] += 1
    return dict(arrows)


def floors_of(rooms: set[str], arrows: dict[tuple[str, str], int]) -> dict[str, int]:
    """Return the floor of each room: one above the highest that it imports.

    Raises:
        SystemExit: rooms import each other in a circle, which is named.
    """
    floors: dict[str, int] = {}

    def floor(room: str, path: tuple[str, ...]) -> int:
        if room in path:
            sys.exit(f"rooms import each other in a circle: {' -> '.join((*path[path.index(room) :], room))}")
        if room not in floors:
            below = [other for (importer, other) in arrows if importer == room]
            floors[room] = 1 + max((floor(other, (*path, room)) for other in below), default=-1)
        return floors[room]

    for room in sorted(rooms):
        floor(room, ())
    return floors


def draw(floors: dict[str, int], arrows: dict[tuple[str, str], int], sizes: dict[str, int]) -> None:
    """Draw the picture."""
    rows: dict[int, list[str]] = defaultdict(list)
    order = {name: place for place, name in enumerate(PACKAGES)}
    for room in sorted(floors, key=lambda name: (order[name.split(".")[0]], name)):
        rows[floors[room]].append(room)
    widest = max(map(len, rows.values()))
    place = {}
    for level, names in rows.items():
        for column, room in enumerate(names):
            place[room] = ((column + 0.5) * widest / len(names) * (WIDTH + 0.35), level * 1.5)
    figure, axes = plt.subplots(figsize=(17, 2.0 + 1.25 * len(rows)), layout="constrained")
    for (importer, imported), count in sorted(arrows.items()):
        (x0, y0), (x1, y1) = place[importer], place[imported]
        axes.add_patch(
            FancyArrowPatch(
                (x0, y0 - HEIGHT / 2), (x1, y1 + HEIGHT / 2), arrowstyle="-|>", mutation_scale=9, color="0.35",
                alpha=0.35, linewidth=0.5 + 0.25 * min(count, 12) ** 0.7, zorder=1,
            )
        )  # fmt: skip
    for room, (x, y) in place.items():
        package, name = room.split(".")
        axes.add_patch(
            FancyBboxPatch(
                (x - WIDTH / 2, y - HEIGHT / 2), WIDTH, HEIGHT, boxstyle="round,pad=0.04", facecolor=COLOURS[package],
                edgecolor="0.4", zorder=2,
            )
        )  # fmt: skip
        label = f"{name}  ({sizes[room]})" if sizes[room] > 1 else name
        axes.text(x, y, f"{package}\n{label}", ha="center", va="center", fontsize=9, zorder=3)
    axes.set_xlim(0, widest * (WIDTH + 0.35))
    axes.set_ylim(-0.8, (len(rows) - 1) * 1.5 + 0.8)
    axes.set_axis_off()
    axes.set_title("Rooms, their modules (number) and imports: every arrow points down", fontsize=11)
    figure.savefig(TARGET, dpi=110)


def main() -> None:
    """Read the imports and draw."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True)
    rooms = rooms_of(graph)
    arrows = arrows_between(graph, rooms)
    sizes: dict[str, int] = defaultdict(int)
    for module, room in rooms.items():
        sizes[room] += module != room or sizes[room] == 0
    floors = floors_of(set(rooms.values()), arrows)
    draw(floors, arrows, dict(sizes))
    print(f"{len(floors)} rooms on {max(floors.values()) + 1} floors, {len(arrows)} arrows; drawn in {TARGET}")


if __name__ == "__main__":
    main()
