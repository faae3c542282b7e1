"""What a measuring run was: poses, beliefs and measurements, gathered while it runs, and what they are worth."""

from dataclasses import dataclass, field, replace

import numpy as np
from naraha.systems.behaviors import Measurement
from naraha.systems.placement import FloorPlan
from naraha.systems.tracking import planar_pose
from pydrake.systems.framework import Context, Diagram

from .illuminate_station import MeasuringRoute
from .mission import Ending
from .wiring import DiagramReader, subsystem

_LOST_TIME = 10.0
"""[s] for which a robot may stand because it is lost."""


@dataclass(frozen=True)
class PointRecord:
    """A measuring point and what became of it.

    Attributes:
        point: of the plan, from 0. asked: where it is in W [m].
        measured: what the robot measured there, None where it never came.
        true: where the meter truly was then, in W [m].
        true_illuminance: there [lux].
    """

    point: int
    asked: tuple[float, float]
    measured: Measurement | None = None
    true: tuple[float, float] = (float("nan"), float("nan"))
    true_illuminance: float = float("nan")

    @property
    def error(self) -> float:
        """From where it was asked for to where it truly was measured [m]."""
        return float(np.hypot(self.true[0] - self.asked[0], self.true[1] - self.asked[1]))


@dataclass(frozen=True)
class RunRecord:
    """A measuring run that is over; plain data, so that it can come from another process.

    Attributes:
        ending: why it ended. failed_at: where the robot truly was when the run failed, in W [m].
        lost: whether it failed because localisation did: the believed position was off by too much, or the robot knew
            that it may be.
        points: all measuring points, in the order of the route.
        track: (t, 8) time, true x, y, heading, believed x, y, heading [s, m, rad], and health of the localisation.
        deviation: (t,) largest standard deviation of the believed position [m].
        shown: (t,) what the meter showed [lux].
    """

    ending: Ending
    points: tuple[PointRecord, ...]
    track: np.ndarray
    deviation: np.ndarray
    shown: np.ndarray
    failed_at: tuple[float, float] | None = None
    lost: bool = False

    @property
    def succeeded(self) -> bool:
        return self.ending.status == "done"

    @property
    def slam_errors(self) -> np.ndarray:
        """Distance of believed and true position over time, (t,) [m]."""
        return np.hypot(*(self.track[:, 4:6] - self.track[:, 1:3]).T)

    def light(self, period: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """What the robot knows of the light: the values at the measuring points, then what the meter showed on the way.

        Args:
            period: of the meter [s]; a reading is shown from its own time on until the next.
            spacing: least distance of a reading on the way from all others [m].

        Returns:
            Where the robot believed to be, (n, 2) [m], and values (n,) [lux].
        """
        taken = [p.measured for p in self.points if p.measured is not None]
        places, values = [np.array([m.x, m.y]) for m in taken], [m.illuminance for m in taken]
        # The state that is seen at a time is the one before what happens then.
        number = np.ceil(self.track[:, 0] / period - 1e-6).astype(int) - 1
        for row in np.flatnonzero((np.diff(number, prepend=-1) > 0) & (number >= 0)):
            x, y = (np.interp(number[row] * period, self.track[:, 0], self.track[:, k]) for k in (4, 5))
            if all(np.hypot(x - place[0], y - place[1]) >= spacing for place in places):
                places.append(np.array([x, y]))
                values.append(float(self.shown[row]))
        return np.array(places).reshape(-1, 2), np.array(values)

    def metrics(self) -> dict[str, float | int]:
        """What the run is judged by, by the truth."""
        errors = [point.error for point in self.points if point.measured is not None]
        lux = [
            abs(p.measured.illuminance - p.true_illuminance) / p.true_illuminance
            for p in self.points
            if p.measured is not None and p.true_illuminance > 0
        ]
        return {
            "path_length_m": float(np.hypot(*np.diff(self.track[:, 1:3], axis=0).T).sum()),
            "max_position_error_m": max(errors, default=float("nan")),
            "mean_position_error_m": float(np.mean(errors)) if errors else float("nan"),
            "max_slam_error_m": float(self.slam_errors.max()),
            "mean_slam_error_m": float(self.slam_errors.mean()),
            "points_asked": len(self.points),
            "points_measured": len(errors),
            "max_illuminance_error": max(lux, default=float("nan")),
        }


@dataclass
class _Gathered:
    track: list[list[float]] = field(default_factory=list)
    deviation: list[float] = field(default_factory=list)
    shown: list[float] = field(default_factory=list)


class IlluminateLog(DiagramReader):
    """Reads the running diagram at every step, and says when the run is over.

    A robot that does not know where it is stands; after `_LOST_TIME` it has failed. The truth is looked at to judge: a
    run whose believed position is off by more than `slam_limit` [m] has failed, as in the source, where the simulation
    ends then.
    """

    def __init__(self, diagram: Diagram, plan: FloorPlan, way: MeasuringRoute, *, slam_limit: float):
        super().__init__(diagram)
        self._plan, self._way, self._slam_limit = plan, way, slam_limit
        self._gathered = _Gathered()
        self._true: list[tuple[tuple[float, float], float]] = []
        self._status, self._lost_since = "", float("inf")

    def step(self, context: Context) -> Ending | None:
        """Notes the state of now, and says whether the run is over."""
        self.context, time = context, context.get_time()
        true, believed = (planar_pose(self.read(port)) for port in ("station.cheat.X_WB", "localizer.X_MB"))
        known = self.read("localizer.localization")
        self._gathered.track.append([time, *true, *believed, known.health])
        self._gathered.deviation.append(float(np.sqrt(np.linalg.eigvalsh(known.covariance[:2, :2])[-1])))
        self._gathered.shown.append(float(self.read("station.illuminance")[0]))
        tour = self.read("tour.tour")
        self._status = str(self.read("tour.status"))
        for _ in range(len(self._true), len(tour.measurements)):
            illuminance = float(self.read("station.cheat.illuminance")[0])
            self._true.append(((float(true[0]), float(true[1])), illuminance))
        self._measurements, self._given_up = tour.measurements, tour.given_up
        off = float(np.hypot(*(believed - true)[:2]))
        if off > self._slam_limit:
            place = f"({true[0]:.1f}, {true[1]:.1f})"
            return Ending("failed", f"localisation was off by {off:.2f} m at {place} after {time:.0f} s")
        self._lost_since = min(self._lost_since, time) if self._status == "lost" else float("inf")
        if time - self._lost_since > _LOST_TIME:
            return Ending("failed", f"the robot says that it has lost its place, after {time:.0f} s")
        if self._status == "done":
            if self._given_up:
                points = ", ".join(str(int(self._way.points[stop])) for stop in self._given_up)
                return Ending("failed", f"points that could not be reached: {points}")
            return Ending("done", "all points were measured")
        return None

    def true_light(self, places: np.ndarray) -> np.ndarray:
        """True illuminance at places (n, 2) in W [m] as the robot's meter would have it, (n,) [lux]."""
        meter = subsystem(self.diagram, "station", "meter")
        found: np.ndarray = meter.illuminance_at(meter.GetMyContextFromRoot(self.context), places)
        return found

    def status_line(self, context: Context) -> str:
        return f"{self._status}, {len(self._true)} of {len(self._way.stops)} points"

    def record(self, ending: Ending) -> RunRecord:
        """What the run was; an ending by time is a failure while points are left."""
        if ending.status == "done" and self._status != "done":
            missing = len(self._way.stops) - len(self._true)
            ending = Ending("failed", f"{ending.reason}, and {missing} points are not measured")
        found = {m.stop: (m, true) for m, true in zip(self._measurements, self._true, strict=True)}
        points = []
        for stop, point in enumerate(self._way.points.tolist()):
            asked = (float(self._plan.measuring_points[point, 0]), float(self._plan.measuring_points[point, 1]))
            if stop in found:
                measurement, (true, illuminance) = found[stop]
                points.append(PointRecord(point, asked, measurement, true, illuminance))
            else:
                points.append(PointRecord(point, asked))
        track = np.array(self._gathered.track)
        failed_at = None if ending.status == "done" else (float(track[-1, 1]), float(track[-1, 2]))
        gathered = (np.array(self._gathered.deviation), np.array(self._gathered.shown))
        record = RunRecord(ending, tuple(points), track, *gathered, failed_at)
        return replace(record, lost=bool(record.slam_errors[-1] > self._slam_limit) or self._status == "lost")
