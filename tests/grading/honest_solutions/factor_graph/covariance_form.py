"""Marginalises where it is easy, in the covariance: a block of the inverse, inverted again."""

import numpy as np


def marginalise(Lam, eta, keep):
    P = np.linalg.inv(Lam)
    Lam_keep = np.linalg.inv(P[np.ix_(keep, keep)])
    return Lam_keep, Lam_keep @ (P @ eta)[keep]


def marginal_covariance(Lam, keep):
    return np.linalg.inv(Lam)[np.ix_(keep, keep)]
