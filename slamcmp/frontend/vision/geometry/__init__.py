"""Epipolar geometry of two images: fitted, tested against chance, and points placed by several views."""
