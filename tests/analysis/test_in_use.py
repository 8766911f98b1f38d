"""Two that write to one place: the second is told, and what the first writes stays whole."""

from __future__ import annotations

import multiprocessing
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from mcap.reader import make_reader

from bike_sim.recording.definitions import MessageType
from bike_sim.recording.in_use import Claim, claim_folder
from bike_sim.recording.recorder import RideRecorder
from bike_training import cli

NUMBER = MessageType("std_msgs/msg/Float64", "float64 data\n")
DATA = b"\x00\x01\x00\x00" + bytes(8)

HOLDS = """
import sys
from pathlib import Path
from bike_sim.recording.in_use import claim_folder
from bike_sim.recording.recorder import RideRecorder
kept = claim_folder(Path(sys.argv[2])) if sys.argv[1] == "folder" else RideRecorder(sys.argv[2], overwrite=True)
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def elsewhere() -> Iterator[Callable[[str, Path], subprocess.Popen]]:
    """Lets another process hold a folder or record."""
    started: list[subprocess.Popen] = []

    def hold(kind: str, path: Path) -> subprocess.Popen:
        command = [sys.executable, "-c", HOLDS, kind, str(path)]
        started.append(subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True))
        stdout = started[-1].stdout
        assert stdout is not None
        assert stdout.readline() == "held\n"
        return started[-1]

    yield hold
    for process in started:
        process.kill()
        process.communicate()


def test_the_second_is_told_who_has_the_folder(elsewhere, tmp_path: Path) -> None:
    folder = tmp_path / "same"
    folder.mkdir()
    other = elsewhere("folder", folder)
    words = f"folder {folder} is in use by process {other.pid}; choose another with --out"
    with pytest.raises(OSError, match=f"^{re.escape(words)}$"):
        claim_folder(folder)
    with claim_folder(tmp_path):  # the folder above it is another one
        pass
    other.send_signal(signal.SIGKILL)
    other.wait()
    with claim_folder(folder), pytest.raises(OSError, match=f"in use by process {os.getpid()};"):
        claim_folder(folder)
    claim_folder(folder).close()
    assert not list(folder.iterdir())  # nothing is left behind


def test_a_link_to_the_folder_is_the_same_folder(elsewhere, tmp_path: Path) -> None:
    (tmp_path / "same").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "same")
    elsewhere("folder", tmp_path / "link")
    with pytest.raises(OSError, match="in use"):
        claim_folder(tmp_path / "same")


def test_a_claim_does_not_outlive_its_close_in_a_child(tmp_path: Path) -> None:
    """A process that was forked meanwhile has inherited the open folder."""
    claim = claim_folder(tmp_path)
    context = multiprocessing.get_context("fork")
    end = context.Event()
    child = context.Process(target=end.wait, args=(60.0,))
    child.start()
    claim.close()
    claim.close()
    claim_folder(tmp_path).close()
    end.set()
    child.join()


@pytest.mark.parametrize("name", ["ride.mcap", "ride"])
def test_a_recording_that_is_being_written_is_not_replaced(name: str, elsewhere, tmp_path: Path) -> None:
    path = tmp_path / name
    path_of_file = path if path.suffix else path / "ride_0.mcap"
    with RideRecorder(path, overwrite=True) as recorder:
        recorder.add_topic("/number", NUMBER)
        for number in range(1000):
            if number == 500:
                recorder.flush()
                size = path_of_file.stat().st_size
                command = [sys.executable, "-c", HOLDS, "recording", str(path)]
                second = subprocess.run(command, capture_output=True, text=True, check=False)
                told = f"BlockingIOError: recording {path} is in use by process {os.getpid()}\n"
                assert second.stderr.endswith(told)
                assert path_of_file.stat().st_size == size
            recorder.write("/number", DATA, number)
    with path_of_file.open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == 1000
    assert elsewhere("recording", path)  # and now it may
    with pytest.raises(OSError, match="in use" if name == "ride" else "exists already"):
        RideRecorder(path)


def test_a_recording_that_failed_is_given_back(tmp_path: Path) -> None:
    (tmp_path / "ride").mkdir()
    (tmp_path / "ride" / "ride_0.mcap").write_text("precious")
    with pytest.raises(FileExistsError):
        RideRecorder(tmp_path / "ride")
    RideRecorder(tmp_path / "ride", overwrite=True).close()


def test_a_pipe_is_no_recording(tmp_path: Path) -> None:
    """Opened for writing it would hang until somebody reads."""
    os.mkfifo(tmp_path / "ride.mcap")
    with pytest.raises(OSError, match=r"recording .*ride.mcap is a named pipe"):
        RideRecorder(tmp_path / "ride.mcap", overwrite=True)


def test_where_there_are_no_locks_nothing_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As on some network file systems."""

    def no_locks(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)
    with Claim(tmp_path, "folder"), Claim(tmp_path, "folder"):
        pass


@pytest.mark.parametrize("words", [["ride"], ["ride", "--course", "barcelona", "--nodes"]])
def test_a_ride_in_a_folder_in_use_ends_with_one_line(
    words: list[str], elsewhere, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    other = elsewhere("folder", tmp_path)
    assert cli.main([*words, "--out", str(tmp_path)]) == 2
    line = f"bike {words[0]}: folder {tmp_path} is in use by process {other.pid}; choose another with --out\n"
    assert capfd.readouterr().err == line
    assert not list(tmp_path.iterdir())


def test_metadata_is_not_written_through_a_link(tmp_path: Path) -> None:
    """Somebody else may have put one where the file is prepared."""
    folder, precious = tmp_path / "ride", tmp_path / "precious"
    folder.mkdir()
    precious.write_text("stays")
    (folder / "metadata.yaml.tmp").symlink_to(precious)
    RideRecorder(folder).close()
    assert precious.read_text() == "stays"
    assert "rosbag2_bagfile_information" in (folder / "metadata.yaml").read_text()
    assert not (folder / "metadata.yaml").is_symlink()
