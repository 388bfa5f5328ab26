"""Set-up: all kernels are compiled once, before the first run, and again when their source has changed."""
