"""Form of the documents, and what else a repository needs for others: workflows, hooks, citation, packages of ROS."""

import re
import shutil
import tomllib
from pathlib import Path

import pytest
import yaml
from catkin_pkg.package import parse_package

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [*(ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG")), *sorted(DOCS.rglob("*.md"))]
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))
PACKAGES = sorted((ROOT / "ros_ws/src").glob("*/package.xml"))
RUN = {
    ROOT / "README.md": (),
    DOCS / "tutorials/recording-in-pandas.md": ("out/ride/ride.mcap",),
    DOCS / "tutorials/score-your-learner.md": (),
    DOCS / "how-to/use-the-environments.md": (),
}
"""Pages whose Python runs here, with the recordings that it reads."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_lines_are_short_but_for_tables_of_data(page: Path) -> None:
    """A row of a table cannot be wrapped; those that are drawn from data are as wide as their data."""
    data = r"<!-- figures: (?:shipped|pairs|optima|random_circuits|baselines|paper) .*?<!-- /figures -->"
    text = re.sub(data, "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert [line for line in text.splitlines() if len(line) > 120] == []


def test_documents_say_what_is() -> None:
    """At most 25,000 words beside the reference, and none of a diary."""
    texts = {page: page.read_text(encoding="utf-8") for page in sorted(DOCS.rglob("*.md"))}
    told = [text for page, text in texts.items() if page.parent.name not in ("reference", "api")]
    assert sum(len(text.split()) for text in told) <= 25_000
    diary = re.compile(
        r"\b(no longer|used to be|the one before|as of today|formerly|until now|nowadays|comes later|first try)\b",
        re.IGNORECASE,
    )
    texts |= {page: page.read_text(encoding="utf-8") for page in PAGES[:2]}
    assert [page.name for page, text in texts.items() if diary.search(text) and page.parent.name != "notes"] == []


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    named = set(re.findall(r"[\w/.-]+\.md", navigation))
    assert named == {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md")}


@pytest.mark.parametrize("page", RUN, ids=lambda page: page.stem)
def test_python_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("gymnasium")
    for name in RUN[page]:
        (tmp_path / name).parent.mkdir(parents=True)
        shutil.copy(ROOT / "tests/analysis/recordings/ride_of_2be20ba.mcap", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
        exec(compile(block, str(page), "exec"), names)


def test_the_rider_of_the_tutorial_rides_a_circle() -> None:
    """Its node is tried without ROS: a state in, a command out."""
    from types import SimpleNamespace

    from bike_sim.sim.config import SimulatorConfig
    from bike_sim.sim.look import CURVATURE, HEADING_ERROR, LATERAL_ERROR, SPEED
    from bike_sim.sim.request import ResetRequest
    from bike_sim.sim.simulator import Simulator

    page = (DOCS / "tutorials/ros-workspace.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```python\n(.*?)^```", page, re.DOTALL | re.MULTILINE)
    sent: list[SimpleNamespace] = []
    body = re.sub(r"^(import rclpy|from (bike_msgs|rclpy).*)$", "", block, flags=re.MULTILINE)
    names = {"Node": object, "BikeState": object, "BikeCommand": SimpleNamespace, "__name__": "page"}
    exec(compile(body, "ros-workspace.md", "exec"), names)
    rider = SimpleNamespace(commands=SimpleNamespace(publish=sent.append))
    simulator = Simulator(SimulatorConfig(engine="whipple", time_step=0.01))
    now, worst = simulator.reset(ResetRequest(course="circle", speed_range=(5.0, 5.0))), 0.0
    while not (now.fallen or now.finished):
        look = {"curvature": CURVATURE, "heading_error": HEADING_ERROR, "lateral_error": LATERAL_ERROR, "speed": SPEED}
        values = {name: now.look[column] for name, column in look.items()} | {"roll": now.state[3]}
        state = SimpleNamespace(**values, roll_rate=now.state[7], steering_limit=1.22, episode=1, step=now.step)
        names["Rider"].answer(rider, state)  # type: ignore[attr-defined]
        now = simulator.step(sent[-1].steering, 0.0)
        worst = max(worst, now.distance)
    assert now.finished
    assert worst < 0.6


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_are_whole(path: Path) -> None:
    """No linter of workflows can be installed from PyPI alone, so this holds what one would find first."""
    flow = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert set(flow) - {True} <= {"name", "permissions", "concurrency", "jobs"}
    assert {"push", "pull_request"} <= set(flow[True]), "`on` is true in YAML 1.1"
    targets = set(re.findall(r"^([\w-]+):.*", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    for name, job in flow["jobs"].items():
        assert job["runs-on"] == "ubuntu-24.04"
        assert set(job.get("needs", "").split()) <= set(flow["jobs"]) - {name}
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step), step
            assert re.fullmatch(r"actions/[\w-]+@v\d+", step.get("uses", "actions/checkout@v4"))
            assert set(re.findall(r"\bmake ([a-z-]+)", step.get("run", ""))) - targets <= {"git"}
            used = re.findall(r"\$\{\{\s*matrix\.(\w+)", str(step))
            assert set(used) <= set(job.get("strategy", {}).get("matrix", {}))


def test_hooks_are_the_tools_of_make_check() -> None:
    checks = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\ncheck:")[2].partition("\n\n")[0]
    (repo,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    for hook in repo["hooks"]:
        assert f"$(BIN)/{hook['entry'].split()[0].removeprefix('.venv/bin/')}" in checks, hook


def test_the_version_is_the_same_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == version
    change_log = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## \[(.+?)\]", change_log, re.MULTILINE) == ["Unreleased", version]
    assert set(re.findall(r"^### (.+)$", change_log, re.MULTILINE)) <= {"Added", "Changed", "Fixed", "Removed"}
    for path in PACKAGES:
        warnings: list[str] = []
        assert parse_package(str(path), warnings=warnings).name == path.parent.name
        assert warnings == []
        assert f"<version>{version}</version>" in path.read_text(), path
        assert version in (path.parent / "CHANGELOG.rst").read_text(), path
        assert "Quality Level 4" in (path.parent / "QUALITY_DECLARATION.md").read_text()
