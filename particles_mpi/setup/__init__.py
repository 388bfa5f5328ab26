"""What set-up does once: all kernels are compiled before the first run."""
