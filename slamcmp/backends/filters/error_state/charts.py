"""Error-state charts: the coordinates in which an EKF-SLAM keeps its covariance.

A chart says what an error vector (pose part e, landmark parts r) means. To first order, with xi the body
tangent of the pose and dl a landmark's offset in world axes,

    xi = A e,    dl = B(l) e + C r,

and everything a filter needs follows from A, B, C: Jacobians in the chart are ``H_pose A + H_land B`` and
``H_land C``. The retraction is exact, not first order, and is what tells charts with equal A, B, C apart.

========  ===================================================================================
symbol    meaning
========  ===================================================================================
e, r      the chart's error of the pose (p,) and of one landmark (n,)
A         chart to body tangent, (p, p)
B, C      chart to the landmark's world offset: by the pose's error (L, n, p), by its own (n, n)
F         the pose error's transition over a step without noise, (p, p)
========  ===================================================================================

None stands for an identity (A, C, F) or zero (B). In all charts a step leaves every landmark's error as it
was, up to the rotation C_to^T C_from and the step's noise.
"""

from __future__ import annotations

import numpy as np

from slamcmp.geometry import adjoint, adjoint_of_inverse, exp, hat, inverse, log, so3_left_jacobian
from slamcmp.types import TANGENT_DIM, FloatArray


class Chart:
    """The body tangent with landmarks in world axes: T exp(e), l + r (the chart of every border).

    Args:
        space_dim: n, 2 or 3.
        T_start: the first pose, (n+1, n+1). Charts with a lever arm from somewhere to the robot have it from
            there, and not from the origin of somebody's coordinates, which may lie any distance away; None:
            the origin.
    """

    def __init__(self, space_dim: int, T_start: FloatArray | None = None) -> None:
        self.n = space_dim
        self.p = TANGENT_DIM[space_dim]
        self._T_start = np.eye(space_dim + 1) if T_start is None else np.array(T_start)
        self._p_start: FloatArray = self._T_start[:-1, -1]
        self.turn = slice(2, 3) if space_dim == 2 else slice(0, 3)
        """Rotation entries of a pose's error."""
        self.shift = slice(0, 2) if space_dim == 2 else slice(3, 6)
        """Translation entries of a pose's error."""

    def to_body(self, T: FloatArray) -> FloatArray | None:  # noqa: ARG002
        """A at the pose T (n+1, n+1)."""
        return None

    def from_body(self, T: FloatArray) -> FloatArray | None:  # noqa: ARG002
        """A^-1 at the pose T."""
        return None

    def offsets(self, T: FloatArray, landmarks: FloatArray) -> FloatArray | None:  # noqa: ARG002
        """B at the pose T for landmarks (L, n), (L, n, p)."""
        return None

    def axes(self, T: FloatArray) -> FloatArray | None:  # noqa: ARG002
        """C at the pose T, a rotation (n, n)."""
        return None

    def transition(self, T_from: FloatArray, T_to: FloatArray) -> FloatArray | None:
        """F for a step between two poses."""
        return adjoint(inverse(T_to) @ T_from)

    def retract(
        self, T: FloatArray, landmarks: FloatArray, error: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Mean moved by an error (..., p + n L): poses (..., n+1, n+1) and landmarks (..., L, n)."""
        return T @ exp(error[..., : self.p]), landmarks + self._parts(error)

    def errors(
        self, T: FloatArray, landmarks: FloatArray, T_moved: FloatArray, moved: FloatArray
    ) -> FloatArray:
        """The error (..., p + n L) that ``retract`` would need for poses (..., n+1, n+1) and landmarks."""
        return self._joined(log(inverse(T) @ T_moved), moved - landmarks)

    def _joined(self, pose_error: FloatArray, parts: FloatArray) -> FloatArray:
        return np.concatenate([pose_error, parts.reshape(*parts.shape[:-2], -1)], axis=-1)

    def _parts(self, error: FloatArray) -> FloatArray:
        return error[..., self.p :].reshape(*error.shape[:-1], -1, self.n)

    def _smear(self, error: FloatArray) -> FloatArray:
        """V (..., n, n), with V r the translation of the group's exponential for the error's rotation."""
        omega = error[..., self.turn]
        if self.n == 3:
            return so3_left_jacobian(omega)
        # V (1, 0) is where the exponential of (1, 0, theta) ends; V turns and shrinks as a complex number.
        xi = np.zeros((*omega.shape[:-1], 3))
        xi[..., 0], xi[..., 2:] = 1.0, omega
        T = exp(xi)
        V = np.empty((*omega.shape[:-1], 2, 2))
        V[..., 0, 0] = V[..., 1, 1] = T[..., 0, 2]
        V[..., 1, 0] = T[..., 1, 2]
        V[..., 0, 1] = -T[..., 1, 2]
        return V

    def _unsmeared(self, error: FloatArray, smeared: FloatArray) -> FloatArray:
        """V^-1 of points (..., L, n)."""
        return smeared @ np.swapaxes(np.linalg.inv(self._smear(error)), -1, -2)

    def _cross(self, points: FloatArray) -> FloatArray:
        """M (..., n, 1 or 3) with ``omega x point == M omega``."""
        if self.n == 3:
            return -hat(points)
        turned = np.empty((*points.shape, 1))
        turned[..., 0, 0], turned[..., 1, 0] = -points[..., 1], points[..., 0]
        return turned


class WorldChart(Chart):
    """The textbook's error: position and landmarks additive in the world, p + e_p, exp(e_w) R, l + r.

    In the plane the heading is additive; in space the rotation error acts on the left, in world axes
    (SO(3) x R^n in Zhang, Wu, Huang 2017).
    """

    def to_body(self, T: FloatArray) -> FloatArray:
        A = np.zeros((self.p, self.p))
        A[self.shift, self.shift] = T[: self.n, : self.n].T
        if self.n == 2:
            A[2, 2] = 1.0
        else:
            A[self.turn, self.turn] = T[:3, :3].T
        return A

    def from_body(self, T: FloatArray) -> FloatArray:
        return self.to_body(T).T

    def transition(self, T_from: FloatArray, T_to: FloatArray) -> FloatArray:
        F = np.eye(self.p)
        F[self.shift, self.turn] = self._cross(T_to[:-1, -1] - T_from[:-1, -1])
        return F

    def retract(
        self, T: FloatArray, landmarks: FloatArray, error: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        n = self.n
        rotation_only = error[..., : self.p].copy()
        rotation_only[..., self.shift] = 0.0
        moved = exp(rotation_only) @ T
        moved[..., :n, n] = T[:n, n] + error[..., self.shift]
        return moved, landmarks + self._parts(error)

    def errors(
        self, T: FloatArray, landmarks: FloatArray, T_moved: FloatArray, moved: FloatArray
    ) -> FloatArray:
        n = self.n
        turned = T_moved @ inverse(T)
        turned[..., :n, n] = 0.0
        error: FloatArray = log(turned)
        error[..., self.shift] = T_moved[..., :n, n] - T[:n, n]
        return self._joined(error, moved - landmarks)


class RightInvariantChart(Chart):
    """One rigid motion for pose and map: exp(e) T, and l = R(e) l + V(e) r (SE_{1+L}(n) from the left).

    All positions are those from the start, in the world's axes: a rotation about a far origin would move
    everything by far more than anything is known to.

    Barrau and Bonnabel 2015, "An EKF-SLAM algorithm with consistency properties"; Zhang, Wu, Huang 2017.
    The gauge directions do not depend on the estimate, so no linearisation point can spoil them.
    """

    def to_body(self, T: FloatArray) -> FloatArray:
        return adjoint_of_inverse(self._from_start(T))

    def from_body(self, T: FloatArray) -> FloatArray:
        return adjoint(self._from_start(T))

    def offsets(self, T: FloatArray, landmarks: FloatArray) -> FloatArray:  # noqa: ARG002
        B = np.zeros((*landmarks.shape, self.p))
        B[..., self.turn] = self._cross(landmarks - self._p_start)
        return B

    def transition(self, T_from: FloatArray, T_to: FloatArray) -> None:  # noqa: ARG002
        return None

    def retract(
        self, T: FloatArray, landmarks: FloatArray, error: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        E = exp(error[..., : self.p])
        R = E[..., : self.n, : self.n]
        V = self._smear(error)
        T_moved = E @ self._from_start(T)
        T_moved[..., : self.n, self.n] += self._p_start
        turned = (landmarks - self._p_start) @ np.swapaxes(R, -1, -2)
        return T_moved, turned + self._parts(error) @ np.swapaxes(V, -1, -2) + self._p_start

    def errors(
        self, T: FloatArray, landmarks: FloatArray, T_moved: FloatArray, moved: FloatArray
    ) -> FloatArray:
        E = self._from_start(T_moved) @ inverse(self._from_start(T))
        error = log(E)
        turned = (landmarks - self._p_start) @ np.swapaxes(E[..., : self.n, : self.n], -1, -2)
        return self._joined(error, self._unsmeared(error, moved - self._p_start - turned))

    def _from_start(self, T: FloatArray) -> FloatArray:
        T_near = T.copy()
        T_near[..., : self.n, self.n] -= self._p_start
        return T_near


class LeftInvariantChart(Chart):
    """Pose and map moved in the body's axes: T exp(e), l + R V(e) r (SE_{1+L}(n) from the right)."""

    def axes(self, T: FloatArray) -> FloatArray:
        return T[: self.n, : self.n]

    def retract(
        self, T: FloatArray, landmarks: FloatArray, error: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        in_body = self._parts(error) @ np.swapaxes(self._smear(error), -1, -2)
        return T @ exp(error[..., : self.p]), landmarks + in_body @ T[: self.n, : self.n].T

    def errors(
        self, T: FloatArray, landmarks: FloatArray, T_moved: FloatArray, moved: FloatArray
    ) -> FloatArray:
        error = log(inverse(T) @ T_moved)
        return self._joined(error, self._unsmeared(error, (moved - landmarks) @ T[: self.n, : self.n]))


class RobocentricChart(WorldChart):
    """Everything where the robot sees it: q + r with q = T^-1 l, and e the error of the start's own pose.

    Castellanos et al. 2007, "Robocentric map joining": the state is X = T^-1 T_start, with e additive as in
    the world chart, and every landmark in the body frame. The observation depends on r alone; a step turns
    and shakes every landmark.
    """

    def to_body(self, T: FloatArray) -> FloatArray:
        # X = exp(-xi) X_hat gives omega = -e_w and v = -e_p + e_w x p, p the start as seen.
        A = -np.eye(self.p)
        A[self.shift, self.turn] = self._cross(self._seen(T, self._p_start))
        return A

    def from_body(self, T: FloatArray) -> FloatArray:
        # A is its own inverse: [[-1, M], [0, -1]].
        A_inv = -np.eye(self.p)
        A_inv[self.shift, self.turn] = -self._cross(self._seen(T, self._p_start))
        return A_inv

    def offsets(self, T: FloatArray, landmarks: FloatArray) -> FloatArray:
        R, q = T[: self.n, : self.n], self._seen(T, landmarks)
        # dl = R (r + v + omega x q) with v and omega from e.
        B = np.empty((*q.shape, self.p))
        B[..., self.shift] = -R
        B[..., self.turn] = R @ self._cross(self._seen(T, self._p_start) - q)
        return B

    def axes(self, T: FloatArray) -> FloatArray:
        return T[: self.n, : self.n]

    def transition(self, T_from: FloatArray, T_to: FloatArray) -> FloatArray:
        back = T_to[: self.n, : self.n].T @ T_from[: self.n, : self.n]
        F = np.eye(self.p)
        F[self.shift, self.shift] = back
        if self.n == 3:
            F[self.turn, self.turn] = back
        return F

    def retract(
        self, T: FloatArray, landmarks: FloatArray, error: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        q = self._seen(T, landmarks)
        X, q_moved = super().retract(inverse(T) @ self._T_start, q, error)
        moved = self._T_start @ inverse(X)
        R, p = moved[..., : self.n, : self.n], moved[..., : self.n, self.n]
        return moved, q_moved @ np.swapaxes(R, -1, -2) + p[..., None, :]

    def errors(
        self, T: FloatArray, landmarks: FloatArray, T_moved: FloatArray, moved: FloatArray
    ) -> FloatArray:
        R, p = T_moved[..., : self.n, : self.n], T_moved[..., : self.n, self.n]
        q_moved = (moved - p[..., None, :]) @ R
        X, X_moved = inverse(T) @ self._T_start, inverse(T_moved) @ self._T_start
        return super().errors(X, self._seen(T, landmarks), X_moved, q_moved)

    def _seen(self, T: FloatArray, points: FloatArray) -> FloatArray:
        return (points - T[: self.n, self.n]) @ T[: self.n, : self.n]
