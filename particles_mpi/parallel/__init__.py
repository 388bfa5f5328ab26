"""Every MPI call of the program: sends rows to ranks, refreshes ghosts, sums numbers. It contains no physics.

In the order in which to read them:

- `communicator`: the ranks of a run, and the collective calls that the program needs
- `exchange`: sends rows to any rank, to all ranks at once or in blocks, or in id order
- `halo`: the ghosts of a rank, and how they are refreshed
- `decomposition`: divides space into one domain for each rank, and decides when to divide it again
- `buffers`: the arrays of a rank, with space for particles that arrive and for ghosts; or all particles on every rank
- `exact_sum`: sums that do not depend on the order of their terms, hence not on the ranks
- `agreement`: an error on one rank becomes an error on all, or ends all
- `shared_file`: a file into which all ranks write
- `signals`: Ctrl-C, SIGTERM, SIGUSR1 and the wall-time limit
- `launcher`: starts mpirun, ends its ranks on Ctrl-C, and shortens its messages about ranks that failed

How a row gets to another rank. `LoadBalance` keeps the `Decomposition` of space, which gives the owner of each position.
`RowBuffers.migrate` sends the rows that another rank owns by `send_rows`, all columns for one rank as a single message; arriving
rows take the places of those that left. Ghosts are sent by `send_rows` too, and `RowBuffers.append_ghosts` puts them behind the
owned rows. `Halo` refreshes them until the next search for neighbours.
"""

import os
from pathlib import Path

if not any(Path(f"/sys/class/{kind}").exists() for kind in ("infiniband", "hfi1", "cxi")):
    # Open MPI would look for fast networks, with drivers that calibrate clocks for 0.2 s, and end at ob1 all the same
    os.environ.setdefault("OMPI_MCA_pml", "ob1")

# A rank that waits for a message gives its core to whoever wants it. Otherwise, where other programs run too, the rank it waits
# for would get that core back after milliseconds only: beside two of the lowest priority headline.toml took 36 ms a step on two
# ranks of two cores, and takes 3 to 5. Where nothing else runs this costs nothing that can be measured.
os.environ.setdefault("OMPI_MCA_mpi_yield_when_idle", "1")
