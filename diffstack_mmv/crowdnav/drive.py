"""The settings of a drive by their names, and what is built and driven of them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import index
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, SupportsIndex

from torch import Tensor

from diffstack_mmv.checks import require, require_one_of, require_positive, require_whole
from diffstack_mmv.crowdnav.parts import HANDED, built_part, left_open, require_part
from diffstack_mmv.dynamics.catalogue import load_dynamics
from diffstack_mmv.simulation import (
    Campaign,
    Controller,
    Method,
    Scenario,
    SimulatedVehicle,
    World,
    actuation,
    controller_model,
    study_world,
    summarise,
    vehicle_robot,
    world_for,
)
from diffstack_mmv.vehicles import VehicleSpec, load_vehicle
from diffstack_mmv.vehicles.reading import config_from_spec
from dmmv_conventions.config_files import chosen_in, names_in, settings_of
from dmmv_conventions.configs import config_folder
from dmmv_conventions.versions import code_version

LIMITS: Mapping[str, float] = MappingProxyType(
    {"speed_max_mps": 3.0, "acceleration_min_mps2": -3.0, "acceleration_max_mps2": 2.0}
)
"""Of the vehicle among people; the tighter of these and its own hold."""

_BY_DEFAULT: Mapping[str, str] = MappingProxyType({"people": "orca", "cost": "closed_loop"})
"""Parts that may be None, and what they are where the file of the controller says nothing."""


@dataclass(frozen=True)
class CrowdNav:
    """A vehicle, a crowd and a controller.

    Each name is that of a file in the configuration group of the same name. Those that read files
    of their own (recordings, a checkpoint, a policy) are for the command line.

    Attributes:
        vehicle: The vehicle, its name, or the path of its YAML file.
        dynamics: Its dynamics, which the controller believes in too.
        scenario: Where pedestrians and robot start and want to go.
        crowd: How the pedestrians walk.
        controller: What drives.
        people: How the controller forecasts the pedestrians; as its file says, or by ORCA, if None.
        cost: What it minimises; as its file says, or that of the closed loop, if None.
        footprint: Outline of the robot.
        sensing: What the robot sees of the pedestrians.
        delay_s: How long a command takes to act; `controller="diffmpc_delay"` knows it.
        noise: Standard deviation of the error of each control of the robot; empty: none.
        limit_s: Time limit of an episode.
        dt_s: Time between two decisions.
        limits: Largest speed (m/s) and accelerations (m/s²).
        seed: Of the noise, and of what crowd and controller draw.

    Raises:
        ValueError: There is no such vehicle or file, a file is for the command line alone, or the
            limits or the times do not fit.
    """

    vehicle: str | Path | VehicleSpec = "bicycle"
    dynamics: str = "kbm"
    scenario: str = "circle_crossing"
    crowd: str = "orca"
    controller: str = "diffmpc"
    people: str | None = None
    cost: str | None = None
    footprint: str = "disc"
    sensing: str = "everything"
    delay_s: float = 0.0
    noise: Sequence[float] = ()
    limit_s: float = 10.0
    dt_s: float = 0.25
    limits: Mapping[str, float] = field(default_factory=lambda: dict(LIMITS), hash=False)
    seed: int = 0

    def __post_init__(self) -> None:
        """Check names, vehicle, seed and delay at the border, before a drive has begun."""
        require_one_of("dynamics", self.dynamics, names_in(config_folder() / "dynamics"))
        for group in HANDED:
            name = getattr(self, group)
            if name is not None or group not in _BY_DEFAULT:
                require_part(group, str(name))
        self.simulated().spec()
        require_whole("seed", self.seed)
        if "known_delay_s" in left_open("controller", self.controller):
            remedy = "It expects the robot's; `diffmpc` expects none."
            require_positive("delay_s", self.delay_s, f"for '{self.controller}'", remedy)

    def simulated(self) -> SimulatedVehicle:
        """The vehicle as simulator and controller know it."""
        known = self.vehicle
        spec = known if isinstance(known, VehicleSpec) else load_vehicle(known)
        content = config_from_spec(spec)
        return SimulatedVehicle(
            content, load_dynamics(self.dynamics), self.limits, name=self.dynamics
        )

    def cases(self) -> Scenario:
        """Where the cases come from."""
        return built_part("scenario", self.scenario, {})

    def world(self) -> World:
        """The world in which the controller drives."""
        outline = built_part("footprint", self.footprint, {"actual": self.simulated()})
        robot = vehicle_robot(
            self.simulated(),
            delay_s=self.delay_s,
            noise=self.noise,
            seed=self.seed,
            footprint=outline,
        )
        given = {"seed": self.seed}
        crowd = built_part("crowd", self.crowd, given)
        sensing = built_part("sensing", self.sensing, given)
        world = study_world(robot, crowd, "exact", self.limit_s, self.dt_s, sensing=sensing)
        return world_for(world, type(self.driver()))

    def driver(self) -> Controller:
        """A fresh controller."""
        vehicle = self.simulated()
        content, limits = vehicle.vehicle, vehicle.spec().limits
        wheelbase, steer = content["wheelbase"]["initial"], content["limits"]["steer_max_rad"]
        files = self._files()
        given = {
            "dt_s": self.dt_s,
            "seed": self.seed,
            "compile": True,
            "cruise_mps": limits.speed_max_mps,
            "model": controller_model(vehicle, vehicle, self.dt_s),
            "actuate": actuation(vehicle, vehicle),
            "people": built_part("people", files["people"], {"dt_s": self.dt_s, "seed": self.seed}),
            "constraints": built_part("constraints", files["constraints"], {}),
            "cost": built_part(
                "cost", files["cost"], {"turning_radius_m": wheelbase / math.tan(steer)}
            ),
            "actual": vehicle,
            "believed": vehicle,
            "vehicle": content,
            "known_delay_s": self.delay_s,
        }
        return built_part("controller", self.controller, given)

    def drive(
        self,
        cases: Iterable[SupportsIndex] = range(100),
        phase: str = "test",
        folder: Path | None = None,
    ) -> dict[str, Any]:
        """Drive cases, all of them as one batch, and judge them.

        Args:
            cases: Their numbers.
            phase: "train", "val" or "test".
            folder: Where the episodes are kept, and found by a repeated call; nowhere if None.
                Those of another version of the code, or of files that have changed, are refused.

        Returns:
            Rates, times (s) and distances (m) as in `closed_loop.json`, and the cases one by one.

        Raises:
            ValueError: A case is no whole number, does not exist or is named twice, or the folder
                holds episodes of other settings or of another version of the code.
        """
        numbers = _listed(cases)
        made_of = self._made_of(), code_version()
        method = Method(self.controller, self.world(), self.driver, *made_of)
        with TemporaryDirectory() as passing:
            kept = Path(passing) if folder is None else folder
            campaign = Campaign(method, self.cases(), numbers, kept, len(numbers), phase)
            return summarise(list(campaign.run()))

    def _files(self) -> dict[str, str]:
        """Name of the file of each group that a drive is made of."""
        named = {group: getattr(self, group) for group in ("dynamics", *HANDED)}
        its_own = chosen_in(self.controller, config_folder() / "controller")
        usual = {group: its_own.get(group, name) for group, name in _BY_DEFAULT.items()}
        chosen = {group: name or usual[group] for group, name in named.items()}
        return {"constraints": "none"} | chosen

    def _made_of(self) -> str:
        """All that decides an episode: the settings, and what is behind their names at present."""
        vehicle = self.simulated().vehicle
        behind = {f"vehicle.{name}": value for name, value in vehicle.items()}
        for group, name in self._files().items():
            behind[f"{group} {name}"] = settings_of(name, config_folder() / group)
        return "\n".join((repr(self), *(f"{name}: {each!r}" for name, each in behind.items())))


def _listed(cases: Iterable[SupportsIndex]) -> list[int]:
    """Numbers of cases, those of an array or of a generator too.

    Raises:
        ValueError: There are none to go through, or one is not whole.
    """
    text = isinstance(cases, str | bytes)
    # an array or a tensor without dimensions has an `__iter__` that fails
    listed = isinstance(cases, Iterable) and not text and getattr(cases, "ndim", 1) > 0
    remedy = "Write range(3) for the first three, or [3] for one."
    require(listed, "cases", "be a list or a range of numbers", repr(cases), "", remedy)
    numbers = cases.tolist() if isinstance(cases, Tensor) else list(cases)
    for place, number in enumerate(numbers):
        require_whole(f"cases[{place}]", number)
    return [index(number) for number in numbers]
