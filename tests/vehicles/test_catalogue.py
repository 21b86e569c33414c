"""The vehicles that come with the package."""

import json
from dataclasses import replace

import pytest
from omegaconf import OmegaConf

from diffstack_mmv.types import Mode
from diffstack_mmv.vehicles import (
    VehicleSpec,
    axles,
    config_folder,
    load_vehicle,
    save_vehicle,
    vehicle_names,
)

NAMES = vehicle_names()


def test_ten_vehicles_are_shipped():
    names = (
        "autobike bicycle cart hoverboard motorcycle scooter skateboard tadpole tricycle wheelchair"
    )
    assert " ".join(NAMES) == names


# the autobike was measured by its builders, and is in no reference set
@pytest.mark.parametrize("name", [name for name in NAMES if name != "autobike"])
def test_shipped_numbers_are_those_of_the_reference(name, shared):
    entries = json.loads((shared / "reference/gm3/vehicles.json").read_text())
    ours, theirs = load_vehicle(name), VehicleSpec.from_reference(entries[name])
    for key in ("mass_kg", "height_m", "front_m", "rear_m", "steering", "leans", "balanced"):
        assert getattr(ours, key) == pytest.approx(getattr(theirs, key)), key
    for key in ("x_m", "y_m", "radius_m", "steered", "truck", "driven", "braked", "caster"):
        assert ours.per_wheel(key) == pytest.approx(theirs.per_wheel(key)), key
    for key, parameter in theirs.parameters.items():
        assert ours.parameters[key].initial == pytest.approx(parameter.initial, rel=1e-9), key


@pytest.mark.parametrize("name", NAMES)
def test_vehicle_survives_saving(name, tmp_path):
    spec = load_vehicle(name)
    save_vehicle(spec, tmp_path / "new" / "copy.yaml", {"data": "none", "seed": 0})
    copy = load_vehicle(tmp_path / "new" / "copy.yaml")
    assert copy.provenance == {"data": "none", "seed": 0}
    assert replace(copy, provenance={}) == spec
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["copy.yaml"]


@pytest.mark.parametrize("name", NAMES)
def test_mode_is_one_that_data_know(name):
    assert Mode.named(load_vehicle(name).mode) is not Mode.UNKNOWN


def leaves(content, path=()):
    for key, value in content.items():
        if isinstance(value, dict):
            yield from leaves(value, (*path, key))
        elif isinstance(value, int | float) and not isinstance(value, bool) and value != 0:
            yield (*path, key)


@pytest.mark.parametrize("name", NAMES)
def test_every_number_has_a_source(name):
    content = OmegaConf.to_container(OmegaConf.load(config_folder() / "vehicle" / f"{name}.yaml"))
    sources = content.pop("sources")
    for path in leaves(content):
        if path[0] in ("parameters", "wheelbase"):
            place = content[path[0]] if path[0] == "wheelbase" else content[path[0]][path[1]]
            assert place["source"], path
        elif path[0] == "wheels":
            assert path[-1] == "truck" or sources["wheels"][path[-1]], path
        else:
            assert sources[path[0]], path


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("end", ["low", "high"])
def test_every_vehicle_survives_a_fit_that_ends_where_its_ranges_end(name, end, tmp_path):
    spec = load_vehicle(name)
    moved = spec.with_values({each: getattr(p, end) for each, p in spec.parameters.items()}, "fit")
    save_vehicle(moved, tmp_path / "fitted.yaml")
    assert load_vehicle(tmp_path / "fitted.yaml").parameters == moved.parameters


def test_calibrated_values_replace_the_priors():
    spec = load_vehicle("bicycle").with_values({"friction": [0.6, 0.7], "wheelbase": 1.1}, "fit")
    assert spec.parameters["friction"].initial == (0.6, 0.7)
    assert spec.wheelbase.initial == 1.1
    assert spec.wheelbase.source == "fit"


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("bicycles", "Did you mean 'bicycle'?"), ("mine/bike.yaml", "There is no such file.")],
)
def test_unknown_vehicle_says_what_may_be_meant(name, remedy):
    with pytest.raises(ValueError, match="`vehicle` must be one of") as told:
        load_vehicle(name)
    assert str(told.value).endswith(f"but got '{name}'. {remedy}")


@pytest.mark.parametrize(
    ("name", "values", "wanted"),
    [
        ("yaw_inertia", [7.0, 99.0], "be one number, but got 2 of them"),
        ("wheelbase", [1.1, 9.0, 9.0], "be one number, but got 3 of them"),
        ("friction", [0.6, 0.7, 0.8], "have 2 entries, but got 3 of them"),
        ("friction", [], "have 2 entries, but got 0 of them"),
    ],
)
def test_calibrated_values_of_another_number_are_refused(name, values, wanted):
    with pytest.raises(ValueError, match=wanted) as told:
        load_vehicle("bicycle").with_values({name: values})
    assert str(told.value).endswith(f"(`{name}` for vehicle 'bicycle')")


def test_a_list_of_one_number_is_that_number():
    spec = load_vehicle("bicycle").with_values({"wheelbase": [1.1], "yaw_inertia": [8.0]})
    assert (spec.wheelbase.initial, spec.parameters["yaw_inertia"].initial) == (1.1, 8.0)


def test_unknown_calibrated_name_is_refused():
    with pytest.raises(ValueError, match="`colour` must be one of"):
        load_vehicle("bicycle").with_values({"colour": 1.0})


@pytest.mark.parametrize("name", ["bicylce", "/nowhere/bicycle.yaml"])
def test_unknown_vehicle_lists_the_known_ones(name):
    with pytest.raises(ValueError, match="bicycle, cart, hoverboard"):
        load_vehicle(name)


@pytest.mark.parametrize("text", ["- a\n- b", "a: [1,", ""])
def test_file_that_is_no_vehicle_is_named(tmp_path, text):
    (tmp_path / "odd.yaml").write_text(text)
    with pytest.raises(ValueError, match="odd.yaml"):
        load_vehicle(tmp_path / "odd.yaml")


def test_axles_are_found_front_first():
    wheels = load_vehicle("tricycle").wheels
    assert [[wheels[index].name for index in axle] for axle in axles(wheels)] == [
        ["front"],
        ["rear_left", "rear_right"],
    ]


def test_example_of_a_new_layout_loads(root):
    spec = load_vehicle(root / "docs" / "examples" / "five_wheeled.yaml")
    assert len(spec.wheels) == 5


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"m": -1.0}, "`mass_kg` must be positive"),
        ({"lf": 0.0, "lr": 0.0}, "wheelbase"),
        ({"control": "joystick"}, "`control` must be one of"),
    ],
)
def test_impossible_parameter_set_is_refused(shared, change, told):
    entry = json.loads((shared / "reference/gm3/vehicles.json").read_text())["bicycle"]
    with pytest.raises(ValueError, match=told):
        VehicleSpec.from_reference(entry | change)
