"""Checkpoints by pieces: who reads some rows gets those, and notices what is wrong with them, and with nothing else."""

import h5py
import numpy as np
import pytest

from particles_mpi.contacts.warm_start import Memory
from particles_mpi.errors import SceneError
from particles_mpi.output import checkpoint
from particles_mpi.output.checkpoint import Checkpoint, save
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange

N, M, PIECE = 95, 33, 10


@pytest.fixture
def written(tmp_path, monkeypatch):
    """(path, particles in id order, contacts in id order) of a state whose rows were in no order."""
    monkeypatch.setattr(checkpoint, "PIECE_ROWS", PIECE)
    random = np.random.default_rng(3)
    x = random.standard_normal((N, 2))
    x[4], x[5, 0] = np.nan, -0.0
    arrays = {"id": 3 * np.arange(N), "position": x, "mass": random.random(N), "fixed": np.zeros(N, np.uint8)}
    taken = Memory(np.sort(random.choice(arrays["id"], M)), np.arange(M), random.random(M))
    order, other = random.permutation(N), random.permutation(M)
    path = tmp_path / "checkpoint.h5"
    mixed = {name: column[order] for name, column in arrays.items()}
    facts = {"step": 7, "scene": "π" * 1000}
    contacts = Memory(*(column[other] for column in taken))
    save(path, Communicator.alone(), mixed, IdRange(0, 3 * N, N), 2, facts, contacts)
    return path, arrays, taken


def same(one, other):
    return all(one[name].tobytes() == other[name].tobytes() for name in one)


def test_any_part_is_that_of_the_whole(written):
    path, arrays, taken = written
    file = Checkpoint(path)
    assert file.attributes["step"] == 7 and (file.total, file.dimension, file.number_of_contacts) == (N, 2, M)
    for first, last in [(0, N), (0, 0), (N, N), (9, 11), (10, 20), (37, 38), (80, N)]:
        assert same(file.rows(first, last), {name: column[first:last] for name, column in arrays.items()})
    for first, last in [(0, M), (5, 5), (9, 31)]:
        assert same(file.contacts(first, last)._asdict(), {k: c[first:last] for k, c in taken._asdict().items()})


def test_other_programs_read_it(written):
    path, arrays, _ = written
    with h5py.File(path, locking=False) as file:
        assert all(file[f"particles/{name}"][:].tobytes() == column.tobytes() for name, column in arrays.items())


def test_a_changed_bit_is_noticed_by_those_who_read_it(written):
    """And by everyone, if it is not in a row."""
    path, arrays, _ = written
    whole = path.read_bytes()
    at = whole.index(arrays["mass"].tobytes())
    for row in (0, 47, N - 1):
        changed = bytearray(whole)
        changed[at + 8 * row + 3] ^= 16
        path.write_bytes(changed)
        file = Checkpoint(path)
        for first in range(0, N, PIECE):
            last = min(first + PIECE, N)
            if first <= row < last:
                with pytest.raises(SceneError, match="damaged"):
                    file.rows(first, last)
            else:
                assert same(file.rows(first, last), {name: column[first:last] for name, column in arrays.items()})
    for place in (3, at - 1, len(whole) - 1, len(whole) - 20, len(whole) - 300):
        changed = bytearray(whole)
        changed[place] ^= 1
        path.write_bytes(changed)
        with pytest.raises(SceneError, match=r"checkpoint\.h5: "):
            Checkpoint(path).rows(0, N)


SHAPES = {  # what is wrong in a file whose checksums are right
    "a row is missing": lambda c: c | {"particles/mass": c["particles/mass"][:-1]},
    "floats of 4 bytes": lambda c: c | {"particles/position": c["particles/position"].astype(np.float32)},
    "too wide": lambda c: c | {"particles/position": np.tile(c["particles/position"], 2)},
    "a field of a user's is too short": lambda c: c | {"particles/mine": np.zeros(N - 1)},
    "a contact is missing": lambda c: c | {"contacts/taken": c["contacts/taken"][:-1]},
    "contacts are too wide": lambda c: c | {"contacts/taken": np.zeros((M, 7))},
}


@pytest.mark.parametrize("wrong", SHAPES)
def test_a_column_of_another_shape_is_not_taken_for_a_state(written, wrong):
    path, arrays, taken = written
    columns = {f"particles/{name}": column for name, column in arrays.items()}
    columns |= {f"contacts/{name}": column for name, column in taken._asdict().items()}
    facts = {checkpoint.MARK: checkpoint.FORMAT, "total": N, "dimension": 2}
    checkpoint._write(path, Communicator.alone(), columns, facts)
    assert same(Checkpoint(path).rows(0, N), arrays)
    checkpoint._write(path, Communicator.alone(), SHAPES[wrong](columns), facts)
    with pytest.raises(SceneError, match="is not a field of 95 particles in dimension 2"):
        Checkpoint(path)


def test_a_write_that_fails_leaves_the_old_one(written, monkeypatch):
    path, arrays, _ = written
    before = path.read_bytes()
    monkeypatch.setattr(checkpoint, "_write_all", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        save(path, Communicator.alone(), arrays, IdRange(0, 3 * N, N), 2, {})
    assert path.read_bytes() == before and [p.name for p in path.parent.iterdir()] == ["checkpoint.h5"]


def test_nobody(tmp_path):
    none = {"id": np.empty(0, np.int64), "position": np.empty((0, 3)), "mass": np.empty(0)}
    save(tmp_path / "checkpoint.h5", Communicator.alone(), none, IdRange(0, 0, 0), 3, {"step": 0})
    file = Checkpoint(tmp_path / "checkpoint.h5")
    assert file.total == file.number_of_contacts == 0 and same(file.rows(0, 0), none)
