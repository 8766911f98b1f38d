"""The environments under their ids in Gymnasium."""

import subprocess
import sys

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env

from bike_training.gymnasium_ids import IDS, register


@pytest.mark.parametrize("name", IDS)
def test_ids_make_environments_that_keep_the_contract(name):
    register()
    register()  # a second time changes nothing
    env = gymnasium.make(name)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_importing_the_package_registers_them():
    code = "import gymnasium, bike_training.gymnasium_ids; print(gymnasium.make('bike_training/Whipple-v0').spec.id)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert told.stdout.strip() == "bike_training/Whipple-v0"
