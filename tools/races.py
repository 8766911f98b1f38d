"""Measure races: ``tools/races.py races|draft|rate|ros``, one CSV on standard output, one line as each is done.

``races``: six mixed machines on random circuits that nothing was chosen on; does each race end, is it the same from its
commands, do any two machines pass through each other between two steps? ``draft``: top speed of a machine behind
another on Barcelona's straight. ``rate``: steps of twelve machines that meet by those of twelve that do not. ``ros``:
rate of a race of four machines through nodes in lockstep, each with a driver of its own.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bike_policy.planning.lap_plan import CLASSICAL_SETTINGS, LinePlan, plan_line
from bike_policy.riders.wheel_to_wheel import RaceField
from bike_sim.course.course import Course
from bike_sim.sim import look as lk
from bike_sim.sim import traffic as tr
from bike_sim.sim.batch import Batch
from bike_sim.sim.race import Entry, Race, RaceSettings
from bike_sim.sim.race import race_config as config_of
from bike_sim.sim.request import ResetRequest
from bike_sim.vehicles.superbike import Superbike

MACHINES = ("panigale_v4r", "zx10rr", "cbr1000rr_r", "r1", "m1000rr")
FIRST_CIRCUIT = 500
SUBSTEPS = 10
EXIT_SPEED = 45.0
"""Speed at which the throttle is opened before the straight, m/s."""
PACE = 0.97
"""Part of a plan's speed that is ridden, since plans of so many circuits are not verified."""


def plan_of(machine: Superbike, line: Course) -> LinePlan:
    """Return a plan that is a little slower than the classical rider's."""
    plan = plan_line(machine, line, CLASSICAL_SETTINGS)
    return plan_line(machine, line, CLASSICAL_SETTINGS, PACE * plan.profile.speed[:-1])


def bodies(race: Race) -> NDArray[np.void]:
    """Return the bodies of a race as they are now."""
    assert race.batch.traffic is not None
    return np.array(race.batch.traffic.bodies)


def missed(before: NDArray[np.void], after: NDArray[np.void], touched: set[tuple[int, int]]) -> int:
    """Return how many pairs come closer than a touch between two steps without one."""
    count = 0
    for i in range(len(before)):
        for j in range(i + 1, len(before)):
            a, b = (before[i], after[i]), (before[j], after[j])
            if 0 in (a[0]["kind"], b[0]["kind"], a[1]["kind"], b[1]["kind"]) or (i, j) in touched:
                continue
            if abs(a[0]["x"] - b[0]["x"]) + abs(a[0]["y"] - b[0]["y"]) > 12.0:
                continue
            gaps = [gap_at(a, b, part / SUBSTEPS) for part in range(SUBSTEPS + 1)]
            crosses = min(gaps) < 0.5 * tr.RADIUS and gaps[0] > 2.0 * tr.RADIUS
            count += crosses and gaps[-1] > 2.0 * tr.RADIUS
    return count


def gap_at(a: tuple[np.void, np.void], b: tuple[np.void, np.void], part: float) -> float:
    """Return the distance of two middle lines at a part of a step, m."""
    mixed = []
    for one in (a, b):
        record = np.array([one[0]])
        for name in ("x", "y", "cos", "sin", "shift_x", "shift_y"):
            record[name] = (1.0 - part) * one[0][name] + part * one[1][name]
        mixed.append(record[0])
    return float(tr._between(mixed[0], mixed[1])[0])


def races(count: int, first: int) -> Iterator[list[object]]:
    """Ride races; yield the head and a row of each."""
    yield ["circuit", "machines", "ended", "race_s", "finished", "falls", "passes", "contacts", "thrown",
           "contact_energy_j", "least_energy_j", "penalties", "missed", "replay"]  # fmt: skip
    for number in range(first, first + count):
        kinds = [MACHINES[number % 5], MACHINES[(number + 2) % 5]]
        entries = tuple(Entry(f"bike_{k}", kinds[k % 2], "classical") for k in range(6))
        settings = RaceSettings(f"random_circuit:{number}", 1, entries, line=0.0)
        race = Race(settings)
        field = RaceField(["classical"] * 6, race.batch.vehicles, race.batch.config.control_period, plan_of)
        for row in range(race.count):
            field.begin(row, race.batch, race.batch.course(row))
        commands, passed_through, least, thrown = [], 0, math.inf, 0
        before = bodies(race)
        while not race.over:
            commands.append(field.commands(race.batch, race.step_number))
            race.step(commands[-1])
            after, touched = bodies(race), set()
            for incident in race.batch.incidents:
                if incident[0] == tr.CONTACT:
                    machines = int(incident[2]), int(incident[3])
                    touched.add((min(machines), max(machines)))
                    least = min(least, float(incident[7]))
                    thrown += int(incident[8] + incident[9])
            passed_through += missed(before, after, touched)
            before = after
        again = Race(settings)
        for pair in commands:
            again.step(pair)
        same = again.batch.state.tobytes() == race.batch.state.tobytes() and again.log == race.log
        kinds_of = [event.kind for event in race.log]
        results = race.classification()
        yield [
            settings.course, "+".join(kinds), race.time < race.limit, round(race.time, 2),
            sum(result.end == "finished" for result in results), kinds_of.count("fall"), kinds_of.count("pass"),
            kinds_of.count("contact"), thrown, round(race.energy, 1), round(least, 3) if thrown or race.energy else "",
            sum(result.penalty_s > 0.0 for result in results), passed_through, "same" if same else "differs",
        ]  # fmt: skip
        race.close()
        again.close()


def draft(vehicle: str = "panigale_v4r") -> Iterator[list[object]]:
    """Ride full throttle along Barcelona's straight, some time after another; yield top speeds, km/h."""
    yield ["behind_at_the_exit_s", "top_speed_km_h", "gained_km_h", "behind_at_the_end_m"]
    settings = RaceSettings("barcelona", 1, (Entry("a", vehicle), Entry("b", vehicle)))
    config, alone = config_of(settings), 0.0
    for late in (math.inf, 0.3, 0.4, 0.5, 0.6, 0.8):
        batch = Batch(2, config, together=math.isfinite(late))
        track = batch.courses(0).line(batch.plant(0), "barcelona", 0.0).track
        leave = track.length - 150.0
        behind = late * EXIT_SPEED if math.isfinite(late) else 0.0
        for row, place in enumerate((leave, leave - behind)):
            request = ResetRequest(course="barcelona", line=0.0, speed_range=(EXIT_SPEED, EXIT_SPEED), progress=place)
            batch.reset(row, request)
        if math.isfinite(late):
            batch.meet()
        top, left, touched = 0.0, behind, False
        while batch.place[1, lk.CENTRE_PROGRESS] < track.length + 650.0 and not touched:
            # who is behind holds its speed up to where the other opened the throttle
            speed = float(batch.look[1, lk.SPEED])
            held = min(max(0.3 + EXIT_SPEED - speed, -1.0), 1.0)
            throttle = 1.0 if batch.place[1, lk.CENTRE_PROGRESS] >= leave else held
            batch.step(np.array([[0.0, 1.0], [0.0, throttle]]))
            touched = any(incident[0] == tr.CONTACT for incident in batch.incidents)
            if not touched:
                top = max(top, 3.6 * float(batch.look[1, lk.SPEED]))
                left = float(batch.place[0, lk.CENTRE_PROGRESS] - batch.place[1, lk.CENTRE_PROGRESS])
        alone = alone or top
        name = f"{late:g}" if math.isfinite(late) else "alone"
        yield [name, round(top, 1), round(top - alone, 1) if behind else "", round(left, 1) if behind else ""]
        batch.close()


def rate(steps: int = 500) -> Iterator[list[object]]:
    """Step twelve machines that meet, and twelve that do not; yield vehicle steps a second of processor time."""
    yield ["rows", "together_1_s", "alone_1_s", "ratio"]
    config = config_of(RaceSettings("barcelona", 1, (Entry("a", "panigale_v4r"), Entry("b", "panigale_v4r"))))
    spent = {True: 0.0, False: 0.0}
    for turn in range(7):
        for together in (True, False):
            batch = Batch(12, config, together=together)
            for row in range(12):
                request = ResetRequest(
                    course="barcelona", line=0.0, speed_range=(40.0, 40.0), progress=20.0 + 8.0 * row
                )
                batch.reset(row, request)
            if together:
                batch.meet()
            commands = np.tile([0.0, 0.2], (12, 1))
            batch.step(commands)
            began = time.process_time()
            for _ in range(steps):
                batch.step(commands)
            spent[together] += (time.process_time() - began) if turn else 0.0
            batch.close()
    done = 6 * steps * 12
    yield [12, round(done / spent[True]), round(done / spent[False]), round(spent[False] / spent[True], 3)]


def ros(steps: int = 1000) -> Iterator[list[object]]:
    """Race four machines through nodes in lockstep; yield simulated by wall-clock time, and by processor time."""
    from bike_msgs.msg import BikeState

    from bike_sim.ros import messages, node_tools
    from bike_sim.ros.isolation import DomainLease
    from bike_sim.ros.subscriptions import RawSubscription
    from bike_training.envs.node_process import NodeProcess

    yield ["machines", "control_steps", "wall_s", "processor_s", "real_time_factor", "by_processor_time"]
    names = ["a", "b", "c", "d"]
    race = {"machines": [f"{name}=panigale_v4r" for name in names], "course": "barcelona", "laps": 9}
    with ExitStack() as opened:
        domain = opened.enter_context(DomainLease()).domain_id
        nodes = [opened.enter_context(NodeProcess("bike_sim.ros.race_node", race, domain, "race"))]
        for name in names:
            drive = NodeProcess("bike_policy.drive", {"policy": "classical"}, domain, name)
            nodes.append(opened.enter_context(drive))
        guest = node_tools.GuestNode("clock", domain)
        opened.callback(guest.close)
        states = RawSubscription(guest, BikeState, f"/{names[0]}/state", node_tools.SENDER_QOS)
        opened.callback(states.close)

        def until(step: int) -> tuple[float, float]:
            while True:
                for node in nodes:
                    node.check()
                data = states.wait(0.5)
                if data is not None and messages.decode_state(data).snapshot.step >= step:
                    return time.monotonic(), sum(processor_time(node.process.pid) for node in nodes)

        (began, used), (ended, used_then) = until(100), until(100 + steps)
    simulated, wall, processor = 0.02 * steps, ended - began, used_then - used
    yield [len(names), steps, round(wall, 1), round(processor, 1), round(simulated / wall, 2),
           round(simulated / processor, 2)]  # fmt: skip


def processor_time(process: int) -> float:
    """Return the processor time of a process, s."""
    fields = Path(f"/proc/{process}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """Print the table that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", choices=("races", "draft", "rate", "ros"))
    parser.add_argument("--count", type=int, default=100, help="races")
    parser.add_argument("--first", type=int, default=FIRST_CIRCUIT, help="seed of the first circuit")
    args = parser.parse_args()
    tables = {"races": lambda: races(args.count, args.first), "draft": draft, "rate": rate, "ros": ros}
    for row in tables[args.table]():
        print(*row, sep=",", flush=True)
        print(*row, sep="  ", file=sys.stderr)


if __name__ == "__main__":
    main()
