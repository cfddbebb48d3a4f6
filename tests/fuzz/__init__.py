"""Random walks of legal and illegal FMI calls on real FMUs, judged call by call against a model of FMI's rules.

library: an FMU's functions, called raw; reference: which status each call must have; walk: draws, makes and judges the
calls; machine: the same walk under hypothesis. Run it from the project's folder:

    python -m tests.fuzz --calls 100000 --seed 1
"""
