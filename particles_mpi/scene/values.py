"""What the keys of a population may hold: numbers, ranges, vectors, lists of them, names of files."""

from __future__ import annotations

from typing import Any

LARGEST = 1e100


def is_number(value: Any) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    if not abs(value) <= LARGEST:
        raise ValueError(
            f"{value} is not a number between -{LARGEST:g} and {LARGEST:g}, beyond which squares and products overflow"
        )
    return True


def is_numbers(value: Any) -> bool:
    return isinstance(value, list) and all(is_number(x) for x in value)


def is_range(value: Any) -> bool:
    return isinstance(value, dict) and set(value) == {"min", "max"} and is_number(value["min"]) and is_number(value["max"])


def is_points(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 0 and all(is_numbers(row) for row in value)


def is_file(value: Any) -> bool:
    return isinstance(value, dict) and set(value) == {"file"} and isinstance(value["file"], str)


def check_order(value: dict[str, float]) -> None:
    if value["min"] > value["max"]:
        raise ValueError(f"min {value['min']} is above max {value['max']}")


def is_plummer(value: Any) -> bool:
    return isinstance(value, dict) and set(value) == {"plummer"} and is_number(value["plummer"]) and value["plummer"] > 0


def position_given(value: Any) -> Any:
    if value in ("random", "lattice") or is_points(value) or is_file(value) or is_plummer(value):
        return value
    raise ValueError(
        'must be "random", "lattice", a list of points [[x, y, ...], ...], {plummer = scale length > 0} or {file = "start.csv"}'
    )


def velocity_given(value: Any) -> Any:
    if value == "equilibrium" or is_points(value) or is_numbers(value) or is_file(value):
        return value
    if (
        isinstance(value, dict)
        and set(value) == {"temperature"}
        and is_number(value["temperature"])
        and value["temperature"] >= 0
    ):
        return value
    if isinstance(value, dict) and set(value) == {"speed"}:
        speed = value["speed"]
        if is_number(speed) and speed >= 0:
            return value
        if is_range(speed) and speed["min"] >= 0:
            check_order(speed)
            return value
    raise ValueError(
        "must be [vx, vy, ...], a list of these, {speed = s}, {speed = {min = a, max = b}}, {temperature = T} (all >= 0),"
        ' {file = "start.csv"} or, with position = {plummer = a}, "equilibrium"'
    )


def scalar_or_list(value: Any) -> Any:
    if is_range(value):
        check_order(value)
        return value
    if is_number(value) or is_numbers(value):
        return value
    raise ValueError("must be a number, {min = a, max = b} or a list of numbers")


def flags(value: Any) -> Any:
    if isinstance(value, bool) or (isinstance(value, list) and all(isinstance(x, bool) for x in value)):
        return value
    raise ValueError("must be true, false or a list of these")


def vector_or_rows(value: Any) -> Any:
    if is_numbers(value) or is_points(value):
        return value
    raise ValueError("must be a vector [ax, ay, ...] or a list of these")
