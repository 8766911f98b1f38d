"""Settings of a refinement; `bike_training.learning.refinement` says what it is."""

from __future__ import annotations

from dataclasses import dataclass

from bike_training.learning.setting_records import check_number, check_positive
from bike_training.tasks.path import TASKS, PathTask


@dataclass(frozen=True, kw_only=True)
class RefinementSettings:
    """Settings of a refinement.

    Attributes:
        task: name in :data:`bike_training.tasks.path.TASKS`; its observation.
        max_steer: set point of the steering angle that the actor's largest answer asks for, rad.
        layers: hidden layers of the network, which is ridden as the odd part of itself, twice as wide.
        bicycles: that ride side by side.
        periods: control periods of a segment. tail: of them those in which the actor is held.
        updates: of the actor with each segment.
        segments: in all.
        learning_rate: at the beginning. final_learning_rate: reached in the end along a half cosine.
        averaging: share of the averaged actor kept in an update; the average is what is compared and deployed.
        knee: d of the cost, m. square: a, 1/m^2. steer_rate: b, s^2/rad^2. change: c.
        lean: weight of the squared roll beyond 38 deg, 1/rad^2: a ride fails at 45.
        steer: weight of the squared steering angle beyond 40 deg, 1/rad^2: a little further the fork of a leaning
            bicycle turns over, whatever the drive does.
        risky: weight that rides get besides that of every ride which lean beyond 38 deg or fail. A fall ends what its
            ride costs, so without it falls count no more than a swing on a straight.
        push: rates that pushes leave in the rides, rad/s.
        delay: largest by which commands act late in a half of the rides, control periods.
        noise: largest of the sensors in a half of the rides, in parts of the disturbances ``noise``.
        impulse: largest sideways push on a half of the rides, N s. Where it is not 0, a quarter of the rides are SLOW
            and actors are compared under pushes as well.
        steep: share of the bicycles that begin each segment on STEEP. Where it is not 0, actors are compared on such
            starts as well.
        select_every: segments between two comparisons of actors.
        seed: of everything.
    """

    task: str = "fine"
    max_steer: float = PathTask.max_steer
    layers: tuple[int, ...] = (64, 64)
    bicycles: int = 64
    periods: int = 120
    tail: int = 40
    updates: int = 20
    segments: int = 300
    learning_rate: float = 2e-3
    final_learning_rate: float = 1e-5
    averaging: float = 0.998
    knee: float = 0.005
    square: float = 1.0
    steer_rate: float = 0.002
    change: float = 1.0
    lean: float = 20.0
    steer: float = 0.0
    risky: float = 0.0
    push: float = 0.1
    delay: int = 0
    noise: float = 0.0
    impulse: float = 0.0
    steep: float = 0.0
    select_every: int = 25
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse values that mean nothing.

        Raises:
            ValueError: naming the setting and its value.
        """
        if self.task not in TASKS:
            raise ValueError(f"setting task={self.task!r} is not one of {', '.join(TASKS)}")
        if not self.layers or min(self.layers) < 1:
            raise ValueError(f"setting layers={self.layers!r} must be sizes of at least 1")
        for name in ("bicycles", "periods", "updates", "segments", "select_every"):
            check_number(name, getattr(self, name), 1)
        check_number("tail", self.tail, 0, self.periods - 1)
        check_number("steep", self.steep, 0.0, 1.0)
        check_number("averaging", self.averaging, 0.0, 0.9999)
        for name in ("max_steer", "learning_rate", "final_learning_rate", "knee"):
            check_positive(name, getattr(self, name))
        weights = ("square", "steer_rate", "change", "lean", "steer", "risky")
        for name in (*weights, "push", "delay", "noise", "impulse", "seed"):
            check_number(name, getattr(self, name), 0.0)
