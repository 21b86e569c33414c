"""The words of a command line, put as Hydra understands them."""

import pytest

from diffstack_mmv.commands.command_line import understood


def test_keys_of_a_vehicle_in_a_file_are_those_of_the_file():
    """Hydra knows the keys of the default vehicle, whose wheels have other names."""
    changes = ["vehicle.wheels.rear_left.x_m=-0.5", "vehicle.mass_kg=80,90"]
    told = understood(["vehicle=trike.yaml", *changes, "~vehicle.sources"], "simulate")
    assert told == [
        "vehicle_file=trike.yaml",
        *(f"++{each}" for each in changes),
        "~vehicle.sources",
    ]
    assert understood(["vehicle=cart", *changes], "simulate") == ["vehicle=cart", *changes]


@pytest.mark.parametrize(
    ("words", "understood_as"),
    [
        ("vehicle=trike.yaml out=a vehicle=cart", "out=a vehicle=cart"),
        ("vehicle_file=trike.yaml vehicle=cart", "vehicle=cart"),
        ("vehicle=cart vehicle=trike.yaml", "vehicle=cart vehicle_file=trike.yaml"),
        ("vehicle=a.yaml vehicle=cart vehicle=b.yaml", "vehicle=cart vehicle_file=b.yaml"),
        ("vehicle_file=trike.yaml", "vehicle_file=trike.yaml"),
    ],
)
def test_the_last_of_several_vehicles_holds_whether_name_or_file(words, understood_as):
    assert understood(words.split(), "simulate") == understood_as.split()


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("out=~/runs", "out='/of/me/runs'"),
        ("out='~/my runs'", "out='/of/me/my runs'"),
        ('data.cache="~/ü"', "data.cache='/of/me/ü'"),
        ("out=~", "out='/of/me'"),
        ("vehicle=~/trike.yaml", "vehicle_file='/of/me/trike.yaml'"),
        ("out=~nobody_of_that_name/runs", "out=~nobody_of_that_name/runs"),
        ("out=runs~/1", "out=runs~/1"),
        ("out='~/a,~/b'", "out='~/a,~/b'"),
        ("runs=[~/a,b,~/c]", "runs=['/of/me/a',b,'/of/me/c']"),
        ("runs=['~/a' , ~ , ~/b c ]", "runs=['/of/me/a' , '/of/me' , '/of/me/b c' ]"),
        ("+columns={x: ~/a}", "+columns={x: '/of/me/a'}"),
        ("checkpoint=~/a,~/b", "checkpoint='/of/me/a','/of/me/b'"),
        ("runs=[a,b~/c]", "runs=[a,b~/c]"),
        ("~search", "~search"),
    ],
)
def test_a_path_may_begin_with_the_home_folder(given, meant, monkeypatch):
    """In a folder named `~` nobody looks, and who removes it may remove the home folder."""
    monkeypatch.setenv("HOME", "/of/me")
    assert understood([given], "train") == [meant]
