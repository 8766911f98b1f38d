"""Records a ride of training as the recorder node would: the same topics, messages and conventions."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from rclpy.serialization import serialize_message

from bike_analysis.columns import MessageSchema
from bike_policy.action import ActionScale
from bike_policy.actor import Actor
from bike_sim import messages
from bike_sim.command_gate import Command
from bike_sim.events import EventWatch
from bike_sim.physics.state import ROLL
from bike_sim.recording import LATCHED, Qos, RideRecorder, message_type
from bike_sim.reset import ResetRequest
from bike_sim.simulator import Simulator, Snapshot
from bike_training.curriculum import VALIDATION_DURATION
from bike_training.task import Task, failed

TOPICS: Final = {
    "/bike/state": "bike_msgs/msg/BikeState",
    "/bike/command": "bike_msgs/msg/BikeCommand",
    "/bike/course": "bike_msgs/msg/Course",
    "/bike/events": "bike_msgs/msg/RideEvent",
}


def record_ride(path: Path, actor: Actor, task: Task, simulator: Simulator, request: ResetRequest) -> None:
    """Ride a validation ride once more and record it.

    Args:
        path: recording, ``.mcap``.
        actor: policy.
        task: what it sees and answers.
        simulator: where it rides.
        request: how the ride begins.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    period = simulator.config.control_period
    scale = ActionScale(task.max_steer)
    with RideRecorder(path, overwrite=True, notes={"layout": task.layout.name}) as recorder:
        schemas: dict[str, MessageSchema] = {}
        for topic, name in TOPICS.items():
            kind = message_type(name)
            recorder.add_topic(topic, kind, LATCHED if topic == "/bike/course" else Qos())
            schemas[topic] = MessageSchema(kind.name, kind.definition)
        snapshot = simulator.reset(request)
        assert simulator.course is not None
        episode = messages.Episode(simulator.vehicle, simulator.course, request.preview, period)
        watch = EventWatch(simulator.course, snapshot)

        def stamp(seen: Snapshot) -> int:
            return round((seen.step + 1) * period * messages.NANOSECONDS)

        def write(name: str, message: Any) -> None:
            # rclpy leaves excess bytes behind messages with empty arrays, which strict readers refuse.
            topic = f"/bike/{name}"
            recorder.write(topic, schemas[topic].trim(serialize_message(message)), stamp(snapshot))

        write("course", messages.course_to_message(simulator.course, snapshot.episode, stamp(snapshot)))
        write("events", messages.event_to_message(watch.begun(), snapshot, stamp(snapshot)))
        write("state", messages.state_to_message(snapshot, episode, stamp(snapshot)))
        for _ in range(round(VALIDATION_DURATION / period)):
            action = actor.act(task.layout.observe(snapshot.state, snapshot.preview_y))
            steering = scale.to_command(action, simulator.vehicle.max_steer)
            command = Command(snapshot.episode, snapshot.step, steering)
            write("command", messages.command_to_message(command, messages.time_to_message(stamp(snapshot))))
            snapshot = simulator.step(steering)
            write("state", messages.state_to_message(snapshot, episode, stamp(snapshot)))
            for event in watch.look(snapshot):
                write("events", messages.event_to_message(event, snapshot, stamp(snapshot)))
            if failed(snapshot.distance, snapshot.state[ROLL]):
                break
