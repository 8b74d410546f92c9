"""Loops over lists instead of arrays; lists come back."""


def times(A, B):
    return [[sum(a * b for a, b in zip(row, column)) for column in zip(*B)] for row in A]


def transposed(A):
    return [list(column) for column in zip(*A)]


def plus(A, B, sign=1.0):
    return [[a + sign * b for a, b in zip(first, second)] for first, second in zip(A, B)]


def inverse_of(A):
    """Gauss-Jordan with the largest pivot."""
    size = len(A)
    rows = [list(map(float, row)) + [float(i == j) for j in range(size)] for i, row in enumerate(A)]
    for i in range(size):
        best = max(range(i, size), key=lambda k: abs(rows[k][i]))
        rows[i], rows[best] = rows[best], rows[i]
        rows[i] = [value / rows[i][i] for value in rows[i]]
        for k in range(size):
            if k != i:
                rows[k] = [a - rows[k][i] * b for a, b in zip(rows[k], rows[i])]
    return [row[size:] for row in rows]


def predict(mean, covariance, A, process_noise):
    A, P, Q = A.tolist(), [list(row) for row in covariance], process_noise.tolist()
    moved = times(A, [[value] for value in mean])
    return [row[0] for row in moved], plus(times(times(A, P), transposed(A)), Q)


def correct(mean, covariance, y, C, measurement_noise):
    C, P, R = C.tolist(), [list(row) for row in covariance], measurement_noise.tolist()
    S = plus(times(times(C, P), transposed(C)), R)
    K = times(times(P, transposed(C)), inverse_of(S))
    residual = plus([[value] for value in y], times(C, [[value] for value in mean]), -1.0)
    step = times(K, residual)
    return [a + b[0] for a, b in zip(mean, step)], plus(P, times(times(K, C), P), -1.0)


def run_filter(mean, covariance, measurements, A, C, process_noise, measurement_noise):
    means, covariances = [], []
    for t in range(len(measurements)):
        if t:
            mean, covariance = predict(mean, covariance, A, process_noise)
        if not any(value != value for value in measurements[t]):
            mean, covariance = correct(mean, covariance, measurements[t], C, measurement_noise)
        means.append(mean)
        covariances.append(covariance)
    return means, covariances
