"""The base of all tables of a scene file, what their keys may hold, and faults as messages."""

import difflib
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Annotated, Any, Literal, Self, Union, get_args

import numpy as np
from annotated_types import Len
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PrivateAttr,
    TypeAdapter,
    ValidationError,
    field_validator,
)

LARGEST_NUMBER = 1e100
NUMBER_TYPES = {float, int, bool}
NotNegative = Annotated[float, Field(ge=0.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class Model(BaseModel):
    """The base class of all tables. It is strict: an unknown key, or a number that is given as text, is an error."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
    _running: bool = PrivateAttr(False)  # does a simulation use it? Then it is read-only

    def __setattr__(self, name: str, value: Any) -> None:
        if name in type(self).model_fields and self._running:
            raise AttributeError(
                f"{name}: the scene of a simulation cannot be changed, for the simulation would not see the change;"
                " set sim.h, sim.time, or an option of sim.effects[name]"
            )
        super().__setattr__(name, value)

    @field_validator("*")
    @classmethod
    def _in_range(cls, value: Any) -> Any:
        """Check that a number, or each number in a list, is not beyond LARGEST_NUMBER."""
        for number in value if isinstance(value, list) else [value]:
            if isinstance(number, float):
                not_too_large(number)
        return value

    def running(self) -> Self:
        """Return a copy, with copies of all tables within, which a simulation uses and which can no longer be changed."""
        copy = self.model_copy(update={name: frozen_copy(value) for name, value in self})
        copy._running = True
        return copy


def python_values(value: Any) -> Any:
    """A value of a table with lists and numbers of Python in place of arrays and tuples, at any depth."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: python_values(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        kinds = set(map(type, value))
        if kinds == {list} and set(map(type, chain.from_iterable(value))) <= NUMBER_TYPES:
            return [row[:] for row in value]  # rows of numbers, of which there may be very many
        return list(value) if kinds <= NUMBER_TYPES else [python_values(inner) for inner in value]
    return value


def values_in(value: Any) -> list[Any]:
    """Return all objects in a table and in the tables within it: keys, values, and entries of lists of tables or texts."""
    if isinstance(value, BaseModel):
        parts = [inner for _, inner in value]
    elif isinstance(value, dict):
        parts = [*value, *value.values()]
    else:  # nothing of a list of numbers, which may be very long
        parts = value if value and isinstance(value[0], BaseModel | dict | str) else []
    return parts + [part for inner in parts if isinstance(inner, list | dict | BaseModel) for part in values_in(inner)]


def frozen_copy(value: Any) -> Any:
    """Return a value of a table, with `running` copies of the tables in it and copies of its lists."""
    if isinstance(value, dict):
        return {name: frozen_copy(inner) for name, inner in value.items()}
    if isinstance(value, list):
        return python_values(value) if not value or not isinstance(value[0], Model) else [frozen_copy(inner) for inner in value]
    return value.running() if isinstance(value, Model) else value


def wrong_length(key: str, value: Any, dimension: int) -> list[str]:
    """Return a fault for each vector, or vector in a list, that has another number of components than `dimension`."""
    if isinstance(value, list) and value and isinstance(value[0], list):
        return [fault for i, row in enumerate(value) for fault in wrong_length(f"{key}[{i}]", row, dimension)]
    wrong = isinstance(value, list) and len(value) != dimension
    return [f"{key}: {len(value)} components in dimension {dimension}"] if wrong else []


def suggestion(name: str, known: list[str]) -> str:
    near = difflib.get_close_matches(name, known)
    meant = [one for one in near if name in one] or near[:1]  # of gravity: both kinds
    return f" (did you mean {' or '.join(map(repr, meant))}?)" if meant else f" (known: {', '.join(known)})"


def misspelt(missing: Any, given: Any, known: list[str]) -> str:
    """Return a text that names the unknown key which is most like the missing one, "" if none is."""
    unknown = [str(key) for key in given if key not in known] if isinstance(given, dict) else []
    near = difflib.get_close_matches(str(missing), unknown, 1, 0.75)
    return f" (got {near[0]!r})" if near else ""


def key_of(location: tuple[Any, ...]) -> str:
    text = ""
    for part in location:
        name = part if str(part).isprintable() else repr(part)  # a key may hold a newline, but a fault is one line
        text += f"[{part}]" if isinstance(part, int) else f".{name}" if text else str(name)
    return text


def tables_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The tables that an annotation names."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from tables_in(part)


def faults_of(error: ValidationError, model: type[BaseModel], prefix: tuple[Any, ...] = ()) -> list[str]:
    """Return the faults in a validation error, one line for each: `key: what is wrong`."""
    faults = []
    for item in error.errors():
        place, given, kind = item["loc"], item.get("input"), item["type"]
        key, known = key_of(prefix + place), list[str]()
        if kind in ("extra_forbidden", "missing"):
            tables = tables_in(model.model_fields[str(place[0])].annotation) if len(place) > 1 else iter([model])
            known = [name for table in tables for name in table.model_fields if name != "folder"]
        if kind == "value_error":
            text = str(item["ctx"]["error"])
            named = place and place[0] != "effects" and place != ("time",)
            faults += [f"{key}: {text}"] if named else text.splitlines()
        elif kind == "extra_forbidden":
            faults.append(f"{key}: unknown key{suggestion(str(place[-1]), known)}")
        else:
            message = item["msg"].replace("Input should be", "must be").replace("Input", "input")
            message = message.replace("a valid list", "a list").replace("a valid boolean", "true or false")
            message = "must be a table" if kind == "model_type" else message
            message += f" of tables: [[{key}]]" if kind == "list_type" and isinstance(given, dict) else ""
            short = isinstance(given, str | float | bool) or (isinstance(given, int) and abs(given) < 10**20)
            shown = f" (got {given!r})" if short else ""
            text = f"missing{misspelt(place[-1], given, known)}" if kind == "missing" else f"{message}{shown}"
            faults.append(f"{key}: {text}")
    return faults


def not_too_large(value: Any) -> Any:
    if not abs(value) <= LARGEST_NUMBER:
        limits = f"-{LARGEST_NUMBER:g} and {LARGEST_NUMBER:g}"
        raise ValueError(f"{value} is not a number between {limits}, beyond which squares and products overflow")
    return value


def in_order(value: Any) -> Any:
    if value["min"] > value["max"]:
        raise ValueError(f"min {value['min']} is above max {value['max']}")
    return value


def table_of(value: Any, *keys: str, check: Any = None) -> Any:
    """Return the type of a table that has exactly these keys, each of which holds a `value`."""
    return Annotated[dict[Literal[keys], value], Len(len(keys), len(keys)), check]  # type: ignore[valid-type]


def one_of(fault: str, *kinds: Any) -> Any:
    """Return a type that accepts values of these kinds and keeps them as given. `fault`: the message about others."""
    any_of: Any = Union[kinds]  # noqa: UP007
    adapter: TypeAdapter[Any] = TypeAdapter(any_of, config=ConfigDict(strict=True))

    def check(value: Any) -> Any:
        try:
            adapter.validate_python(value)
        except ValidationError as error:
            reasons = [str(item["ctx"]["error"]) for item in error.errors() if item["type"] == "value_error"]
            raise ValueError(reasons[0] if reasons else fault) from None
        return value

    return Annotated[Any, BeforeValidator(check)]


Number = Annotated[int | float, AfterValidator(not_too_large)]
NotNegativeNumber = Annotated[Number, Field(ge=0)]
Numbers = list[Number]
Points = Annotated[list[Numbers], Len(1)]
File = table_of(str, "file")
Range = table_of(Number, "min", "max", check=AfterValidator(in_order))
Speed = table_of(NotNegativeNumber, "min", "max", check=AfterValidator(in_order))

Scalar = one_of("must be a number, {min = a, max = b} or a list of numbers", Number, Range, Numbers)
Flags = one_of("must be true, false or a list of these", bool, list[bool])
Vectors = one_of("must be a vector [ax, ay, ...] or a list of these", Numbers, Points)
Warmth = table_of(NotNegativeNumber, "temperature")
Spin = one_of("must be a number, {temperature = T} with T >= 0, or a list of numbers", Number, Numbers, Warmth)
SpinVector = one_of("must be a vector [sx, sy, sz], a list of these or {temperature = T} with T >= 0", Numbers, Points, Warmth)
Position = one_of(
    'must be "random", "lattice", a list of points [[x, y, ...], ...], {plummer = scale length > 0} or {file = "start.csv"}',
    *(Literal["random", "lattice"], list[Numbers], File, table_of(Annotated[Number, Field(gt=0)], "plummer")),
)
Velocity = one_of(
    "must be [vx, vy, ...], a list of these, {speed = s}, {speed = {min = a, max = b}}, {temperature = T} (all >= 0),"
    ' {file = "start.csv"} or, with position = {plummer = a}, "equilibrium"',
    *(Literal["equilibrium"], Points, Numbers, File, Warmth, table_of(NotNegativeNumber | Speed, "speed")),
)
