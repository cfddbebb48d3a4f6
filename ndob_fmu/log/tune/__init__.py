"""Settings of an observer for a log by hand: what the linearised filter says with them, at once, on a local page."""
