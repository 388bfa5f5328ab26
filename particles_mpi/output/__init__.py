"""What a run leaves on disk: frames (HDF5 and VTK), checkpoints, and the table of diagnostics.

In the order in which to read them:

- `replacing`: files that are replaced as a whole
- `files`: what all writers share: errors are raised on all ranks together; the columns of a frame
- `layout`: how frames are stored in the HDF5 file that ParaView opens
- `file_length`: keeps that file at least as long as its header says
- `frame_rows`: writes rows of frames into a column of that file
- `trajectory`: appends all frames of a run to that file
- `read_frames`: reads frames back, also while a run writes them
- `vtk`: writes the same frames as VTK files: one for each frame, or several pieces of a large one
- `diagnostics_csv`: a row of sums every few steps
- `checkpoint`: the exact state in one file, from which a run continues with the same bits
- `run_folder`: decides whether a run may write into its folder, and from which checkpoint there it goes on

How a frame gets to disk. `run.files` gives each writer this rank's rows. `parallel.exchange.in_id_order` sorts the rows of all
ranks by id: each rank gets a range of ids where HDF5 is parallel and every rank writes; otherwise rank 0 gets all; of a VTK frame
each rank gets one block of ids at a time. `frame_arrays` makes the columns that viewers expect, and the writer appends them. The
count of frames in the file is raised last, so that a killed run leaves a readable file. Checkpoints are written by all ranks with
any HDF5. Every access to a file is in a block `failing_together`: if the file system refuses it on one rank, all ranks raise the
same error. When a run is continued, the constructor of each writer reads the old file and changes nothing; `open` then removes
what came after the checkpoint. So a fault in one file is found before another file is changed.
"""
