"""The file of an effect: found, loaded, and asked for its two classes. An effect that no scene names is never loaded."""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import sys
from hashlib import sha256
from pathlib import Path
from types import ModuleType

from particles_mpi.scene.effect import KINDS
from particles_mpi.scene.model import EffectOptions

PACKAGE = "particles_mpi.effects"
OUTSIDE = "particles_mpi_effect"  # modules of effects from outside the package are called so, with a digest of their path


def effect_names() -> list[str]:
    """The effects that come with the program: one file each in `effects/`."""
    package = importlib.import_module(PACKAGE)
    return sorted(module.name for module in pkgutil.iter_modules(package.__path__))


def load_effect(name: str, file: Path | None) -> ModuleType:
    """The module of an effect of the program, or of a `file` of the user's, which is loaded once.

    The attribute `digest` of the latter is the sha256 of its file.

    Raises ValueError, one line without the key, for a file that cannot be read, fails, or does not hold the two classes.
    """
    if file is None:
        return importlib.import_module(f"{PACKAGE}.{name}")
    path = file.resolve()
    title = f"{OUTSIDE}_{sha256(str(path).encode()).hexdigest()[:12]}_{path.stem}"
    if title in sys.modules:
        return sys.modules[title]
    spec = importlib.util.spec_from_file_location(title, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise ValueError(f"{file}: no such Python file")
    module = sys.modules[title] = importlib.util.module_from_spec(spec)
    module.digest = sha256(path.read_bytes()).hexdigest()  # type: ignore[attr-defined]
    try:
        spec.loader.exec_module(module)
        check_classes(module)
    except Exception as error:
        del sys.modules[title]
        if isinstance(error, ValueError):
            raise ValueError(f"{file}: {error}") from None
        raise ValueError(f"{file}: {type(error).__name__}: {' '.join(str(error).split())}") from error
    return module


def check_classes(module: ModuleType) -> None:
    """Raises ValueError if the module has no class `Options` or `Effect`, or they are of no kind that the program knows."""
    options, effect = getattr(module, "Options", None), getattr(module, "Effect", None)
    if not (isinstance(options, type) and issubclass(options, EffectOptions)):
        raise ValueError("needs a class Options(EffectOptions)")
    if not (isinstance(effect, type) and issubclass(effect, KINDS)):
        raise ValueError("needs a class Effect that is a Force, a VelocityFlow or an Event")
    if not isinstance(getattr(effect, "formula", None), str):
        raise ValueError("its class Effect needs a formula, in one line")
