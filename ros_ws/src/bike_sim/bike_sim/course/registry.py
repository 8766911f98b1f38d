"""What a name or a file of a course is: a path or a circuit."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from bike_sim.course.document import read_text
from bike_sim.course.track_files import FORMAT as CIRCUIT_FORMAT
from bike_sim.course.track_files import shipped_tracks

PATH: Final = "path"
CIRCUIT: Final = "circuit"


def kind_of(name_or_path: str | Path) -> str:
    """Return PATH or CIRCUIT."""
    path = Path(name_or_path)
    if not path.suffix:
        return CIRCUIT if str(name_or_path) in shipped_tracks() else PATH
    if path.suffix.lower() == ".csv":
        return CIRCUIT
    try:
        return CIRCUIT if CIRCUIT_FORMAT in read_text(path) else PATH
    except (OSError, ValueError):
        return PATH
