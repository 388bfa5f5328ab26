"""Set-up: all kernels are compiled once, before the first run, and again when their source has changed.

- `warmup`: runs small scenes which together call all kernels
- `kernel_sources`: finds the kernels that are out of date, by digests of all that they use
- `freshness`: checks that whenever the program starts, for files that have changed since the last check
"""
