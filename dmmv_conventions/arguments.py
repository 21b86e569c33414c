"""Whether what a configuration has built takes the arguments that it is given.

A word too many is otherwise told when the part is built, after everything that it needs has been
imported, and with a traceback.
"""

from collections.abc import Collection
from typing import Any

from dmmv_conventions.checks import did_you_mean, message
from dmmv_conventions.definitions import defined
from dmmv_conventions.targets import parts

_OF_HYDRA = frozenset({"_target_", "_partial_", "_args_", "_convert_", "_recursive_"})


def require_arguments(content: Any, words: Collection[str] | None = None) -> None:
    """Refuse arguments that a part does not have; nothing is imported.

    Parts of this project, of Lightning and of torch are judged, as far as their sources tell.

    Args:
        content: Plain containers; interpolations have to be resolved.
        words: The command line; what none of them names stands in a file. None: not known.

    Raises:
        ValueError: A part has no argument of that name.
    """
    for place, node in parts(content):
        target = str(node["_target_"])
        found = defined(target)
        taken = found.arguments() if found is not None else None
        if taken is None:
            continue
        for name in sorted(set(node) - _OF_HYDRA - taken):
            key = f"{place}.{name}".lstrip(".")
            remedy = did_you_mean(name, taken, "`") or "Remove it."
            if words is not None and not any(name in word for word in words):
                part = place.partition(".")[0]
                remedy = f"A file of the configuration gives it: choose another `{part}`."
            wanted = f"be an argument of {target}"
            raise ValueError(message(key, wanted, node[name], "in the configuration", remedy))
