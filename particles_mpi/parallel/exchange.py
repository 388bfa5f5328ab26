"""Exchange of rows between ranks: to any rank, to all ranks, in id order, and in blocks."""

from collections.abc import Iterator, Sequence
from math import prod
from typing import NamedTuple

import numpy as np
from mpi4py import MPI

from particles_mpi.kernels.limits import require_countable
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.particles import Array, row_bytes, rows_of

TAG = 0  # of messages with rows; `agreement` uses another one
ONE_MESSAGE = 10_000  # particles whose rows are sent in one message; `blocks` and `in_id_order` send those of more in pieces
WORD = 8  # bytes; all messages consist of such words
MOST_WORDS = 2**31 - 1  # in one message, as MPI counts with 32 bits: longer ones are sent in pieces


class IdRange(NamedTuple):
    """The ids of all particles of all ranks lie in first <= id < end; there are `total` of them."""

    first: int
    end: int
    total: int


def send_rows(ranks: Communicator, arrays: dict[str, Array], rows: Array, counts: Array) -> tuple[dict[str, Array], Array]:
    """Send the `rows` (indices) of the arrays, sorted by destination: counts[p] of them to rank p; see `by_destination`.

    Returns the rows that arrived, sorted by sender, and how many came from each rank. Collective.
    """
    if ranks.size == 1:
        return rows_of(arrays, rows), counts
    require_countable(len(rows), "rows to send")
    arriving, me = np.empty_like(counts), ranks.rank
    ranks.comm.Alltoall(counts, arriving)
    require_countable(int(arriving.sum()), "rows that arrive")
    ranks.all_to_alls += 1
    ranks.bytes["counts"] += counts.itemsize * (ranks.size - 1)
    ranks.rows += int(arriving.sum() - arriving[me])
    row_size = row_bytes(*arrays.values())
    words_out, words_in = (-(row_size * numbers.astype(np.int64) // -WORD) for numbers in (counts, arriving))
    outgoing, incoming = np.empty(words_out.sum()), np.empty(words_in.sum())
    messages = {p: outgoing[first:last] for p, first, last in parts(words_out)}
    places = {p: incoming[first:last] for p, first, last in parts(words_in)}
    requests = [one for p, place in places.items() if p != me for one in receive(ranks, p, place)]
    for p, begin, end in parts(counts):
        message = places[me] if p == me else messages[p]
        for name, part in unpacked(message, end - begin, arrays):
            arrays[name].take(rows[begin:end], axis=0, out=part, mode="clip")
        if p != me:
            requests += send(ranks, p, message, len(message))
    MPI.Request.Waitall(requests)
    if len(arrays) == 1 and row_size % WORD == 0:  # the messages are the column
        ((name, column),) = arrays.items()
        return {name: incoming.view(column.dtype).reshape(int(arriving.sum()), *column.shape[1:])}, arriving
    return joined(places, arriving, arrays), arriving


def send(ranks: Communicator, to: int, message: Array, size: int) -> list[MPI.Request]:
    """Begin to send the first `size` words of a message, in as many pieces as the whole message would need."""
    pieces = [message[at : min(at + MOST_WORDS, size)] for at in range(0, len(message), MOST_WORDS)]
    ranks.messages += len(pieces)
    ranks.bytes["rows"] += WORD * size
    return [ranks.comm.Isend([piece, MPI.DOUBLE], dest=to, tag=TAG) for piece in pieces]


def receive(ranks: Communicator, sender: int, place: Array) -> list[MPI.Request]:
    """Begin to receive a message of up to as many words as there are in `place`, in the pieces of `send`."""
    return [ranks.comm.Irecv([piece, MPI.DOUBLE], source=sender, tag=TAG) for piece in in_pieces(place)]


def in_pieces(message: Array) -> list[Array]:
    """The parts of a message that MPI can count: it is sent as so many messages."""
    return [message[at : at + MOST_WORDS] for at in range(0, len(message), MOST_WORDS)]


def allgather_rows(ranks: Communicator, arrays: dict[str, Array]) -> dict[str, Array]:
    """The rows of all ranks on every rank, sorted by owner. Collective."""
    if ranks.size == 1:
        return {name: column.copy() for name, column in arrays.items()}
    n = len(next(iter(arrays.values())))
    counts = ranks.allgather_array(np.array(n))
    require_countable(int(counts.sum()), "rows of all ranks")
    words = -(row_bytes(*arrays.values()) * counts // -WORD)
    all_words, first_words = np.empty(int(words.sum()), np.int64), starts(words)
    messages = {p: all_words[first:last] for p, first, last in parts(words)}
    for name, part in unpacked(all_words[first_words[ranks.rank] :], n, arrays):
        part[:] = arrays[name]
    if len(all_words) <= MOST_WORDS:
        ranks.comm.Allgatherv(MPI.IN_PLACE, [all_words, (words, first_words)])
    else:
        for p, message in messages.items():
            for piece in in_pieces(message):
                ranks.comm.Bcast(piece, root=p)
    ranks.messages += ranks.size - 1
    ranks.bytes["gathers"] += WORD * int(words[ranks.rank]) * (ranks.size - 1)
    ranks.rows += int(counts.sum()) - n
    return joined(messages, counts, arrays)


def sendrecv(ranks: Communicator, others: Sequence[int], outgoing: Sequence[Array]) -> Array:
    """Send one float64 message to each of the `others`, which do the same; returns what they sent, one after the other."""
    requests = []
    for p, message in zip(others, outgoing, strict=True):  # the last piece, which may be empty, is not full
        pieces = [message[at : at + MOST_WORDS] for at in range(0, len(message) + 1, MOST_WORDS)]
        requests += [ranks.comm.Isend([piece, MPI.DOUBLE], dest=p, tag=TAG) for piece in pieces]
        ranks.bytes["rows"] += WORD * len(message)
    ranks.messages += len(requests)
    status, messages = MPI.Status(), []
    for p in others:
        size = MOST_WORDS
        while size == MOST_WORDS:
            piece = ranks.comm.Mprobe(source=p, tag=TAG, status=status)
            size = status.Get_count(MPI.DOUBLE)
            messages.append((piece, size))
    incoming = np.empty(sum(size for _, size in messages))
    at = 0
    for piece, size in messages:
        piece.Recv([incoming[at : at + size], MPI.DOUBLE])
        at += size
    MPI.Request.Waitall(requests)
    return incoming


def unpacked(words: Array, count: int, like: dict[str, Array]) -> Iterator[tuple[str, Array]]:
    """(name, view of `count` rows) for each column of one rank's part of a message, which begins at words[0].

    The columns of `like` stand one after the other, those with the widest numbers first so that each is aligned in memory.
    """
    data, begin = words.view(np.uint8), 0
    for name in sorted(like, key=lambda name: -like[name].dtype.itemsize):
        dtype, rest = like[name].dtype, like[name].shape[1:]
        end = begin + count * prod(rest) * dtype.itemsize
        yield name, data[begin:end].view(dtype).reshape(count, *rest)
        begin = end


def joined(messages: dict[int, Array], counts: Array, like: dict[str, Array]) -> dict[str, Array]:
    """The columns that all `messages` (rank → words) hold, counts[rank] rows of each rank, one after the other."""
    columns = {name: np.empty((int(counts.sum()), *column.shape[1:]), column.dtype) for name, column in like.items()}
    for p, begin, end in parts(counts):
        for name, part in unpacked(messages[p], end - begin, like):
            columns[name][begin:end] = part
    return columns


def starts(counts: Array) -> Array:
    """Where each of the parts with these lengths begins."""
    return np.cumsum(counts) - counts


def parts(counts: Array) -> list[tuple[int, int, int]]:
    """(rank, first, last + 1) of the rows of every rank that has some, of counts[rank] each, one after the other."""
    return [(p, first, first + count) for p, (first, count) in enumerate(zip(starts(counts).tolist(), counts.tolist())) if count]


def by_destination(destination: Array, size: int) -> tuple[Array, Array]:
    """(rows sorted by their destination (n,), how many go to each of `size` ranks): what `send_rows` takes."""
    counts = np.bincount(destination, minlength=size).astype(np.int32)
    if size < 2**15:  # numpy sorts 16 bits by counting, three times as fast
        destination = destination.astype(np.int16)
    return np.argsort(destination, kind="stable"), counts


def holders(ranks: Communicator, mine: Array, wanted: Array) -> Array:
    """The rank that has each of the `wanted` ids (n,); lower ranks have lower ones, and `mine` ascend. Collective."""
    least = ranks.allgather_array(np.array(mine[0] if len(mine) else -1))
    some = np.flatnonzero(least >= 0)
    return some[np.searchsorted(least[some], wanted, "right") - 1]


def id_range(ranks: Communicator, ids: Array) -> IdRange:
    """The range of the ids of all ranks; `ids` (n,): those of this rank. Collective."""
    low, high = (int(ids.min()), int(ids.max())) if len(ids) else (2**62, -1)
    ends = ranks.allreduce_max(np.array([-low, high], np.int64))
    return IdRange(max(-int(ends[0]), 0) if ends[1] >= 0 else 0, int(ends[1]) + 1, ranks.total(len(ids))[0])


def by_range(numbers: Array, ids: IdRange, writers: int, size: int) -> tuple[Array, Array]:
    """`by_destination` of rows with these ids, where the first `writers` of `size` ranks each own an even part of the range."""
    return by_destination(owners_by_range(numbers, ids, writers), size)


def owners_by_range(numbers: Array, ids: IdRange, writers: int) -> Array:
    """The rank, below `writers`, whose even part of the range contains each of these ids (n,)."""
    return ((numbers - ids.first + 1) * writers - 1) // max(ids.end - ids.first, 1)


def own_range(rank: int, ids: IdRange, writers: int) -> tuple[int, int]:
    """The first and the end of the ids that `by_range` sends to this rank."""
    length = ids.end - ids.first
    least, most = (ids.first + length * min(r, writers) // writers for r in (rank, rank + 1))
    return least, most


def in_id_order(ranks: Communicator, arrays: dict[str, Array], ids: IdRange, writers: int) -> dict[str, Array]:
    """Rows in id order: the range of ids is divided evenly among the first `writers` ranks. Collective.

    Few rows are sent together. Of many, the columns are sent one after the other: a rank holds the rows that it gets and, of a
    single column, what is on its way. Where all have theirs in order already, as without pairs, they are the arrays given.
    """
    mine, (least, most) = arrays["id"], own_range(ranks.rank, ids, writers)
    if ranks.all(not len(mine) or (least <= mine[0] and mine[-1] < most and (mine[1:] > mine[:-1]).all())):
        return dict(arrays)
    if ranks.size == 1:
        return rows_of(arrays, rows_in_order(arrays["id"]))
    order, counts = by_range(arrays["id"], ids, writers, ranks.size)
    arrived, _ = send_rows(ranks, arrays if ids.total <= ONE_MESSAGE else {"id": arrays["id"]}, order, counts)
    places = rows_in_order(arrived["id"])
    for name in arrays:
        column = arrived[name] if name in arrived else send_rows(ranks, {name: arrays[name]}, order, counts)[0][name]
        arrived[name] = column.take(places, axis=0)
    return {name: arrived[name] for name in arrays}


def rows_in_order(ids: Array) -> Array:
    """The rows (n,) of the `ids` (n,), from the lowest to the highest; where they repeat, in the order in which they stand."""
    if len(ids) and ids.max() - ids.min() + 1 == len(ids):  # if all are different none is missing: each tells its place
        rows = np.full_like(ids, -1)
        rows[ids - ids.min()] = np.arange(len(ids))
        if (rows >= 0).all():
            return rows
    return np.argsort(ids, kind="stable")


def blocks(ranks: Communicator, columns: dict[str, Array], ids: IdRange) -> Iterator[dict[str, Array]]:
    """The rows of all ranks in id order, as one block for each rank; `columns` (with "id") are float64 or int64. Collective.

    Few rows are a single block. Otherwise the next block is on its way while the caller works on one: a rank holds two blocks
    at a time, which are O(N/P) rows.
    """
    if ranks.size == 1 or ids.total <= ONE_MESSAGE:
        rows = columns if ranks.size == 1 else allgather_rows(ranks, columns)
        yield rows if (rows["id"][1:] > rows["id"][:-1]).all() else rows_of(rows, rows_in_order(rows["id"]))
        return
    # all columns in one message: this is done in each step
    mine, _ = send_rows(ranks, columns, *by_range(columns["id"], ids, ranks.size, ranks.size))
    mine = rows_of(mine, rows_in_order(mine["id"]))
    ranks.all_to_alls += 1
    ranks.rows += ids.total - len(mine["id"])
    counts = ranks.allgather_array(np.array(len(mine["id"])))
    width = sum(prod(column.shape[1:]) for column in columns.values())

    def start(rank: int) -> tuple[dict[str, Array], list[MPI.Request]]:
        """Begin to send the block of a rank to all."""
        buffer = np.empty(int(counts[rank]) * width, np.int64)
        block = dict(unpacked(buffer, int(counts[rank]), columns))
        if rank == ranks.rank:
            ranks.messages += 1
            ranks.bytes["gathers"] += buffer.nbytes * (ranks.size - 1)
            for name, column in block.items():
                column[:] = mine[name]
        return block, [ranks.comm.Ibcast(piece, root=rank) for piece in in_pieces(buffer)]

    coming = start(0)
    for rank in range(ranks.size):
        block, requests = coming
        MPI.Request.Waitall(requests)
        if rank + 1 < ranks.size:
            coming = start(rank + 1)
        yield block
