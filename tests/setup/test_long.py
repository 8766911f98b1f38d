"""What takes minutes or downloads: the wheel in an empty environment, and kernels that no ride compiles again."""

from __future__ import annotations

import os
import subprocess
import sys
import urllib.error
import urllib.request
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PATIENCE = 900.0
"""Longest wait for a program, s."""

pytestmark = [pytest.mark.long, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def index() -> None:
    """Skips where the package index cannot be reached."""
    try:
        urllib.request.urlopen(
            urllib.request.Request("https://pypi.org/simple/pip/", method="HEAD"), timeout=20
        ).close()
    except (urllib.error.URLError, OSError) as error:
        pytest.skip(f"PyPI cannot be reached: {error}")


@pytest.mark.usefixtures("index")
def test_the_wheel_reads_and_simulates_in_an_empty_environment(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", tmp_path, ROOT]
    subprocess.run(command, check=True, timeout=PATIENCE)
    (wheel,) = tmp_path.glob("*.whl")
    venv.create(tmp_path / "empty", with_pip=True)
    python = tmp_path / "empty" / "bin" / "python"
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "LD_"))}
    for variable in ("AMENT_PREFIX_PATH", "NUMBA_CACHE_DIR"):
        environment.pop(variable, None)
    pins = ROOT / "requirements" / "constraints.txt"
    install = [
        python,
        *["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-c"],
        pins,
        f"{wheel}[analysis]",
    ]
    subprocess.run(install, check=True, timeout=PATIENCE, env=environment, cwd=tmp_path)
    program = """
from bike_analysis import open_ride, RecordingError
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import Simulator, SimulatorConfig
from pathlib import Path
try:
    open_ride(__file__)
except RecordingError as error:
    print(type(error).__name__)
simulator = Simulator(SimulatorConfig(engine="whipple"))
simulator.reset(ResetRequest())
print(simulator.step(0.0).step)
"""
    (tmp_path / "use.py").write_text(program)
    used = subprocess.run(
        [python, tmp_path / "use.py"], timeout=PATIENCE, env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert used.stdout.split() == ["RecordingError", "1"], used.stderr
    analyze = subprocess.run(
        [tmp_path / "empty" / "bin" / "bike", "analyze", "--help"], timeout=PATIENCE, env=environment, cwd=tmp_path
    )
    assert analyze.returncode == 0


def test_rides_compile_nothing_that_the_set_up_did_not(tmp_path: Path) -> None:
    kernels = tmp_path / "kernels"
    environment = os.environ | {"NUMBA_CACHE_DIR": str(kernels), "BIKE_CACHE": str(tmp_path / "lines")}

    def run(*command: str | Path) -> None:
        subprocess.run(command, check=True, timeout=PATIENCE, env=environment, cwd=tmp_path, capture_output=True)

    def compiled() -> set[Path]:
        return {path.relative_to(kernels) for path in kernels.rglob("*.nbc")}

    run(sys.executable, ROOT / "tools" / "compile_kernels.py")
    ahead = compiled()
    assert len(ahead) > 50
    bike = Path(sys.executable).with_name("bike")
    run(bike, "ride")
    run(bike, "ride", "--engine", "whipple", "--course", "junction")
    run(bike, "ride", "--course", "barcelona", "--nodes", "--laps", "1")
    assert compiled() == ahead
