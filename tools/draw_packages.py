"""Draw the packages and the imports between them, from the code: docs/images/packages.png.

A box is a package inside one of the four distributions, or a module directly in one. It lies a layer above all that it
imports, so an arrow that pointed upward would be a cycle. Run as ``python tools/draw_packages.py``.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Final

import grimp
import matplotlib as mpl

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

ROOT: Final = Path(__file__).resolve().parents[1]
TARGET: Final = ROOT / "docs" / "images" / "packages.png"
COLOURS: Final = {
    "bike_sim": "#cfe3f5",
    "bike_policy": "#d9efd2",
    "bike_analysis": "#f7e7c4",
    "bike_training": "#f3d3d3",
}
WIDTH, HEIGHT = 2.3, 0.62


def imports_between(graph: grimp.ImportGraph, packages: dict[str, str]) -> dict[tuple[str, str], int]:
    """Return the number of imports from each package to each other one."""
    counts: dict[tuple[str, str], int] = defaultdict(int)
    for module, package in packages.items():
        for imported in graph.find_modules_directly_imported_by(module):
            other = packages.get(imported, package)
            if other != package:
                counts[package, other] += 1
    return counts


def layers_of(packages: set[str], imports: dict[tuple[str, str], int]) -> dict[str, int]:
    """Return the layer of each package: one above the highest that it imports.

    Raises:
        SystemExit: packages import each other in a cycle, which is named.
    """
    below = {package: [other for importer, other in imports if importer == package] for package in sorted(packages)}
    layers: dict[str, int] = {}
    try:
        for package in TopologicalSorter(below).static_order():
            layers[package] = 1 + max((layers[other] for other in below[package]), default=-1)
    except CycleError as error:
        sys.exit(f"packages import each other in a cycle: {' <- '.join(error.args[1])}")
    return layers


def draw(layers: dict[str, int], imports: dict[tuple[str, str], int], sizes: dict[str, int]) -> None:
    """Draw the picture."""
    rows: dict[int, list[str]] = defaultdict(list)
    order = list(COLOURS)
    for package in sorted(layers, key=lambda name: (order.index(name.split(".")[0]), name)):
        rows[layers[package]].append(package)
    widest = max(map(len, rows.values()))
    centres = {
        package: ((column + 0.5) * widest / len(names) * (WIDTH + 0.35), layer * 1.5)
        for layer, names in rows.items()
        for column, package in enumerate(names)
    }
    figure, axes = plt.subplots(figsize=(17, 2.0 + 1.25 * len(rows)), layout="constrained")
    for (importer, imported), count in sorted(imports.items()):
        (x0, y0), (x1, y1) = centres[importer], centres[imported]
        axes.add_patch(
            FancyArrowPatch(
                (x0, y0 - HEIGHT / 2), (x1, y1 + HEIGHT / 2), arrowstyle="-|>", mutation_scale=9, color="0.35",
                alpha=0.35, linewidth=0.5 + 0.25 * min(count, 12) ** 0.7, zorder=1,
            )
        )  # fmt: skip
    for package, (x, y) in centres.items():
        distribution, name = package.split(".")
        axes.add_patch(
            FancyBboxPatch(
                (x - WIDTH / 2, y - HEIGHT / 2), WIDTH, HEIGHT, boxstyle="round,pad=0.04",
                facecolor=COLOURS[distribution], edgecolor="0.4", zorder=2,
            )
        )  # fmt: skip
        label = f"{name}  ({sizes[package]})" if sizes[package] > 1 else name
        axes.text(x, y, f"{distribution}\n{label}", ha="center", va="center", fontsize=9, zorder=3)
    axes.set_xlim(0, widest * (WIDTH + 0.35))
    axes.set_ylim(-0.8, (len(rows) - 1) * 1.5 + 0.8)
    axes.set_axis_off()
    axes.set_title("Packages, their modules (number) and imports: every arrow points down", fontsize=11)
    figure.savefig(TARGET, dpi=110)


def main() -> None:
    """Read the imports and draw."""
    graph = grimp.build_graph(*COLOURS, exclude_type_checking_imports=True)
    packages = {module: ".".join(module.split(".")[:2]) for module in graph.modules if "." in module}
    imports = imports_between(graph, packages)
    sizes: dict[str, int] = defaultdict(int)
    for module, package in packages.items():
        sizes[package] += module != package or sizes[package] == 0
    layers = layers_of(set(packages.values()), imports)
    draw(layers, imports, sizes)
    print(f"{len(layers)} packages in {max(layers.values()) + 1} layers, {len(imports)} arrows; drawn in {TARGET}")


if __name__ == "__main__":
    main()
