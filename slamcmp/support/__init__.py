"""Files, configuration, progress and processes: nothing about SLAM."""
