"""The published preferred pairs (gold.h), for the independent makers of codes in the tests."""

PAIRS = {
    5: ((2, 5), (2, 3, 4, 5)),
    6: ((1, 6), (1, 2, 5, 6)),
    7: ((3, 7), (1, 2, 3, 7)),
    9: ((4, 9), (3, 4, 6, 9)),
    10: ((3, 10), (2, 3, 6, 8, 9, 10)),
    11: ((2, 11), (2, 5, 8, 11)),
}
"""The exponents of u and of v for each degree."""
