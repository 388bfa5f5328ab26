"""What the keys of a population may hold: numbers, ranges, vectors, lists of them, names of files."""

from typing import Annotated, Any, Literal, Union

from annotated_types import Len
from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError

LARGEST = 1e100


def not_too_large(value: Any) -> Any:
    if not abs(value) <= LARGEST:
        raise ValueError(
            f"{value} is not a number between -{LARGEST:g} and {LARGEST:g}, beyond which squares and products overflow"
        )
    return value


def in_order(value: Any) -> Any:
    if value["min"] > value["max"]:
        raise ValueError(f"min {value['min']} is above max {value['max']}")
    return value


def table(value: Any, *keys: str, check: Any = None) -> Any:
    """A table with these keys and no others, each of which holds a `value`."""
    return Annotated[dict[Literal[keys], value], Len(len(keys), len(keys)), check]  # type: ignore[valid-type]


def one_of(told: str, *kinds: Any) -> Any:
    """What is of one of these kinds, and stays as it was given; `told`: what anything else is told."""
    any_of: Any = Union[kinds]  # noqa: UP007
    adapter: TypeAdapter[Any] = TypeAdapter(any_of, config=ConfigDict(strict=True))

    def check(value: Any) -> Any:
        try:
            adapter.validate_python(value)
        except ValidationError as error:
            reasons = [str(item["ctx"]["error"]) for item in error.errors() if item["type"] == "value_error"]
            raise ValueError(reasons[0] if reasons else told) from None
        return value

    return Annotated[Any, BeforeValidator(check)]


Number = Annotated[int | float, AfterValidator(not_too_large)]
Positive = Annotated[Number, Field(ge=0)]
Numbers = list[Number]
Points = Annotated[list[Numbers], Len(1)]
File = table(str, "file")
Range = table(Number, "min", "max", check=AfterValidator(in_order))
Speed = table(Positive, "min", "max", check=AfterValidator(in_order))

Scalar = one_of("must be a number, {min = a, max = b} or a list of numbers", Number, Range, Numbers)
Flags = one_of("must be true, false or a list of these", bool, list[bool])
Vectors = one_of("must be a vector [ax, ay, ...] or a list of these", Numbers, Points)
Position = one_of(
    'must be "random", "lattice", a list of points [[x, y, ...], ...], {plummer = scale length > 0} or {file = "start.csv"}',
    *(Literal["random", "lattice"], Points, File, table(Annotated[Number, Field(gt=0)], "plummer")),
)
Velocity = one_of(
    "must be [vx, vy, ...], a list of these, {speed = s}, {speed = {min = a, max = b}}, {temperature = T} (all >= 0),"
    ' {file = "start.csv"} or, with position = {plummer = a}, "equilibrium"',
    *(Literal["equilibrium"], Points, Numbers, File, table(Positive, "temperature"), table(Positive | Speed, "speed")),
)
