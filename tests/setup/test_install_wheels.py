"""tools/install_wheels.py: what it reads off pip's words, and what it says of it."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools"))
import install_wheels  # noqa: E402
from install_wheels import Pin, Progress, Teller, expected, new_packages, read_pins, reason  # noqa: E402

INDEX_WITH_METADATA = """\
Collecting numpy==2.4.6 (from -r requirements/runtime.txt (line 6))
  Downloading numpy-2.4.6-cp311-cp311-manylinux_2_28_x86_64.whl.metadata (6.6 kB)
Collecting ros-jazzy-rclpy[fastrtps]==7.1.6 (from -r requirements/ros.txt (line 3))
  Downloading ros_jazzy_rclpy-7.1.6-py3-none-any.whl.metadata (1.2 kB)
Collecting notify2>=0.3 (from colcon-notification)
  Downloading notify2-0.3.1.tar.gz.metadata (1.2 kB)
"""
DOWNLOADS = """\
Downloading numpy-2.4.6-cp311-cp311-manylinux_2_28_x86_64.whl (16.9 MB)
Progress 0 of 16900000
Progress 8450000 of 16900000
"""
REST = """\
Progress 16900000 of 16900000
Using cached notify2-0.3.1.tar.gz (20 kB)
Processing /somewhere/ros_jazzy_rclpy-7.1.6-py3-none-any.whl
Installing collected packages: notify2, numpy, ros-jazzy-rclpy
"""
SIZES = {"numpy": 16.0, "notify2": 0.02, "ros-jazzy-rclpy": 0.01}


def fed(*texts: str) -> Progress:
    progress = Progress(dict(SIZES))
    for line in "".join(texts).splitlines():
        progress.feed(line)
    return progress


def test_metadata_is_no_package() -> None:
    assert fed(INDEX_WITH_METADATA).text(1.0) == "looking for packages: 3 of 3"


def test_half_a_download_is_half_of_the_megabytes() -> None:
    progress = fed(INDEX_WITH_METADATA, DOWNLOADS)
    assert progress.received == pytest.approx(8.45)
    assert progress.text(10.0) == "downloading: 0 of 3 packages, 8 of 17 MB, 0:10 left"


def test_only_the_network_counts_as_downloaded() -> None:
    progress = fed(INDEX_WITH_METADATA, DOWNLOADS, REST)
    assert progress.fetched == set(SIZES)
    assert progress.downloaded == pytest.approx(16.9)


def test_unpacking_is_weighed_by_size() -> None:
    progress = fed(INDEX_WITH_METADATA, DOWNLOADS, REST)
    # 20 kB of 16.93 MB took 10 s, from which nothing follows
    assert progress.text(99.0, {"notify2"}, 10.0) == "unpacking: 1 of 3 packages"
    assert progress.text(99.0, set(SIZES), 10.0) == "unpacking: 3 of 3 packages, 0:00 left"


def test_compiling_is_said_until_something_else_happens() -> None:
    progress = fed(INDEX_WITH_METADATA, "Building wheel for pybullet (setup.py): started\n")
    assert progress.text(1.0) == "building wheel for pybullet (setup.py)"
    progress.feed("Downloading numpy-2.4.6-cp311-cp311-manylinux_2_28_x86_64.whl (16.9 MB)")
    assert progress.text(1.0).startswith("downloading")


def test_an_unknown_package_is_added_to_the_whole() -> None:
    progress = fed("Collecting torch==2.13.0\n", "Downloading torch-2.13.0-cp311-cp311-linux.whl (888.1 MB)\n")
    assert progress.total == pytest.approx(sum(SIZES.values()) + 888.1)


def test_pins_are_read_with_origin_and_size() -> None:
    text = "# head\nPyYAML==6.0.3  # runtime, 0.81 MB\nnot-measured==1.0\nros_x==2.0  # ros, 0.01 MB\n"
    pins = read_pins(text)
    assert pins == {"pyyaml": Pin("6.0.3", "runtime", 0.81), "ros-x": Pin("2.0", "ros", 0.01)}
    assert expected(pins, ["runtime", "ros"], {"pyyaml": "6.0.3"}) == {"ros-x": 0.01}
    assert expected(pins, ["runtime"], {"pyyaml": "6.0.2"}) == {"pyyaml": 0.81}


CONNECTION = (
    "WARNING: Retrying (Retry(total=0)) after connection broken by 'NewConnectionError(\"HTTPSConnection(host='x'): "
    "Failed to establish a new connection: [Errno 111] Connection refused\")': /simple/numpy/"
)
UNFOUND = "ERROR: No matching distribution found for numpy==9.9"


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([CONNECTION, UNFOUND], "no connection to the package index"),
        ([UNFOUND], "the package index has no numpy==9.9 for CPython"),
        (["ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device"], "disk is full"),
        (["x", "ERROR: Failed building wheel for pybullet", "ERROR: y"], "Failed building wheel for pybullet"),
        (["SSLError(SSLCertVerificationError(1, 'certificate verify failed'))", UNFOUND], "does not trust"),
        ([CONNECTION, "ERROR: THESE PACKAGES DO NOT MATCH THE HASHES"], "DO NOT MATCH THE HASHES"),
        (["Killed", ""], "Killed"),
        (
            ["ERROR: Exception:", "Traceback (most recent call last):", "  File x", "ValueError: None"],
            "ValueError: None",
        ),
        ([], "pip said nothing"),
    ],
)
def test_one_line_says_why_pip_failed(lines: list[str], words: str) -> None:
    found = reason(lines)
    assert words in found
    assert "\n" not in found


def test_a_failed_installation_ends_in_one_line(tmp_path: Path) -> None:
    environment = os.environ | {"PIP_INDEX_URL": "https://127.0.0.1:9/simple", "PIP_RETRIES": "1"}
    environment |= {"PIP_CONFIG_FILE": os.devnull, "PIP_NO_INDEX": "0", "PIP_FIND_LINKS": ""}
    command = [sys.executable, ROOT / "tools" / "install_wheels.py", tmp_path / "log", "--dry-run", "no-such-package"]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=90)
    assert ended.returncode == 1
    assert ended.stdout == ""
    *waiting, last = ended.stderr.splitlines()
    assert "no connection to the package index" in last
    assert all(line.startswith("setup: looking for packages") or "trying again" in line for line in waiting)
    assert "no-such-package" in (tmp_path / "log").read_text()


def test_records_written_since_are_new_packages(tmp_path: Path) -> None:
    for name, time in (("old-1.0", 100.0), ("colcon_core-0.21", 300.0)):
        record = tmp_path / f"{name}.dist-info" / "RECORD"
        record.parent.mkdir()
        record.touch()
        os.utime(record, (time, time))
    assert new_packages(tmp_path, 200.0) == {"colcon-core"}


def test_lines_come_every_few_seconds_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(range(1000))
    monkeypatch.setattr(install_wheels.time, "monotonic", lambda: float(next(clock)))
    stream = io.StringIO()
    teller = Teller(stream)
    for count in range(30):
        teller.tell(f"{count}")
    assert 2 <= stream.getvalue().count("\n") <= 30 / install_wheels.LINE_EVERY * 2
