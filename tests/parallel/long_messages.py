"""Messages in pieces of a few words bring the same bits as whole ones: rows, ghosts, neighbours' messages, blocks in id order."""

import numpy as np

from particles_mpi.parallel import exchange
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, allgather_rows, blocks, by_destination, send_rows, sendrecv
from particles_mpi.parallel.halo import Halo

FULL, FEW = exchange.MOST_WORDS, exchange.ONE_MESSAGE
ranks = Communicator()
random = np.random.default_rng(ranks.rank)
n, everyone = 40 + ranks.rank, range(ranks.size)
total = sum(40 + p for p in everyone)
columns = {"id": np.arange(n) * ranks.size + ranks.rank, "x": random.random((n, 3)), "fixed": random.integers(0, 2, n, np.uint8)}
order, counts = by_destination(random.integers(0, ranks.size, n), ranks.size)
others = [p for p in everyone if p != ranks.rank]
messages = [random.random(length) for length in (0, 1, 6, 7, 60)]  # 6 words are whole pieces of 1, 2 and 3


def all_messages(most):
    """All that arrives on this rank, as bytes, and how many messages it sent, where messages have at most so many words."""
    exchange.MOST_WORDS, before = most, ranks.messages
    arrived, arriving = send_rows(ranks, columns, order, counts)
    found = [arriving, *arrived.values(), *allgather_rows(ranks, columns).values()]
    if ranks.size > 1:
        found += [sendrecv(ranks, others, [message] * len(others)) for message in messages]
        ghosts = int(arriving.sum() - arriving[ranks.rank])
        there, here = (np.where(np.arange(ranks.size) == ranks.rank, 0, number) for number in (counts, arriving))
        halo = Halo(ranks, order[np.repeat(np.arange(ranks.size), counts) != ranks.rank], there, here, n, 4)

        def pack(rows, buffer):
            """Only some of the rows, so that messages are shorter than the room for them."""
            some = columns["x"][rows[::2]].ravel()
            buffer[: len(some)] = some
            return len(some)

        found += [np.append(message, first) for first, message in halo.exchange(pack)]
        table = np.concatenate((columns["x"], np.zeros((ghosts, 3))))
        halo.refresh(table)
        found.append(table)
    wide = {name: columns[name] for name in ("id", "x")}
    exchange.ONE_MESSAGE = 0
    found += [column for block in blocks(ranks, wide, IdRange(0, 50 * ranks.size, total)) for column in block.values()]
    return [np.ascontiguousarray(one).tobytes() for one in found], ranks.messages - before


expected, few = all_messages(FULL)
for most in (1, 2, 3, 7):
    found, many = all_messages(most)
    assert found == expected, (ranks.rank, most)
    assert many > 2 * few or ranks.size == 1, (few, many)
exchange.MOST_WORDS, exchange.ONE_MESSAGE = FULL, FEW
ranks.barrier()
if ranks.is_root:
    print("the same bits")
