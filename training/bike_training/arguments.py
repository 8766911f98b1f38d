"""Arguments of commands: which option applies to which subject, and checks that name the option and the value."""

from __future__ import annotations

import argparse
import difflib
import itertools
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from bike_sim.recording.in_use import claim_folder


@dataclass(frozen=True)
class Option:
    """An option of a command.

    Attributes:
        flag: as it is written; the name of a positional argument.
        dest: its attribute in the parsed arguments.
        defaults: its default for each subject that it applies to.
    """

    flag: str
    dest: str
    defaults: Mapping[str, Any]


class CommandParser(argparse.ArgumentParser):
    """Parser of a command whose options may apply to some of its subjects only (a bicycle, a superbike, ...).

    All options are None after parsing where they are not given. `resolve` refuses those that do not apply to the
    subject of a call, and sets the defaults of the others.

    Attributes:
        subjects: what the command can be about, in words for messages.
        options: all options, by their attribute in the parsed arguments.
    """

    def __init__(self, command: str, summary: str, subjects: Sequence[str]) -> None:
        """Begin a parser.

        Args:
            command: its name.
            summary: one line about it.
            subjects: what the command can be about.
        """
        super().__init__(
            prog=f"bike {command}",
            description=summary[0].upper() + summary[1:] + ".",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        self.subjects = tuple(subjects)
        self.options: dict[str, Option] = {}
        self.add_argument("--json", action="store_true", help="print one JSON object on standard output, nothing else")

    def option(self, *flags: str, only: str | Sequence[str] = (), default: Any = None, **settings: Any) -> None:
        """Declare an option.

        Args:
            flags: as for `argparse.ArgumentParser.add_argument`.
            only: the subject or subjects that it applies to; all where none is given.
            default: value where the option is not given; a mapping has one for each subject that it applies to.
            settings: as for `argparse.ArgumentParser.add_argument`.
        """
        subjects = (only,) if isinstance(only, str) else tuple(only) or self.subjects
        defaults = default if isinstance(default, Mapping) else dict.fromkeys(subjects, default)
        assert set(defaults) <= set(self.subjects), flags
        if settings.get("action") == "store_true":
            defaults = {subject: bool(value) for subject, value in defaults.items()}
        words = {str(value): None for value in defaults.values() if value not in (None, False, ())}
        if words and "(default" not in settings["help"]:
            settings["help"] += f" (default: {' or '.join(words)})"
        action = self.add_argument(*flags, default=None, **settings)
        self.options[action.dest] = Option(flags[-1], action.dest, defaults)

    def resolve(self, args: argparse.Namespace, subject: str) -> None:
        """Refuse given options that do not apply to a subject, and set the defaults of those that are not given.

        Raises:
            ValueError: an option does not apply.
        """
        for name, option in self.options.items():
            if subject in option.defaults:
                if getattr(args, name) is None:
                    setattr(args, name, option.defaults[subject])
            elif getattr(args, name) is not None:
                raise ValueError(f"{option.flag} is for {', or '.join(option.defaults)}, and this is {subject}")

    def error(self, message: str) -> NoReturn:
        """Refuse the command line, with the option that may be meant.

        Raises:
            ValueError: always.
        """
        hint = f"see {self.prog} --help"
        wrong, _, names = message.partition(" (choose from ")
        known, word = re.findall(r"[\w-]+", names), wrong.rpartition(" ")[2].strip("'")
        if "unrecognized" in message:
            word = next((word for word in message.split() if word.startswith("--")), "").partition("=")[0]
            known = [option.flag for option in self.options.values()]
        near = difflib.get_close_matches(word, known, 1)
        if near:
            hint = f"did you mean {near[0]}? See {self.prog} --help"
        raise ValueError(f"{message}; {hint}")


def check_positive(option: str, value: float, unit: str, most: float = math.inf) -> None:
    """Check a number.

    Raises:
        ValueError: it is not finite, not above 0, or above the largest.
    """
    if not (math.isfinite(value) and 0.0 < value <= most):
        bound = "and finite" if math.isinf(most) else f"and at most {most:g} {unit}"
        raise ValueError(f"{option} must be positive {bound}, got {value:g} {unit}")


def check_whole(option: str, value: int, least: int, most: int | None = None) -> None:
    """Check a whole number.

    Raises:
        ValueError: it is less than the least or more than the most.
    """
    if value < least or (most is not None and value > most):
        wanted = f"at least {least}" if most is None else f"{least} to {most}"
        raise ValueError(f"{option} must be {wanted}, got {value}")


def seeds_of(option: str, text: str) -> tuple[int, ...]:
    """Return seeds: of ``N`` those from 0 to N - 1, of ``A-B`` those from A to B, both ends included.

    Raises:
        ValueError: it is neither, or there would be no seed.
    """
    match = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?", text, re.ASCII)
    if match is None:
        raise ValueError(f"{option} must be a number of seeds, as 5, or a range of seeds, as 2-4; got {text!r}")
    first, last = (0, int(match[1]) - 1) if match[2] is None else (int(match[1]), int(match[2]))
    if last < first:
        raise ValueError(f"{option} {text} holds no seed")
    return tuple(range(first, last + 1))


def make_folder(option: str, path: Path) -> None:
    """Make a folder for what a command writes, so that one that cannot be is known before and not after the work.

    Raises:
        FileExistsError: there is a file of that name. OSError: it cannot be made.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise FileExistsError(f"{option} {path} cannot be a folder: a file is in the way") from error


def read_json(path: Path, needed: Iterable[str] = ()) -> dict[str, Any]:
    """Read a JSON object.

    Args:
        path: the file.
        needed: entries that it must have.

    Raises:
        OSError: there is no such file.
        ValueError: it holds something else.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} cannot be read as JSON ({error}); it is damaged or another file") from error
    if not isinstance(found, dict) or not set(needed) <= set(found):
        wanted = f" with {', '.join(sorted(needed))}" if needed else ""
        raise ValueError(f"{path} must hold one JSON object{wanted}; it is another file than asked for")
    return found


@contextmanager
def recording_folder(given: Path | None, usual: str, overwrite: bool) -> Iterator[Path]:
    """Make and claim the folder of a new recording.

    Args:
        given: the folder; None for the usual one or, where that is in use or holds a recording, the next number.
        usual: its name where none is given, in the folder out.
        overwrite: whether it may hold a recording.

    Yields:
        The folder.

    Raises:
        FileExistsError: the given folder holds a recording, or there is a file of its name.
        OSError: it cannot be made, or is in use.
    """
    for number in itertools.count(1):
        folder = given or Path("out", usual if number == 1 else f"{usual}-{number}")
        make_folder("--out", folder)
        if not overwrite and (found := sorted(folder.glob("*.mcap"))):
            if given is None:
                continue
            raise FileExistsError(f"--out {folder} holds {found[0].name}; choose another folder, or add --overwrite")
        try:
            claim = claim_folder(folder)
        except BlockingIOError:
            if given is None:
                continue
            raise
        with claim:
            yield folder
        return
