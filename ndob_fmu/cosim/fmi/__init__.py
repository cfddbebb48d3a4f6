"""One FMU as a component: archive, description, values, log."""
