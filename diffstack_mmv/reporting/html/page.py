"""One page for some runs, with everything inside: it needs no network and no other file."""

from collections.abc import Sequence
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from diffstack_mmv.reporting.files import write_text
from diffstack_mmv.reporting.html.readers import RunPage


def write_page(path: Path, runs: Sequence[RunPage]) -> None:
    """Write one self-contained HTML page about some runs, atomically."""
    write_text(path, render(runs))


def render(runs: Sequence[RunPage]) -> str:
    """The page as text."""
    loader = PackageLoader("diffstack_mmv.reporting.html", "templates")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # the order of methods and parts is that of the files, which the default would sort away
    environment.policies["json.dumps_kwargs"] = {"sort_keys": False}
    # our own files, which are written as they are; the scripts must not end their element early
    parts = {
        name: Markup(Path(__file__).with_name("templates").joinpath(name).read_text("utf-8"))
        for name in ("report.css", "charts.js", "scenes.js")
    }
    return environment.get_template("page.html.j2").render(runs=runs, parts=parts)
