"""Races whose machines are driven by nodes of their own: the same as in process, and going on without one that died."""

from __future__ import annotations

import signal
from typing import Any

import numpy as np
import pytest
from bike_msgs.msg import BikeState, Opponents
from rclpy.serialization import serialize_message

from bike_policy.riders.wheel_to_wheel import RaceField
from bike_sim.ros import node_tools
from bike_sim.ros.messages import decode_opponents
from bike_sim.schema import STATE
from bike_sim.sim.race import Race, RaceSettings, entries_of
from tests.circuits import OVAL

pytestmark = pytest.mark.ros

MACHINES = ("one=panigale_v4r", "two=panigale_v4r")
RIDERS = {"one": "solo:classical", "two": "classical"}
STEPS = 150
PLANNED = 600.0
"""Longest wait for two plans that are ridden first, s."""


@pytest.fixture(scope="module")
def oval(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("race") / "oval.yaml"
    path.write_text(OVAL, encoding="utf-8")
    return str(path)


@pytest.mark.slow
def test_race_of_nodes_is_that_of_the_process_and_outlives_one_of_them(ros: Any, oval: str) -> None:
    """Lockstep: states and what is seen of others are the same bit for bit; a killed driver's machine rolls out."""
    race_of = {"machines": list(MACHINES), "course": oval, "line": 0.0, "command_timeout_s": 4.0}
    node = ros.start("bike_sim.ros.race_node", namespace="race", **race_of)
    witness = ros.sender()
    heard = {name: witness.listen(BikeState, f"/{name}/state", node_tools.SENDER_QOS) for name in RIDERS}
    seen = witness.listen(Opponents, "/two/opponents", node_tools.SENDER_QOS)
    drivers = {name: ros.start("bike_policy.drive", namespace=name, policy=policy) for name, policy in RIDERS.items()}
    witness.until(lambda: heard["two"] and heard["two"][-1].step >= STEPS, PLANNED)
    race = Race(RaceSettings(oval, 2, entries_of(MACHINES), 0.0))
    field = RaceField(list(RIDERS.values()), race.batch.vehicles, race.batch.config.control_period)
    for row in range(race.count):
        field.begin(row, race.batch, race.batch.course(row))
    through_ros = {name: {s.step: [getattr(s, each) for each in STATE.names] for s in heard[name]} for name in RIDERS}
    others = {step: shown for _, step, shown in map(decode_opponents, map(serialize_message, seen))}
    for step in range(STEPS):
        for row, name in enumerate(RIDERS):
            assert through_ros[name][step] == race.batch.state[row].tolist(), (name, step)
        np.testing.assert_array_equal(others[step], race.batch.opponents[1])
        race.step(field.commands(race.batch, step))
    assert others[STEPS - 1][0, 0] == 1.0
    race.close()
    drivers["one"].end(signal.SIGKILL)
    killed_at = heard["two"][-1].step
    witness.until(lambda: "commands of one have stopped: it rolls out" in node.words)
    witness.until(lambda: heard["two"][-1].step > killed_at + 50)
    assert heard["one"][-1].throttle_command == 0.0
    assert heard["two"][-1].throttle_command != 0.0
    ros.start("bike_policy.drive", namespace="one", policy=RIDERS["one"])
    witness.until(lambda: "one is driven again" in node.words or heard["one"][-1].fallen)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "parameter machines names the machines of the race"),
        ({"machines": ["a=r1", "a=r1"]}, "two machines of a race are called 'a'; each needs a name of its own"),
        ({"machines": ["a b=r1", "r1"]}, "machine 'a b' needs a name of letters, digits and underscores"),
        ({"machines": ["r1", "r1"], "real_time_factor": 0.0}, "parameter real_time_factor must be positive"),
    ],
)
def test_what_is_no_race_ends_the_node_with_one_line(run_here: Any, changes: dict[str, Any], words: str) -> None:
    """Exit code 2, and a line that names the value."""
    code, said = run_here("bike_sim.ros.race_node", **changes)
    assert code == 2
    assert words in said
    assert len(said.strip().splitlines()) == 1


def test_policy_that_cannot_see_others_is_refused(ros: Any, oval: str) -> None:
    """The driver ends with a line that says how to ride it all the same; the race waits."""
    ros.start("bike_sim.ros.race_node", namespace="race", machines=list(MACHINES), course=oval, line=0.0)
    driver = ros.start("bike_policy.drive", namespace="one", policy="racer")
    assert driver.wait() == 2
    assert "policy 'racer' cannot see others, as a race asks for; solo:racer rides it" in driver.words
