"""Names in recordings are whatever a publisher put there, and files are whatever somebody made."""

from __future__ import annotations

import json
import os
import unicodedata
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bike_analysis import RecordingError, read_recording
from bike_analysis.page.document import html_text, script_json
from bike_analysis.read.container import shown
from bike_sim.recording.definitions import MessageType
from bike_sim.recording.recorder import RideRecorder
from bike_training.cli import main


@pytest.fixture
def named_ride(writer: Any, circle: Any, tmp_path: Path) -> Any:
    """Write rides on courses, and in sections, of these names."""

    def make(*names: str) -> Path:
        rides = []
        for episode, name in enumerate(names, start=1):
            event = {"step": 330, "kind": 2, "text": f"left {name}"}
            rides.append(circle(steps=350, episode=episode, start_s=20.0 * episode, events=[event]))
            rides[-1].course |= {"name": name, "section_names": [name, f"{name} again"]}
            rides[-1].states["vehicle"] = np.full(350, name)
        return writer.write(tmp_path / "ride.mcap", rides, overwrite=True)

    return make


def is_plain(text: str) -> bool:
    """Whether each character of a line shows itself."""
    return not any(unicodedata.category(c) in {"Cc", "Cf", "Cs", "Zl", "Zp"} for c in text)


@given(st.text())
def test_shown_text_is_one_plain_line(text: str) -> None:
    assert is_plain(shown(text))
    if is_plain(text) and len(text) <= 200:
        assert shown(text) == text
    assert shown(shown(text), 10_000) == shown(text)
    shown(text).encode()
    assert not set("<>\"'\n") & set(html_text(text))
    assert shown("a\x1b[2Jb\u202e\U000e0001") == "a\\x1b[2Jb\\u202e\\U000e0001"
    assert shown("x" * 300) == "x" * 199 + "…"
    assert shown("x" * 200) == "x" * 200


def test_errors_and_warnings_are_lines_of_a_terminal(tmp_path: Path, capsys: Any) -> None:
    """Whatever texts a recording holds: here the name of its only topic."""
    path = tmp_path / "long.mcap"
    with RideRecorder(path, metadata_file=False) as recorder:
        recorder.add_topic(f"/{'n' * 5000}", MessageType("std_msgs/msg/Float64", "float64 data\n"))
    assert main(["analyze", str(path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "not a recording of a ride" in line
    assert len(line) < 450


@given(st.recursive(st.text() | st.integers(), lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner)))
def test_data_in_a_script_is_the_same_data_without_a_tag(data: Any) -> None:
    text = script_json(data)
    assert json.loads(text) == data
    assert not set("<>&\u2028\u2029") & set(text)


def test_the_terminal_gets_plain_lines_and_no_warning(
    named_ride: Any, evil_names: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With page and picture, for which a name may be a formula or have letters without a glyph."""
    names = [evil_names[number] for number in (6, 3, 4, 8, 10)]
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        assert main(["analyze", str(named_ride(*names)), "--out", str(tmp_path / "out")]) == 0
    assert [str(warning.message) for warning in told] == []
    text = capsys.readouterr().out
    assert all(is_plain(line) for line in text.split("\n"))
    assert all(shown(name) in text for name in names)
    assert max(map(len, text.split("\n"))) < 1000


def test_tables_go_into_folders_that_are_made(named_ride: Any, tmp_path: Path, capsys: Any) -> None:
    target = tmp_path / "new" / "folder" / "laps.csv"
    assert main(["analyze", str(named_ride("circle")), "--json", "--csv", str(target)]) == 0
    assert target.is_file()


@pytest.mark.timeout(20)
@pytest.mark.parametrize("what", ["itself", "in a folder", "description", "device"])
def test_only_regular_files_are_read(named_ride: Any, tmp_path: Path, what: str) -> None:
    """A pipe would wait for its writer for ever."""
    pipe, folder = tmp_path / "pipe.mcap", tmp_path / "folder"
    folder.mkdir()
    if what == "description":
        os.mkfifo(folder / "metadata.yaml")
        named_ride("circle").rename(folder / "ride.mcap")
        assert len(read_recording(folder).states) == 350
        return
    if what == "in a folder":
        os.mkfifo(folder / "ride.mcap")
    os.mkfifo(pipe)
    path = {"itself": pipe, "in a folder": folder, "device": Path("/dev/zero")}[what]
    with pytest.raises(RecordingError, match=r"not a regular file|neither a file nor a directory"):
        read_recording(path)


def test_a_description_of_names_within_names_is_not_believed(named_ride: Any, tmp_path: Path) -> None:
    """Aliases of aliases would be gigabytes, and brackets within brackets too deep, where somebody wrote them out."""
    folder = tmp_path / "folder"
    folder.mkdir()
    named_ride("circle").rename(folder / "ride.mcap")
    layers = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    layers += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 10)}]" for k in range(1, 12)]
    bomb = "\n".join([*layers, "rosbag2_bagfile_information: {relative_file_paths: [*a11]}"])
    for content in (bomb, "[" * 100_000, "x" * (5 * 1024 * 1024)):
        (folder / "metadata.yaml").write_text(content)
        assert len(read_recording(folder).states) == 350
