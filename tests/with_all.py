"""Cases of a test that run with `--all` or `--search` only: others of the same test show the same in less time."""

import pytest


def marked(mark, cases):
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=mark) for case in cases]


def with_all(*cases):
    """`cases` as parameters for `pytest.mark.parametrize`: each a value, or a tuple of them."""
    return marked(pytest.mark.slow, cases)


def with_search(*cases):
    """As `with_all`: more scenes at random, in which faults are looked for that nobody has thought of."""
    return marked(pytest.mark.search, cases)
