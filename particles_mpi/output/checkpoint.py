"""The exact state of a run in one HDF5 file, which is replaced as a whole.

- /particles/<field>: (N,) or (N, d), in id order, every bit as it was (NaN, -0.0 and subnormals too)
- /contacts/id, partner, taken: (M,), in the order of ids, the impulses of lasting contacts: see `contacts/warm_start`
- @particles_mpi_checkpoint, the FORMAT, @total, @dimension, and the attributes given: step, time, scene text, counts

Rank 0 makes the file with room for all rows, and each rank writes those of its range of ids into it, by MPI-IO: no rank holds the
rows of another. Behind the HDF5 file there is a seal, which HDF5 ignores: the CRC-32 of each piece of rows, and of all bytes
between them. A file that was cut short, or in which a bit has changed, is never accepted as a state. To read some rows, a rank
reads and checks only the pieces that contain them.
"""

import json
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from particles_mpi.contacts.warm_start import NOTHING, Memory, rough_columns
from particles_mpi.errors import SceneError
from particles_mpi.output.files import FILE_PATIENCE, failing_together, mpi_io_errors, open_everywhere, sync
from particles_mpi.output.replacing import replacing, temporary_of
from particles_mpi.parallel.communicator import Communicator
from particles_mpi.parallel.exchange import IdRange, in_id_order
from particles_mpi.parallel.shared_file import SharedFile
from particles_mpi.particles import FIELDS, Array, row_bytes, rows_of, shape

MARK, FORMAT = "particles_mpi_checkpoint", 6
TAIL = f"\n{MARK} {{:20d}} {{:20d}} {{:08x}}\n"  # the last line: lengths of the HDF5 file and of the seal, CRC-32 of the seal
PIECE_ROWS = 2**17  # rows that have a checksum together


def save(
    path: Path,
    ranks: Communicator,
    arrays: dict[str, Array],
    ids: IdRange,
    dimension: int,
    attributes: dict[str, Any],
    contacts: Memory = NOTHING,
) -> None:
    """Write the state of all ranks, whose ids lie in `ids`. Collective.

    `arrays`: this rank's owned rows in any order, with every field that a restart needs; `attributes`: numbers and texts;
    `contacts`: those of this rank's rows.
    """
    rows = in_id_order(ranks, arrays, ids, ranks.size)
    lasting = in_id_order(ranks, contacts._asdict(), ids, ranks.size)
    lasting = rows_of(lasting, np.lexsort((lasting["partner"], lasting["id"])))
    columns = {f"particles/{name}": column for name, column in rows.items()}
    columns |= {f"contacts/{name}": column for name, column in lasting.items()}
    facts = {MARK: FORMAT, "total": ids.total, "dimension": dimension} | attributes
    _write(path, ranks, columns, facts)


def dump(path: Path, ranks: Communicator, arrays: dict[str, Array], attributes: dict[str, Any]) -> None:
    """Write all rows, however wrong, and the `rank` that holds each: for inspection, not for a restart. Collective."""
    held = arrays | {"rank": np.full(len(arrays["id"]), ranks.rank)}
    _write(path, ranks, {f"particles/{name}": column for name, column in held.items()}, attributes)


def _write(path: Path, ranks: Communicator, columns: dict[str, Array], facts: dict[str, Any]) -> None:
    """A file with the columns of all ranks, those of lower ranks first, and these attributes. Collective."""
    counts = ranks.allgather_array(np.array([len(column) for column in columns.values()]))
    first, total = (dict(zip(columns, n.tolist(), strict=True)) for n in (counts[: ranks.rank].sum(axis=0), counts.sum(axis=0)))
    part = temporary_of(path)
    task = f"cannot write {path} at step {facts.get('step', '?')}"
    try:
        places: dict[str, int] = {}
        with failing_together(ranks, task):
            if ranks.is_root:
                places = _make(part, columns, total, facts)
        places = ranks.bcast(places)
        writes = [(places[name] + first[name] * row_bytes(column), column) for name, column in columns.items() if len(column)]
        _write_all(part, ranks, writes, task)
        pieces = {name: _pieces(column, first[name]) for name, column in columns.items()}
        gathered = ranks.comm.gather(pieces) or []
        with failing_together(ranks, task):
            if ranks.is_root:
                sizes = {name: [places[name], row_bytes(column)] for name, column in columns.items() if total[name]}
                crcs = {name: [piece for of in gathered for piece in of[name]] for name in sizes}
                _replace(path, sizes, crcs)
    except BaseException:
        if ranks.is_root:
            part.unlink(missing_ok=True)  # half a file is of no use
        raise


def _make(part: Path, columns: dict[str, Array], total: dict[str, int], facts: dict[str, Any]) -> dict[str, int]:
    """An HDF5 file with room for all rows of the columns; returns at which byte each begins."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.CONTIGUOUS)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    places = {}
    with h5py.File(part, "w", locking=False) as file:
        for name, column in columns.items():
            made = file.create_dataset(name, (total[name], *column.shape[1:]), column.dtype, dcpl=properties)
            places[name] = made.id.get_offset() or 0
        file.attrs.update(facts)
    return places


def _write_all(part: Path, ranks: Communicator, writes: list[tuple[int, Array]], task: str) -> None:
    """Write the columns of each rank at these bytes of the file. Collective."""
    open_everywhere(ranks, part, task)
    with failing_together(ranks, task, FILE_PATIENCE), mpi_io_errors():
        file = SharedFile(ranks, part)
        for place, column in writes:
            file.write(place, column)
    with failing_together(ranks, task, FILE_PATIENCE), mpi_io_errors():
        file.close()


def _pieces(column: Array, first: int) -> list[list[int]]:
    """[first row, last + 1, CRC-32] of each piece of a column, whose first row is row `first` of all."""
    pieces = []
    for begin in range(0, len(column), PIECE_ROWS):
        rows = np.ascontiguousarray(column[begin : begin + PIECE_ROWS])
        pieces.append([first + begin, first + begin + len(rows), zlib.crc32(rows.view(np.uint8).data)])
    return pieces


def _replace(path: Path, sizes: dict[str, list[int]], crcs: dict[str, list[list[int]]]) -> None:
    """Seal the file that all have written, and give it its name."""
    with replacing(path) as part:
        length = part.stat().st_size
        contents = {"columns": sizes, "pieces": crcs}
        seal = json.dumps(contents | {"rest": _crc_between(part, length, contents)}).encode()
        with open(part, "ab") as written:
            written.write(seal + TAIL.format(length, len(seal), zlib.crc32(seal)).encode())
        sync(part)  # on the disk before it takes the name, or a power cut leaves an empty file of that name
    sync(path.parent)


def _crc_between(path: Path, length: int, seal: dict[str, Any]) -> int:
    """CRC-32 of the bytes of the HDF5 file that are not of a column."""
    crc, at = 0, 0
    ends = [(place, place + width * seal["pieces"][name][-1][1]) for name, (place, width) in seal["columns"].items()]
    with open(path, "rb") as file:
        for begin, end in [*sorted(ends), (length, length)]:
            file.seek(at)
            crc = zlib.crc32(file.read(begin - at), crc)
            at = end
    return crc


class Checkpoint:
    """A checkpoint to be read: `attributes`, `total` particles; `rows` and `contacts` of some. Not collective.

    Raises a SceneError, one line, for any other or a damaged file.
    """

    def __init__(self, path: Path):
        self.path = Path(path)
        try:
            self.inode = self.path.stat().st_ino
            self.seal = self._check_seal()
            with h5py.File(path, "r", locking=False) as file:
                stored = file.attrs.items()
                self.attributes = {name: value.item() if hasattr(value, "item") else value for name, value in stored}
                if self.attributes.pop(MARK, None) != FORMAT:
                    raise SceneError(f"{path}: not a checkpoint of this version of particles_mpi")
                self.total, self.dimension = self.attributes["total"], self.attributes["dimension"]
                self.shapes = {
                    f"{group}/{name}": (file[group][name].shape, file[group][name].dtype)
                    for group in ("particles", "contacts")
                    for name in file[group]
                }
            self.number_of_contacts = int(self.shapes["contacts/id"][0][0])
            self._check_shapes()
        except FileNotFoundError:
            raise SceneError(f"{path}: no such checkpoint") from None
        except (OSError, RuntimeError, KeyError, AttributeError) as error:
            raise SceneError(f"{path}: cannot be read as a checkpoint ({str(error).splitlines()[0]})") from None

    def _check_seal(self) -> dict[str, Any]:
        """The seal, if the file has one and all but its columns is as it was written. HDF5 may crash on a file that is not."""
        size, tail = self.path.stat().st_size, len(TAIL.format(0, 0, 0))
        with open(self.path, "rb") as file:
            file.seek(max(size - tail, 0))
            last = file.read()
            words = last.decode(errors="replace").split()
            sealed = len(words) == 4 and words[0] == MARK and words[1].isdigit() and words[2].isdigit()
            if not sealed or int(words[1]) + int(words[2]) + tail != size:
                raise SceneError(f"{self.path}: not a checkpoint of this version of particles_mpi, or cut short")
            length = int(words[1])
            file.seek(length)
            seal = file.read(int(words[2]))
        if last != TAIL.format(length, len(seal), zlib.crc32(seal)).encode():
            raise self._damaged()
        read: dict[str, Any] = json.loads(seal)
        if read["rest"] != _crc_between(self.path, length, read):
            raise self._damaged()
        return read

    def _damaged(self) -> SceneError:
        """What is wrong with the file; where a run has put a newer one in its place meanwhile, nothing is."""
        with suppress(FileNotFoundError):
            if self.path.stat().st_ino != self.inode:
                return SceneError(f"{self.path}: its run replaced it while it was read: try again")
        return SceneError(f"{self.path}: damaged: its contents are not what was written (CRC-32)")

    def _check_shapes(self) -> None:
        """Every field has a row for each particle: checksums do not tell whether all who wrote them agreed on that."""
        rough = rough_columns(self.dimension)
        for place, (found, dtype) in self.shapes.items():
            group, name = place.split("/")
            is_field = group == "particles" and name in FIELDS
            across = found[1:] if name == "taken" else ()  # of rough contacts: see `rough_columns`
            wrong = found[:1] != (self.total,) if group == "particles" else across not in ((), rough)
            wrong |= group == "contacts" and found != (self.number_of_contacts, *across)
            if wrong or (is_field and (found != shape(name, self.total, self.dimension) or dtype != FIELDS[name].dtype)):
                raise SceneError(f"{self.path}: {place} is not a field of {self.total} particles in dimension {self.dimension}")

    def rows(self, first: int, last: int) -> dict[str, Array]:
        """The fields of the particles first ... last - 1, in id order."""
        names = [place.split("/")[1] for place in self.shapes if place.startswith("particles/")]
        names.sort(key=lambda n: list(FIELDS).index(n) if n in FIELDS else len(FIELDS))  # as at the start
        return {name: self._column(f"particles/{name}", first, last) for name in names}

    def contacts(self, first: int, last: int) -> Memory:
        """The contacts first ... last - 1, in the order of their ids."""
        return Memory(*(self._column(f"contacts/{name}", first, last) for name in Memory._fields))

    def _column(self, place: str, first: int, last: int) -> Array:
        """Rows first ... last - 1 of a column, from the pieces that have them."""
        found, dtype = self.shapes[place]
        column = np.empty((last - first, *found[1:]), dtype)
        if last == first:
            return column
        offset, width = self.seal["columns"][place]
        with open(self.path, "rb") as file:
            for begin, end, crc in self.seal["pieces"][place]:
                if end <= first or begin >= last:
                    continue
                file.seek(offset + begin * width)
                data = file.read((end - begin) * width)
                if zlib.crc32(data) != crc or len(data) != (end - begin) * width:
                    raise self._damaged()
                piece = np.frombuffer(data, dtype).reshape(-1, *found[1:])
                low, high = max(begin, first), min(end, last)
                column[low - first : high - first] = piece[low - begin : high - begin]
        return column
