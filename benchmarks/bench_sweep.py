"""(d) Runs of a study per second: two workers over one, and over fmpy's own function for each run."""

from __future__ import annotations

from benchmarks.figures import Ratio, Section, Time
from benchmarks.sweep_throughput import rows

TEXT = (
    "The workers are processes of a local cluster that have loaded the FMUs before the time is taken. The ratios "
    "are those of the times for a run, on the clock, so that other work on the machine disturbs them. `python -m "
    "benchmarks.sweep_throughput` also measures the memory over 10 000 runs, and a study of 2000 runs."
)
# Peer, the row that compares with it, and how many times the rate of the peer is required.
PEERS = (
    ("one worker", "two workers over one, demo for 5 s at 5 ms", 1.8),
    ("fmpy.simulate_fmu afresh", "two workers over fmpy.simulate_fmu afresh, plant, 100 steps", 6.0),
)


def test_sweep(benchmark, section):
    found = {}

    def once():
        found.update({row.what: row for row in rows(("workers", "fresh"))})

    benchmark.pedantic(once, rounds=1)
    section(
        Section(
            rank=5,
            title="Studies",
            text=TEXT,
            ratios=tuple(_ratio(peer, 1.0 / found[what].measured, 1.0 / least) for peer, what, least in PEERS),
            times=tuple(Time(row.what, 1.0 / row.measured) for row in found.values() if row.unit == "runs/s"),
        )
    )


def _ratio(peer: str, measured: float, most: float) -> Ratio:
    return Ratio("a run of a study, two workers", peer, measured, measured, measured, most)
