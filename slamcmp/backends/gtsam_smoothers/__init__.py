"""Smoothers on GTSAM."""
