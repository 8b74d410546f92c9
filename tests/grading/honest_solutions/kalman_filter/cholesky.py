"""Gain by a Cholesky factor of S, products by einsum."""

import numpy as np


def predict(mean, covariance, A, process_noise):
    return np.einsum("ij,j->i", A, mean), np.einsum("ij,jk,lk->il", A, covariance, A) + process_noise


def correct(mean, covariance, y, C, measurement_noise):
    L = np.linalg.cholesky(np.einsum("ij,jk,lk->il", C, covariance, C) + measurement_noise)
    W = np.linalg.solve(L, C @ covariance)
    e = np.linalg.solve(L, y - C @ mean)
    return mean + W.T @ e, covariance - W.T @ W
