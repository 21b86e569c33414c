"""The words of a command line, put as Hydra understands them."""

import pytest

from diffstack_mmv.commands.command_line import understood


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
