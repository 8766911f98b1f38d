"""A race that people watch and ride in, in this process: the last machine of the grid is theirs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import Any

from bike_policy.riders.wheel_to_wheel import RaceField
from bike_sim.course.course import Course
from bike_sim.sim.race import Race, RaceEvent, RaceSettings
from bike_sim.sim.request import ResetRequest
from bike_sim.sim.simulator import RowSnapshots
from bike_sim.sim.snapshot import Snapshot
from bike_training.nodes.live_ride import LiveRide, LiveSettings, state_values
from bike_training.nodes.race_recording import RaceRecorder


class RaceClient(AbstractContextManager["RaceClient"]):
    """A race as the simulator of one of its machines; the riders of the entries ride the others.

    Attributes:
        race: the race.
        own: row of the machine that is ridden by commands: the last one.
        vehicle: that machine.
        shown: snapshots of all machines after the last step.
        events: what happened in it.
    """

    domain_id = 0

    def __init__(self, settings: RaceSettings, recording: Path, report: Callable[[str], None]) -> None:
        """Prepare machines and riders.

        Args:
            settings: of the race.
            recording: file that is written; a restart writes it anew.
            report: gets a text for each machine whose line and plan are computed or looked up.

        Raises:
            ValueError: what is no race, or a rider that cannot race.
            FileNotFoundError: an unknown vehicle, rider or circuit.
        """
        self.race = Race(settings, report)
        batch = self.race.batch
        self.own, self.vehicle, self.preview = self.race.count - 1, batch.vehicles[-1], batch.preview
        self._path, self._recorder = recording, ExitStack()
        self._report = report
        self.shown: list[Snapshot] = []
        self.events: list[RaceEvent] = []
        try:
            riders = [*(entry.rider for entry in settings.entries[:-1]), ""]
            self._field = RaceField(riders, batch.vehicles, batch.config.control_period)
        except BaseException:
            self.race.close()
            raise

    @property
    def course(self) -> Course:
        """Line of the own machine."""
        return self.race.batch.course(self.own)

    def reset(self, request: ResetRequest | None = None) -> Snapshot:
        """Begin the race, again; the request is that of the grid."""
        race, batch = self.race, self.race.batch
        race.begin()
        for row, entry in enumerate(race.settings.entries[:-1]):
            self._report(f"plan of {entry.name}")
            self._field.begin(row, batch, batch.course(row))
        self._recorder.close()
        self._recorder = ExitStack()
        self._written = self._recorder.enter_context(RaceRecorder(self._path, race, overwrite=True))
        self._views = [RowSnapshots(batch, row) for row in range(race.count)]
        self.shown, self.events = [view.begin() for view in self._views], []
        return self.shown[self.own]

    def step(self, steering: float, throttle: float = 0.0) -> Snapshot:
        """Hold a command of the own machine for a control period."""
        race = self.race
        commands = self._field.commands(race.batch, race.step_number)
        commands[self.own] = steering, throttle
        self.events = race.step(commands)
        self._written.step(commands, self.events)
        step = race.step_number
        self.shown = [view.take(step, *commands[row].tolist()) for row, view in enumerate(self._views)]
        return self.shown[self.own]

    def finish(self) -> None:
        """Write the result as it stands."""
        self._written.finish()
        self._recorder.close()

    def __exit__(self, *_: object) -> None:
        """Finish the recording and release the engines."""
        self._recorder.close()
        self.race.close()


class LiveRace(LiveRide):
    """Rides a race until `end`.

    Attributes:
        client: of the race, once it has begun.
    """

    thread_name = "live race"
    client: RaceClient

    def __init__(
        self, race: RaceSettings, settings: LiveSettings, told: Callable[[str], None],
        report: Callable[[dict[str, Any]], None],
    ) -> None:  # fmt: skip
        """Prepare a race.

        Args:
            race: what is raced.
            settings: of the ride of the own machine.
            told: gets a text for each machine that is prepared.
            report: see `LiveRide`.
        """
        super().__init__(settings, report)
        self._race, self._told, self._place = race, told, 0

    def _live(self) -> None:
        recording = self._settings.recording
        assert recording is not None, "races are recorded"
        with RaceClient(self._race, recording, self._told) as client:
            self.client = client
            self._begin(client)
            self._begun.set()
            self._ride(client)
            client.finish()

    def _moves(self) -> bool:
        over = self.client.race.over
        return not over and (not self._paused or self._steps_asked > 0)

    def _more(self) -> dict[str, Any]:
        """Return the other machines."""
        return {"others": [state_values(snapshot, ()) for snapshot in self.client.shown[:-1]]}

    def _show(self) -> None:
        super()._show()
        for event in self.client.events:
            self._report({"event": event.text})
        place = self.client.race.positions().index(self.client.own) + 1
        if place != self._place:
            self._place = place
            self._report({"event": f"position {place} of {self.client.race.count}"})
