"""Calls of the code of effects, which may be a user's: what goes wrong there is told with the name of the effect."""

import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from particles_mpi.errors import SceneError, StoppedError, one_line
from particles_mpi.scene.effect import Effect, EffectOptions, Event, Force, VelocityFlow


def told(name: str, what: str, error: BaseException) -> str:
    """The message about an error in the code of the effect of that name."""
    return f"effects.{name}: {what}: {type(error).__name__}: {one_line(error)}"


def faults_in(name: str, options: EffectOptions, scene: Any) -> list[str]:
    """What is wrong with the options of the effect of that name in a scene, each beginning with its key in the scene file."""
    try:
        found: Any = options.faults(scene) or []
        return [f"effects.{name}.{fault}" for fault in ([found] if isinstance(found, str) else found)]
    except (Exception, SystemExit) as error:
        raise SceneError(told(name, "its `faults` failed", error)) from error


def built(name: str, options: EffectOptions, scene: Any) -> Any:
    """The effect of that name with its options. SceneError if it cannot be made."""
    try:
        made = options.effect_class()(options, scene)
        if options.file and (taken := names_taken(made, scene.dimension)):
            raise SceneError(f"effects.{name}.file: self.{taken[0]} means something else to the program: use another name")
        return made
    except SceneError:
        raise
    except (Exception, SystemExit) as error:
        raise SceneError(told(name, "it cannot be made", error)) from error


def names_taken(effect: Any, dimension: int) -> list[str]:
    """Attributes that an effect has set, though they are methods of its kind, or the `g` of a force and no (d,)."""
    kinds = [kind for kind in (Effect, Force, VelocityFlow, Event) if isinstance(effect, kind)]
    taken = [key for key in vars(effect) if any(callable(getattr(kind, key, None)) for kind in kinds)]
    g = vars(effect).get("g") if isinstance(effect, Force) else None
    return taken + ["g"] * (g is not None and np.shape(g) != (dimension,))


def asked(name: str, method: Callable[..., Any], *arguments: Any) -> Any:
    """What a method of an effect returns. StoppedError, which names the effect, file and line, where it fails."""
    try:
        return method(*arguments)
    except (StoppedError, SceneError, MemoryError):
        raise
    except Exception as error:
        own = getattr(sys.modules.get(getattr(method, "__module__", "")), "__file__", None)
        calls = [call for call in traceback.extract_tb(error.__traceback__) if call.filename == own]
        where = f" (at {Path(calls[-1].filename).name}:{calls[-1].lineno} {calls[-1].name})" if calls else ""
        raise StoppedError(told(name, f"its `{getattr(method, '__name__', 'method')}` failed", error) + where) from error


def call_in_place(name: str, method: Callable[..., Any], *arguments: Any) -> None:
    """Call a method of an effect that changes arrays in place. StoppedError if it returns something, which would be lost."""
    if asked(name, method, *arguments) is not None:
        raise StoppedError(f"effects.{name}: its `{method.__name__}` must change the arrays that it is given, and return nothing")


def number_from(name: str, returned: Any) -> int:
    """How many particles an event says that it changed. StoppedError for what is no such number."""
    if isinstance(returned, int | np.integer) and not isinstance(returned, bool) and returned >= 0:
        return int(returned)
    raise StoppedError(f"effects.{name}: its `act` returned {returned!r:.60}, and not how many particles it has changed")
