"""Which samples are refused: each is explained as good, as an outlier or as one that repeats an earlier sample.

Good samples have the innovation e with the variance α. Outliers have 100, 10 000 or 1e6 times the noise, and are as
frequent as they were until now. A few of them are of any size, as the numbers that stand for a missing sample. A
faulty sample that repeats the value before it predicts that value exactly; good samples repeat a value as often as
they did until now. The explanation of higher probability decides. Hypotheses of a jump (`jump_bank`) judge a refused
sample for themselves.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log

# A sample nearer to its prediction than so many standard deviations is good.
SUSPICIOUS = 2.5
# The share of outliers that is expected before the first sample. Their probability is a share doubled, because an
# outlier that is taken for a jump costs more than a jump that is found a sample later; and the least one more, which
# keeps the first outlier after many good samples from being one. It is at most the last number.
FIRST_RATE = 0.009
_LEAST, _TIMES, _MOST = 0.002, 2.0, 0.1
# Outliers come in bursts: each one that was found lately adds to the share.
_BURST = 0.01
# The probability of a fault that repeats a sample.
_REPEATED = 0.02
# After another fault of the sensor or in the same sample, a faulty one is as likely as a good one.
_LOG_ODDS_AGAIN = 0.0
# During the start the covariance is not sure enough to call a sample faulty that is only somewhat improbable.
_LOG_ODDS_AT_START = -30.0
_OUTLIERS = (1e4, 1e8, 1e12)  # variance over that of the noise
# The share of outliers that are of any size. It is so small that a jump explains what it may explain at all: without
# noise all innovations of a jump are larger than the outliers above.
_LOG_ANY_SIZE = -20.0
_RAREST_REPEAT = 1e-4


def is_stuck(in_a_row: float) -> bool:
    """Return whether a sensor is stuck rather than good, for the probability of its repeats as in `SensorMemory`."""
    return in_a_row < log(_REPEATED / (1.0 - _REPEATED))


@dataclass(frozen=True)
class Judgement:
    """What a sample of one output is taken for.

    refused: whether it is not used.
    if_good, if_faulty: logarithms of its probability, over the density of a good sample at its prediction.
    """

    refused: bool
    if_good: float
    if_faulty: float


def judge(
    squared: float,
    e: float,
    alpha: float,
    variance: float,
    *,
    repeats: bool,
    repeat_rate: float,
    outlier_rate: float,
    doubtful: float,
    again: bool,
    starting: bool,
    broken: bool,
    settled: bool,
    change: float,
) -> Judgement:
    """Judge a sample with the innovation e, e²/α = `squared`, whose noise has a variance.

    repeats: whether it repeats the sample before
    repeat_rate: how often good samples do
    outlier_rate, doubtful: as in `SensorMemory`
    again: whether a fault has been found in this sample, or in the last one of this output
    broken: whether its sensor is, whose samples then have the last one as their mean
    settled: whether a jump that explains why would have shown by now
    change: from the last one
    """
    share = _REPEATED if repeats else min(_LEAST + _TIMES * (outlier_rate + _BURST * doubtful), _MOST)
    odds = _LOG_ODDS_AGAIN if again else log(share / (1.0 - share))
    if starting and not repeats:
        odds = _LOG_ODDS_AT_START
    good = -0.5 * squared
    if repeats:
        good += log(max(repeat_rate, _RAREST_REPEAT))
        faulty = odds
    else:
        usual = max(_log_density(e, alpha, alpha + more * variance) for more in _OUTLIERS) - log(len(_OUTLIERS))
        of_any_size = _log_density(e, alpha, max(e * e, alpha)) + _LOG_ANY_SIZE
        faulty = odds + max(usual, of_any_size)
    # That the sensor is broken is no reason against a jump at first: what a jump explains is one.
    stays = _log_density(change, alpha, 2.0 * variance) if broken and not repeats else faulty
    stays = max(faulty, stays)
    return Judgement(refused=stays > good, if_good=good, if_faulty=stays if settled else faulty)


def _log_density(e: float, alpha: float, variance: float) -> float:
    """Return the logarithm of the density of e with a variance, over that of 0 with the variance α."""
    return -0.5 * (e * e / variance + log(variance / alpha))
