"""The Gymnasium environment of races."""

from __future__ import annotations

from dataclasses import replace

from bike_sim.sim.batch import SUPERBIKE_ENGINE
from bike_sim.sim.superbike_plant import superbike_config
from bike_training.curricula.race import CircuitSet, RaceCurriculum
from bike_training.envs.clients import Client, make_client
from bike_training.envs.env import BikeEnv
from bike_training.tasks.race import RaceTask


class RaceEnv(BikeEnv):
    """One superbike that races on circuits: a `BikeEnv` with the task, the starts and the engine of races."""

    def __init__(
        self,
        client: Client | str = "local",
        task: RaceTask | None = None,
        vehicle: str = "panigale_v4r",
        circuits: tuple[str, ...] = ("barcelona",),
    ) -> None:
        """Make the environment.

        Args:
            client: a client, or ``local`` or ``ros`` to make one.
            task: settings of the task.
            vehicle: name or file of the machine, where a client is made.
            circuits: where episodes begin.

        Raises:
            ValueError: a vehicle that is no superbike. FileNotFoundError: an unknown vehicle or circuit.
        """
        if isinstance(client, str):
            client = make_client(client, replace(superbike_config(vehicle), engine=SUPERBIKE_ENGINE))
        episodes = RaceCurriculum(CircuitSet(client.vehicle, circuits)).episodes(0)
        super().__init__(client, task or RaceTask(), episodes)
