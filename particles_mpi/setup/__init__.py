"""Set-up: all kernels are compiled once, before the first run, and again when their source has changed.

- `warmup`: runs small scenes, which between them call all kernels
- `kernel_sources`: which kernels are out of date, by digests of all that they use
- `freshness`: the same look whenever the program starts, at what has changed since the last one
"""
