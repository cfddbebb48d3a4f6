"""The commands of `ndob-fmu`: for each one its options, and a function that runs it and prints the result."""
