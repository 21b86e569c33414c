"""Where an environment of a cache came from, so that other recordings do not take its place."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from data_converters.cache import write_json
from data_converters.conversion_settings import ConversionSettings
from data_converters.errors import require
from data_converters.recordings import SceneSource, fingerprint

ORIGIN_FILE = "origin.json"


def write_origin(settings: ConversionSettings, sources: Iterable[SceneSource]) -> None:
    """Write the origin of an environment into the folder in which it grows."""
    content = {"root": _place(settings.dataset.root), "recordings": _recordings(sources)}
    write_json(settings.staging / ORIGIN_FILE, content)


def require_same_origin(settings: ConversionSettings, sources: Iterable[SceneSource]) -> None:
    """Refuse recordings that would take the place of others under the same name.

    A folder that was moved, with the same recordings in it, is the same; so is a folder whose
    recordings changed where they are.

    Args:
        settings: The conversion; whoever sets its `replace` has nothing refused.
        sources: The scenes that are to be converted.

    Raises:
        ConversionError: The environment was made from another folder with other recordings.
    """
    cache, name, root = settings.cache, settings.dataset.name, _place(settings.dataset.root)
    origin = _origin(cache / name / ORIGIN_FILE)
    moved = origin.get("recordings") == _recordings(sources)
    same = not origin or settings.replace or origin.get("root") == root or moved
    needs = f"be the folder from which '{name}' in {cache} was converted, {origin.get('root')!r}"
    remedy = (
        "To keep both, give another data.cache, or, for own tables, another data.name; to put "
        "these recordings in the place of the others, add replace=true (scenes whose files did "
        "not change are kept)."
    )
    require(same, "root", needs, root, "", remedy)


def _origin(path: Path) -> dict[str, object]:
    """What the file says; nothing where there is none, or none that can be read."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _place(root: Path) -> str:
    return str(root.expanduser().resolve())


def _recordings(sources: Iterable[SceneSource]) -> str:
    """Hash of names and files of all scenes, wherever they lie and whatever their split."""
    return fingerprint(repr(sorted((each.name, each.fingerprint) for each in sources)).encode())
