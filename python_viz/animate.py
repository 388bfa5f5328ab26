"""Animate a run: draw the picture of plot_frame.py for all frames, with one view and one range of colours.

Writes an mp4 if ffmpeg is installed, otherwise a gif (larger, and with fewer colours).

example:
    python python_viz/animate.py out/marbles --every 2 --fps 25 --color energy --save marbles.mp4
takes every second frame; without --save the film is out/marbles/plots/animation.mp4 (or .gif)
"""

import sys
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from picture import Picture, add_picture_options
from PIL import Image
from run_files import DEFAULT_RUN, new_parser, save_path, start, stop, within

from particles_mpi import Run

FPS = 0.01, 100.0  # least and most frames per second: a gif tells the hundredths of a second of a frame, and at most 65 535


class GifWriter(PillowWriter):
    """Writes all frames with one palette, from the first, middle and last frame: one for each would take half of the time."""

    def finish(self) -> None:
        if not self._frames:  # an error, which is on its way
            return
        frames = [frame.convert("RGB") for frame in self._frames]
        shown = [frames[0], frames[len(frames) // 2], frames[-1]]
        palette = Image.fromarray(np.vstack([np.asarray(frame) for frame in shown])).quantize()
        first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
        first.save(self.outfile, save_all=True, append_images=others, duration=round(1000 / self.fps), loop=0)


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument("run", nargs="?", type=Path, default=DEFAULT_RUN, metavar="RUN_DIR", help=f"default: {DEFAULT_RUN}")
    parser.add_argument("--every", type=int, default=1, metavar="K", help="take every K-th frame (default: 1)")
    parser.add_argument("--fps", type=within(*FPS), default=25, help="frames per second of the film (default: 25)")
    add_picture_options(parser)
    options = parser.parse_args()
    if options.every < 1:
        stop("--every must be positive")
    matplotlib.use("Agg")
    run = Run(options.run)
    chosen = range(0, len(run), options.every)
    if not chosen:
        stop(f"{run.folder}: the run has no frame yet")
    path = save_path(options.save, options.run, "animation" + (".mp4" if FFMpegWriter.isAvailable() else ".gif"))
    writer: PillowWriter | FFMpegWriter
    if path.suffix == ".gif":
        dpi, writer = 80, GifWriter(options.fps)
    elif path.suffix == ".mp4" and FFMpegWriter.isAvailable():
        dpi, writer = 120, FFMpegWriter(options.fps, codec="h264", bitrate=6000)
    else:
        stop(f"cannot write {path}: " + ("mp4 needs ffmpeg; save a .gif" if path.suffix == ".mp4" else "use .mp4 or .gif"))

    picture = Picture(run, (run[k] for k in chosen), options.color, options.view, dpi)
    try:
        with writer.saving(picture.figure, path, dpi):
            for done, k in enumerate(chosen, 1):
                picture.draw(run[k])
                writer.grab_frame()
                if sys.stderr.isatty():
                    print(f"\r{done} of {len(chosen)} frames", end="", file=sys.stderr, flush=True)
    except OSError as error:
        stop(f"cannot write {path}: {error}")
    print(path)


if __name__ == "__main__":
    start(main)
