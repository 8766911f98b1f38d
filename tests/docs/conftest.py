"""Commands in documents, helps and heads of data."""

import re
import shlex
from collections.abc import Callable

import pytest

from bike_training.commands.declarations import COMMANDS, CommandParser

FOR_READERS = {"...", "COMMAND", "\N{HORIZONTAL ELLIPSIS}"}


def check(command: str, complete: bool = True) -> None:
    """Parse a command, and resolve it where all that it names is here."""
    words = shlex.split(re.sub(r"\$\w+", "", re.sub(r"\$\([^)]*\)", "X", command.partition(" > ")[0])), comments=True)[
        1:
    ]
    assert words[0] in COMMANDS, command
    if (not complete and len(words) == 1) or FOR_READERS & set(words):
        return
    declared = COMMANDS[words[0]]
    parser = CommandParser(words[0])
    try:
        args = parser.parse_args(words[1:])
    except ValueError as error:
        # Prose may leave out what a command needs, or have a capital for a value, but no unknown option.
        if complete or not re.search("are required|expected one argument|invalid .*'[A-Z]'", str(error)):
            raise AssertionError(command) from error
        return
    try:
        subject = declared.subject(args)
    except FileNotFoundError:
        return  # a file or a policy of the reader
    parser.resolve(args, subject)


@pytest.fixture
def check_command() -> Callable[..., None]:
    return check
