"""Jacobians by complex steps, exact to rounding (Squire and Trapp 1998)."""

import numpy as np

H_STEP = 1e-30


def complex_step(function, at):
    columns = []
    for number in range(len(at)):
        moved = np.array(at, dtype=complex)
        moved[number] += 1j * H_STEP
        columns.append(np.imag(function(moved)) / H_STEP)
    return np.column_stack(columns)


def drive(state, control, dt, wheelbase):
    return np.array(
        [
            state[0] + control[0] * dt * np.cos(state[2]),
            state[1] + control[0] * dt * np.sin(state[2]),
            state[2] + control[0] * dt * np.tan(control[1]) / wheelbase,
        ]
    )


def motion_jacobian(state, control, dt, wheelbase):
    return complex_step(lambda s: drive(s, control, dt, wheelbase), state)


def measurement_jacobian(state, landmark):
    def seen(s):
        x, y = landmark[0] - s[0], landmark[1] - s[1]
        # arctan2 takes no complex numbers: about the real angle, where the rest of it is small.
        angle = np.arctan2(y.real, x.real)
        rest = np.arctan((y * np.cos(angle) - x * np.sin(angle)) / (x * np.cos(angle) + y * np.sin(angle)))
        return np.array([np.sqrt(x * x + y * y), angle + rest - s[2]])

    return complex_step(seen, state)
