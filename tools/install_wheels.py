#!/usr/bin/env python3
"""Runs `pip install` and tells how far it is: packages and megabytes done of all, and the time left.

    install_wheels.py LOG [pip arguments ...]
    install_wheels.py --reason LOG

pip itself says either everything or nothing, and through a pipe nothing at all while it unpacks. Here its words go to a
file, and what people need is read off them: one line that changes in a terminal, else a line every few seconds. What
is still to come is known from requirements/constraints.txt, where each version stands with the size of its wheel. Where
pip fails, one line says why.

Only the standard library is used: this runs in an environment that is empty.
"""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Iterable, Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import distributions
from pathlib import Path
from typing import TextIO

ROOT = Path(__file__).resolve().parent.parent
CONSTRAINTS = ROOT / "requirements" / "constraints.txt"

LINE_EVERY = 8.0
"""Time between two lines where there is no terminal, s."""
LOOK_EVERY = 0.5
"""Time between two looks at what pip has done, s."""
RATE_AFTER = 3.0
"""Time after which a rate of downloads means something, s."""
SHARE_AFTER = 0.02
"""Share of the whole after which it does."""

_PIN = re.compile(r"^(?P<name>[A-Za-z0-9._-]+)==(?P<version>\S+)\s+#\s+(?P<stage>\w+), (?P<megabytes>[\d.]+) MB$")
_FILE = re.compile(r"(?P<file>[^/\s]+\.(?:whl|tar\.gz|zip))(?:\s+\((?P<size>[^)]+)\))?$")
_BYTES = {"bytes": 1e-6, "kB": 1e-3, "MB": 1.0, "GB": 1e3}
_NO_CONNECTION = (
    "NewConnectionError",
    "NameResolutionError",
    "Failed to establish a new connection",
    "Failed to resolve",
    "Connection to ",
    "ConnectionError",
    "Connection refused",
    "Network is unreachable",
    "ProxyError",
    "Cannot connect to proxy",
    "Read timed out",
    "ReadTimeoutError",
    "ConnectTimeoutError",
    "Unable to connect",
)
_UNFOUND = re.compile(r"No matching distribution found for (\S+)")
_CERTIFICATE = ("CERTIFICATE_VERIFY_FAILED", "SSLError", "SSLCertVerificationError")


@dataclass(frozen=True)
class Pin:
    """A version in the file of constraints.

    Attributes:
        version: as installed.
        stage: requirement file that brings it, without its ending.
        megabytes: size of its wheel, MB.
    """

    version: str
    stage: str
    megabytes: float


def normal(name: str) -> str:
    """Return a distribution's name as the Python packaging specification compares names (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def read_pins(text: str) -> dict[str, Pin]:
    """Return the versions of a file of constraints, by normal name; lines without a size are left out."""
    found = (_PIN.match(line) for line in text.splitlines())
    return {
        normal(match["name"]): Pin(match["version"], match["stage"], float(match["megabytes"]))
        for match in found
        if match
    }


def expected(pins: Mapping[str, Pin], stages: Iterable[str], installed: Mapping[str, str]) -> dict[str, float]:
    """Return what an installation of stages must fetch.

    Args:
        pins: all versions.
        stages: requirement files that are installed, without their ending.
        installed: versions that are there already, by normal name.

    Returns:
        Sizes by normal name, MB.
    """
    wanted = set(stages)
    return {
        name: pin.megabytes for name, pin in pins.items() if pin.stage in wanted and installed.get(name) != pin.version
    }


@dataclass
class Progress:
    """What pip has done, read off its words.

    Attributes:
        sizes: MB of what must be fetched, by normal name; corrected and added to on the way.
        found: packages that pip has named so far.
        fetched: packages whose file is here.
        downloaded: what came through the network, MB.
        to_install: packages that are being installed; empty until that begins.
        doing: what takes long and has no number, such as compiling.
    """

    sizes: dict[str, float]
    found: set[str] = field(default_factory=set)
    fetched: set[str] = field(default_factory=set)
    downloaded: float = 0.0
    to_install: list[str] = field(default_factory=list)
    doing: str = ""
    _current: str = ""
    _current_part: float = 0.0

    def feed(self, line: str) -> None:
        """Take note of a line of pip's."""
        line = line.strip()
        first, _, rest = line.partition(" ")
        if first == "Progress":
            self._feed_part(rest)
        elif first == "Collecting":
            self._end_download()
            self.found.add(normal(re.split(r"[ \[<>=!~;(]", rest, maxsplit=1)[0]))
        elif first in ("Downloading", "Using", "Processing"):
            self._feed_file(first, rest)
        elif line.startswith(("Building wheel for", "Preparing metadata", "Installing build dependencies")):
            self._end_download()
            self.doing = line.split(":")[0].removesuffix(" ...").lower()
        elif line.startswith("Installing collected packages:"):
            self._end_download()
            self.to_install = [normal(name.strip()) for name in line.partition(":")[2].split(",")]
            self.doing = ""
        elif "Retrying (Retry(" in line:
            self.doing = "no answer from the package index, trying again"

    def _feed_part(self, rest: str) -> None:
        done, _, total = rest.partition(" of ")
        if done.isdigit() and total.isdigit():
            self._current_part = int(done) / 1e6
            self.doing = ""
            if int(total):
                self.sizes[self._current] = int(total) / 1e6

    def _feed_file(self, verb: str, rest: str) -> None:
        self._end_download()
        match = _FILE.search(rest)
        if not match:  # a wheel's metadata, or a folder
            return
        self.doing = ""
        name = normal(match["file"].rsplit("-", 1)[0] if match["file"][-4:] != ".whl" else match["file"].split("-")[0])
        megabytes = _megabytes(match["size"])
        if megabytes is not None:
            self.sizes[name] = megabytes
        if verb == "Downloading":
            self._current = name
        else:
            self.sizes.setdefault(name, 0.0)
            self.fetched.add(name)

    def _end_download(self) -> None:
        """Count the file whose download was the last that pip spoke of."""
        if self._current:
            self.downloaded += self.sizes.setdefault(self._current, self._current_part)
            self.fetched.add(self._current)
        self._current, self._current_part = "", 0.0

    def finish(self) -> None:
        """Count what is not counted yet."""
        self._end_download()

    @property
    def received(self) -> float:
        """What came through the network so far, MB, with the part of an open download."""
        return self.downloaded + self._current_part

    @property
    def total(self) -> float:
        """All that must be fetched, as far as it is known, MB."""
        return sum(self.sizes.values())

    def text(self, seconds: float, installed: Set[str] = frozenset(), install_seconds: float = 0.0) -> str:
        """Return the state in words.

        Args:
            seconds: time since the first download began, s.
            installed: packages that are in place, by normal name.
            install_seconds: time since their installation began, s.
        """
        if self.to_install:
            weights = {name: self.sizes.get(name, 0.0) for name in self.to_install}
            in_place = weights.keys() & installed
            left = _left(install_seconds, sum(weights[name] for name in in_place), sum(weights.values()))
            return f"unpacking: {len(in_place)} of {len(weights)} packages{left}"
        if self.doing:
            return self.doing
        done = self._current_part + sum(self.sizes.get(name, 0.0) for name in self.fetched)
        if not self.fetched and not self._current:
            return f"looking for packages: {len(self.found)} of {max(len(self.sizes), len(self.found))}"
        # What had not to be fetched took no time, so the rate is that of the network.
        left = _left(seconds, self.received, self.received + max(0.0, self.total - done))
        return (
            f"downloading: {len(self.fetched)} of {len(self.sizes)} packages, {done:.0f} of {self.total:.0f} MB{left}"
        )


def _megabytes(text: str | None) -> float | None:
    """Return a size as pip writes it, in MB."""
    number, _, unit = (text or "").partition(" ")
    try:
        return float(number) * _BYTES[unit]
    except (ValueError, KeyError):
        return None


def _left(seconds: float, done: float, total: float) -> str:
    """Return the time left at the rate so far as ", 1:05 left", or nothing where that would be a guess."""
    if seconds < RATE_AFTER or done <= SHARE_AFTER * total:
        return ""
    left = round(seconds * (total - done) / done)
    return f", {left // 60}:{left % 60:02d} left"


def reason(lines: Sequence[str]) -> str:
    """Return in one line why pip failed, read off what it said."""
    text = "\n".join(lines)
    errors = [line.strip().removeprefix("ERROR: ") for line in lines if line.strip().startswith("ERROR:")]
    errors = [error for error in errors if error != "Exception:"]  # a traceback's head; its last line tells more
    if "No space left on device" in text:
        return "the disk is full (No space left on device)"
    if any(sign in text for sign in _CERTIFICATE):
        return "the package index shows a certificate that this machine does not trust (PIP_CERT names others)"
    unfound = [match for match in map(_UNFOUND.match, errors) if match]
    spoken = text if unfound or not errors else "\n".join(errors)  # warnings alone may tell of another index
    if any(sign in spoken for sign in _NO_CONNECTION):
        return (
            "no connection to the package index; is this machine online, or does it need HTTPS_PROXY or PIP_INDEX_URL?"
        )
    if unfound:
        return f"the package index has no {unfound[0][1]} for CPython {sys.version_info[0]}.{sys.version_info[1]}"
    if errors:
        return next((error for error in errors if "ailed to build" in error or "ailed building" in error), errors[0])
    return next((line.strip() for line in reversed(lines) if line.strip()), "pip said nothing")


class Teller:
    """Shows one line: rewritten in a terminal, else printed every few seconds."""

    def __init__(self, stream: TextIO) -> None:
        """Begin to tell."""
        self._stream = stream
        self._live = stream.isatty()
        self._told = time.monotonic()

    def tell(self, text: str) -> None:
        """Show the present state, where it is time."""
        if self._live:
            self._stream.write(f"\r\033[Ksetup: {text}")
        elif time.monotonic() - self._told >= LINE_EVERY:
            self._told = time.monotonic()
            self._stream.write(f"setup: {text}\n")
        self._stream.flush()

    def end(self, text: str) -> None:
        """Show a last line that stays."""
        self._stream.write(f"\r\033[Ksetup: {text}\n" if self._live else f"setup: {text}\n")
        self._stream.flush()


def new_packages(folder: Path, since: float) -> set[str]:
    """Return what was put into a folder since a time, by normal name; a package's RECORD is written last."""
    found = set()
    for record in folder.glob("*.dist-info/RECORD"):
        with suppress(FileNotFoundError):  # an old version, removed meanwhile
            if record.stat().st_mtime >= since:
                found.add(normal(record.parent.name.split("-")[0]))
    return found


def install(arguments: Sequence[str], sizes: dict[str, float], log: Path, stream: TextIO = sys.stderr) -> int:
    """Run pip and tell how far it is.

    Args:
        arguments: of ``pip install``.
        sizes: MB of what must be fetched, by normal name.
        log: file for all that pip says.
        stream: where to tell it.

    A file `downloaded` beside the log gets a line with the MB that came through the network.

    Returns:
        pip's exit code; 130 where it was interrupted.
    """
    command = [sys.executable, "-u", "-m", "pip", "--disable-pip-version-check", "--no-input", "install"]
    command += ["--progress-bar", "raw", *arguments]
    progress, teller = Progress(sizes), Teller(stream)
    lines: list[str] = []
    with log.open("w", encoding="utf-8") as file:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
        )
        reader = threading.Thread(target=_read, args=(process, progress, lines, file), daemon=True)
        reader.start()
        began = time.monotonic()
        try:
            _watch(process, progress, teller)
        except KeyboardInterrupt:
            process.wait()
            teller.end("interrupted")
            return 130
        reader.join()
    progress.finish()
    if process.returncode:
        teller.end(f"pip could not install the packages: {reason(lines)}")
        return process.returncode
    with log.with_name("downloaded").open("a", encoding="utf-8") as file:
        print(round(progress.downloaded, 1), file=file)
    took = round(time.monotonic() - began)
    count = len(progress.to_install)
    teller.end(
        f"{count} package{'' if count == 1 else 's'} installed, {progress.downloaded:.0f} MB downloaded, "
        f"in {took // 60}:{took % 60:02d}"
    )
    return 0


def _read(process: subprocess.Popen[str], progress: Progress, lines: list[str], log: TextIO) -> None:
    """Read pip's words until it ends."""
    assert process.stdout is not None
    for line in process.stdout:
        progress.feed(line)
        if not line.startswith("Progress "):
            lines.append(line)
            log.write(line)


def _watch(process: subprocess.Popen[str], progress: Progress, teller: Teller) -> None:
    """Tell the state until pip ends."""
    folder = Path(sysconfig.get_path("purelib"))
    first_byte = install_began = 0.0
    stamp = time.time()
    while True:
        try:
            process.wait(LOOK_EVERY)
            return
        except subprocess.TimeoutExpired:
            now = time.monotonic()
        if progress.received and not first_byte:
            first_byte = now
        if progress.to_install and not install_began:
            install_began = now
        done = new_packages(folder, stamp) if install_began else set()
        teller.tell(progress.text(now - first_byte, done, now - install_began))


def main(arguments: Sequence[str]) -> int:
    """Install what the arguments name, or say why an installation failed that left a log."""
    if arguments[0] == "--reason":
        print(reason(Path(arguments[1]).read_text(encoding="utf-8", errors="replace").splitlines()))
        return 0
    log, rest = Path(arguments[0]), list(arguments[1:])
    stages = [Path(word).stem for word in rest if word.endswith(".txt")]
    # A package whose files are partly gone has neither name nor version.
    installed = {normal(package.name): package.version for package in distributions() if package.metadata["Name"]}
    sizes = expected(read_pins(CONSTRAINTS.read_text(encoding="utf-8")), stages, installed)
    return install(rest, sizes, log)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
