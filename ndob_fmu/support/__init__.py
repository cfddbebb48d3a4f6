"""What every folder may import: progress, interrupts, temporary folders, whole files, units, optional packages."""
