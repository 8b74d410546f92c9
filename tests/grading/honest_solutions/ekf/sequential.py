"""One landmark after the other, all linearised at the predicted mean; Joseph form."""

import numpy as np


def ekf_step(mean, covariance, control, dt, wheelbase, process_noise, landmarks, observations, noise):
    predicted = motion(mean, control, dt, wheelbase)
    P = propagate(covariance, motion_jacobian(mean, control, dt, wheelbase), process_noise)
    mean = predicted
    for landmark, z in zip(landmarks, observations):
        H = measurement_jacobian(predicted, landmark)
        # What is left of the innovation after the observations before, without linearising anew.
        y = innovation(z, measurement(predicted, landmark)) - H @ (mean - predicted)
        mean, P = update(mean, P, y, H, noise)
    return mean, P


def update(mean, covariance, y, H, noise):
    K = np.linalg.solve(H @ covariance @ H.T + noise, H @ covariance).T
    left = np.eye(3) - K @ H
    return mean + K @ y, left @ covariance @ left.T + K @ noise @ K.T
