"""Races whose machines are driven by nodes of their own: the same as in process, and going on without one that died."""

from __future__ import annotations

import signal
from pathlib import Path
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
from bike_training.nodes.race_recording import RecordedRace

pytestmark = pytest.mark.ros

MACHINES = {"one": "panigale_v4r", "two": "panigale_v4r"}
ENTRIES = [f"{name}={vehicle}" for name, vehicle in MACHINES.items()]
STEPS = 150
PLANNED = 200.0
"""Longest wait for plans of all grips, s."""


@pytest.mark.slow
def test_race_of_nodes_is_that_of_the_process_and_outlives_one_of_them(ros: Any, oval: str, tmp_path: Path) -> None:
    """Lockstep: states and what is seen of others are the same bit for bit, of a gamepad that nobody touches and of a
    rider; one recording of all of it replays; a machine whose driver is killed rolls out, and is driven by who is
    started again.
    """
    race = Race(RaceSettings(oval, 2, entries_of(ENTRIES), 0.0))
    field = RaceField(["", "classical"], race.batch.vehicles, race.batch.config.control_period)
    for row in range(race.count):  # the plan that is verified here is found by the driver
        field.begin(row, race.batch, race.batch.course(row))
    states, seen_here = [], []
    for step in range(STEPS):
        states.append(race.batch.state.tolist())
        seen_here.append(race.batch.opponents[1].copy())
        race.step(field.commands(race.batch, step))
    race.close()
    race_of = {"machines": ENTRIES, "course": oval, "line": 0.0, "command_timeout_s": 4.0}
    node = ros.start("bike_sim.ros.race_node", namespace="race", **race_of)
    witness = ros.sender()
    heard = {name: witness.listen(BikeState, f"/{name}/state", node_tools.SENDER_QOS) for name in MACHINES}
    seen = witness.listen(Opponents, "/two/opponents", node_tools.SENDER_QOS)
    written = ros.start("bike_sim.ros.record", all_topics=True, path=str(tmp_path / "race.mcap"))
    witness.until(lambda: "recording to" in written.words)
    hands = ros.start("bike_policy.joy", namespace="one")
    rider = ros.start("bike_policy.drive", namespace="two", policy="classical")
    witness.until(lambda: heard["two"] and heard["two"][-1].step >= STEPS, PLANNED)
    through_ros = {name: {s.step: [getattr(s, each) for each in STATE.names] for s in heard[name]} for name in MACHINES}
    others = {step: shown for _, step, shown in map(decode_opponents, map(serialize_message, seen))}
    for step in range(STEPS):
        for row, name in enumerate(MACHINES):
            assert through_ros[name][step] == states[step][row], (name, step)
        np.testing.assert_array_equal(others[step], seen_here[step])
    assert others[0][0, 0] == 1.0
    assert any(state.throttle_command != 0.0 for state in heard["two"])
    written.end(signal.SIGINT)
    recorded = RecordedRace.read(tmp_path / "race.mcap")
    assert [entry.name for entry in recorded.settings.entries] == list(MACHINES)
    assert len(recorded.states) > STEPS
    assert recorded.replay() == (len(recorded.states), "")
    rider.end(signal.SIGKILL)
    witness.until(lambda: "commands of two have stopped: it rolls out" in node.words)
    stopped = heard["one"][-1].step
    witness.until(lambda: min(heard[name][-1].step for name in MACHINES) > stopped + 50)
    assert (heard["two"][-1].steering_command, heard["two"][-1].throttle_command) == (0.0, 0.0)
    hands.end(signal.SIGKILL)
    witness.until(lambda: "commands of one have stopped: it rolls out" in node.words)
    ros.start("bike_policy.joy", namespace="one")
    witness.until(lambda: "one is driven again" in node.words)


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
    ros.start("bike_sim.ros.race_node", namespace="race", machines=ENTRIES, course=oval, line=0.0)
    driver = ros.start("bike_policy.drive", namespace="one", policy="racer")
    assert driver.wait() == 2
    assert "policy 'racer' cannot see others, as a race asks for; solo:racer rides it" in driver.words
