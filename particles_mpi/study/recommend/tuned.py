"""Writes a scene file with other settings, and everything else as its author wrote it, remarks included."""

import os
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from particles_mpi import Scene
from particles_mpi.errors import SceneError

Tables = dict[str, Any]
OUTPUT_PERIODS = ("every", "diagnostics_every", "checkpoint_every")


def tuned(scene: Scene, variant: Scene, steps: int) -> Tables:
    """Return the tables of a scene with the settings of a variant, for a whole run in `steps`, with about as many frames."""
    tables, new = scene.to_dict(), variant.to_dict()
    step = scene.steps * scene.time.step / steps
    tables["time"] = {key: value for key, value in new["time"].items() if key not in ("step", "steps", "end")}
    tables["time"] |= {"step": step, "steps": steps}
    if scene.time.end is not None and round(scene.time.end / step) == steps:
        tables["time"]["end"] = scene.time.end
        del tables["time"]["steps"]
    tables["effects"] = new["effects"]
    for key in OUTPUT_PERIODS:
        tables["output"][key] = max(1, round(tables["output"][key] * steps / scene.steps))
    return tables


def written(tables: Tables, source: Path, target: Path, remark: str) -> str:
    """Return the text of `source` with the values of `tables` instead of its own, and `remark` as its first line.

    Files that the scene names are looked for beside the scene: a target in another folder needs other names for them.
    """
    scene, old, new = Scene.load(source), source.parent, target.parent
    wanted = tables if old.resolve() == new.resolve() else {key: moved(table, old, new) for key, table in tables.items()}
    document = tomlkit.parse(source.read_text(encoding="utf-8-sig"))
    try:
        enter(document, scene.to_dict(), wanted)
        text = tomlkit.dumps(document)
        faithful = Scene.from_dict(tomlkit.parse(text).unwrap(), target.parent) == Scene.from_dict(wanted, target.parent)
    except (TOMLKitError, SceneError):
        faithful = False
    if not faithful:
        raise SceneError(f"{target}: the tuned scene is not the same when it is read again; nothing was written")
    return f"# {remark}\n{text}"


def moved(value: Any, old: Path, new: Path) -> Any:
    """Return a value of a scene with file names relative to another folder, so that they name the same files."""
    if isinstance(value, list):
        return [moved(one, old, new) for one in value]
    if not isinstance(value, dict):
        return value
    return {key: os.path.relpath(old / one, new) if key == "file" else moved(one, old, new) for key, one in value.items()}


def enter(document: Any, old: Tables, new: Tables) -> None:
    """Enter into the tables of a TOML document the values that differ between `new` and `old`, and nothing else."""
    for key in (key for key in {**new, **old} if old.get(key) != new.get(key)):
        before, after = old.get(key), new.get(key)
        if after is None:
            document.pop(key, None)
        elif isinstance(before, dict) and isinstance(after, dict):
            enter(document.setdefault(key, tomlkit.table()), before, after)
        elif key == "particles":
            for population, one, other in zip(document[key], before or [], after, strict=True):
                enter(population, one, other)
        else:
            document[key] = after
