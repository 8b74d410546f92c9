"""Entry by entry, lists where arrays are not needed; variables are eliminated one after the other."""

import numpy as np


def linear_system(factors, size):
    Lam, eta = [[0.0] * size for _ in range(size)], [0.0] * size
    for r, blocks in factors:
        for start, J in blocks:
            for a in range(J.shape[1]):
                for row in range(len(r)):
                    eta[start + a] -= J[row, a] * r[row]
                for other, K in blocks:
                    for b in range(K.shape[1]):
                        Lam[start + a][other + b] += float(
                            sum(J[row, a] * K[row, b] for row in range(len(r)))
                        )
    return np.array(Lam), np.array(eta)


def marginalise(Lam, eta, keep):
    Lam, eta = np.array(Lam, dtype=float), np.array(eta, dtype=float)
    left = list(range(len(eta)))
    for variable in range(len(eta)):
        if variable in keep:
            continue
        at = left.index(variable)
        others = [i for i in range(len(left)) if i != at]
        column = Lam[others, at] / Lam[at, at]
        eta = eta[others] - column * eta[at]
        Lam = Lam[np.ix_(others, others)] - np.outer(column, Lam[at, others])
        left.remove(variable)
    return Lam, eta
