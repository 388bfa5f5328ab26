"""The scene file: TOML is read and becomes a validated model. Faults that only the particles can show are found by `populate`."""

import sys
import tomllib
from math import inf, prod
from operator import is_
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, PrivateAttr, ValidationError, field_validator, model_validator

from particles_mpi.errors import SceneError
from particles_mpi.particles import Array
from particles_mpi.scene.calls import faults_in
from particles_mpi.scene.effect import VelocityFlow
from particles_mpi.scene.effect_files import plain_options, validated_effects
from particles_mpi.scene.losses import Losses
from particles_mpi.scene.model import LARGEST_NUMBER, Flags, Model, NotNegative, faults_of, python_values, values_in, wrong_length
from particles_mpi.scene.population import Population, population_faults

FORMATS: list[Literal["hdf5", "vtk"]] = ["hdf5", "vtk"]
TOLERANCES = 1e-12, 1e-3  # of `adaptive`, smallest and largest: below, round-off of the forces alone is more


class Box(Model):
    """The region that holds the particles; faces that are not periodic are the default walls."""

    lower: list[float]
    upper: list[float]
    periodic: Flags = False


class Time(Model):
    """Step length, end, and the rule that advances a step."""

    step: Annotated[float, Field(gt=0.0)]
    end: NotNegative | None = None
    steps: Annotated[int, Field(ge=0, lt=10**15)] | None = None
    integrator: Literal["leapfrog", "order4", "taylor", "adaptive"] = "leapfrog"
    tolerance: Annotated[float, Field(ge=TOLERANCES[0], le=TOLERANCES[1])] | None = None

    @model_validator(mode="after")
    def _one_end(self) -> Self:
        if (self.end is None) == (self.steps is None):
            raise ValueError("time.steps: give either time.end or time.steps")
        if self.tolerance is not None and self.integrator != "adaptive":
            raise ValueError('time.tolerance: only with integrator "adaptive"')
        if self.end is not None and not self.end / self.step < 1e15:
            raise ValueError(f"time.end: {self.end:g} is too many steps of {self.step:g}")
        return self


class Output(Model):
    """What a run writes, and after how many steps. It may be changed while a simulation uses it, and is then checked again.

    If the scene does not give `every`, and the run has fewer steps than its default, `every` is the number of steps of the run.
    """

    model_config = ConfigDict(validate_assignment=True)
    every: Annotated[int, Field(ge=1)] = 100
    formats: list[Literal["hdf5", "vtk"]] = Field(default=FORMATS)
    checkpoint_every: Annotated[int, Field(ge=1)] = 1000
    diagnostics_every: Annotated[int, Field(ge=1)] = 10
    observables: bool = False
    orientation: bool = False

    @field_validator("formats")
    @classmethod
    def _once(cls, formats: list[str]) -> list[str]:
        if len(set(formats)) < len(formats):
            raise ValueError("names a format twice")
        return formats

    def __setattr__(self, name: str, value: Any) -> None:
        try:
            super().__setattr__(name, value)
        except ValidationError as error:
            raise SceneError(faults_of(error, type(self), ("output",))) from None

    def running(self) -> Self:
        return self.model_copy(deep=True)


class Scene(Model):
    """A validated scene: what is simulated, for how long, and what is written.

    `Scene.load(path)` reads a TOML file, `Scene.from_dict(tables)` takes the same tables as dictionaries, and `Scene(...)` takes
    them as keyword arguments. All raise `SceneError`.
    """

    folder: Annotated[Path, Field(exclude=True)] = Path()
    title: str = ""
    dimension: Annotated[int, Field(ge=1, le=1000)]
    seed: Annotated[int, Field(ge=0, lt=2**64)] = 0
    G: NotNegative = 6.6740831e-11
    box: Box | None = None
    time: Time
    particles: list[Population]
    effects: Annotated[dict[str, Any], BeforeValidator(validated_effects)] = Field(default_factory=dict)
    output: Output = Output()
    _validated: list[Any] = PrivateAttr([])  # what `values_in` gave at the last validation

    def __init__(self, **tables: Any):
        try:
            super().__init__(**python_values(tables))
        except ValidationError as error:
            raise SceneError(faults_of(error, Scene)) from None

    def __eq__(self, other: object) -> bool:
        """Compare the tables, whichever file they come from."""
        return isinstance(other, Scene) and self.to_dict() == other.to_dict()

    @classmethod
    def from_dict(cls, tables: dict[str, Any], folder: str | Path = "") -> Self:
        """A scene from the tables of the TOML layout; file names in it are relative to `folder`."""
        if not isinstance(tables, dict):
            raise SceneError(f"a scene must be a table of tables, not {tables!r:.60}")
        if "folder" in tables:
            raise SceneError("folder: unknown key")
        return cls(**tables, folder=Path(folder))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read and validate a scene file; every fault names the file and the key."""
        path = Path(path)
        try:
            tables = tomllib.loads(path.read_text(encoding="utf-8-sig"))
        except OSError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror})") from None
        except (ValueError, RecursionError) as error:  # also bytes that are no text, numbers of thousands of digits
            raise SceneError(f"{path}: not a TOML file: {error}") from None
        try:
            return cls.from_dict(tables, path.parent)
        except SceneError as error:
            raise SceneError([f"{path}: {fault}" for fault in error.faults]) from None

    def checked(self) -> Self:
        """Return this scene, or one that is validated again if its tables were changed since it was made. Raises `SceneError`.

        A number that was changed within a list is not noticed.
        """
        now = values_in(self)
        if len(now) == len(self._validated) and all(map(is_, now, self._validated)):
            return self
        output: Any = self.output
        if isinstance(output, Output):  # keys that were not set get their defaults anew
            output = output.model_dump(exclude_unset=True) | ({"formats": output.formats} if output.formats != FORMATS else {})
        return self.from_dict(self.to_dict() | {"output": output}, self.folder)

    def to_dict(self) -> dict[str, Any]:
        """Return the tables from which this scene can be made again, as plain lists, numbers and text."""
        tables = self.model_dump(  # including what a script has set, see `checked`
            mode="json", exclude_none=True, exclude={"effects"}, warnings=False, fallback=python_values
        )
        effects = {
            name: options if isinstance(options, dict) else plain_options(options) for name, options in self.effects.items()
        }
        shown = {name: {k: v for k, v in table.items() if (k, v) != ("active", True)} for name, table in effects.items()}
        return tables | {"effects": shown}

    @property
    def outside(self) -> dict[str, Any]:
        """Options of the effects from outside the program, by name."""
        return {name: options for name, options in self.effects.items() if options.file}

    def digests(self) -> dict[str, str]:
        """sha256 of the files of effects from outside the program, by effect."""
        return {name: sys.modules[type(options).__module__].digest for name, options in self.outside.items()}

    @property
    def periodic(self) -> list[bool]:
        """Which axes are periodic; none where space is open."""
        flags = self.box.periodic if self.box else False
        return flags if isinstance(flags, list) else [flags] * self.dimension

    @property
    def corners(self) -> tuple[Array, Array]:
        """The lower and the upper corner of the box, (d,) each; infinite where space is open."""
        lower, upper = (self.box.lower, self.box.upper) if self.box else ([-inf] * self.dimension, [inf] * self.dimension)
        return np.array(lower, float), np.array(upper, float)

    @property
    def periodic_length(self) -> Array:
        """(d,): length of periodic axes, 0 of the others."""
        lower, upper = self.corners
        return np.where(self.periodic, upper - lower, 0.0)

    @property
    def active(self) -> dict[str, Any]:
        """The options of the effects that are not switched off, by name."""
        return {name: options for name, options in self.effects.items() if options.active}

    @property
    def steps(self) -> int:
        """How many steps the run takes; the last one reaches `end` at the nearest whole step."""
        return round((self.time.end or 0.0) / self.time.step) if self.time.steps is None else self.time.steps

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        d, faults = self.dimension, self.effect_faults()
        if self.box:
            faults += wrong_length("box.lower", self.box.lower, d) + wrong_length("box.upper", self.box.upper, d)
            if len(self.periodic) != d:
                faults.append(f"box.periodic: {len(self.periodic)} flags in dimension {d}")
            for k, (lo, hi) in enumerate(zip(self.box.lower, self.box.upper)):
                if not hi > lo:
                    faults.append(f"box.upper: {hi} is not above box.lower {lo} on axis {k}")
            volume = prod(hi - lo for lo, hi in zip(self.box.lower, self.box.upper))
            if not faults and not 1.0 / LARGEST_NUMBER < volume < inf:
                faults.append(f"box: its volume {volume:g} is too small or too large to compute with")
        if "vtk" in self.output.formats and d > 3:
            self.output.formats.remove("vtk")
            if not self.output.formats:
                faults.append(f'output.formats: VTK files have three axes at most; in dimension {d} use "hdf5"')
        if "every" not in self.output.model_fields_set and 0 < self.steps < self.output.every:
            self.output.every = self.steps
            self.output.model_fields_set.discard("every")  # the user has not set it
        for number, population in enumerate(self.particles):
            faults += population_faults(self, f"particles[{number}]", population)
        if self.output.orientation and not self.rough:
            faults.append("output.orientation: spheres turn only with friction in [effects.collisions] or [effects.walls]")
        if faults:
            raise ValueError("\n".join(faults))
        self._validated = values_in(self)
        return self

    def effect_faults(self) -> list[str]:
        """Return faults: options of effects that are impossible in this scene, and effects that the integrator cannot compute."""
        integrator, faults = self.time.integrator, []
        reason = {"order4": "goes back in time between kicks", "adaptive": "needs smooth paths"}.get(integrator)
        for name, options in self.effects.items():
            effect = options.effect_class()
            if integrator not in effect.needs.integrators:
                why = f"{reason}, which {name} does not allow" if reason else f"cannot compute {name}"
                faults.append(f'time.integrator: "{integrator}" {why}; use "leapfrog"')
            elif integrator == "taylor" and getattr(effect, "rate", None) is VelocityFlow.rate:
                faults.append(f'time.integrator: "taylor" needs a method `rate` of the effect {name}; use "leapfrog"')
            faults += faults_in(name, options, self)
        return faults

    @property
    def rough(self) -> bool:
        """Does an effect make spheres rough?"""
        tables = [options for options in self.effects.values() if isinstance(options, Losses)]
        return any(losses.rough for table in tables for losses in table.parts().values())

    @property
    def columns(self) -> dict[str, Any]:
        """The per-particle columns that effects from outside the program bring, by name."""
        outside = [options.effect_class().needs.columns for options in self.outside.values()]
        return {name: column for columns in outside for name, column in columns.items()}
