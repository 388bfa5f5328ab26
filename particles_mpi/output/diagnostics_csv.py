"""`diagnostics.csv`: one row of sums over all particles every few steps."""

from __future__ import annotations

import csv
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from particles_mpi.output import failing_together
from particles_mpi.parallel.ranks import Ranks


class Diagnostics:
    """Writer of the table; rank 0 writes, every method is collective.

    columns: the header, `step` first. With `resume_step`, rows of steps up to that one stay. Raises StoppedError on all ranks
    if the file system refuses, or if the table to be continued has other columns.
    """

    def __init__(self, path: Path, ranks: Ranks, columns: list[str], resume_step: int | None = None):
        self.path, self.ranks, self.columns = Path(path), ranks, list(columns)
        self.file: IO[str] | None = None
        with failing_together(ranks, f"cannot prepare {path}"):
            if ranks.is_root:
                rows = [] if resume_step is None or not self.path.exists() else self._kept(resume_step)
                part = self.path.with_name(self.path.name + ".tmp")
                self.file = part.open("w", newline="")
                csv.writer(self.file, lineterminator="\n").writerows([self.columns, *rows])
                self.file.flush()
                os.replace(part, self.path)  # the open file keeps its place under the new name

    def write(self, values: Mapping[str, float | int | str]) -> None:
        """Append a row, `values` by column; floats with the fewest digits that give the same bits back."""
        with failing_together(self.ranks, f"cannot write {self.path} at step {values.get('step', '?')}"):
            if self.file is not None:
                row = [repr(float(v)) if isinstance(v := values[name], float) else str(v) for name in self.columns]
                self.file.write(",".join(row) + "\n")
                self.file.flush()

    def close(self) -> None:
        """Close the file; every row written is there without it."""
        if self.file is not None:
            self.file.close()
            self.file = None

    def _kept(self, resume_step: int) -> list[list[str]]:
        """The whole rows of steps up to one; a killed run may have left half a line."""
        with self.path.open(newline="") as lines:
            header, *rows = list(csv.reader(lines)) or [[]]
        if header != self.columns:
            raise ValueError("it has other columns than the run to be continued")
        return [row for row in rows if len(row) == len(header) and all(row) and int(row[0]) <= resume_step]
