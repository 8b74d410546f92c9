"""Jacobians by central differences."""

import numpy as np


def differentiated(function, at):
    columns = []
    for step in 1e-5 * np.eye(len(at)):
        difference = function(at + step) - function(at - step)
        columns.append(difference / 2e-5)
    return np.array(columns).T


def motion_jacobian(state, control, dt, wheelbase):
    return differentiated(lambda x: motion(x, control, dt, wheelbase), state)


def measurement_jacobian(state, landmark):
    predicted = measurement(state, landmark)
    return differentiated(lambda x: innovation(measurement(x, landmark), predicted), state)
