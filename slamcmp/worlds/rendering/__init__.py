"""A small renderer for rooms of textured rectangles; imported only when an image is asked for."""
