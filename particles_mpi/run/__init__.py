"""One run of the program from its plan to its phase table, and what is needed around it: set-up, signals, forecast."""
