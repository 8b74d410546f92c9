"""Whether images can be what their calibration, their clocks and the wheels say."""
