"""A simulator of moving, colliding particles in any dimension, on any number of MPI ranks.

from particles_mpi import Run, Scene, Simulation
Simulation(Scene.load("marbles.toml")).run("out/marbles")
Run("out/marbles")[-1].position
"""

from typing import Any

from particles_mpi.setup.freshness import forget_stale_kernels

forget_stale_kernels()

__all__ = ["Particles", "Run", "Scene", "SceneError", "Simulation", "StoppedError"]
__version__ = "0.1.0"

PUBLIC = {  # name → its module
    "Particles": "particles",
    "Run": "results.run",
    "Scene": "scene.schema",
    "SceneError": "errors",
    "Simulation": "simulation",
    "StoppedError": "errors",
}


def __getattr__(name: str) -> Any:
    """Import on first use, so that `--help` and the checks of one module do not wait for numba and MPI."""
    if name not in PUBLIC:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{PUBLIC[name]}"), name)
