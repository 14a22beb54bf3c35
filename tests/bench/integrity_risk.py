"""Upper limits of a risk from counts of rare events, and what they mean per hour."""

from __future__ import annotations

from scipy.special import betaincinv

CONFIDENCE = 0.95
CORRELATION_S = 10.0
"""Time after which epochs of one sensor count as independent: it has then moved to another geometry. An epoch every
0.1 s is a hundredth of an independent one; a fault or a bad place that lasts is one event, not a hundred."""


def upper_limit(events: int, trials: int, confidence: float = CONFIDENCE) -> float:
    """Return the one-sided upper limit of a probability by Clopper and Pearson (1934); 1 without trials."""
    if events >= trials:
        return 1.0
    return float(betaincinv(events + 1, trials - events, confidence))


def per_hour(risk: float) -> float:
    """Return the probability of at least one event in an hour of epochs, one independent each `CORRELATION_S`."""
    return float(1.0 - (1.0 - risk) ** (3600.0 / CORRELATION_S))
