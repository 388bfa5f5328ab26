"""Cases of a test that run with `--all` only: others of the same test show the same in less time."""

import pytest


def with_all(*cases):
    """`cases` as parameters for `pytest.mark.parametrize`: each a value, or a tuple of them."""
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow) for case in cases]
