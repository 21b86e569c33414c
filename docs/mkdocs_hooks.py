"""Hooks of the site: pages that lie outside of this folder, the reference, and their links.

The Markdown files link each other as the repository shows them; on the site such a link leads to
the page that was made of the file.
"""

import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
# files of the repository that are pages of the site
OUTSIDE = {
    "README.md": "project.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "data_converters/README.md": "converters.md",
    "diffstack_mmv/data/README.md": "data.md",
}
MODULES = {
    "diffstack_mmv.control": "Solver",
    "diffstack_mmv.control.constrained": "Solver with constraints",
    "diffstack_mmv.vehicles": "Vehicles",
    "diffstack_mmv.dynamics": "Dynamics",
    "diffstack_mmv.dynamics.catalogue": "Dynamics by their names",
    "diffstack_mmv.dynamics.gm3": "DiffGM3",
    "diffstack_mmv.costs": "Costs",
    "diffstack_mmv.planning": "Planning",
    "diffstack_mmv.crowdnav": "CrowdNav from Python",
    "diffstack_mmv.simulation": "Closed loop",
    "diffstack_mmv.prediction": "Prediction",
    "diffstack_mmv.metrics": "Scores",
    "diffstack_mmv.identification": "Identification",
    "diffstack_mmv.identification.measured": "Identification from measured controls",
    "diffstack_mmv.data": "Samples",
    "diffstack_mmv.stack": "Stack",
    "diffstack_mmv.online": "A trained stack on live tracks",
    "diffstack_mmv.types": "Types",
    "data_converters": "Converters",
}
LINK = re.compile(r"(!?\[[^\]]*\])\(([^)\s#]+)(#[^)\s]*)?\)")
CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)


def page_of(path: str) -> str | None:
    """Page or file of the site for a path of the repository; none where it has none."""
    if path in OUTSIDE:
        return OUTSIDE[path]
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    return path if path.startswith("benchmarks/results/") and (ROOT / path).is_file() else None


def source_of(page: str) -> str:
    """Path in the repository of a page."""
    named = {target: source for source, target in OUTSIDE.items()}
    return named.get(page, page if page.startswith("benchmarks/") else f"docs/{page}")


def on_config(config: Any) -> Any:
    """Complete the navigation by the pages that are found."""
    tables = sorted(f"benchmarks/results/{path.name}" for path in _tables())
    chapters = [{title: f"reference/{module}.md"} for module, title in MODULES.items()]
    for section in config.nav:
        if "Reference" in section:
            section["Reference"] = chapters
        if "Results" in section:
            section["Results"] = [*section["Results"][:-1], {"Benchmarks": tables}]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the pages from outside, pictures they show, and a page per module."""
    outside = OUTSIDE | {f"benchmarks/results/{each.name}": None for each in _tables(".md", ".png")}
    for source, target in outside.items():
        page = target or source
        files.append(File.generated(config, page, abs_src_path=str(ROOT / source)))
    for module, title in MODULES.items():
        content = f"# {title}\n\n`{module}`\n\n::: {module}\n"
        files.append(File.generated(config, f"reference/{module}.md", content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Turn links between files of the repository into links between pages."""
    here = page.file.src_uri
    parts, end = [], 0
    for code in CODE.finditer(markdown):
        parts += [_linked(markdown[end : code.start()], here), code.group()]
        end = code.end()
    return "".join([*parts, _linked(markdown[end:], here)])


def _linked(text: str, here: str) -> str:
    return LINK.sub(lambda found: _link(found, here), text)


def _link(found: re.Match[str], here: str) -> str:
    words, target, anchor = found[1], found[2], found[3] or ""
    if "://" in target:
        return found.group()
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source_of(here)), target))
    page = page_of(path)
    if page is None:  # a file of the repository that is no page: only its name is told
        return words.strip("![]") if (ROOT / path).exists() else found.group()
    return f"{words}({posixpath.relpath(page, posixpath.dirname(here) or '.')}{anchor})"


def _tables(*endings: str) -> list[Path]:
    """Files of the benchmarks with these endings: tables, unless they are given."""
    found = (ROOT / "benchmarks" / "results").iterdir()
    return sorted(path for path in found if path.suffix in (endings or (".md",)))
