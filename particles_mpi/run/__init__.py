"""One run of the program from its plan to its phase table, with progress, forecast, and a check of the installation (doctor)."""
