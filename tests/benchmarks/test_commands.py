"""What documents and scripts give the benchmarks is what these take."""

import argparse
import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

from tests.test_docs import DOCUMENTS, ROOT

SCRIPTS = sorted((ROOT / "benchmarks").glob("*.py"))
CALL = re.compile(r"python (?:-m )?benchmarks[/.](\w+)(?:\.py)?((?: [^\n`#>]*)?)")
TARGET = re.compile(r"(?:^|`)make ([a-z-]+)((?: [A-Z]+=)?[^\n`#]*)", re.MULTILINE)
SHOWN_AS_USAGE = re.compile(r"[\[\]]|\.\.\.")


def documented():
    """Script and words of each call, the optional ones as well; `faults` has tests of its own."""
    tables = sorted((ROOT / "benchmarks" / "results").glob("*.md"))
    found = {}
    for path in (*DOCUMENTS, *tables, *SCRIPTS):
        text = path.read_text(encoding="utf-8").replace("\\\n", " ")
        for name, words in CALL.findall(text):
            given = tuple(shlex.split(SHOWN_AS_USAGE.sub(" ", words)))
            found[name, given] = None
    return [call for call in found if call[0] != "faults"]


class Read(Exception):  # noqa: N818, no error
    """The words are understood."""


def takes(name, words, monkeypatch):
    """Whether a script takes these words; it ends when it has read them."""
    parse, path = argparse.ArgumentParser.parse_args, ROOT / "benchmarks" / f"{name}.py"

    def parsed(parser):
        parse(parser)
        raise Read

    with monkeypatch.context() as patched:
        patched.syspath_prepend(str(path.parent))
        if not re.search("parse_args|arguments_of", path.read_text(encoding="utf-8")):
            runpy.run_path(str(path), run_name=name)  # imports what it needs
            return not words
        patched.setattr(argparse.ArgumentParser, "parse_args", parsed)
        patched.setattr(sys, "argv", [str(path), *words])
        try:
            runpy.run_path(str(path), run_name="__main__")
        except (Read, SystemExit) as end:
            return isinstance(end, Read)
    return False


@pytest.mark.parametrize("call", documented(), ids=lambda call: shlex.join((call[0], *call[1])))
def test_a_documented_call_is_understood(call, monkeypatch):
    assert takes(*call, monkeypatch)


def test_every_script_is_documented_or_imported():
    """One that no document names is read here, so that what it imports is there."""
    named = {name for name, _ in documented()}
    rest = {path.stem for path in SCRIPTS} - named
    assert rest == {"bench_data", "bench_solver_worker", "bench_training", "load"}


def test_an_unknown_option_is_refused(monkeypatch):
    assert not takes("lean_laws", ["two_wheeler", "CACHE", "bicycle", "--picture"], monkeypatch)
    assert not takes("gm3_table_iv", ["--letters"], monkeypatch)


def test_stages_of_the_measured_identification_are_understood(script, monkeypatch):
    measured = script("identification_measured")
    stages = measured.stages(Path("recordings"), Path("out"))
    commands = [stage.command for stage in stages if stage.command[0].startswith("benchmarks/")]
    assert len(commands) == 3
    assert all(takes(Path(file).stem, words, monkeypatch) for file, *words in commands)


def test_targets_and_their_variables_are_in_the_makefile():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    unknown, shown = [], (*DOCUMENTS, *sorted((ROOT / "benchmarks").glob("**/*.py")))
    calls = {call for path in shown for call in TARGET.findall(path.read_text(encoding="utf-8"))}
    for target, words in calls:
        variables = re.findall(r"\b([A-Z]+)=", words)
        needed = [f"\n{target}:", *(f"$({each})" for each in variables)]
        unknown += [(target, each) for each in needed if each not in makefile]
    assert unknown == []
    assert {"bench", "results", "throughput", "profile"} <= {target for target, _ in calls}
