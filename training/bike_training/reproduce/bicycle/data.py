"""Tables of the bicycle paper's experiments."""

from __future__ import annotations

from dataclasses import dataclass

from bike_training.reproduce.data import Tables, table


@dataclass(frozen=True)
class Rides:
    """A ride of a controller.

    Attributes:
        setting, seed: of its run. course: ``benchmark`` or ``random``. speed: m/s. completed: it came to its end.
        mean: mean distance of the rear contact, m. largest: m.
    """

    setting: str
    seed: int
    course: str
    speed: float
    completed: bool
    mean: float
    largest: float


@dataclass(frozen=True)
class Track:
    """An instant of a ride on the junction.

    Attributes:
        rider: controller or classical rider. time: s. x, y: rear contact, m. front_x, front_y: front contact, m.
        rear_error, front_error: their lateral errors, m. completed: whether the ride came to its end.
    """

    rider: str
    time: float
    x: float
    y: float
    front_x: float
    front_y: float
    rear_error: float
    front_error: float
    completed: bool


@dataclass(frozen=True)
class Instant:
    """An instant of the ride of Figs. 12 and 13.

    Attributes:
        progress: along the path, m. x, y: rear contact, m. front_x, front_y: front contact, m. roll: rad. steer: rad.
        curvature: of the path at the rear contact, 1/m.
    """

    progress: float
    x: float
    y: float
    front_x: float
    front_y: float
    roll: float
    steer: float
    curvature: float


@dataclass(frozen=True)
class Impact:
    """What a feature of an observation does to the set point of the steering angle (Fig. 14).

    Attributes:
        policy: setting, or name of a shipped actor. observation: number. feature: name in the layout.
        value: of the feature, in its unit. shap: share in the set point, rad.
    """

    policy: str
    observation: int
    feature: str
    value: float
    shap: float


@dataclass(frozen=True)
class Direction:
    """A row of Table 8, in degrees.

    Attributes:
        roll, steer: posture. published: direction of the front contact. formula: by Eq. (A.10).
        whipple, pybullet: measured by rolling in an engine.
    """

    roll: float
    steer: float
    published: float
    formula: float
    whipple: float
    pybullet: float


@dataclass(frozen=True)
class SteeringStep:
    """An instant of the step response of Fig. 16.

    Attributes:
        time: s. whipple, pybullet: steering angle in an engine, deg.
    """

    time: float
    whipple: float
    pybullet: float


@dataclass(frozen=True)
class Chance:
    """How often learning meets a full circle (Sect. 6).

    Attributes:
        paths: drawn from part 4. length: least length of each, m. circles: paths with five bends in a row to one side.
    """

    paths: int
    length: float
    circles: int


@dataclass(frozen=True)
class Data(Tables):
    """All tables; the error of a validation is the mean of its errors e_i (Eq. 12)."""

    rides: tuple[Rides, ...] = table("rides.csv", Rides)
    tracks: tuple[Track, ...] = table("junction.csv", Track)
    ride: tuple[Instant, ...] = table("ride.csv", Instant)
    impacts: tuple[Impact, ...] = table("impacts.csv", Impact)
    directions: tuple[Direction, ...] = table("table8.csv", Direction)
    steering: tuple[SteeringStep, ...] = table("steering_step.csv", SteeringStep)
    chances: tuple[Chance, ...] = table("full_circles.csv", Chance)
