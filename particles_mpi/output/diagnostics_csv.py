"""`diagnostics.csv`: a row of sums over all particles every few steps."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from particles_mpi.output.files import check_last, continuing, failing_together, replacing
from particles_mpi.parallel.communicator import Communicator


class Diagnostics:
    """Writer of the table; rank 0 writes, every method is collective.

    columns: the header, `step` first. With `resume_step` rows up to that step are kept, and the last of them must be of step
    `last`, as when the checkpoint was written. Raises a SceneError on all ranks for a table that cannot be continued, before it
    is changed, and a StoppedError if the file system refuses.
    """

    def __init__(
        self, path: Path, ranks: Communicator, columns: list[str], resume_step: int | None = None, last: int | None = None
    ):
        self.path, self.ranks, self.columns = Path(path), ranks, list(columns)
        self.file: IO[str] | None = None
        self.rows: list[list[str]] = []
        with failing_together(ranks, f"cannot read {path}"):
            if ranks.is_root and resume_step is not None and self.path.exists():
                with continuing(self.path):
                    self.rows = self._kept(resume_step, last)

    def open(self) -> None:
        """Make the table, or remove the rows that are not kept."""
        with failing_together(self.ranks, f"cannot prepare {self.path}"):
            if self.ranks.is_root:
                with replacing(self.path) as part:
                    self.file = part.open("w", newline="")  # keeps its place under the new name
                    csv.writer(self.file, lineterminator="\n").writerows([self.columns, *self.rows])
                    self.file.flush()
                self.rows = []

    def write(self, values: Mapping[str, float | int | str]) -> None:
        """Append a row, `values` by column; floats with the fewest digits from which the same bits can be read."""
        with failing_together(self.ranks, f"cannot write {self.path} at step {values.get('step', '?')}"):
            if self.file is not None:
                row = [repr(float(v)) if isinstance(v := values[name], float) else str(v) for name in self.columns]
                self.file.write(",".join(row) + "\n")
                self.file.flush()

    def close(self) -> None:
        """Close the file; every row is on disk without it."""
        if self.file is not None:
            self.file.close()
            self.file = None

    def _kept(self, resume_step: int, last: int | None) -> list[list[str]]:
        """The rows up to step `resume_step`. Behind them a killed run may have left half a line."""
        header, *lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True) or [""]
        if header.rstrip("\n").split(",") != self.columns:
            raise ValueError("it has other columns than the run to be continued")
        rows: list[list[str]] = []
        for number, line in enumerate(lines, 2):
            cells = line.rstrip("\n").split(",")
            if not line.endswith("\n") or (cells[0].isdigit() and int(cells[0]) > resume_step):
                break
            if len(cells) != len(self.columns) or not cells[0].isdigit() or not all(_is_number(cell) for cell in cells):
                raise ValueError(f"line {number} is no row of it")
            rows.append(cells)
        check_last([int(row[0]) for row in rows], resume_step, last)
        return rows


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
