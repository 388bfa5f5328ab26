"""The files of effects: those of the program, and those of a user."""

import importlib
import pkgutil
import sys
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import Any

from pydantic import BaseModel, ValidationError, ValidationInfo

from particles_mpi.errors import one_line
from particles_mpi.scene.effect import EffectOptions, Event, Force, VelocityFlow
from particles_mpi.scene.model import faults_of, key_of, python_values, suggestion

PACKAGE = "particles_mpi.effects"
# The method that a user's effect must have, by its kind. Each of the other kinds has one effect, which is the program's own.
METHODS = {Force: "add", VelocityFlow: "advance", Event: "act"}
OUTSIDE = "particles_mpi_effect"  # the name of modules from outside the package begins so; a digest of path and content follows


def effect_names() -> list[str]:
    """Return the names of the program's own effects, each of which is a file in `effects/`."""
    return sorted(module.name for module in pkgutil.iter_modules(importlib.import_module(PACKAGE).__path__))


def load_effect(name: str, file: Path | None) -> ModuleType:
    """Return the module of one of the program's effects, by its name; or that of a user's `file`, whatever its name in the scene.

    A file that has changed is loaded again, as a new module; simulations that use the old module keep it. `module.digest` is the
    sha256 of the file.

    Raises ValueError, one line without the key, for a file that cannot be read, fails, or does not hold the two classes.
    """
    if file is None:
        return importlib.import_module(f"{PACKAGE}.{name}")
    path = file.resolve()
    try:
        text = path.read_bytes()
    except OSError:
        raise ValueError(f"{file}: no such Python file") from None
    digest = sha256(text).hexdigest()
    title = f"{OUTSIDE}_{sha256(str(path).encode() + text).hexdigest()[:12]}_{path.stem}"
    if title in sys.modules:
        return sys.modules[title]
    module = sys.modules[title] = ModuleType(title)
    vars(module).update(__file__=str(path), digest=digest)
    try:
        exec(compile(text, path, "exec"), vars(module))
        options, effect = getattr(module, "Options", None), getattr(module, "Effect", None)
        if not (isinstance(options, type) and issubclass(options, EffectOptions) and options.__module__ == title):
            raise ValueError("needs a class Options(EffectOptions) of its own")
        if not (isinstance(effect, type) and issubclass(effect, tuple(METHODS))):
            raise ValueError("needs a class Effect that is a Force, a VelocityFlow or an Event")
        if not isinstance(getattr(effect, "formula", None), str):
            raise ValueError("its class Effect needs a formula, in one line")
        base, method = next((base, method) for base, method in METHODS.items() if issubclass(effect, base))
        if getattr(effect, method) is getattr(base, method):
            raise ValueError(f"its class Effect, a {base.__name__}, needs a method `{method}`")
    except (Exception, SystemExit) as error:
        del sys.modules[title]
        kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
        raise ValueError(f"{file}: {kind}{one_line(error)}") from error
    return module


def require_same_again(options: Any) -> None:
    """Raise ValueError for options that change on the way through a checkpoint: it has numbers, text, lists and tables only."""
    plain = plain_options(options)
    try:
        again = type(options).model_validate(plain)
    except ValidationError as error:
        keys = ", ".join(key_of(item["loc"]) for item in error.errors())
        raise ValueError(
            f"option {keys}: {error.errors()[0]['msg']}, when read from a checkpoint: use numbers, text or lists"
        ) from None
    here, there = python_values(dict(options)), python_values(dict(again))  # an array is the same as a list
    other = [key for key in here if here[key] != there[key]]
    if other:
        raise ValueError(f"option {other[0]}: changes on its way through a checkpoint: convert it in Effect.__init__")


def plain_options(options: Any) -> dict[str, Any]:
    """Return options as numbers, text, lists and tables; None only for a key whose default is not None."""
    plain: dict[str, Any] = options.model_dump(mode="json", warnings=False, fallback=python_values)
    return without_idle(options, plain)


def without_idle(value: Any, plain: Any) -> Any:
    """Return `plain`, the plain form of `value`, without the keys that are None and whose default is None."""
    if isinstance(value, BaseModel):
        fields = type(value).model_fields
        idle = {key: key in fields and getattr(value, key) is None and fields[key].default is None for key in plain}
        return {key: without_idle(getattr(value, key, None), inner) for key, inner in plain.items() if not idle[key]}
    if isinstance(value, dict) and isinstance(plain, dict):
        return {key: without_idle(value.get(key), inner) for key, inner in plain.items()}
    if isinstance(value, list | tuple) and isinstance(plain, list):
        return [without_idle(one, inner) for one, inner in zip(value, plain, strict=True)]
    return plain


def validated_effects(value: Any, info: ValidationInfo) -> dict[str, Any]:
    """Validate each `[effects.NAME]` by the Options of its file; an effect that is not named is not imported."""
    if not isinstance(value, dict):
        raise ValueError("effects: must be tables [effects.NAME]")
    validated, names = {}, effect_names()
    for name, keys in value.items():
        key = key_of(("effects", name))
        file = keys.get("file") if isinstance(keys, dict) else None
        if file is None and name not in names:
            raise ValueError(f"{key}: unknown effect{suggestion(name, names)}; an effect of your own needs the key file")
        if file is not None:
            if name in names:
                raise ValueError(f"{key}.file: {name} is a built-in effect; give yours another name")
            if not isinstance(file, str) or not str(name).isidentifier():
                raise ValueError(f"{key}.file: must be the name of a Python file, for an effect whose name is an identifier")
            keys = keys | {"file": str((info.data["folder"] / file).resolve())}
        try:
            options = load_effect(name, None if file is None else Path(keys["file"])).Options
            validated[name] = options.model_validate(keys)
            if file is not None:
                require_same_again(validated[name])
        except ValidationError as error:
            raise ValueError("\n".join(faults_of(error, options, ("effects", name)))) from None
        except ValueError as error:
            raise ValueError(f"{key}.file: {error}") from None
    return validated
