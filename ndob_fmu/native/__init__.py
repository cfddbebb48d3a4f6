"""FMUs in C, which need no Python where they run: C text of a component, the shell around it, and its compilers."""
