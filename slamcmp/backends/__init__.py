"""Estimators: Kalman filter, EKF-SLAM, and GTSAM's smoothers."""
