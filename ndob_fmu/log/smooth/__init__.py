"""The smoothed estimate of a log: its linearised record, the passes over it, and the events that explain it."""
