"""Commands in README, documents and help can be given as they stand there."""

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from bike_sim.ros.isolation import DomainLease
from bike_training import cli
from bike_training.commands import declarations as dc
from bike_training.commands.declarations import COMMANDS

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
STARTS = re.compile(r"(?:\.venv/bin/)?bike [a-z]")


def commands_of(text: str) -> list[str]:
    """Commands in code blocks and code spans of a page, but for those that are filled in from a help."""
    text = re.sub(r"<!-- figures: command .*?<!-- /figures -->", "", text, flags=re.DOTALL)
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    prose = re.sub(r"^```\w*\n.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    spans = [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose)]
    parts = [part.strip() for line in lines for part in line.partition(" # ")[0].split("&&")]
    return [part.removeprefix(".venv/bin/") for part in [*parts, *spans] if STARTS.match(part)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_of_pages_can_be_given(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, check_command: Callable[..., None]
) -> None:
    monkeypatch.chdir(tmp_path)
    for command in commands_of(page.read_text(encoding="utf-8")):
        check_command(command, complete=False)


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_of_help_can_be_given(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, check_command: Callable[..., None]
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [re.split(r" {2,}", line.strip())[0] for line in COMMANDS[name].examples.splitlines()]
    examples = [part.strip() for line in lines for part in line.split("&&") if part.strip().startswith("bike ")]
    assert any(example.startswith(f"bike {name}") for example in examples)
    for example in examples:
        check_command(example)


def test_the_reference_names_all_commands() -> None:
    page = (ROOT / "docs/reference/commands.md").read_text(encoding="utf-8")
    assert re.findall(r"<!-- figures: command (\w+) -->", page) == list(COMMANDS)


def test_make_rides_with_commands_that_exist(check_command: Callable[..., None]) -> None:
    for line in (ROOT / "Makefile").read_text().splitlines():
        if "$(BIN)/bike " in line:
            check_command(line.strip().removeprefix("@$(BIN)/").replace("$(or $(V),whipple)", "whipple"))


SHORTER = {
    ("ride", dc.SUPERBIKE): "--laps 1 --engine compiled",
    ("ride", dc.ALL): "--laps 1 --engine compiled",
    ("ride", dc.NODES): "--laps 1",
    ("live", dc.BICYCLE): "--seconds 2",
    ("evaluate", dc.BICYCLE): "--speeds 4 --random-rides 0 --engine whipple --time-step 0.01",
    ("evaluate", dc.SUPERBIKE): "--starts 1",
    ("validate", dc.BICYCLE): "--engine whipple --time-step 0.01",
    ("train", dc.BICYCLE): "--steps 4000",
    ("train", dc.SUPERBIKE): "--steps 3000",
    ("train", dc.REFINEMENT): "--set learner.segments=1",
    ("bench", dc.WORK): "recorder",
}
"""Words that make a command take seconds, by command and subject."""


@pytest.mark.long
@pytest.mark.ros
@pytest.mark.timeout(3600)
def test_every_line_of_readme_can_be_given_in_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each in a form that takes seconds, `make` by what it calls; then nodes and Python."""
    pytest.importorskip("rclpy")
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    recipes = dict(re.findall(r"^([\w-]+):.*\n\t@\$\(BIN\)/(bike .*)$", (ROOT / "Makefile").read_text(), re.MULTILINE))
    blocks = "\n".join(re.findall(r"^```sh\n.*?^```$", text, re.DOTALL | re.MULTILINE))
    shell = re.sub(r"^make ([\w-]+)", lambda made: recipes.get(made[1], made[0]), blocks, flags=re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    given = commands_of(shell.replace("$(or $(V),whipple)", "whipple"))
    assert len(given) >= 13
    for command in given:
        words = shlex.split(command)[1:]
        subject = cli.parse(words[0], words[1:]).subject
        code = cli.main([*words, *SHORTER.get((words[0], subject), "").split()])
        # One segment of learning is no rider.
        assert code in ((0, 1) if subject == dc.REFINEMENT else (0,)), command
    nodes = [shlex.split(line) for line in re.findall(r"^ros2 run .*$", blocks, re.MULTILINE)]
    with DomainLease() as lease, (tmp_path / "words").open("w") as file:
        environment = os.environ | {"ROS_DOMAIN_ID": str(lease.domain_id)}
        running = [
            subprocess.Popen([Path(sys.prefix) / "bin" / ros2, *rest], env=environment, stderr=file)
            for ros2, *rest in nodes
        ]
        end = time.monotonic() + 120.0
        while "driving episode" not in (tmp_path / "words").read_text() and time.monotonic() < end:
            time.sleep(0.5)
        for node in running:
            node.send_signal(signal.SIGINT)
        assert [node.wait(60.0) for node in running] == [0, 0]
    assert "driving episode" in (tmp_path / "words").read_text()
    for block in re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE):
        exec(block, {})
