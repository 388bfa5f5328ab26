"""Calls the methods of effects, which may be a user's own. If one fails, the error names the effect."""

import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.errors import SceneError, StoppedError, one_line
from particles_mpi.scene.effect import Effect, EffectOptions, Event, Force, VelocityFlow


def error_message(name: str, what: str, error: BaseException) -> str:
    """Return the message about an error in the code of effect `name`; `what` says which part of it failed."""
    return f"effects.{name}: {what}: {type(error).__name__}: {one_line(error)}"


def faults_in(name: str, options: EffectOptions, scene: Any) -> list[str]:
    """Return what is wrong with the options of effect `name` in a scene: lines that begin with the key in the scene file."""
    try:
        found: Any = options.faults(scene) or []
        return [f"effects.{name}.{fault}" for fault in ([found] if isinstance(found, str) else found)]
    except (Exception, SystemExit) as error:
        raise SceneError(error_message(name, "its `faults` failed", error)) from error


def built(name: str, options: EffectOptions, scene: Any) -> Any:
    """The effect of that name with its options. SceneError if it cannot be made."""
    try:
        made = options.effect_class()(options, scene)
        if options.file and (taken := names_taken(made, scene.dimension)):
            raise SceneError(f"effects.{name}.file: self.{taken[0]} is used by the program itself: use another name")
        return made
    except SceneError:
        raise
    except (Exception, SystemExit) as error:
        raise SceneError(error_message(name, "it cannot be made", error)) from error


def names_taken(effect: Any, dimension: int) -> list[str]:
    """Return attributes of an effect that replace a method of its kind, or, of a force, a `g` whose shape is not (d,)."""
    kinds = [kind for kind in (Effect, Force, VelocityFlow, Event) if isinstance(effect, kind)]
    taken = [key for key in vars(effect) if any(callable(getattr(kind, key, None)) for kind in kinds)]
    g = vars(effect).get("g") if isinstance(effect, Force) else None
    return taken + ["g"] * (g is not None and np.shape(g) != (dimension,))


def call_method(name: str, method: Callable[..., Any], *arguments: Any) -> Any:
    """Call a method of an effect and return its value. If it fails, StoppedError names effect, file and line."""
    try:
        return method(*arguments)
    except (StoppedError, SceneError, MemoryError):
        raise
    except Exception as error:
        own = getattr(sys.modules.get(getattr(method, "__module__", "")), "__file__", None)
        calls = [call for call in traceback.extract_tb(error.__traceback__) if call.filename == own]
        where = f" (at {Path(calls[-1].filename).name}:{calls[-1].lineno} {calls[-1].name})" if calls else ""
        raise StoppedError(error_message(name, f"its `{getattr(method, '__name__', 'method')}` failed", error) + where) from error


def call_in_place(name: str, method: Callable[..., Any], *arguments: Any) -> None:
    """Call a method of an effect that changes arrays in place. Raises StoppedError if it returns a value, which would be lost."""
    if call_method(name, method, *arguments) is not None:
        raise StoppedError(f"effects.{name}: its `{method.__name__}` must change the arrays that it is given, and return nothing")


def number_from(name: str, returned: Any) -> int:
    """Return the number of particles that an event says it has changed. StoppedError if it is no such number."""
    if isinstance(returned, int | np.integer) and not isinstance(returned, bool) and returned >= 0:
        return int(returned)
    raise StoppedError(f"effects.{name}: its `act` returned {returned!r:.60}, and not the number of particles that it changed")
