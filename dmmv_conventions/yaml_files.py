"""YAML files that anyone may have written: plain values, of a bounded size."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from dmmv_conventions.checks import message, require
from dmmv_conventions.extras import needs
from dmmv_conventions.targets import NOTHING, nodes, require_buildable

MOST_VALUES = 100_000
"""Values that a file may hold, each alias counted with all that it repeats."""
_FLOAT = "tag:yaml.org,2002:float"
# YAML 1.1, which PyYAML follows, wants a dot in a number with an exponent; Hydra does not
_EXPONENT = re.compile(r"[-+]?\d[\d_]*(\.[\d_]*)?[eE][-+]?\d+$")


class _Loader(yaml.SafeLoader):
    """Reads plain values as Hydra does: 1e-3 is a number, a date is text, a key stands once."""

    yaml_implicit_resolvers = {
        first: [pair for pair in pairs if pair[0] != "tag:yaml.org,2002:timestamp"]
        for first, pairs in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping in which no key stands twice.

        Raises:
            yaml.constructor.ConstructorError: One does.
        """
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        twice = next((key for index, key in enumerate(keys) if key in keys[:index]), None)
        if twice is not None:
            told = f"found the key {twice} twice"
            raise yaml.constructor.ConstructorError(None, None, told, node.start_mark)
        return super().construct_mapping(node, deep)


class _Dumper(yaml.SafeDumper):
    """Writes text that `_Loader` would take for a number in quotes."""


for _each in (_Loader, _Dumper):
    _each.add_implicit_resolver(_FLOAT, _EXPONENT, list("-+0123456789"))


def read_mapping(path: Path, argument: str) -> dict[str, Any]:
    """Plain values of a YAML file, interpolations within the file resolved.

    Args:
        path: The file.
        argument: Name of the setting that names it, for messages.

    Raises:
        ValueError: The file is no YAML, no mapping, too large or too deep, or names what is to be
            built from it.
    """
    content = read_plain(path, argument)
    if any(isinstance(value, str) and "${" in value for _, value in nodes(content)):
        content = _resolved(content, path, argument)
    require_buildable(content, NOTHING, f"in {path}")
    return {str(key): value for key, value in content.items()}


def read_plain(path: Path, argument: str, remedy: str = "") -> dict[Any, Any]:
    """Plain values of a YAML file as they stand; what they would have built is not looked at.

    Args:
        path: The file.
        argument: Name of what names it, for messages.
        remedy: What to do about a file that is none, for messages.

    Raises:
        ValueError: The file is no YAML, no mapping, too large or too deep.
    """
    try:
        loader = _Loader(path.read_text(encoding="utf-8"))
        node = loader.get_single_node()
        values = _size(node, {})
        found, wanted = f"{values} in {path}", f"hold at most {MOST_VALUES} values"
        require(values <= MOST_VALUES, argument, wanted, found, "", remedy)
        content = None if node is None else loader.construct_document(node)
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as problem:
        raise _no_yaml(argument, path, problem, remedy) from problem
    if not isinstance(content, dict):
        found = f"{path}: {content!r}"
        raise ValueError(message(argument, "be a mapping of keys", found, "", remedy))
    return content


def load_plain(text: str) -> Any:
    """Plain values of the text of a YAML file.

    Raises:
        yaml.YAMLError: The text is no YAML, or a key stands twice.
    """
    return yaml.load(text, Loader=_Loader)  # noqa: S506  a SafeLoader


def to_yaml(content: Mapping[str, Any]) -> str:
    """Text of a YAML file that `read_mapping` reads back.

    Args:
        content: Plain values, in mappings and sequences of any kind.

    Raises:
        yaml.YAMLError: A value is no plain one.
    """
    return yaml.dump(_plain(content), Dumper=_Dumper, sort_keys=False, allow_unicode=True)


def _plain(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, Sequence) and not isinstance(content, str):
        return [_plain(value) for value in content]
    return content


def _resolved(content: dict[Any, Any], path: Path, argument: str) -> Any:
    """The values of a file whose interpolations lead to others of its values."""
    with needs("stack", f"`${{...}}` in {path}"):
        from omegaconf import OmegaConf
        from omegaconf.errors import OmegaConfBaseException
    try:
        return OmegaConf.to_container(OmegaConf.create(content), resolve=True)
    except OmegaConfBaseException as problem:
        raise _no_yaml(argument, path, problem) from problem


def _no_yaml(argument: str, path: Path, problem: Exception, remedy: str = "") -> ValueError:
    told = " ".join(f"{path}: {problem}".split())
    return ValueError(message(argument, "be a YAML file", told, "", remedy))


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
