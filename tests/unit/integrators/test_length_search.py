"""The length of a step that ends with a contact: zeros, jumps, and that the search ends."""

import pytest

from particles_mpi.integrators.length_search import MOST_ROOT_TRIES, PAST_JUMP, LengthSearch


def search(moment, whole=1.0):
    """(search, how late its last try was, tries) if the contact of a step kicked for h comes at moment(h), None for never."""
    found, tries = LengthSearch(whole), 0
    while True:
        tries += 1
        at, h = moment(found.h), found.h
        late = (whole if at is None else min(at, whole)) - h
        if found.ends_with(late, at is not None) or found.jump:
            return found, late, tries
        assert tries <= MOST_ROOT_TRIES


@pytest.mark.parametrize("where", [0.0, 1e-12, 1e-4, 0.3, 0.999])
def test_smooth(where):
    """Secants: few tries."""
    found, late, tries = search(lambda h: max(0.0, where + 0.3 * (h - where) - 0.2 * (h - where) ** 2))
    assert not found.jump and abs(late) <= 1e-14 and found.h == pytest.approx(where, abs=2e-14)
    assert tries <= 8


@pytest.mark.parametrize("later", [0.4, None])
def test_a_jump_is_where_the_step_ends(later):
    """From h = 0.3 on there is a contact at 0.1; in shorter steps it comes after their end, or never."""
    found, _, _ = search(lambda h: 0.1 if h >= 0.3 else later)
    assert found.jump and 0.3 - 1e-13 <= found.h < 0.3


def test_a_zero_beyond_a_jump_is_found():
    found, late, _ = search(lambda h: 0.05 if h > 0.7 else 0.31 + 0.1 * (h - 0.31))
    assert not found.jump and abs(late) <= 1e-14 and found.h == pytest.approx(0.31, abs=1e-13)


def test_at_a_jump_soon_after_the_start_time_goes_on_with_a_contact():
    found, late, _ = search(lambda h: 0.2 * PAST_JUMP if h >= 0.5 * PAST_JUMP else 0.6 * PAST_JUMP)
    assert not found.jump and abs(late) <= PAST_JUMP
    assert late == pytest.approx(0.1 * PAST_JUMP, abs=1e-12)  # the shorter step: less late than the other is early
