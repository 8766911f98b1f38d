"""Measure races: ``tools/races.py races|back|draft|rate|ros``, one CSV on standard output, one line as each is done.

``races``: six mixed machines on random circuits that nothing was chosen on; does each race end, is it the same from its
commands, do any two machines pass through each other between two steps? ``back``: riders that begin behind five
classical ones on the same machine; what do they gain? ``draft``: top speed of a machine behind
another on Barcelona's straight. ``rate``: steps of twelve machines that meet by those of twelve that do not. ``ros``:
rate of a race of four machines through nodes in lockstep, each with a driver of its own.
"""

from __future__ import annotations

import argparse
import itertools
import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bike_policy.riders.wheel_to_wheel import RaceField, unverified_plan
from bike_sim.sim import look as lk
from bike_sim.sim import traffic as tr
from bike_sim.sim.batch import Batch
from bike_sim.sim.race import Entry, Race, RaceSettings
from bike_sim.sim.race import race_config as config_of
from bike_sim.sim.request import ResetRequest

MACHINES = ("panigale_v4r", "zx10rr", "cbr1000rr_r", "r1", "m1000rr")
FIRST_CIRCUIT = 500
SUBSTEPS = 10
EXIT_SPEED = 45.0
"""Speed at which the throttle is opened before the straight, m/s."""


@njit(cache=True)
def missed(before: Any, after: Any, touched: NDArray[np.bool_], between: Any) -> int:
    """Return how many pairs of bodies pass through each other between two steps without a touch.

    Args:
        before: bodies after the step before, shape (n,).
        after: bodies now.
        touched: which pairs touch, shape (n, n).
        between: scratch of two bodies.
    """
    count = 0
    for i in range(len(before)):
        for j in range(i + 1, len(before)):
            present = before[i].kind * before[j].kind * after[i].kind * after[j].kind
            near = abs(before[i].x - before[j].x) + abs(before[i].y - before[j].y) < 12.0
            if present == 0 or touched[i, j] or not near:
                continue
            first = last = least = math.inf
            for part in range(SUBSTEPS + 1):
                _mix(before[i], after[i], part / SUBSTEPS, between[0])
                _mix(before[j], after[j], part / SUBSTEPS, between[1])
                last = tr._between(between[0], between[1])[0]
                first, least = (last if part == 0 else first), min(least, last)
            count += least < 0.5 * tr.RADIUS and min(first, last) > 2.0 * tr.RADIUS
    return count


@njit(cache=True)
def _mix(before: Any, after: Any, part: float, mixed: Any) -> None:
    """Place a body at a part of a step."""
    mixed.length = after.length
    mixed.x, mixed.y = before.x + part * (after.x - before.x), before.y + part * (after.y - before.y)
    mixed.cos = before.cos + part * (after.cos - before.cos)
    mixed.sin = before.sin + part * (after.sin - before.sin)
    mixed.shift_x = before.shift_x + part * (after.shift_x - before.shift_x)
    mixed.shift_y = before.shift_y + part * (after.shift_y - before.shift_y)


RACE: Final = (
    "circuit", "machines", "ended", "race_s", "finished", "thrown", "other_falls", "passes", "contacts", "avoidable",
    "lost_j", "least_lost_j", "passed_through", "replay",
)  # fmt: skip
"""Columns of a race: machines that a contact threw down and that fell otherwise, kinetic energy of all contacts and of
the one that took least, pairs that passed through each other, and whether its commands give the same race again."""


def races(count: int, first: int, rider: str = "classical") -> Iterator[list[object]]:
    """Ride races; yield the head and a row of each.

    Args:
        count: of races.
        first: seed of the first circuit.
        rider: of all machines.
    """
    yield list(RACE)
    for number in range(first, first + count):
        kinds = [MACHINES[number % 5], MACHINES[(number + 2) % 5]]
        entries = tuple(Entry(f"bike_{k}", kinds[k % 2], rider) for k in range(6))
        race = Race(RaceSettings(f"random_circuit:{number}", 1, entries))
        batch, traffic = race.batch, race.batch.traffic
        assert traffic is not None
        order = np.random.default_rng(number).permutation(race.count).tolist()
        race.begin(order)
        passed_through, least = 0, math.inf
        before, between = traffic.bodies.copy(), np.zeros(2, dtype=tr.BODY)
        commands = []
        for pair, _ in RaceField.of(race, unverified_plan).ride(race):
            commands.append(pair)
            touched = np.zeros((race.count, race.count), dtype=np.bool_)
            for incident in batch.incidents[batch.incidents[:, 0] == tr.CONTACT]:
                touched[min(incident[2:4].astype(int)), max(incident[2:4].astype(int))] = True
                least = min(least, float(incident[7]))
            passed_through += missed(before, traffic.bodies, touched, between)
            before[:] = traffic.bodies
        log, energy, states = race.log, race.energy, batch.state.tobytes()
        ended, seconds, results = race.time < race.limit, race.time, race.classification()
        race.begin(order)
        for pair in commands:
            race.step(pair)
        same = batch.state.tobytes() == states and race.log == log
        kinds_of, ends = [event.kind for event in log], [result.end for result in results]
        falls = sum(end not in ("finished", "running") for end in ends)
        yield [
            race.settings.course, "+".join(kinds), ended, round(seconds, 2), ends.count("finished"),
            ends.count("contact"), falls - ends.count("contact"), kinds_of.count("pass"), kinds_of.count("contact"),
            sum(result.avoidable for result in results), round(energy, 1),
            round(least, 3) if math.isfinite(least) else "", passed_through, "same" if same else "differs",
        ]  # fmt: skip
        race.close()


def back(count: int, first: int, rider: str) -> Iterator[list[object]]:
    """Ride races of six equal machines, five of them by classical riders; yield what the last on the grid gained.

    Args:
        count: of races.
        first: seed of the first circuit.
        rider: of the last on the grid, or several with commas between them.
    """
    yield ["circuit", "machine", "rider", "gained", "contacts", "avoidable", "end", "others_out", "race_s"]
    for number, last in itertools.product(range(first, first + count), rider.split(",")):
        machine = MACHINES[number % 5]
        entries = [Entry(f"bike_{k}", machine, "classical" if k < 5 else last) for k in range(6)]
        race = Race(RaceSettings(f"random_circuit:{number}", 1, tuple(entries)))
        for _ in RaceField.of(race, unverified_plan).ride(race):
            pass
        results = race.classification()
        found = next(result for result in results if result.name == "bike_5")
        out = sum(result.end not in ("finished", "running") for result in results if result is not found)
        yield [
            race.settings.course, machine, last, found.grid - found.position, found.contacts, found.avoidable,
            found.end, out, round(race.time, 2),
        ]  # fmt: skip
        race.close()


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
    parser.add_argument("table", choices=("races", "back", "draft", "rate", "ros"))
    parser.add_argument("--count", type=int, default=100, help="races")
    parser.add_argument("--first", type=int, default=FIRST_CIRCUIT, help="seed of the first circuit")
    parser.add_argument("--rider", default="classical", help="of all machines of races; of the last on the grid")
    args = parser.parse_args()
    which = args.count, args.first, args.rider
    tables = {"races": lambda: races(*which), "back": lambda: back(*which), "draft": draft, "rate": rate, "ros": ros}
    for row in tables[args.table]():
        print(*row, sep=",", flush=True)
        print(*row, sep="  ", file=sys.stderr)


if __name__ == "__main__":
    main()
