"""Vehicle files: every mistake gets one message that names vehicle, field and value."""

import copy
import math

import pytest
from omegaconf import OmegaConf

from diffstack_mmv.vehicles import WHEEL_PARAMETERS, VehicleSpec, axles, config_folder


@pytest.fixture
def content():
    path = config_folder() / "vehicle" / "bicycle.yaml"
    return copy.deepcopy(OmegaConf.to_container(OmegaConf.load(path)))


def changed(content, path, value):
    """Set (or with None remove) a nested key."""
    *parents, last = path.split("/")
    place = content
    for parent in parents:
        place = place[parent]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return content


MISTAKES = [
    ("mass_kg", -90.0, "`mass_kg` must be positive, but got -90.0 for vehicle 'bicycle'"),
    ("mass_kg", "90 kg", "`mass_kg` must be a number, but got '90 kg'"),
    ("mass", 90.0, "Did you mean `mass_kg`"),
    ("MASS_KG", 90.0, "Did you mean `mass_kg`"),
    ("height_m", None, "`height_m` must be given"),
    ("parameters/friction/unit", None, "`parameters.friction.unit` must be given"),
    ("parameters/friction/unit", "N", "`parameters.friction.unit` must be '1', but got 'N'"),
    ("parameters/friction/initial", 1.5, "parameters.friction"),
    ("parameters/friction/initial", [0.8, 0.8, 0.8], "3 entries"),
    ("parameters/friction/learn", "yes", "must be true or false"),
    ("parameters/friction/source", "", "`source` must be given"),
    ("parameters/yaw_inertia", None, "`parameters.yaw_inertia` must be given"),
    ("parameters/frictoin", {}, "Did you mean `friction`"),
    ("wheels/rear/x_m", 0.6, "zero wheelbase"),
    ("wheels/rear/x_m", 0.1, "between the front and the rear axle"),
    ("wheels/rear/radius_m", 0.0, "`radius_m` must be positive"),
    ("wheels/rear/driven", False, "must have a driven one"),
    ("wheels/rear/caster", True, "neither steered, driven nor braked"),
    ("wheels/front/steered", False, "at least one steered wheel"),
    ("wheels/front/y_m", 0.2, "stand in one line"),
    ("wheels/rear/truck", 0.5, "`wheels.rear.truck` must be a whole number"),
    ("wheels/rear", None, "must be at least two"),
    ("limits/steer_max_rad", 45.0, "Give radians"),
    ("mode", "bike", "`mode` must be one of bicycle, car, cart"),
    ("limits/acceleration_min_mps2", 5.0, "must be negative"),
    ("limits/acceleration_min_mps2", -math.inf, "must be negative and finite"),
    ("leans", False, "Nothing else keeps it upright"),
    ("wheelbase", {"initial": 0.0, "low": 0.0, "high": 0.0}, "wheelbase.unit"),
    ("steering", {"ackerman": {}}, "Did you mean `ackermann`"),
    ("steering", {"ackermann": {}, "trucks": {}}, "exactly one of"),
    ("steering", {"trucks": {"gain": 1.0, "pivot_rad": 0.7}}, "wheels on trucks"),
    ("smoothing", {"friction_share": 1.2}, "must lie in (0, 1)"),
    ("wheels", [1, 2], "mapping from names"),
    ("mode", "", "`mode` must be text, but got ''"),
    ("limits", [12.0], "`limits` must be a mapping of keys, but got [12.0] for vehicle"),
    ("sources", "a tape", "`sources` must be a mapping of keys, but got 'a tape' for vehicle"),
    ("provenance", [1, 2], "`provenance` must be a mapping of keys, but got [1, 2]"),
    ("steering", {"ackermann": {"gain": 1.0}}, "`steering.ackermann.gain` must be left out, but"),
    ("limits/yaw_rate_max_radps", 143.0, "must lie in [0.0, 20.0], but got 143.0. Give radians"),
    ("limits/yaw_rate_max_radps", 0.0, "`limits.yaw_rate_max_radps` must be positive"),
    ("footprint/length_m", 1800.0, "`footprint.length_m` must lie between 1.05, as far as the"),
    ("footprint/length_m", 0.6, "apart, and 10.5, but got 0.6 for vehicle 'bicycle'. Give metres"),
    ("footprint/width_m", 600.0, "`footprint.width_m` must lie between 0, as far as the wheels"),
    ("parameters/yaw_inertia/initial", 7.6e4, "parameters.yaw_inertia"),
    ("mass_kg", 0.09, "`parameters.yaw_inertia.initial` must lie between 0.00013 and 0.324 for a"),
    ("wheels/rear", {"x_m": -1.5, "y_m": 0.0, "radius_m": 0.3, "driven": True}, "bicycle of 2.1 m"),
    ("mass_kg", 110.0, "must be at least m h² = 110 of a leaning vehicle"),
    ("steering", {"trucks": {"gain": 0.0, "pivot_rad": 0.7}}, "`steering.gain` must be positive"),
    ("steering", {"trucks": {"gain": 1.0, "pivot_rad": 0}}, "pivot_rad` must be positive"),
    ("wheels/rear-left", {"x_m": -1.5, "y_m": 0.0, "radius_m": 0.3}, "letters, digits and under"),
    ("wheelbase/unit", "cm", "must be 'm', but got 'cm' for vehicle 'bicycle'. Convert initial"),
    ("wheelbase/high", [1.2, 1.3], "`wheelbase` must be one number, but got 2 entries"),
    ("wheelbase/high", 1e9, "single precision loses it, but got 1.05 between low = 0.89"),
    ("parameters/friction/unit", "%", "but got '%' for vehicle 'bicycle'. Convert initial, low"),
    ("wheels/front/x_m", 60, "`wheels.front.x_m` must be at most 10 times the footprint of 1.8 m"),
    ("wheels/front/radius_m", 34.0, "but got 34 for vehicle 'bicycle'. Give metres."),
    ("height_m", 100.0, "`height_m` must be at most 10 times the footprint of 1.8 m, but got 100"),
    (
        "wheelbase",
        {"initial": 105, "low": 89, "high": 121, "unit": "m", "learn": True, "source": "tape"},
        "`wheelbase.initial` must be at most 10 times the footprint of 1.8 m, but got 105",
    ),
]


@pytest.mark.parametrize(
    ("path", "value", "told"), MISTAKES, ids=[m[0] + "=" + str(m[1])[:12] for m in MISTAKES]
)
def test_mistake_in_a_file_is_named(content, path, value, told):
    with pytest.raises(ValueError) as caught:  # noqa: PT011
        VehicleSpec.from_config(changed(content, path, value))
    assert told in str(caught.value)
    assert "bicycle" in str(caught.value)


def test_two_axles_need_a_wheelbase(content):
    content["wheelbase"].update(initial=0.0, low=0.0, high=0.0)
    with pytest.raises(ValueError, match="`wheelbase.low` must be positive"):
        VehicleSpec.from_config(content)


def test_plain_numbers_apply_to_all_wheels(content):
    content["parameters"]["friction"]["initial"] = 0.7
    assert VehicleSpec.from_config(content).wheel_parameter("friction").initial == (0.7, 0.7)


def test_a_truck_is_a_whole_number_however_it_is_written(content):
    content["wheels"]["rear"]["truck"] = 0.0
    wheels = VehicleSpec.from_config(content).wheels
    assert [repr(wheel.truck) for wheel in wheels] == ["0", "0"]


@pytest.mark.parametrize(("name", "neutral"), [("length_scale", 1.0), ("drag", 0.0)])
def test_optional_parameters_are_neutral(content, name, neutral):
    assert VehicleSpec.from_config(content).parameters[name].initial == neutral


def wheel(x_m, y_m, **roles):
    return {"x_m": x_m, "y_m": y_m, "radius_m": 0.2, "braked": True} | roles


def on_wheels(content, **wheels):
    """The bicycle as an upright vehicle on other wheels."""
    parameters = copy.deepcopy(content["parameters"])
    for name in WHEEL_PARAMETERS:
        entry = parameters[name]
        numbers = {key: entry[key] for key in ("initial", "low", "high")}
        entry |= {k: v[0] if isinstance(v, list) else v for k, v in numbers.items()}
    return content | {"leans": False, "wheels": wheels, "parameters": parameters}


def three_wheeler(content, second):
    """Front and rear wheel stand to the left."""
    front, rear = wheel(0.6, 0.1, steered=True), wheel(-0.5, 0.1, driven=True)
    return on_wheels(content, front=front, rear=rear, second=second)


def test_wheels_need_not_stand_exactly_side_by_side(content):
    spec = VehicleSpec.from_config(three_wheeler(content, wheel(-0.3, -0.5)))
    assert axles(spec.wheels) == [[0], [2, 1]]


@pytest.mark.parametrize(
    ("second", "told"),
    [
        (wheel(-0.5, -0.4), None),
        (wheel(0.55, -0.5, steered=True), None),
        (wheel(0.05, -0.5), "stand in one line"),
        (wheel(-0.5, -0.05), "within the outline of their contact points"),
        (wheel(-0.5, 0.5), "on both sides of the centre of gravity"),
    ],
)
def test_the_centre_of_gravity_lies_between_the_wheels(content, second, told):
    if told is None:
        assert VehicleSpec.from_config(three_wheeler(content, second))
    else:
        with pytest.raises(ValueError, match=told):
            VehicleSpec.from_config(three_wheeler(content, second))


def test_a_steered_axle_needs_another_one_to_turn_about(content):
    left, right = (wheel(0.0, y, steered=True, driven=True) for y in (0.3, -0.3))
    with pytest.raises(ValueError, match="steer at some distance from the axle that does not"):
        VehicleSpec.from_config(on_wheels(content, left=left, right=right))
