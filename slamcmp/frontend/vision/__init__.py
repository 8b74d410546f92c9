"""From images to verified matches; nothing here is imported for planar data, which needs no OpenCV."""
