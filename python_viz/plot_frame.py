"""Draw the marbles of one frame as lit spheres with their true radii, in their box.

Space is drawn in perspective, a planar run (all z = 0) from above. Fixed particles have a dark rim, walls that are not faces
of the box are grey planes, periodic faces have dashed edges. Marbles smaller than a pixel, and points, are enlarged; the
caption says so.

example:
    python python_viz/plot_frame.py out/marbles --frame -1 --color speed
draws the last frame into out/marbles/plots/frame_000005.png (if 5 is the last)
"""

from pathlib import Path

from picture import Picture, add_picture_options
from run_files import DEFAULT_RUN, finish, new_parser, parse, save_path, start, within

from particles_mpi import Run

LEAST_DPI, MOST_DPI = 20, 2000  # with fewer no letter can be drawn, with more a picture may be too large for the memory


def main() -> None:
    parser = new_parser(__doc__)
    parser.add_argument("run", nargs="?", type=Path, default=DEFAULT_RUN, metavar="RUN_DIR", help=f"default: {DEFAULT_RUN}")
    parser.add_argument("--frame", type=int, default=-1, help="number of the frame; -1 is the last (default)")
    parser.add_argument(
        "--dpi",
        type=within(LEAST_DPI, MOST_DPI),
        default=150,
        help="pixels per inch: half makes a picture half as large (default: 150)",
    )
    add_picture_options(parser)
    options = parse(parser)
    run = Run(options.run)
    frame = run[options.frame]
    picture = Picture(run, [frame], options.color, options.view, options.dpi)
    picture.draw(frame)
    finish(picture.figure, save_path(options.save, options.run, f"frame_{frame.index:06d}.png"), options.show)


if __name__ == "__main__":
    start(main)
