"""Dependencies and requirement files against what the packages import, and the wheel that carries them."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from functools import cache
from importlib.metadata import packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from bike_training import learning_packages
from bike_training.learning_packages import PACKAGES, ROS_PACKAGES, SWEEP_PACKAGES

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
FOLDERS = {Path(folder).name: ROOT / folder for folder in tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"][
    "hatch"]["build"]["targets"]["wheel"]["packages"]}  # fmt: skip
REFUSED = PACKAGES | SWEEP_PACKAGES
NOT_IMPORTED = {
    "pyarrow": "pandas writes Parquet files with it",
    "tensorboard": "stable-baselines3 writes its logs with it",
}


@cache
def owners() -> dict[str, str]:
    """Distribution of each importable name."""
    return {top: canonicalize_name(names[0]) for top, names in packages_distributions().items()}


@cache
def imported(package: str) -> dict[str, str]:
    """Distributions that a package imports anywhere, each with one of the files that do."""
    found = {}
    for file in sorted(FOLDERS[package].rglob("*.py")):
        for name in imports(ast.parse(file.read_text(encoding="utf-8"))):
            top = name.partition(".")[0]
            if top not in {*sys.stdlib_module_names, *FOLDERS} and not ROS_PACKAGES.match(top):
                assert top in owners(), f"{file} imports {top}, which is not installed"
                found[owners()[top]] = str(file.relative_to(ROOT))
    return found


def imports(tree: ast.AST) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module


def declared(*extras: str) -> set[str]:
    """Names of the dependencies, with those of extras."""
    lines = list(PROJECT["dependencies"])
    for extra in extras:
        lines += PROJECT["optional-dependencies"][extra]
    return {canonicalize_name(Requirement(line).name) for line in lines}


def pinned(name: str) -> set[str]:
    """Names in a requirement file."""
    lines = (ROOT / "requirements" / f"{name}.txt").read_text().splitlines()
    return {canonicalize_name(Requirement(line).name) for line in lines if line and not line.startswith("#")}


@pytest.mark.parametrize(
    ("package", "extras"),
    [
        ("bike_sim", ()),
        ("bike_policy", ()),
        ("bike_analysis", ("analysis",)),
        ("bike_training", ("foxglove", "onnx", "sweep", "training")),
    ],
)
def test_what_a_package_imports_is_declared(package: str, extras: tuple[str, ...]) -> None:
    missing = {name: file for name, file in imported(package).items() if name not in declared(*extras)}
    assert not missing


def test_what_is_declared_is_imported() -> None:
    used = {name for package in FOLDERS for name in imported(package)} | set(NOT_IMPORTED)
    assert declared("analysis", "foxglove", "onnx", "parquet", "sweep", "training") == used


def test_all_is_all() -> None:
    extras = set(PROJECT["optional-dependencies"]) - {"all"}
    assert Requirement(PROJECT["optional-dependencies"]["all"][0]).extras == extras


def test_requirement_files_pin_what_is_declared() -> None:
    assert pinned("runtime") == declared("analysis")
    assert pinned("training") | pinned("torch") == declared("training", "foxglove", "parquet") - declared()
    assert pinned("sweep") == declared("sweep") - declared("training", "parquet")


def test_what_is_pinned_and_what_it_pulls_in_has_one_version() -> None:
    lines = (ROOT / "requirements" / "constraints.txt").read_text().splitlines()
    versions = dict(line.split("==") for line in lines if not line.startswith("#"))
    names = {canonicalize_name(name) for name in versions}
    assert len(names) == len(versions)
    for stage in ("runtime", "build", "ros-jazzy", "training", "sweep", "dev"):
        assert pinned(stage) <= names, f"requirements/{stage}.txt: run tools/update-constraints"


RIDING = """
import importlib, sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in PACKAGES:
            raise ModuleNotFoundError(f"{name} is not for riding", name=name)
sys.meta_path.insert(0, Refuse())
"""


def run_python(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)


def test_riding_and_analysis_import_no_learning_package() -> None:
    commands = ["declarations", "sweep", "ride", "evaluate", "analyze", "replay", "curves", "validate", "bench"]
    modules = [f"bike_training.commands.{name}" for name in commands]
    modules += [
        "bike_training.cli",
        "bike_training.nodes.node_rides",
        "bike_sim.ros.sim_node",
        "bike_sim.ros.record",
        "bike_policy.drive",
        "bike_policy.estimate",
    ]
    program = f"PACKAGES = {set(REFUSED)}\n{RIDING}\nfor name in {modules}: importlib.import_module(name)"
    ended = run_python(program)
    assert ended.returncode == 0, ended.stderr


def test_a_command_that_learns_says_what_to_run() -> None:
    program = f"PACKAGES = {set(REFUSED)}\n{RIDING}\nfrom bike_training.cli import main\nsys.exit(main(sys.argv[1:]))"
    ended = subprocess.run(
        [sys.executable, "-c", program, "train", "whipple", "--out", "never"],
        capture_output=True, text=True, timeout=120, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr.count("\n") == 1
    assert ended.stderr.startswith("bike train: this needs the learning packages (")
    assert ended.stderr.rstrip().endswith("run: make setup-training")


@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("bike_msgs", ["ride", "--rider", "racer", "--nodes"]),
        ("rclpy", ["live", "--attach"]),
    ],
)
def test_without_ros_one_line_says_what_works_and_how_to_get_it(words: list[str], package: str, tmp_path: Path) -> None:
    program = f"PACKAGES = {{{package!r}}}\n{RIDING}\nfrom bike_training.cli import main\nsys.exit(main(sys.argv[1:]))"
    ended = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, cwd=tmp_path)
    assert ended.returncode == 2
    assert re.fullmatch(rf"bike \w+: this needs ROS 2 \({package} is not .*make setup .*without ROS .*\n", ended.stderr)
    assert not list(tmp_path.iterdir())


def test_a_wheel_advises_the_address_that_it_came_from(monkeypatch, tmp_path: Path, capsys) -> None:
    """A name that no index has could be published by anybody."""
    monkeypatch.setattr(learning_packages, "SETUP", tmp_path / "none")
    learning_packages.advise("train", "torch")
    assert re.search(r"pip install 'two-wheeler-lab\[all\] @ file:///\S+'\n$", capsys.readouterr().err)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The project's wheel, built with what is installed."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--no-index"]
    subprocess.run([*command, "--wheel-dir", folder, ROOT], check=True, timeout=120)
    (found,) = folder.glob("*.whl")
    return found


def test_the_wheel_carries_types_and_data(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for package, folder in FOLDERS.items():
        assert f"{package}/py.typed" in names
        files = {file for file in folder.rglob("*") if file.is_file() and "__pycache__" not in file.parts}
        assert {f"{package}/{file.relative_to(folder)}" for file in files} <= names


def with_dependencies(names: set[str]) -> set[str]:
    """Distributions and all that they need, as far as it is installed."""
    found: set[str] = set()
    while names - found:
        name = (names - found).pop()
        found.add(name)
        needed = (Requirement(line) for line in requires(name) or [])
        names |= {
            canonicalize_name(each.name) for each in needed if not each.marker or each.marker.evaluate({"extra": ""})
        }
    return found


def test_the_wheel_needs_no_more_than_it_declares(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path)
    (metadata,) = tmp_path.glob("*.dist-info/METADATA")
    lines = re.findall(r"^Requires-Dist: (.*)$", metadata.read_text(), re.MULTILINE)
    names = {
        canonicalize_name(each.name)
        for each in map(Requirement, lines)
        if not each.marker or each.marker.evaluate({"extra": "analysis"})
    }
    assert names == declared("analysis")
    allowed = with_dependencies(set(names))
    tops = {top for top, owner in owners().items() if owner in allowed}
    program = f"""
import sys
sys.path.insert(0, {str(tmp_path)!r})
TOPS, OWN = {tops}, {set(FOLDERS)}
class OnlyDeclared:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if not (top in TOPS or top in OWN or top in sys.stdlib_module_names or top.startswith("_")):
            raise ModuleNotFoundError(f"{{name}} is not among the dependencies", name=name)
sys.meta_path.insert(0, OnlyDeclared())
from bike_analysis import open_ride
import bike_analysis.report, bike_analysis
assert bike_analysis.__file__.startswith({str(tmp_path)!r}), bike_analysis.__file__
"""
    ended = run_python(program)
    assert ended.returncode == 0, ended.stderr
