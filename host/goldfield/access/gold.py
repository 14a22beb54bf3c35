"""Gold codes: the host's own generator, independent of the firmware's.

Code index k of degree n, N = 2**n - 1: k = 0..N-1 is ``u[t] XOR v[(t + k) mod N]``, N is u, N + 1 is v. Both registers
are Fibonacci, start all ones and put out their last stage. Bit 1 is chip -1.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

PREFERRED_PAIRS: dict[int, tuple[tuple[int, ...], tuple[int, ...]]] = {
    5: ((2, 5), (2, 3, 4, 5)),
    6: ((1, 6), (1, 2, 5, 6)),
    7: ((3, 7), (1, 2, 3, 7)),
    9: ((4, 9), (3, 4, 6, 9)),
    10: ((3, 10), (2, 3, 6, 8, 9, 10)),
    11: ((2, 11), (2, 5, 8, 11)),
}
"""Exponents of u and v for each degree; those of degree 10 are GPS C/A's G1 and G2 (IS-GPS-200), the others the
classical preferred pairs (Gold 1967; octal 45/75, 103/147, 211/217, 1021/1131, 4005/4445)."""


@cache
def sequence(degree: int, which: int) -> NDArray[np.uint8]:
    """Return one period of u (0) or v (1) as bits, shape (2**degree - 1,).

    Each bit is the XOR of the bits that came as many steps before as the polynomial's exponents say.

    Examples
    --------
    >>> sequence(5, 0)[:10].tolist()
    [1, 1, 1, 1, 1, 0, 0, 1, 1, 0]
    """
    taps = PREFERRED_PAIRS[degree][which]
    bits = [1] * degree
    while len(bits) < (1 << degree) - 1:
        bits.append(sum(bits[-tap] for tap in taps) & 1)
    result = np.array(bits, dtype=np.uint8)
    result.setflags(write=False)
    return result


def code_matrix(degree: int, codes: Sequence[int]) -> NDArray[np.int8]:
    """Return the chips, +1 or -1, of the codes as columns, shape (N, n).

    Raises
    ------
    ValueError
        If a code index is beyond 2**degree.

    Examples
    --------
    GPS PRN 1 begins with octal 1440:

    >>> bits = (1 - code_matrix(10, [1018])[:10, 0]) // 2
    >>> "".join(map(str, bits.tolist()))
    '1100100000'
    """
    u, v = sequence(degree, 0), sequence(degree, 1)
    chips = len(u)
    columns = []
    for code in codes:
        if not 0 <= code <= chips + 1:
            raise ValueError(f"code {code} does not exist: codes of degree {degree} are 0 to {chips + 1}")
        if code < chips:
            columns.append(u ^ np.roll(v, -code))
        else:
            columns.append(u if code == chips else v)
    bits = np.array(columns, dtype=np.int8).reshape(len(columns), chips).T
    return np.asarray(1 - 2 * bits, dtype=np.int8)
