"""Corners, few of them spread over the image, and their descriptors."""
