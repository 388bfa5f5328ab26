"""The program: signals first, so that none finds it with half of its imports done and leaves a traceback."""

from particles_mpi.parallel.signals import exit_on_signals

exit_on_signals()

from particles_mpi.cli import main  # noqa: E402

if __name__ == "__main__":
    main()
