"""What the user writes: the plant's equations, names, units and defaults."""
