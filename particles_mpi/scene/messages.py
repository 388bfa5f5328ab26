"""Faults of a scene as messages: one line each, which names the key."""

from __future__ import annotations

import difflib
from typing import Any, get_args

from pydantic import BaseModel, ValidationError


def wrong_length(key: str, value: list[float], dimension: int) -> list[str]:
    return [] if len(value) == dimension else [f"{key}: {len(value)} components in dimension {dimension}"]


def suggestion(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known, 1)
    return f" (did you mean '{near[0]}'?)" if near else f" (known: {', '.join(known)})"


def key_of(location: tuple[Any, ...]) -> str:
    text = ""
    for part in location:
        name = part if str(part).isprintable() else repr(part)  # a fault is one line, whatever the key
        text += f"[{part}]" if isinstance(part, int) else f".{name}" if text else str(name)
    return text


def known_keys(model: type[BaseModel], location: tuple[Any, ...]) -> list[str]:
    """The keys that the table at `location` may hold."""
    inner = model.model_fields.get(str(location[0])) if len(location) > 1 else None
    tables = [kind for kind in kinds(inner.annotation if inner else None) if issubclass(kind, BaseModel)]
    table = tables[0] if tables else model
    return [name for name in table.model_fields if name != "folder"]


def kinds(annotation: Any) -> list[type]:
    """The classes that an annotation names."""
    inside = [kind for part in get_args(annotation) for kind in kinds(part)]
    return inside or ([annotation] if isinstance(annotation, type) else [])


def faults_of(error: ValidationError, model: type[BaseModel], prefix: tuple[Any, ...] = ()) -> list[str]:
    """One line a fault: `key: what is wrong`."""
    faults = []
    for item in error.errors():
        location = prefix + item["loc"]
        if item["type"] == "extra_forbidden":
            faults.append(f"{key_of(location)}: unknown key{suggestion(str(location[-1]), known_keys(model, item['loc']))}")
        elif item["type"] == "missing":
            faults.append(f"{key_of(location)}: missing")
        elif item["type"] == "value_error":
            text = str(item["ctx"]["error"])
            named = item["loc"] and item["loc"][0] != "effects" and item["loc"] != ("time",)
            faults += [f"{key_of(location)}: {text}"] if named else text.splitlines()
        else:
            given = item.get("input")
            short = isinstance(given, str | float | bool) or (isinstance(given, int) and abs(given) < 10**20)
            shown = f" (got {given!r})" if short else ""
            message = item["msg"].replace("Input should be", "must be").replace("Input", "input")
            faults.append(f"{key_of(location)}: {message}{shown}")
    return faults
