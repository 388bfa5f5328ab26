"""`diagnostics.csv`: a row of sums over all particles every few steps."""

from collections.abc import Mapping
from pathlib import Path

from particles_mpi.output.files import Continuing, check_last, failing_together
from particles_mpi.output.replacing import replacing
from particles_mpi.parallel.communicator import Communicator


class Diagnostics(Continuing):
    """Writer of the table; rank 0 writes, every method is collective. columns: the header, `step` first."""

    def __init__(
        self, path: Path, ranks: Communicator, columns: list[str], resume_step: int | None = None, last: int | None = None
    ):
        self.columns, self.rows = columns, list[list[str]]()  # of those that are kept
        super().__init__(path, ranks, resume_step, last)

    def prepare(self) -> None:
        """Make the table, or remove the rows that are not kept."""
        with replacing(self.path) as part:
            self.file = part.open("w", newline="")  # keeps its place under the new name
            self.file.writelines(",".join(row) + "\n" for row in [self.columns, *self.rows])
            self.file.flush()

    def write(self, values: Mapping[str, float | int | str]) -> None:
        """Append a row, `values` by column; floats with the fewest digits from which the same bits can be read."""
        with failing_together(self.ranks, f"cannot write {self.path} at step {values.get('step', '?')}"):
            if self.file is not None:
                row = [repr(float(v)) if isinstance(v := values[name], float) else str(v) for name in self.columns]
                self.file.write(",".join(row) + "\n")
                self.file.flush()

    def read_kept(self, resume_step: int, last: int | None) -> None:
        """The rows up to step `last`, if it is known. Behind them may be an extra one, of the run's end, and half a line."""
        end = resume_step if last is None else last
        header, *lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True) or [""]
        if header.rstrip("\n").split(",") != self.columns:
            raise ValueError("its columns are not those of the run to be continued")
        for number, line in enumerate(lines, 2):
            cells = line.rstrip("\n").split(",")
            if not line.endswith("\n") or (cells[0].isdigit() and int(cells[0]) > end):
                break
            try:
                numbers = [float(cell) for cell in cells] if cells[0].isdigit() else []
            except ValueError:
                numbers = []
            if len(numbers) != len(self.columns):
                raise ValueError(f"line {number} is not a row of this table")
            self.rows.append(cells)
        check_last([int(row[0]) for row in self.rows], resume_step, last)
