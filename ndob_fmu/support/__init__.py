"""What every room may use: progress, interrupts, temporary folders, units, optional packages."""
