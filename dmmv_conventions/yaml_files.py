"""Reading of YAML files that anyone may have written: plain values, of a bounded size."""

from pathlib import Path
from typing import Any

import yaml
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from dmmv_conventions.checks import message, require
from dmmv_conventions.targets import NOTHING, require_buildable

MOST_VALUES = 100_000
"""Values that a file may hold, each alias counted with all that it repeats."""


def read_mapping(path: Path, argument: str) -> dict[str, Any]:
    """Plain values of a YAML file, interpolations within the file resolved.

    Args:
        path: The file.
        argument: Name of the setting that names it, for messages.

    Raises:
        ValueError: The file is no YAML, no mapping, too large or too deep, or names what is to be
            built from it.
    """
    try:
        text = path.read_text(encoding="utf-8")
        values = _size(yaml.compose(text, Loader=yaml.SafeLoader), {})
        found = f"{values} in {path}"
        require(values <= MOST_VALUES, argument, f"hold at most {MOST_VALUES} values", found)
        content = OmegaConf.to_container(OmegaConf.create(text), resolve=True)
    except (yaml.YAMLError, OmegaConfBaseException, UnicodeDecodeError, RecursionError) as problem:
        raise ValueError(message(argument, "be a YAML file", f"{path}: {problem}")) from problem
    if not isinstance(content, dict):
        raise ValueError(message(argument, "be a mapping of keys", f"{path}: {content!r}"))
    require_buildable(content, NOTHING, f"in {path}")
    return {str(key): value for key, value in content.items()}


def _size(node: yaml.Node | None, known: dict[int, int]) -> int:
    """Number of values below a node; a node that contains itself has too many."""
    if not isinstance(node, yaml.CollectionNode):
        return 1
    if id(node) not in known:
        known[id(node)] = MOST_VALUES + 1
        parts = [
            part for each in node.value for part in (each if isinstance(each, tuple) else (each,))
        ]
        known[id(node)] = 1 + sum(_size(part, known) for part in parts)
    return known[id(node)]
