"""What the choice of the strongest codes is compared with: the module at hand, brute force, and cycles of fields."""

from fractions import Fraction

import numpy as np

DEGREES = (5, 6, 7, 9, 10, 11)
ROUNDS = 3


class Chooser:
    """The module, with the cycle it looks at and the selection that it keeps."""

    def __init__(self, core, degree):
        self.ffi, self.lib = core
        self.family = self.lib.gold_family(degree)
        self.state = self.ffi.new("strongest_t *")
        self.despread = self.ffi.new("despread_t *")
        self.selection = self.ffi.new("epoch_selection_t *")
        self.ffi.buffer(self.state)[:] = b"\xa5" * self.ffi.sizeof("strongest_t")
        self.lib.strongest_init(self.state, self.family, self.despread)
        self.lib.strongest_clear(self.state, self.selection)

    def transform(self, samples, missing=()):
        self.lib.despread_start(self.despread, self.family)
        chip = self.ffi.new("int16_t[3]")
        for t, sample in enumerate(samples.tolist()):
            if t in missing:
                self.lib.despread_skip(self.despread, 1)
            else:
                chip[0:3] = sample
                self.lib.despread_store(self.despread, chip)
        self.lib.despread_transform(self.despread)

    def choose(self, samples, most, missing=()):
        """Choose from a cycle of samples, shape (N, 3). Returns whether anything changed."""
        self.transform(samples, missing)
        return self.lib.strongest_choose(self.state, self.despread, most, self.selection)

    def choose_of(self, correlations, most, others=(0, 0, 0)):
        """Choose from correlations by code, those of all other codes being alike and the plain sums 0.

        Balanced codes whose fields are below half a count in sum leave them as they are: a code's strength is then the
        sum of their squares.
        """
        words = np.tile(np.array(others, dtype=np.int32)[:, None], (1, 2048))
        for code, correlation in correlations.items():
            words[:, self.lib.despread_word(self.family, code)] = correlation
        self.ffi.buffer(self.despread.words)[:] = words.tobytes()
        self.ffi.buffer(self.despread.sum)[:] = bytes(12)
        self.despread.missing = 0
        return self.lib.strongest_choose(self.state, self.despread, most, self.selection)

    @property
    def codes(self):
        return [self.selection.codes[i].code for i in range(self.selection.count)]

    @property
    def strengths(self):
        return [self.state.strengths[i] for i in range(self.selection.count)]


def solve(matrix, right):
    """Solve a small system of integers in fractions."""
    rows = [[Fraction(int(value)) for value in row] + [Fraction(int(b))] for row, b in zip(matrix, right, strict=True)]
    for i in range(len(rows)):
        pivot = next(r for r in range(i, len(rows)) if rows[r][i])
        rows[i], rows[pivot] = rows[pivot], rows[i]
        for r in range(len(rows)):
            if r != i and rows[r][i]:
                factor = rows[r][i] / rows[i][i]
                rows[r] = [a - factor * b for a, b in zip(rows[r], rows[i], strict=True)]
    return [row[-1] / row[i] for i, row in enumerate(rows)]


def nearest(value):
    """Round to the nearest integer, halves away from zero."""
    return int(abs(value) + Fraction(1, 2)) * (1 if value >= 0 else -1)


def class_of(value):
    """Return the first value of a class and the first of the next: below 8 each number, then four to an octave."""
    width = 1 << max(value.bit_length() - 3, 0)
    return value // width * width, value // width * width + width


class Reference:
    """What the header says, without transform or closed form; codes by index."""

    def __init__(self, chips):
        self.chips, self.length = chips, chips.shape[1]
        self.codes = []

    def strengths(self, samples):
        """Return the strength of each code 0..N: least squares on the selection and an offset takes all else out."""
        columns = np.vstack([self.chips[self.codes], np.ones((1, self.length), dtype=np.int64)])
        found = np.zeros(self.length + 1, dtype=object)
        correlations = (self.chips[:-1] @ samples).astype(object)
        for axis in range(3):
            fit = solve((columns @ columns.T).tolist(), (columns @ samples[:, axis]).tolist())
            shares = {}
            for code in range(self.length + 1):
                if code in self.codes:
                    share = (self.length + 1) * fit[self.codes.index(code)] - correlations[code, axis]
                else:
                    total = int(self.chips[code].sum())
                    if total not in shares:  # Products of two codes are -1.
                        others = [int(self.chips[code] @ self.chips[other]) for other in self.codes]
                        shares[total] = -sum(f * o for f, o in zip(fit, [*others, total], strict=True))
                    share = shares[total]
                found[code] += (correlations[code, axis] + nearest(share)) ** 2
        return found

    def noise(self, strengths):
        absent = sorted(strengths[code] for code in range(self.length + 1) if code not in self.codes)
        rank = 3 * len(absent) // 4
        begin, end = class_of(absent[rank])
        inside = [i for i, value in enumerate(absent) if begin <= value < end]
        return max(begin + (end - begin) // len(inside) * (rank - inside[0]), self.length)

    def bar(self, most):
        enter = 8 * self.q
        return enter if len(self.codes) < most else 2 * (min(self.own) + enter)

    def choose(self, samples, most):
        most = min(most, 64, (self.length + 1) // 8)
        for _ in range(ROUNDS):
            strengths = self.strengths(samples)
            self.own = [strengths[code] for code in self.codes]
            while len(self.codes) > most:
                del self.codes[self.own.index(min(self.own))]
                strengths = self.strengths(samples)
                self.own = [strengths[code] for code in self.codes]
            self.q = self.noise(strengths)
            absent = [code for code in range(self.length + 1) if code not in self.codes]
            largest = max(strengths[code] for code in absent)
            if most == 0 or largest <= self.bar(most):
                keep = [2 * s >= 5 * self.q for s in self.own]
                self.codes = [code for code, kept in zip(self.codes, keep, strict=True) if kept]
                self.own = [s for s, kept in zip(self.own, keep, strict=True) if kept]
                return
            share = max(2 * (self.length.bit_length()) - 11, 0)
            above = max(self.bar(most), (largest - 1) >> share)
            new = sorted((code for code in absent if strengths[code] > above), key=lambda c: (-strengths[c], c))
            for code in new[:most]:
                if strengths[code] <= self.bar(most):
                    break
                if len(self.codes) < most:
                    self.codes.append(code)
                    self.own.append(strengths[code])
                else:
                    place = self.own.index(min(self.own))
                    self.codes[place], self.own[place] = code, strengths[code]


def scene(rng, chips, fields, offset=(300, -2000, 900), noise=100.0):
    """Samples of beacons (code: field vector), an offset and noise, shape (N, 3)."""
    y = rng.normal(0, noise, (chips.shape[1], 3)) + offset
    for code, field in fields.items():
        y += np.outer(chips[code], field)
    return np.clip(np.rint(y), -16384, 16376).astype(np.int64)


def far_fields(rng, length, count, strongest=3000.0):
    """Fields of beacons at random distances: a few strong ones, many weak ones."""
    codes = rng.permutation(length + 1)[:count]
    sizes = strongest / rng.uniform(1, 12, count) ** 3
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return {int(code): size * direction for code, size, direction in zip(codes, sizes, directions, strict=True)}
