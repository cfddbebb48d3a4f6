"""One module for each component FMU that fits any plant; it defines `RECORD`."""
