"""Mode `event`: all contacts in exact order of time."""
