"""A scene file with other settings, and all else as its author wrote it."""

from __future__ import annotations

import json
import os
import re
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

from particles_mpi import Scene
from particles_mpi.errors import SceneError
from particles_mpi.scene.schema import Output, Time

Tables = dict[str, Any]
OUTPUT = ("every", "diagnostics_every", "checkpoint_every")
MANAGED = {
    "time": ("step", "steps", "end", "integrator", "tolerance"),
    "effects.collisions": ("mode", "passes", "contact_duration"),
    "effects.mutual_gravity": ("method", "opening_angle", "accuracy"),
    "output": OUTPUT,
}


def tuned(scene: Scene, variant: Scene, steps: int) -> Tables:
    """The tables of a scene with the settings of a variant of it, for a whole run in `steps`, with the same frames as before."""
    tables, new = scene.to_dict(), variant.to_dict()
    step = scene.steps * scene.time.step / steps
    tables["time"] = {key: value for key, value in new["time"].items() if key not in ("step", "steps", "end")}
    tables["time"] |= {"step": step, "steps": steps}
    if scene.time.end is not None and round(scene.time.end / step) == steps:
        tables["time"]["end"] = scene.time.end
        del tables["time"]["steps"]
    tables["effects"] = new["effects"]
    for key in OUTPUT:
        tables["output"][key] = max(1, round(tables["output"][key] * steps / scene.steps))
    return tables


def written(tables: Tables, source: Path | None, target: Path, remark: str) -> str:
    """The text of the tuned scene: that of `source` with other values, or all of it anew where that does not lead there.

    Files that the scene names are looked for beside the scene: another folder needs other names. `remark`: its first line.
    """
    folder = source.parent if source else Path()
    tables = moved(tables, folder, target.parent)
    if source:
        text = edited(source.read_text(encoding="utf-8"), tables)
        if text and same(text, tables, target.parent):
            return f"# {remark}\n{text}"
    text = "".join(serialised(tables))
    if not same(text, tables, target.parent):
        raise SceneError(f"{target}: the tuned scene does not come back as it should")
    return f"# {remark}\n{text}"


def same(text: str, tables: Tables, folder: Path) -> bool:
    """Does the text mean these tables?"""
    try:
        return Scene.from_dict(tomllib.loads(text), folder).to_dict() == Scene.from_dict(tables, folder).to_dict()
    except (ValueError, SceneError):
        return False


def moved(tables: Tables, old: Path, new: Path) -> Tables:
    """The same files, seen from another folder."""
    if old.resolve() == new.resolve():
        return tables
    populations = [
        {
            key: {"file": os.path.relpath(old / value["file"], new)} if isinstance(value, dict) and "file" in value else value
            for key, value in table.items()
        }
        for table in tables["particles"]
    ]
    return tables | {"particles": populations}


def edited(text: str, tables: Tables) -> str:
    """The text with the managed keys replaced, line by line; an [output] of its own where the scene has none."""
    if not re.search(r"^\[output\]", text, re.MULTILINE):
        text = f"{text.rstrip()}\n\n[output]\n"
    for section, keys in MANAGED.items():
        values: Any = tables
        for name in section.split("."):
            values = values.get(name, {})
        head = re.search(rf"^\[{re.escape(section)}\][^\n]*\n?", text, re.MULTILINE)
        if head is not None:
            after = re.search(r"^\[", text[head.end() :], re.MULTILINE)
            end = head.end() + after.start() if after else len(text)
            text = text[: head.end()] + replaced(text[head.end() : end], keys, values, defaults(section)) + text[end:]
    return text


def defaults(section: str) -> Tables:
    """What the keys of a table are where it does not give them."""
    model: Any = {"time": Time, "output": Output}.get(section)
    if model is None:
        model = import_module(f"particles_mpi.{section}").Options
    return {key: field.default for key, field in model.model_fields.items()}


def replaced(body: str, keys: tuple[str, ...], values: Tables, default: Tables) -> str:
    """The lines of a table with new values; new keys come first, keys without a value go."""
    lines, seen = [], set()
    for line in body.splitlines(keepends=True):
        match = re.match(r"(\s*)(\w+)(\s*=\s*)([^#\n]*?)(\s*(?:#[^\n]*)?\n?)$", line)
        if match and match[2] in keys:
            seen.add(match[2])
            if match[2] in values:
                kept = tomllib.loads(f"x = {match[4]}")["x"] == values[match[2]]
                lines.append(line if kept else f"{match[1]}{match[2]}{match[3]}{value(values[match[2]])}\n")
        else:
            lines.append(line)
    fresh = [f"{k} = {value(values[k])}\n" for k in keys if k in values and k not in seen and values[k] != default[k]]
    return "".join(fresh + lines)


def serialised(tables: Tables, prefix: str = "") -> list[str]:
    """Any tables of a scene as TOML, keys before tables."""
    lines = [f"{key} = {value(v)}\n" for key, v in tables.items() if not is_table(v)]
    for key, v in tables.items():
        if isinstance(v, dict) and is_table(v):
            lines += [f"\n[{prefix}{key}]\n", *serialised(v, f"{prefix}{key}.")]
        elif is_table(v):
            for row in v:
                lines += [f"\n[[{prefix}{key}]]\n", *(f"{name} = {value(x)}\n" for name, x in row.items())]
    return lines


def is_table(v: Any) -> bool:
    return isinstance(v, dict) or (isinstance(v, list) and bool(v) and all(isinstance(row, dict) for row in v))


def value(v: Any) -> str:
    """A TOML value."""
    if isinstance(v, dict):
        return "{" + ", ".join(f"{key} = {value(x)}" for key, x in v.items()) + "}"
    if isinstance(v, list):
        return "[" + ", ".join(map(value, v)) + "]"
    return repr(v) if isinstance(v, float) else json.dumps(v)
