"""Points followed from image to image, measured, and handed on as landmarks."""
