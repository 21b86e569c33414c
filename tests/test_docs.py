"""What the documents show exists and runs: links, code, command lines, and the site."""

import os
import re
import shlex
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf

import diffstack_mmv.commands.cli  # noqa: F401  registers the resolvers

ROOT = Path(__file__).resolve().parents[1]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "data_converters" / "README.md",
    ROOT / "diffstack_mmv" / "data" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *TUTORIALS,
    *sorted((ROOT / "docs" / "results").glob("*.md")),
    *sorted((ROOT / "docs" / "studies").glob("*.md")),
]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s#]*)(?:#([^)\s]*))?\)")


def name(path):
    return path.relative_to(ROOT).as_posix()


def blocks(path, *languages):
    """Language and text of the blocks; the example of own tables has a test of its own."""
    text = path.read_text(encoding="utf-8").partition("## Your own tables")[0]
    return [found.groups() for found in BLOCK.finditer(text) if found[1] in languages]


def anchors(path):
    """Anchors of the headings of a document, as the repository and the site make them."""
    text = BLOCK.sub("", path.read_text(encoding="utf-8"))
    titles = re.findall(r"^#+ +(.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("path", DOCUMENTS, ids=name)
def test_links_lead_to_files_and_headings(path):
    for target, anchor in LINK.findall(BLOCK.sub("", path.read_text(encoding="utf-8"))):
        if "://" in target:
            continue
        found = (path.parent / target).resolve() if target else path
        assert found.exists(), target
        assert not anchor or anchor in anchors(found), f"{target}#{anchor}"


@pytest.mark.parametrize(
    "documents",
    [
        ["README.md"],
        ["docs/tutorials/solver.md"],
        ["docs/tutorials/online.md"],
        ["docs/dynamics.md"],
        pytest.param(["docs/diffmpc.md"], marks=pytest.mark.slow),
        pytest.param(["docs/closed_loop.md"], marks=pytest.mark.slow),
        pytest.param(
            ["data_converters/README.md", "diffstack_mmv/data/README.md"], marks=pytest.mark.slow
        ),
    ],
    ids=" ".join,
)
def test_code_runs(documents, tmp_path, monkeypatch, unchecked):
    monkeypatch.chdir(tmp_path)
    for document in documents:
        run_blocks(ROOT / document)


def run_blocks(path, languages=("python",), shell=""):
    """Run the blocks of a document one after the other, those of Python in one namespace."""
    space = {"__name__": "__main__"}
    for language, code in blocks(path, *languages):
        if language == "python":
            exec(compile(code, name(path), "exec"), space)  # noqa: S102
        else:
            environment = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
            subprocess.run(["bash", "-c", shell + code], check=True, env=environment)


def commands(path):
    """Command lines of the scripts in a document, as the words behind `python scripts/`."""
    for _, text in blocks(path, "sh", "bash"):
        for line in text.replace("\\\n", " ").splitlines():
            words = shlex.split(line.removeprefix("srun "), comments=True)
            if words[:1] == ["python"] and words[1].startswith("scripts/"):
                yield words[1:]


def settings():
    """All settings that documents give a script, together for each data set, experiment, table."""
    found = {}
    for script, *words in (words for path in DOCUMENTS for words in commands(path)):
        given = {word.partition("=")[0]: word.replace("$", "") for word in words if "=" in word}
        swept = [key for key in given if key.startswith("hydra") or "," in given[key].split("[")[0]]
        if given.get("vehicle", "").endswith(".yaml"):
            swept.append("vehicle")
        if "--config-dir" in words:  # of a model of one's own
            swept.append("dynamics")
        kept = {key: word for key, word in given.items() if key not in swept}
        choice = Path(script).stem, *(given.get(key, "") for key in ("data", "experiment", "table"))
        found.setdefault(choice, {}).update(kept)
    return found


def test_settings_in_command_lines_exist():
    refused, found = [], settings()
    with initialize_config_dir(str(ROOT / "configs"), version_base="1.3"):
        for (script, *_), given in found.items():
            try:
                compose(script, list(given.values()))
            except HydraException as error:
                refused.append((script, str(error)))
    GlobalHydra.instance().clear()
    assert refused == []
    assert {"train", "evaluate", "convert", "navigate", "identify"} <= {each for each, *_ in found}


def test_drives_in_command_lines_are_of_their_table():
    parser, unknown, drives, tables = OverridesParser.create(), [], {}, set()
    for script, *words in (words for path in DOCUMENTS for words in commands(path)):
        if script != "scripts/closed_loop_table.py":
            continue
        read = parser.parse_overrides([word.replace("$", "") for word in words])
        given = {each.key_or_group: each.value() for each in read}
        chosen = given["table"]
        table = OmegaConf.load(ROOT / "configs" / "table" / f"{chosen}.yaml")
        named = {key: list(given.get(key, table[key])) for key in ("rows", "places")}
        unknown += [
            (chosen, each) for key in named for each in named[key] if each not in table[key]
        ]
        if "overrides" in given and not unknown:
            first = (table.rows[named["rows"][0]], table.places[named["places"][0]])
            drives[tuple(map(str, given["overrides"]))] = [*table["settings"], *first[1], *first[0]]
        tables.add(chosen)
    assert unknown == []
    assert {"crowdnav", "published", "dense"} <= tables
    with initialize_config_dir(str(ROOT / "configs"), version_base="1.3"):
        for overrides, before in drives.items():
            typed = {each.partition("=")[0]: each for each in (*before, *overrides)}
            compose("navigate", list(typed.values()))
    GlobalHydra.instance().clear()


@pytest.mark.slow
def test_tutorials_run_as_they_stand(tmp_path, monkeypatch, unchecked):
    shell = f'set -e; python() {{ {sys.executable} {ROOT}/"$@"; }}\n'
    for stem in ("solver", "train_and_compare", "identify", "own_data", "drive"):
        folder = tmp_path / ("own" if stem == "own_data" else "all")
        folder.mkdir(exist_ok=True)
        monkeypatch.chdir(folder)
        run_blocks(ROOT / "docs" / "tutorials" / f"{stem}.md", ("python", "sh"), shell)
    assert torch.get_default_dtype() == torch.float32
    assert (tmp_path / "all" / "reports" / "table" / "table.md").is_file()
    assert (tmp_path / "own" / "page" / "report.html").is_file()


@pytest.mark.skipif(find_spec("mkdocs") is None, reason="needs the extra `docs`; see `make docs`")
def test_the_site_is_built_without_a_warning(tmp_path):
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    subprocess.run(command, cwd=ROOT, check=True)
    assert (tmp_path / "reference" / "diffstack_mmv.control.html").is_file()
