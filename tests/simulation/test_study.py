"""The configured dynamics and footprint arrive in the robot and in the controller's model."""

import json

import pytest
from hydra.utils import instantiate

from diffstack_mmv.dynamics.catalogue import dynamics_names, model_of
from diffstack_mmv.simulation import (
    DiffMPCController,
    DiscFootprint,
    HolonomicRobot,
    OrcaPolicy,
    RectangleFootprint,
    StraightLine,
    models_told,
    study_world,
    world_for,
)
from tests.simulation.conftest import composed_navigate


@pytest.fixture
def built():
    """Robot and controller's model of a command line, and what is told of them."""

    def build(*overrides):
        config = composed_navigate(*overrides)
        world, model = instantiate(config.world), instantiate(config.model)
        robot = world.robot
        told = models_told(instantiate(config.actual), instantiate(config.believed), world, model)
        assert json.loads(json.dumps(told)) == told
        return robot, model, told

    return build


def settings_of(model):
    """What sets the variants apart: class, law and numbers, substeps, floor; not the step."""
    return {key: value for key, value in model.description().items() if key != "step_s"}


@pytest.mark.parametrize("name", dynamics_names())
def test_the_configured_variant_drives_and_plans(name, built):
    robot, model, told = built(f"dynamics={name}")
    expected = settings_of(model_of("bicycle", name, 0.1))
    assert settings_of(robot.model) == settings_of(model.model) == expected
    assert robot.model.dt_s == 0.01
    assert model.dt_s == 0.25
    assert told["dynamics"] == told["believed_dynamics"] == name
    for whose in ("actual_model", "believed_model"):
        assert expected.items() <= told[whose].items()


def test_overrides_of_the_dynamics_reach_both(built):
    given = ["dynamics=gm3_paper", "dynamics.substeps=4", "dynamics.tire.steepness=200"]
    robot, model, _ = built(*given)
    for each in (robot.model, model.model):
        assert (each.substeps, each.chassis.tire.steepness) == (4, 200)


def test_a_controller_may_believe_in_other_dynamics(built):
    robot, model, told = built("dynamics=gm3_paper", "believed.dynamics=kbm_smooth")
    assert told["actual_model"]["class"] == "DiffGM3"
    assert told["believed_model"]["speed_floor"] == "SoftplusFloor(width_mps=0.05)"
    assert (told["dynamics"], told["believed_dynamics"]) == ("gm3_paper", "kbm_smooth")
    assert model.ahead_m == pytest.approx(0.45)
    assert told["believed_model"]["step_s"] == pytest.approx(0.05)


@pytest.mark.parametrize("whose", ["actual", "believed"])
def test_one_of_both_may_be_heavier_or_on_another_road(whose, built):
    altered = [f"{whose}.friction=0.3", f"{whose}.mass_factor=1.3"]
    robot, model, _ = built("dynamics=gm3_fine", *altered)
    models = {"actual": robot.model, "believed": model.model}
    changed = models.pop(whose)
    (other,) = models.values()
    assert changed.spec.mass_kg == pytest.approx(1.3 * other.spec.mass_kg)
    assert changed.physical_parameters()["friction"].max().item() == pytest.approx(0.3)
    assert changed.substeps == other.substeps == 4


@pytest.mark.parametrize("dynamics", ["kbm", "gm3"])
def test_the_box_is_where_the_vehicle_is_whatever_the_reference_point(dynamics, built):
    robot, _, told = built(f"dynamics={dynamics}", "footprint=vehicle")
    assert isinstance(robot.footprint, RectangleFootprint)
    assert told["actual_model"]["footprint"]["length_m"] == 1.8
    middle = robot.footprint.ahead_m + robot.model.reference_ahead_m
    assert middle == pytest.approx(0.5 * (0.6 - 0.45))


def test_the_disc_of_the_benchmark_is_what_is_driven_by_default(built):
    assert built()[0].footprint == DiscFootprint(0.3)


@pytest.mark.parametrize(
    ("kind", "massless"), [(StraightLine, True), (OrcaPolicy, True), (DiffMPCController, False)]
)
def test_massless_controllers_drive_the_robot_of_the_benchmark(kind, massless, built, world_with):
    robot = built("footprint=vehicle")[0]
    world = study_world(robot, world_with().crowd, "exact", 10.0, 0.25)
    place = world_for(world, kind)
    assert isinstance(place.robot, HolonomicRobot) == massless
    assert (place is world) == (not massless)


def test_of_a_massless_controller_its_own_robot_is_told():
    config = composed_navigate("footprint=vehicle")
    vehicles = instantiate(config.actual), instantiate(config.believed)
    world = world_for(instantiate(config.world), StraightLine)
    told = models_told(*vehicles, world, instantiate(config.model))
    assert told["dynamics"] == told["believed_dynamics"] == "massless"
    assert told["actual_model"] == told["believed_model"]
    assert told["actual_model"]["class"] == "HolonomicRobot"
    assert told["actual_model"]["step_s"] == 0.25
    assert told["actual_model"]["footprint"] == DiscFootprint(0.3).description()
    assert told["footprint"] == "disc"  # above that of the header
    assert told["actual_model"]["controls"] == ["velocity_x", "velocity_y"]
